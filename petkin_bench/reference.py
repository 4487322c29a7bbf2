"""Reference-region methods on a test problem of their own, against a loop over voxels and against bare numpy products.

Truth, log-normal a voxel: R1 median 1 (sigma of log .2), k2 .12 / min (.3), BPND 1 (.5); the reference region is one
tissue, K1 .1, k2 .12, under Feng's input. Frames, noise and weights as in `problems`.

    C_T = R1 C_R + (k2 - R1 k2a) C_R * e^(-k2a t),   C_R * e^(-at) = .1 (B(.12) - B(a)) / (a - .12)

by formula, since the convolution of two exponentials is their divided difference.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import curve_fit

from petkin.fitting import Choices, FitResult, Given, ReferenceCurve
from petkin.imaging import FrameObservation, FrameSchedule
from petkin.methods import Method, find_method
from petkin_bench.closed_form import ClosedForm
from petkin_bench.problems import SCHEDULES, SEED_NOISE, SEED_TRUTH, counting_noise
from petkin_bench.product import beside_product

Array = NDArray[np.float64]

_DELIVERY, _RETURN = 0.1, 0.12
_T_STAR = 20.0
_BY_HAND = 100
_SAMPLE = 10_000
#: Rates of the bare product's basis functions, 1/min.
_BASIS = np.geomspace(0.01, 1.0, 40)


def measure_reference(label: str, *, voxels: int) -> dict[str, object]:
    """One row: a method with errors and status against its baselines."""
    closed_form, frames = _frames()
    reference = _DELIVERY * closed_form.basis(_RETURN)
    truth = _truth(voxels)
    clean = _curves(closed_form, reference, *truth.T[..., None])
    sd, weights = counting_noise(clean, frames, percent=5.0)
    curves = clean + sd * np.random.default_rng(SEED_NOISE).standard_normal(clean.shape)
    given = Given(FrameObservation(frames, 0.0), weights, reference=ReferenceCurve("reference", reference))
    read = np.ascontiguousarray(curves.T, np.float32).T
    method, choices = find_method(label), Choices(t_star=_T_STAR)
    by_hand, product = _BASELINES[label]
    scene = (closed_form, reference, frames.duration, frames.mid >= _T_STAR, weights)
    shared = {"scan_cpu_us": lambda: _shared(method, read, given, choices)} if method.share is not None else {}
    row = beside_product(
        label,
        voxels,
        lambda: _fit(method, read, given, choices),
        lambda: [by_hand(*scene, curve) for curve in curves[:_BY_HAND]],
        _BY_HAND,
        lambda: product(*scene, read),
        baseline="curve_fit by formula (SRTM) or lstsq a voxel, values only",
        **shared,
    )
    error = 100.0 * (_fit(method, read, given, choices)["BPND"] / truth[:, 2] - 1.0)
    bias = float(np.nanmedian(error))
    spread = 1.4826 * float(np.nanmedian(np.abs(error - bias)))
    return row | {"outcome": "BPND", "bias_percent": bias, "spread_percent": spread}


def _fit(method: Method, curves: NDArray[np.float32], given: Given, choices: Choices) -> FitResult:
    """As a study fits voxels: what they share is estimated from a sample of them first."""
    return method.fit(curves, given, _shared(method, curves, given, choices), True)


def _shared(method: Method, curves: NDArray[np.float32], given: Given, choices: Choices) -> Choices:
    """Choices with what the voxels of a scan share, once a scan whatever their number."""
    if method.share is None:
        return choices
    shared = method.share(curves[:: max(1, len(curves) // _SAMPLE)], given, choices, True)
    return replace(choices, fixed={symbol: value for symbol, (value, _) in shared.items()})


def _frames() -> tuple[ClosedForm, FrameSchedule]:
    counts, seconds = zip(*SCHEDULES[26])
    edges = np.concatenate([[0.0], np.cumsum(np.repeat(seconds, counts) / 60.0)])
    return ClosedForm.at(edges), FrameSchedule(edges[:-1], edges[1:])


def _truth(voxels: int) -> Array:
    """R1, k2, BPND (N, 3)."""
    draw = np.random.default_rng(SEED_TRUTH)
    medians, sigmas = np.array([1.0, 0.12, 1.0]), np.array([0.2, 0.3, 0.5])
    return medians * np.exp(sigmas * draw.standard_normal((voxels, 3)))


def _curves(closed_form: ClosedForm, reference: Array, R1, k2, BPND) -> Array:
    k2a = k2 / (1.0 + BPND)
    return R1 * reference + (k2 - R1 * k2a) * _response(closed_form, k2a)


def _response(closed_form: ClosedForm, rate: float | Array) -> Array:
    """Frame averages of C_R * e^(-at)."""
    return _DELIVERY * (closed_form.basis(_RETURN) - closed_form.basis(rate)) / (rate - _RETURN)


def _srtm_by_hand(closed_form, reference, duration, late, weights, curve) -> Array:
    sigma, bounds = 1.0 / np.sqrt(weights), ([0.0, 0.0, -0.5], [5.0, 3.0, 30.0])
    start = (1.0, 0.1, 1.0)
    found = curve_fit(
        lambda _, *p: _curves(closed_form, reference, *p), sigma, curve, p0=start, sigma=sigma, bounds=bounds
    )
    return found[0]


def _srtm_product(closed_form, reference, duration, late, weights, curves) -> Array:
    """The basis function method: one product with two unit columns a rate, the best rate by the sum of squares."""
    root, bases = np.sqrt(weights), []
    for rate in _BASIS:
        columns = np.stack([reference, _response(closed_form, rate)], axis=1) * root[:, None]
        bases.append(np.linalg.qr(columns)[0])
    seen = (np.concatenate(bases, axis=1).T * root).astype(np.float32) @ curves.T
    return (seen**2).reshape(len(_BASIS), 2, -1).sum(axis=1).argmax(axis=0)


def _areas(curves: Array, duration: Array) -> Array:
    """Areas to mid-frame, frames on the first axis."""
    whole = curves * (duration[:, None] if curves.ndim == 2 else duration).astype(curves.dtype)
    return np.cumsum(whole, axis=0) - 0.5 * whole


def _mrtm_by_hand(closed_form, reference, duration, late, weights, curve) -> Array:
    columns = np.stack([_areas(reference, duration), _areas(curve, duration), reference], axis=1)[late]
    root = np.sqrt(weights[late])
    return np.linalg.lstsq(columns * root[:, None], curve[late] * root)[0]


def _mrtm_product(closed_form, reference, duration, late, weights, curves) -> Array:
    """Normal equations of two columns in common and one of the curve's own."""
    common = np.stack([_areas(reference, duration), reference])[:, late].astype(np.float32)
    w, y = weights[late].astype(np.float32), curves.T[late]
    z = _areas(curves.T, duration)[late]
    axes = np.linalg.qr((common * np.sqrt(w)).T)[0].T * np.sqrt(w)
    off_z, off_y = axes @ z, axes @ y
    own = (w @ (z * y) - (off_z * off_y).sum(axis=0)) / (w @ (z * z) - (off_z**2).sum(axis=0))
    return np.stack([*(off_y - own * off_z), own])


def _logan_by_hand(closed_form, reference, duration, late, weights, curve) -> Array:
    columns = np.stack([_areas(reference, duration) / curve, reference / curve, np.ones_like(curve)], axis=1)[late]
    return np.linalg.lstsq(columns, (_areas(curve, duration) / curve)[late])[0]


_BASELINES: dict[str, tuple[Callable[..., Array], Callable[..., Array]]] = {
    "SRTM": (_srtm_by_hand, _srtm_product),
    "MRTM1": (_mrtm_by_hand, _mrtm_product),
    "LoganRef": (_logan_by_hand, _mrtm_product),
}
