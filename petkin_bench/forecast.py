"""Real curves, the later half withheld: fits of the earlier half against what other people's scans teach.

Every person is left out in turn. From the whole curves of the others a prior is learned, with one tissue compartment
and with the hybrid on it (`petkin.learning.prior`); the person's own curves are seen until half of the scan, and
forecast until its end. The plain fits of one and two tissue compartments see the same frames. The delay of the input
is estimated from those frames as well; the blood is known until the end of the scan.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.fitting import NonlinearSettings, estimate_delay, fit_curves
from petkin.hybrid import Settings
from petkin.imaging import FrameObservation
from petkin.inputs import InputFunction
from petkin.kinetics import TWO_TISSUE, compartment_model
from petkin.learning import Conditions, Curves, Known, TissuePrior, identify, learn, tissue_task
from petkin.study.arterial import arterial_input
from petkin.study.reading import read_sources
from petkin.study.request import FitRequest
from petkin.study.sources import Source
from petkin.study.whole_brain import frame_weights

Array = NDArray[np.float64]

#: Mean of a scan's curves after scaling, the scale of f_NN; most regions of a scan that are used.
_LEVEL, _REGIONS = 10.0, 6
#: c_p of real tissue.
_BOUNDS = {"K1": (0.0, 1.0), "k2": (0.0, 1.0), "k3": (0.0, 0.5), "k4": (0.0, 0.5), "vB": (0.0, 0.2)}
_HIGHEST = 2.0
_LEARN, _IDENTIFY = Settings(steps=400, rate=1e-2), Settings(steps=200, rate=1e-2)
#: What is learned from the others: name, way of modelling, what f_NN sees.
LEARNED = (
    ("prior_1TCM", "purely_physics", ""),
    ("hybrid_C_T,C_P", "meta_hylad", "C_T,C_P"),
    ("hybrid_hidden", "meta_hylad", "hidden"),
    ("hybrid_held", "meta_hylad", "held"),
    ("prior_2TCM", "full_physics", ""),
)
FITS = ("1TCM", "2TCM")


@dataclass(frozen=True)
class Scan:
    """One scan, its curves scaled to a common level.

    Args:
        label, person: whose.
        curves: (R, K).
        regions: their names.
        known: input, delayed as the seen frames tell, and frames.
        weights: of all frames (K,).
        seen: frames that end within the earlier half (K,).
    """

    label: str
    person: str
    curves: Array
    regions: tuple[str, ...]
    known: Known
    weights: Array
    seen: NDArray[np.bool_]


def read_scans(folder: Path, seg: str | None = None, sessions: tuple[str, ...] = ()) -> tuple[Scan, ...]:
    """Scans of a study, those with the most usual number of frames, in regions that all have.

    Raises:
        InputError: no such study, or no scan with curves and blood.
    """
    request = FitRequest(folder, level="region", seg=seg, sessions=sessions, models=("1TCM",))
    sources = [source for source in read_sources(request)[2] if source.curves is not None]
    if not sources:
        raise InputError(f"{folder}: no scan has regional curves to forecast.")
    counts = [len(source.frames) for source in sources]
    usual = max(set(counts), key=counts.count)
    sources = [source for source, count in zip(sources, counts) if count == usual]
    names = set.intersection(*(set(s.curves.names) for s in sources if s.curves is not None))
    ordered = [name for name in sources[0].curves.names if name in names]  # type: ignore[union-attr]
    chosen = tuple(ordered[i] for i in np.unique(np.linspace(0, len(ordered) - 1, _REGIONS).round().astype(int)))
    return tuple(_scan(source, request, chosen) for source in sources)


def _scan(source: Source, request: FitRequest, regions: tuple[str, ...]) -> Scan:
    assert source.curves is not None
    rows = [source.curves.names.index(name) for name in regions]
    curves, frames = source.curves.values[rows], source.curves.frames
    observation = FrameObservation(frames, source.decay)
    whole = curves.mean(axis=0)
    weights, _ = frame_weights(whole, source, request)
    seen = frames.end <= 0.5 * frames.end[-1]
    arterial = arterial_input(source, request)
    delay = estimate_delay(whole, arterial, observation, weights * seen, TWO_TISSUE, rate_bounds=(1e-3, 5.0))
    delayed = arterial.delayed(0.0 if delay.at_end else delay.minutes)
    known = Known(delayed.plasma, delayed.whole_blood, observation)
    return Scan(source.label, source.entities["sub"], curves, regions, known, weights, seen)


def measure_forecasts(
    scans: tuple[Scan, ...], progress: Callable[[str, float], None] = lambda what, share: None
) -> Iterator[list[dict[str, object]]]:
    """One row a curve and way of forecasting, person by person: relative error over the withheld frames, root mean
    square and mean."""
    conditions = Conditions.of([s.known for s in scans], torch.eye(len(scans)), highest=_HIGHEST)
    people = sorted({scan.person for scan in scans})
    for i, person in enumerate(people):
        own = [scan for scan in scans if scan.person == person]
        rows = [row for scan in own for label in FITS for row in _rows(scan, f"fit_{label}", _fit(scan, label))]
        for j, (name, dynamics, sees) in enumerate(LEARNED):
            progress(f"{person} {name}", (i + j / len(LEARNED)) / len(people))
            start = time.process_time()
            found = _learned(scans, conditions, person, dynamics, sees)
            spent = {"cpu_s": time.process_time() - start}
            rows += [row | spent for scan, values in found for row in _rows(scan, name, values)]
        yield rows


def _fit(scan: Scan, label: str) -> Array:
    """Frame values that a fit of the seen frames predicts (R, K)."""
    known, settings = scan.known, NonlinearSettings(compartment_model(label), standard_errors=False)
    arterial = InputFunction(known.plasma, known.blood)
    found = fit_curves(scan.curves, arterial, known.observation, scan.weights * scan.seen, settings)
    model = settings.model
    parameters = torch.tensor(np.stack([found[symbol] for symbol in model.parameters.symbols], axis=-1))
    return model.frame_values(parameters, arterial, known.observation).numpy()


def _learned(
    scans: tuple[Scan, ...], conditions: Conditions, person: str, dynamics: str, sees: str
) -> list[tuple[Scan, Array]]:
    task = tissue_task(dynamics, conditions, _BOUNDS, residual=sees or "C_T")
    prior = TissuePrior(task)
    learn(prior, _together(scans, [s.person != person for s in scans], whole=True), _LEARN)
    mine = [s.person == person for s in scans]
    curves = _together(scans, mine, whole=False)
    with torch.no_grad():
        u = identify(prior, curves, _IDENTIFY)
        values = prior.predict(u, curves.amounts)[..., 1].double().numpy()
    own = [scan for scan, is_mine in zip(scans, mine) if is_mine]
    parts = np.split(values, np.cumsum([len(scan.curves) for scan in own])[:-1])
    return [(scan, part / _scale(scan)) for scan, part in zip(own, parts)]


def _scale(scan: Scan) -> float:
    """To the common level, by what is seen; input and curves alike, so that the model stays as it is."""
    return _LEVEL / float(scan.curves[:, scan.seen].mean())


def _together(scans: tuple[Scan, ...], use: list[bool], *, whole: bool) -> Curves:
    """Curves of some scans; the amount of its own input is each scan's scale."""
    chosen = [(j, scan) for j, scan in enumerate(scans) if use[j]]
    values = torch.cat([torch.tensor(scan.curves * _scale(scan)) for _, scan in chosen])
    weights = [scan.weights * (np.ones_like(scan.weights) if whole else scan.seen) for _, scan in chosen]
    amounts = [_scale(scan) * torch.eye(len(scans))[j].expand(len(scan.curves), -1) for j, scan in chosen]
    repeated = [torch.tensor(w).expand(len(scan.curves), -1) for w, (_, scan) in zip(weights, chosen)]
    return Curves(values.float(), torch.cat(repeated).float(), torch.cat(amounts))


def _rows(scan: Scan, way: str, values: Array) -> list[dict[str, object]]:
    late = ~scan.seen
    duration = scan.known.observation.frames.duration[late]
    rows = []
    for region, curve, forecast in zip(scan.regions, scan.curves, values):
        off, level = forecast[late] - curve[late], np.average(curve[late], weights=duration)
        root = float(np.sqrt(np.average(off**2, weights=duration)) / level)
        bias = float(np.average(off, weights=duration) / level)
        rows.append({"scan": scan.label, "region": region, "way": way, "error": root, "bias": bias})
    return rows


def summary(rows: list[dict[str, object]]) -> pd.DataFrame:
    """Median error and bias over the curves, share of curves forecast better than by the one-tissue fit."""
    table = pd.DataFrame(rows)
    errors = table.pivot_table(index=["scan", "region"], columns="way", values="error", sort=False)
    bias = table.pivot_table(index=["scan", "region"], columns="way", values="bias", sort=False)
    better = errors.lt(errors["fit_1TCM"], axis=0).mean()
    found = {"error": errors.median(), "p90": errors.quantile(0.9), "bias": bias.median(), "better": better}
    return pd.DataFrame(found).assign(curves=len(errors))
