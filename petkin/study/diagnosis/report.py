"""What the page of a scan shows of its diagnosis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis import Diagnosis
from petkin.diagnosis.refit import Fit
from petkin.fitting import Status
from petkin.io import RegionalCurves
from petkin.reporting import GapReport, MapSet, ParameterMap, RegionCurves
from petkin.study.diagnosis.including import included
from petkin.study.diagnosis.regional import PRIOR, RegionalSimulator
from petkin.study.diagnosis.shared_law import SharedLaw
from petkin.study.diagnosis.sidecar import Blunder
from petkin.study.diagnosis.state import StatesRead
from petkin.study.diagnosis.state_files import drawn_states
from petkin.study.fit_report import directions
from petkin.study.sources import Source

#: A rate is far below its prior's median from this many of its standard deviations on.
_FAR = 2.0


@dataclass(frozen=True)
class Judged:
    """A scan's diagnosis, and what it was compared with; what its sidecar shows, the gap by voxel where there is an
    image, the state map, and the law of noise as other scans tell it too."""

    found: Diagnosis
    simulator: RegionalSimulator
    shown: tuple[Blunder, ...]
    gap: NDArray[np.float32] | None
    states: StatesRead | None
    shared: SharedLaw | None


def gap_report(
    source: Source,
    curves: RegionalCurves,
    one: Judged,
    text: dict[str, Any],
    command_line: str,
) -> GapReport:
    """Everything that the page shows.

    Args:
        source: the scan.
        curves: its regional curves.
        one: what was found.
        text: the answer.
        command_line: what was typed.
    """
    shape, found = curves.values.shape, one.found
    leader = found.causes[0].fit if found.causes else None
    return GapReport(
        title=f"{source.label}: where the simulator and the scan part",
        answer=text,
        curves=RegionCurves(curves.names, curves.frames, curves.values),
        before=found.base.values,
        after=None if leader is None else leader.values,
        residual=found.base.residual.reshape(shape),
        residual_after=None if leader is None else leader.residual.reshape(shape),
        alike=tuple(sorted((tuple(sorted(pair)), c) for pair, c in found.alike.items())),
        visible=tuple((v.hypothesis.name, v.detectability, v.kept, v.partners[:1]) for v in found.visible),
        shown=tuple((b.effect, b.why) for b in one.shown),
        gap_map=_gap_map(source, one),
        lacking=drawn_states(one.states),
        scan=(*source.facts, *_included(one), ("Noise", _law_of_noise(one.simulator, one.shared))),
        warnings=_warnings(source, one),
        command_line=command_line,
    )


def _included(one: Judged) -> tuple[tuple[str, str], ...]:
    """What the refit makes of included effects; of what regions have for themselves the middle, and how far it goes."""
    found: dict[str, list[str]] = {}
    every = included(one.simulator, one.found.base)
    for effect, symbol in dict.fromkeys((e.effect, e.symbol) for e in every):
        mine = [e for e in every if (e.effect, e.symbol) == (effect, symbol)]
        values, unit = [e.value for e in mine], "" if mine[0].unit == "1" else f" {mine[0].unit}"
        text = f"{symbol} {float(np.median(values)):.3g}{unit}"
        if len(mine) > 1:
            text += f" ({min(values):.3g} to {max(values):.3g} over the regions)"
        elif mine[0].low < mine[0].high:
            text += f" ({mine[0].low:.3g} to {mine[0].high:.3g})"
        found.setdefault(effect, []).append(text)
    return tuple((f"Included {effect}", "; ".join(texts)) for effect, texts in found.items())


def _law_of_noise(simulator: RegionalSimulator, shared: SharedLaw | None) -> str:
    """Which it is, and how it came to be taken."""
    if shared is not None and shared.law == simulator.law:
        return f"{simulator.law}; {shared}"
    instead = "" if not len(simulator.law_errors) else "; by that of counts there would be a gap, which it explains"
    return f"{simulator.law}{instead}"


def _warnings(source: Source, one: Judged) -> tuple[str, ...]:
    """What was odd about the files and the refit, and what hybrids have not seen; each once."""
    unseen = () if one.states is None else one.states.remarks
    said = [
        *map(str, source.remarks),
        *one.simulator.input.remarks,
        *irreversible(one.simulator, one.found.base),
        *unseen,
    ]
    return tuple(dict.fromkeys(said))


def irreversible(simulator: RegionalSimulator, fit: Fit) -> tuple[str, ...]:
    """A remark where k4 refits so far below what its prior takes for likely that the prior itself is a gap."""
    if "k4" not in simulator.own.symbols:
        return ()
    median, sd = PRIOR["k4"]
    k4 = float(np.exp(np.median(fit.state.own[:, simulator.own.symbols.index("k4")])))
    if k4 > median * np.exp(-_FAR * sd):
        return ()
    return (
        f"k4 refits to {k4:.2g} min^-1 (median of the regions), far below the {median:g} that is likely beforehand, "
        "which can pass for a gap. Where binding is irreversible, as of FDG, use --model 2tcm3k.",
    )


def _gap_map(source: Source, one: Judged) -> MapSet | None:
    """The voxel map as a report draws maps."""
    if one.gap is None or source.image is None:
        return None
    mask = np.isfinite(one.gap)
    z = one.gap.ravel(order="F")[mask.ravel(order="F")]
    x, y, z_mm = (float(edge) for edge in source.image.voxel_mm)
    status = np.full(z.size, Status.OK, np.uint8)
    return MapSet((ParameterMap("z", "", z),), status, mask, (x, y, z_mm), directions(source.image.affine))
