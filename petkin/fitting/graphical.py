"""Patlak and Logan plots as weighted linear regressions, all curves at once.

Patlak (irreversible), in its multilinear form without division by a noisy plasma value:

    C_k = Ki A_k + V P_k,   A_k, P_k = frame k's report of int_0^t C_P and of C_P,   frames after t*.

Logan (reversible):  int_0^t C_T / C_T = VT int_0^t C_P / C_T + b,  frames after t*, at frame mid-times.

References: Patlak CS, Blasberg RG, Fenstermacher JD. J Cereb Blood Flow Metab 1983;3:1-7, doi:10.1038/jcbfm.1983.1.
Logan J et al. J Cereb Blood Flow Metab 1990;10:740-747, doi:10.1038/jcbfm.1990.127.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.fitting.curves import check_shapes, finite_curves
from petkin.fitting.results import Estimate, FitResult, Status
from petkin.imaging import FrameObservation
from petkin.inputs.input_function import InputFunction

Array = NDArray[np.float64]

_V0 = "initial volume: tracer in blood and in fast exchange with it"


@dataclass(frozen=True)
class GraphicalSettings:
    """Which plot, and what of the curve it uses.

    Args:
        t_star: frames whose middle comes at or after this time take part, if they have weight, min.
        vB: blood volume fraction taken off the curves beforehand; 0 leaves them as they are.
        keep_predicted: return fitted curves.
    """

    t_star: float = 30.0
    vB: float = 0.0
    keep_predicted: bool = True


def fit_patlak(
    curves: NDArray[np.floating],
    arterial: InputFunction,
    observation: FrameObservation,
    weights: Array,
    settings: GraphicalSettings,
) -> FitResult:
    """Ki and the initial volume V of every curve (N, K), by weighted least squares on frame values after t*."""
    curves, weights = np.asarray(curves), np.asarray(weights, np.float64)
    late = _late(curves, weights, observation, settings)
    finite, usable = finite_curves(curves)
    blood = observation.of_forcing(arterial.whole_blood).numpy()
    exposure = observation.of_response(arterial.plasma, torch.zeros(1, dtype=torch.float64))[0].numpy()
    plasma = observation.of_forcing(arterial.plasma).numpy()
    tissue = (usable - settings.vB * blood) / (1.0 - settings.vB)
    design = np.stack([exposure, plasma], axis=1)[late]
    root = np.sqrt(weights[late])
    inverse = np.linalg.inv((design * root[:, None]).T @ (design * root[:, None]))
    solved = tissue[:, late] @ ((design * root[:, None] ** 2) @ inverse)
    residual = (tissue[:, late] - solved @ design.T) * root
    wrss = (residual**2).sum(axis=1)
    variance = wrss[:, None] / (late.sum() - 2) * np.diag(inverse)
    predicted = np.full(curves.shape, np.nan)
    predicted[:, late] = (1.0 - settings.vB) * (solved @ design.T) + settings.vB * blood[late]
    units = (("Ki", "mL cm^-3 min^-1", "net influx rate"), ("V0", "mL cm^-3", _V0))
    return _result(
        "Patlak", units, solved, np.sqrt(variance), wrss, int(late.sum()), finite, usable, weights, predicted, settings
    )


def fit_logan(
    curves: NDArray[np.floating],
    arterial: InputFunction,
    observation: FrameObservation,
    weights: Array,
    settings: GraphicalSettings,
) -> FitResult:
    """VT and the intercept of every curve (N, K); noise enters both axes and biases VT low (Slifstein 2000)."""
    curves, weights = np.asarray(curves), np.asarray(weights, np.float64)
    late = _late(curves, weights, observation, settings)
    finite, usable = finite_curves(curves)
    frames = observation.frames
    mid = torch.tensor(frames.mid)
    blood = observation.of_forcing(arterial.whole_blood).numpy()
    tissue = (usable - settings.vB * blood) / (1.0 - settings.vB)
    area = _area_to_middle(tissue, frames)
    plasma_area = arterial.plasma.integral(mid).numpy()
    root = np.sqrt(weights[late])
    with np.errstate(all="ignore"):
        # Weights of C hold for the ratio after scaling by C^2; frames at or below zero have none and no ratio either.
        level = np.where(tissue[:, late] > 0.0, tissue[:, late], np.inf)
        x, y = plasma_area[late] / level, area[:, late] / level
        w = np.where(np.isfinite(level), root**2 * level**2, 0.0)
        total = w.sum(axis=1)
        mx, my = (w * x).sum(axis=1) / total, (w * y).sum(axis=1) / total
        sxx = (w * (x - mx[:, None]) ** 2).sum(axis=1)
        slope = (w * (x - mx[:, None]) * (y - my[:, None])).sum(axis=1) / sxx
        intercept = my - slope * mx
        left = y - slope[:, None] * x - intercept[:, None]
        wrss = (w * left**2).sum(axis=1)
        variance = wrss / (np.isfinite(level).sum(axis=1) - 2)
        errors = np.sqrt(np.stack([variance / sxx, variance * (1.0 / total + mx**2 / sxx)], axis=1))
        predicted = np.full(curves.shape, np.nan)
        fitted = (area[:, late] - slope[:, None] * plasma_area[late]) / intercept[:, None]
        predicted[:, late] = (1.0 - settings.vB) * fitted + settings.vB * blood[late]
    solved = np.stack([slope, intercept], axis=1)
    units = (("VT", "mL cm^-3", "total distribution volume"), ("intercept", "min", "where the line meets the axis"))
    return _result("Logan", units, solved, errors, wrss, int(late.sum()), finite, usable, weights, predicted, settings)


def _late(
    curves: NDArray[np.floating], weights: Array, observation: FrameObservation, settings: GraphicalSettings
) -> NDArray[np.bool_]:
    """Frames that take part: after t*, with weight."""
    check_shapes(curves, weights, len(observation.frames))
    if weights.ndim != 1:
        raise InputError("Graphical methods take one weight a frame, shared by all curves; give one row of weights.")
    if not 0.0 <= settings.vB < 1.0:
        raise InputError(f"A blood volume fraction of {settings.vB:g} cannot be taken off; it lies in [0, 1).")
    late = (observation.frames.mid >= settings.t_star) & (weights > 0)
    if late.sum() < 3:
        raise InputError(
            f"Only {int(late.sum())} frames with weight lie after t* = {settings.t_star:g} min; "
            "a line with an error needs three: choose an earlier --t-star."
        )
    return late


def _area_to_middle(tissue: Array, frames) -> Array:
    """int_0^mid C dt from frame means; over a gap between frames the curve runs straight."""
    whole = tissue * frames.duration
    before = np.cumsum(whole, axis=1) - whole
    bridge = np.zeros_like(tissue)
    bridge[:, 1:] = 0.5 * (tissue[:, 1:] + tissue[:, :-1]) * frames.gaps
    lead = 0.5 * tissue[:, :1] * frames.start[0]
    return before + 0.5 * whole + np.cumsum(bridge, axis=1) + lead


def _result(
    label: str,
    units: tuple[tuple[str, str, str], ...],
    solved: Array,
    errors: Array,
    wrss: Array,
    count: int,
    finite: NDArray[np.bool_],
    usable: Array,
    weights: Array,
    predicted: Array,
    settings: GraphicalSettings,
) -> FitResult:
    with np.errstate(all="ignore"):
        signal = usable.sum(axis=1) > 0
        percent = 100.0 * errors / np.abs(solved)
        aicc = count * np.log(wrss / count) + 6.0 + (24.0 / (count - 4) if count > 4 else np.nan)
    status = np.full(len(usable), Status.OK, np.uint8)
    status[~(percent[:, 0] <= 100.0)] = Status.NOT_IDENTIFIABLE
    status[~np.isfinite(solved).all(axis=1)] = Status.NOT_CONVERGED
    status[~signal] = Status.NO_SIGNAL
    status[~finite] = Status.NOT_FINITE
    missing = (status == Status.NO_SIGNAL) | (status == Status.NOT_FINITE) | (status == Status.NOT_CONVERGED)
    blank = np.where(missing, np.nan, 1.0)
    return FitResult(
        model=label,
        estimates=tuple(
            Estimate(symbol, unit, solved[:, i] * blank, percent[:, i] * blank, meaning)
            for i, (symbol, unit, meaning) in enumerate(units)
        ),
        chi2=wrss / (count - 2) * blank,
        aicc=aicc * blank,
        status=status,
        weights=weights,
        predicted=predicted if settings.keep_predicted else None,
        settings={"t_star": settings.t_star, "vB": settings.vB, "frames_used": count},
    )
