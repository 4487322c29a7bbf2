"""A diagnosis of regions together with what the image of the same scan shows."""

from __future__ import annotations

from dataclasses import dataclass, replace

from petkin.diagnosis import CLAIM, Cause, Diagnosis, Elsewhere, Estimate, Fit, smallest_set
from petkin.io import read_regions
from petkin.study.diagnosis.picture import Picture, Voxels, read_picture
from petkin.study.diagnosis.regional import RegionalSimulator
from petkin.study.diagnosis.spatial import Looked, look
from petkin.study.sources import Source

#: From this log evidence on the image, not the regions, says how large an effect is and when it set in.
_SURE = 3.0
#: What the smaller of two p-values, of regions and of contrasts, is multiplied by. Of 182 training scans of noise alone
#: 0.027 then lie below 0.03, and 0.060 with 2.
_TESTS = 2.5
#: Effects whose size an image gives in mm.
_IN_MM = ("partial_volume", "motion_step", "motion_drift")


@dataclass(frozen=True)
class Imaged:
    """What the image of a scan adds: its voxels, and what contrasts say of spatial effects and gaps of no name."""

    voxels: Voxels
    looked: Looked

    @property
    def log_odds(self) -> dict[str, float]:
        return self.looked.log_odds

    @property
    def elsewhere(self) -> Elsewhere | None:
        """What the image says of a gap of no name."""
        unnamed = self.looked.contrasted.unnamed
        return None if unnamed is None else Elsewhere(unnamed, self.log_odds)


def picture_of(source: Source, simulator: RegionalSimulator, fit: Fit) -> Picture | None:
    """The image behind a scan's regional curves; None where those are all there is.

    Args:
        source: the scan.
        simulator: what predicts the means over the regions of its segmentation.
        fit: of the simulator to them.
    """
    if source.image is None or source.dseg is None or source.curves is not None:
        return None
    return read_picture(source.image, read_regions(source.dseg, source.image), simulator, fit)


def look_at_image(
    picture: Picture, simulator: RegionalSimulator, fit: Fit, names: frozenset[str], *, seed: int
) -> Imaged:
    """The image's own evidence on spatial effects.

    Args:
        picture: the image.
        simulator: what predicts the means over its regions.
        fit: of the simulator to them.
        names: of the candidates.
        seed: of the draws of noise.
    """
    voxels = Voxels.of(picture, simulator, fit)
    return Imaged(voxels, look(voxels, simulator, names, seed=seed))


def weighed(found: Diagnosis, looked: Looked) -> Diagnosis:
    """A diagnosis that knew the image's evidence beforehand, with the p-value of either, and sizes in mm.

    Args:
        found: of the regions, whose hypotheses carried the image's evidence.
        looked: what contrasts say.
    """
    p = min(1.0, _TESTS * min(found.p_value, looked.contrasted.p_value))
    present = p <= CLAIM
    likely = tuple(_sized(cause, looked) for cause in found.likely)
    chosen: tuple[str, ...] = ()
    if present and found.unknown < 0.5:
        chosen = smallest_set({cause.label: cause.probability for cause in likely}, found.alike)
    leader = likely[0]
    onset = next((e.value for e in leader.estimates if e.symbol == "onset"), None)
    frame = next((int(e.value) for e in leader.estimates if e.symbol == "frame"), None)
    return replace(
        found,
        present=present,
        p_value=p,
        causes=likely if present else (),
        likely=likely,
        chosen=chosen,
        set_probability=sum(cause.probability for cause in likely if cause.label in chosen),
        onset=onset if present else None,
        frame=frame if present else None,
    )


def _sized(cause: Cause, looked: Looked) -> Cause:
    """The cause with the image's amplitude and onset where the image is surer than the regions' means can be."""
    estimates = list(cause.estimates)
    for name in cause.effects:
        best = looked.contrasted.best.get(name)
        if best is None or looked.contrasted.evidence[name] < _SURE:
            continue
        place = cause.effects.index(name)
        amplitudes = [i for i, e in enumerate(estimates) if e.symbol == "amplitude"]
        if name in _IN_MM and place < len(amplitudes):
            low, high = sorted((abs(best.low), abs(best.high)))
            size = abs(best.value)
            if name == "partial_volume":
                spread = 0.5 * (high - low) / max(size, 1e-300) / 2.0  # blur grows with the square of its width
                size = looked.width_mm
                low, high = size * max(1.0 - spread, 0.0), size * (1.0 + spread)
            estimates[amplitudes[place]] = Estimate("amplitude", "mm", size, low, high)
        if len(cause.effects) == 1:
            units = {"onset": "min"} | ({"axis": "1"} if name in _IN_MM else {})
            setting = {
                symbol: float(best.pattern.setting[symbol]) for symbol in units if symbol in best.pattern.setting
            }
            estimates = [e for e in estimates if e.symbol not in setting]
            estimates += [Estimate(symbol, units[symbol], *(3 * [value])) for symbol, value in setting.items()]
    return replace(cause, estimates=tuple(estimates))
