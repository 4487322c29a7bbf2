"""Parent fraction: the share of the plasma activity that is still the injected tracer, f(t), from a few noisy samples.

Every model is f(t) = f0 s(t; a, b, c) with a shape s that starts at s(0) = 1 and falls within [0, 1], so f can never
leave that range.

Reference: Tonietto M, Rizzo G, Veronese M et al. Plasma radiometabolite correction in dynamic PET studies: insights on
the available modeling approaches. J Cereb Blood Flow Metab 2016;36:326-339. doi:10.1177/0271678X15610585
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.inputs.least_squares import fit_curve

_Array = NDArray[np.float64]


def hill(t: _Array, a: float, b: float, c: float) -> _Array:
    """s(t) = a + (1 - a) / (1 + (t/c)^b): Hill's equation, half way down at c (min), a of it for ever.

    Reference: Gunn RN et al. NeuroImage 1998;8:426-440. doi:10.1006/nimg.1998.0379
    """
    return a + (1.0 - a) / (1.0 + (t / c) ** b)


def power(t: _Array, a: float, b: float, c: float) -> _Array:
    """s(t) = 1 / (1 + (a t)^b)^c with a in 1/min.

    Reference: Watabe H et al. J Cereb Blood Flow Metab 2000;20:899-909, whose exponent b = 2 is free here.
    """
    return (1.0 + (a * t) ** b) ** -c


def exponential(t: _Array, a: float, b: float, c: float) -> _Array:
    """s(t) = a e^{-b t} + (1 - a) e^{-c t} with b and c in 1/min; Tonietto et al. 2016 review its use."""
    return a * np.exp(-b * t) + (1.0 - a) * np.exp(-c * t)


def sigmoid(t: _Array, a: float, b: float, c: float) -> _Array:
    """s(t) = ((1 - t^3 / (t^3 + a^3))^b + c) / (1 + c) with a in min.

    Reference: Guo Q et al. J Nucl Med 2013;54:1915-1923. doi:10.2967/jnumed.113.121020
    """
    return ((1.0 + (t / a) ** 3) ** -b + c) / (1.0 + c)


@dataclass(frozen=True)
class ParentFractionModel:
    """A shape s(t; a, b, c), the bounds of a, b and c, and where their fit starts."""

    shape: Callable[[_Array, float, float, float], _Array]
    bounds: tuple[tuple[float, float], ...]
    starts: tuple[tuple[float, ...], ...]


_TIMES = (1.0, 3.0, 10.0, 30.0, 100.0)
_RATES = (0.003, 0.01, 0.03, 0.1, 0.3)
_SHARES = (0.0, 0.1, 0.3, 0.6)
_EXPONENTS = (0.1, 0.3, 1.0, 3.0)

#: The models that `auto` chooses among. The power's exponent b stays near Watabe's 2: a steep one bends within a gap of
#: the samples, and the late area under C_P would hang on that.
PARENT_FRACTION_MODELS: Mapping[str, ParentFractionModel] = {
    "hill": ParentFractionModel(hill, ((0, 1), (1, 20), (1e-2, 1e4)), (_SHARES, (1.0, 2.0, 4.0), _TIMES)),
    "power": ParentFractionModel(power, ((1e-4, 60), (1, 3), (1e-3, 20)), (_RATES, (1.0, 2.0, 3.0), _EXPONENTS)),
    "exponential": ParentFractionModel(exponential, ((0, 1), (0, 1), (0, 10)), (_SHARES, (0.0, 0.003, 0.03), _RATES)),
    "sigmoid": ParentFractionModel(sigmoid, ((1e-2, 1e4), (1e-3, 50), (0, 100)), (_TIMES, _EXPONENTS, (0.0, 0.1, 0.5))),
}


@dataclass(frozen=True)
class ParentFractionFit:
    """A fitted parent fraction; calling it evaluates f at times in min.

    Args:
        name: hill, power, exponential, sigmoid or interpolated.
        parameters: f0, a, b, c (their meaning is the model's); empty if interpolated.
        standard_errors: of the fitted ones, linearised; nan where the data do not determine one.
        times: of the samples, min.
        values: the samples.
        fitted: f at the samples.
        rss: residual sum of squares.
        aicc: corrected Akaike criterion; infinite with too few samples, and if interpolated.
        curve: f itself.
        remarks: what was assumed, one sentence each.
    """

    name: str
    parameters: Mapping[str, float]
    standard_errors: Mapping[str, float]
    times: _Array
    values: _Array
    fitted: _Array
    rss: float
    aicc: float
    curve: Callable[[_Array], _Array]
    remarks: tuple[str, ...] = ()

    def __call__(self, t: _Array) -> _Array:
        """f(t), t in min; before injection it is f(0)."""
        return self.curve(np.maximum(np.asarray(t, dtype=float), 0.0))


def fit_parent_fraction(
    times: _Array, values: _Array, *, model: str = "auto", start: float | None = None
) -> ParentFractionFit:
    """Describe parent fraction samples by a curve.

    f(0): a sample at time 0, or `start`, fixes it; without either, 1 and a free value are tried and AICc chooses.
    `auto` takes the model of least AICc, and interpolates (with a remark) where the samples are too few for any.

    Args:
        times: min, ascending, (samples,).
        values: unmetabolised share of plasma activity, 0 to 1, (samples,).
        model: auto, hill, power, exponential, sigmoid, or interpolated (monotone cubic of ln f between samples, f(0)
            = `start` or 1, the last value held).
        start: f(0), if it is known.

    Returns:
        The fit.

    Raises:
        InputError: an unknown model, or too few samples for the one asked for.

    Reference: see the module. Interpolation: Fritsch FN, Carlson RE. SIAM J Numer Anal 1980;17:238-246.
    """
    if model not in {"auto", "interpolated", *PARENT_FRACTION_MODELS}:
        known = ", ".join(["auto", *PARENT_FRACTION_MODELS, "interpolated"])
        raise InputError(f"There is no parent fraction model {model!r}; use one of {known}.")
    if start is None and times[0] == 0.0:
        start = float(values[0])
    if model == "interpolated":
        return _interpolated(times, values, 1.0 if start is None else start)
    names = PARENT_FRACTION_MODELS if model == "auto" else [model]
    fits = [fit for name in names for fit in _candidates(name, times, values, start)]
    best = min(fits, key=lambda fit: (fit.aicc, fit.rss), default=None)
    if best is not None and (np.isfinite(best.aicc) or model != "auto"):
        return best
    count = f"{times.size} parent fraction sample{'s' if times.size > 1 else ''}"
    if model != "auto":
        raise InputError(f"{count}: too few to fit the model {model!r}; use 'interpolated'.")
    remark = f"{count}: too few to fit a curve, so they are interpolated."
    return replace(_interpolated(times, values, 1.0 if start is None else start), remarks=(remark,))


def _candidates(name: str, times: _Array, values: _Array, start: float | None) -> list[ParentFractionFit]:
    """The model with f(0) fixed, and with f(0) free where nothing says what it is."""
    later = times > 0.0  # a sample at time 0 fixes f(0), so it is no sample of the rest
    fits = []
    if later.sum() >= 3:
        fits.append(_fitted(name, times[later], values[later], 1.0 if start is None else start, free=False))
    if start is None and times.size >= 4:
        fits.append(_fitted(name, times, values, min(1.0, float(values.max())), free=True))
    return fits


def _fitted(name: str, times: _Array, values: _Array, start: float, *, free: bool) -> ParentFractionFit:
    model = PARENT_FRACTION_MODELS[name]

    def curve(t: _Array, p: _Array) -> _Array:
        f0 = p[3] if free else start
        return f0 * model.shape(t, *p[:3])

    bounds = [*model.bounds, (0.3, 1.0)] if free else model.bounds
    starts = [*model.starts, (start,)] if free else model.starts
    fit = fit_curve(curve, times, values, bounds=bounds, starts=starts)
    symbols = ("a", "b", "c", "f0") if free else ("a", "b", "c")
    parameters: dict[str, float] = dict(zip(symbols, map(float, fit.parameters), strict=True))
    return ParentFractionFit(
        name=name,
        parameters=parameters if free else {**parameters, "f0": start},
        standard_errors=dict(zip(symbols, map(float, fit.standard_errors), strict=True)),
        times=times,
        values=values,
        fitted=curve(times, fit.parameters),
        rss=fit.rss,
        aicc=fit.aicc,
        curve=lambda t: curve(t, fit.parameters),
        remarks=(f"The parent fraction at injection was fitted: {parameters['f0']:.3f}.",) if free else (),
    )


def _interpolated(times: _Array, values: _Array, start: float) -> ParentFractionFit:
    from scipy.interpolate import PchipInterpolator

    later = times > 0.0
    knots, levels = np.append(0.0, times[later]), np.append(start, values[later])
    positive = bool(levels.min() > 0)  # the logarithm follows the convex tail, but cannot meet 0

    def curve(t: _Array) -> _Array:
        if knots.size == 1:
            return np.full_like(t, start)
        inside = np.minimum(t, knots[-1])
        if positive:
            return np.exp(PchipInterpolator(knots, np.log(levels))(inside))
        return PchipInterpolator(knots, levels)(inside)

    return ParentFractionFit(
        name="interpolated",
        parameters={},
        standard_errors={},
        times=times,
        values=values,
        fitted=values,
        rss=0.0,
        aicc=float("inf"),
        curve=curve,
    )
