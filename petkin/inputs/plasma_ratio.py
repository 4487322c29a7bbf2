"""Plasma over whole blood: turns a continuous whole blood curve into total plasma."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.inputs.blood_table import Samples
from petkin.inputs.least_squares import CurveFit, fit_curve

_Array = NDArray[np.float64]

#: Pairs before the peak that hold less than this share of it are background, and so is their ratio.
_BACKGROUND = 0.05


@dataclass(frozen=True)
class PlasmaRatioModel:
    """r(t; p), the bounds of p, and where the fit starts."""

    curve: Callable[[_Array, _Array], _Array]
    bounds: tuple[tuple[float, float], ...]
    starts: tuple[tuple[float, ...], ...]


_LEVELS = (0.6, 1.0, 1.5)

#: r = p0; r = p0 + p1 t; r = p1 + (p0 - p1) e^{-p2 t} (exchange with the cells, rise of the metabolites).
PLASMA_RATIO_MODELS = {
    "constant": PlasmaRatioModel(lambda t, p: p[0] + 0.0 * t, ((0, 20),), (_LEVELS,)),
    "linear": PlasmaRatioModel(lambda t, p: p[0] + p[1] * t, ((0, 20), (-1, 1)), (_LEVELS, (-0.003, 0.003))),
    "exponential": PlasmaRatioModel(
        lambda t, p: p[1] + (p[0] - p[1]) * np.exp(-p[2] * t),
        ((0, 20), (0, 20), (1e-3, 10)),
        (_LEVELS, _LEVELS, (0.01, 0.1, 1.0)),
    ),
}


@dataclass(frozen=True)
class PlasmaRatio:
    """Plasma over whole blood as a function of time (min), held after the last of the samples behind it."""

    name: str
    pairs: Samples
    curve: Callable[[_Array], _Array]

    def __call__(self, t: _Array) -> _Array:
        return self.curve(np.clip(t, 0.0, self.pairs.times[-1]))


def ratio_pairs(plasma: Samples, whole_blood: Samples, at: _Array) -> Samples:
    """plasma / whole blood at sampling times of plasma, where both are positive and more than background.

    Args:
        plasma: total plasma, kBq/mL.
        whole_blood: kBq/mL, read as straight lines between its samples.
        at: times of plasma samples to use, min, at least one.
    """
    if at.size == 0:
        return Samples(at, at)
    p = plasma.values[np.isin(plasma.times, at)]
    b = np.interp(at, whole_blood.times, whole_blood.values)
    background = (p < _BACKGROUND * p.max()) | (b < _BACKGROUND * b.max())
    good = (p > 0) & (b > 0) & ~(background & (at < at[int(p.argmax())]))
    return Samples(at[good], p[good] / b[good])


def fit_plasma_ratio(pairs: Samples, *, model: str = "auto") -> PlasmaRatio:
    """Plasma over whole blood as a curve.

    Args:
        pairs: ratios at their times (min).
        model: constant, linear, exponential (towards a plateau), interpolated (straight lines), or auto: of the first
            three that of least AICc, the constant if there are too few samples.

    Raises:
        InputError: an unknown model.
    """
    if model not in {"auto", "interpolated", *PLASMA_RATIO_MODELS}:
        known = ", ".join(["auto", *PLASMA_RATIO_MODELS, "interpolated"])
        raise InputError(f"There is no plasma-to-blood model {model!r}; use one of {known}.")
    if model == "interpolated":
        return PlasmaRatio(model, pairs, lambda t: np.interp(t, pairs.times, pairs.values))
    names = (
        [model] if model != "auto" else [n for n, m in PLASMA_RATIO_MODELS.items() if pairs.size > len(m.bounds) + 2]
    )
    fits = {name: _fit(PLASMA_RATIO_MODELS[name], pairs) for name in names or ["constant"]}
    best = min(fits, key=lambda name: fits[name].aicc)
    parameters, curve = fits[best].parameters, PLASMA_RATIO_MODELS[best].curve
    return PlasmaRatio(best, pairs, lambda t: curve(t, parameters))


def _fit(model: PlasmaRatioModel, pairs: Samples) -> CurveFit:
    return fit_curve(model.curve, pairs.times, pairs.values, bounds=model.bounds, starts=model.starts)
