"""Linear methods in the discretisation of the reference program (kinfitr 0.9.1), to compare like with like.

It puts curve and input on 6000 equal steps, the curve as straight lines between zero at time 0 and the middles of
frames, integrates by trapezoids, and reads columns at the middles of frames; its regressions are unweighted for Logan's
plot and weighted by w C_P^2 for Patlak's. Its two-tissue K1 and VT with a fitted blood volume hold the factor 1 - vB.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..fitting.real_scans import Scan

Array = NDArray[np.float64]

STEPS = 6000
FRAMES_USED = 10


def as_the_reference_computes(scan: Scan, curve: Array, vB: float) -> dict[tuple[str, str], float]:
    """Estimates by (model, parameter) as its table names them; vB is fixed where a model takes it off."""
    t, grid, plasma, blood = _regridded(scan)
    weights = np.r_[0.0, scan.weights]
    measured = np.interp(grid, t, np.r_[0.0, curve])
    tissue = (measured - vB * blood) / (1.0 - vB)

    def at(values: Array) -> Array:
        return np.interp(t, grid, values)

    def once(values: Array) -> Array:
        return _trapezoids(grid, values)

    late, one = slice(-FRAMES_USED, None), np.ones(FRAMES_USED)
    with np.errstate(all="ignore"):
        x, y = at(once(plasma) / tissue)[late], at(once(tissue) / tissue)[late]
        found = {("logan_t10", "Vt"): _solve([x, one], y, one)[0]}
        x, y = at(once(plasma) / plasma)[late], at(tissue / plasma)[late]
    found["patlak_t10", "Ki"] = _solve([x, one], y, (weights * at(plasma) ** 2)[late])[0]
    b = _solve([at(once(plasma))[late], at(once(tissue))[late]], at(tissue)[late], weights[late])
    found["ma1_t10", "Vt"] = -b[0] / b[1]
    b = _solve(
        [at(once(once(v))) for v in (plasma, tissue)] + [at(once(v)) for v in (tissue, plasma)], at(tissue), weights
    )
    found["ma2", "Vt"], found["ma2", "K1"] = -b[0] / b[1], b[3]
    columns = [once(once(plasma)), once(plasma), plasma, -once(once(measured)), -once(measured)]
    p = _solve([at(column) for column in columns], np.r_[0.0, curve], weights)
    K1 = p[1] - p[2] * p[4]
    k2 = p[4] - (p[0] - p[2] * p[3]) / K1
    k4 = p[3] / k2
    found["lin2tcm", "Vt"] = K1 / k2 * (1.0 + (p[4] - k2 - k4) / k4)
    found["lin2tcm", "K1"], found["lin2tcm", "vB"] = K1, p[2]
    return found


def _regridded(scan: Scan) -> tuple[Array, Array, Array, Array]:
    """Middles of frames with a zero before, and the input shifted and put on the grid up to the last of them."""
    t = np.r_[0.0, scan.frames.mid]
    time, plasma, blood = (scan.blood[c].to_numpy() for c in ("time", "AIF", "whole_blood_radioactivity"))
    time = time + scan.shift
    if time[0] < 0:
        t[1:], time = t[1:] - time[0], time - time[0]
    if time[0] > 0:
        time, plasma, blood = (np.r_[0.0, v] for v in (time, plasma, blood))
    last = int(np.searchsorted(time, t[-1], side="right"))
    if last < len(time):
        time, plasma, blood = time[: last + 1].copy(), plasma[: last + 1], blood[: last + 1]
        time[last] = t[-1]
    elif time[-1] < t[-1]:
        time, plasma, blood = np.r_[time, t[-1]], np.r_[plasma, plasma[-1]], np.r_[blood, blood[-1]]
    grid = np.linspace(time[0], time[-1], STEPS)
    return t, grid, np.interp(grid, time, plasma), np.interp(grid, time, blood)


def _trapezoids(x: Array, y: Array) -> Array:
    return np.r_[0.0, np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(x))]


def _solve(columns: list[Array], response: Array, weights: Array) -> Array:
    root = np.sqrt(weights)
    return np.linalg.lstsq(np.stack(columns, axis=1) * root[:, None], response * root)[0]
