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
from petkin.fitting.results import Estimate, FitResult, Status
from petkin.imaging import FrameObservation
from petkin.inputs.input_function import InputFunction

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GraphicalSettings:
    """Which plot, and what of the curve it uses.

    Args:
        t_star: frames whose middle comes at or after this time take part, min.
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
    late = _late(observation, settings)
    blood = observation.of_forcing(arterial.whole_blood).numpy()
    exposure = observation.of_response(arterial.plasma, torch.zeros(1, dtype=torch.float64))[0].numpy()
    plasma = observation.of_forcing(arterial.plasma).numpy()
    tissue = (np.asarray(curves, np.float64) - settings.vB * blood) / (1.0 - settings.vB)
    design = np.stack([exposure, plasma], axis=1)[late]
    root = np.sqrt(np.asarray(weights, np.float64)[late])
    inverse = np.linalg.inv((design * root[:, None]).T @ (design * root[:, None]))
    solved = tissue[:, late] @ ((design * root[:, None] ** 2) @ inverse)
    residual = (tissue[:, late] - solved @ design.T) * root
    wrss = (residual**2).sum(axis=1)
    variance = wrss[:, None] / (late.sum() - 2) * np.diag(inverse)
    predicted = np.full(curves.shape, np.nan)
    predicted[:, late] = (1.0 - settings.vB) * (solved @ design.T) + settings.vB * blood[late]
    units = (("Ki", "mL cm^-3 min^-1"), ("V0", "mL cm^-3"))
    return _result(
        "Patlak", units, solved, np.sqrt(variance), wrss, int(late.sum()), curves, weights, predicted, settings
    )


def fit_logan(
    curves: NDArray[np.floating],
    arterial: InputFunction,
    observation: FrameObservation,
    weights: Array,
    settings: GraphicalSettings,
) -> FitResult:
    """VT and the intercept of every curve (N, K); noise enters both axes and biases VT low (Slifstein 2000)."""
    late = _late(observation, settings)
    frames = observation.frames
    mid = torch.tensor(frames.mid)
    blood = observation.of_forcing(arterial.whole_blood).numpy()
    tissue = (np.asarray(curves, np.float64) - settings.vB * blood) / (1.0 - settings.vB)
    area = _area_to_middle(tissue, frames)
    plasma_area = arterial.plasma.integral(mid).numpy()
    root = np.sqrt(np.asarray(weights, np.float64)[late])
    with np.errstate(all="ignore"):
        x, y = (plasma_area / tissue)[:, late], (area / tissue)[:, late]
        # Weights of C hold for the ratio after scaling by C^2; kept relative within a curve.
        w = root**2 * np.maximum(tissue[:, late], 0.0) ** 2
        total = w.sum(axis=1)
        mx, my = (w * x).sum(axis=1) / total, (w * y).sum(axis=1) / total
        sxx = (w * (x - mx[:, None]) ** 2).sum(axis=1)
        slope = (w * (x - mx[:, None]) * (y - my[:, None])).sum(axis=1) / sxx
        intercept = my - slope * mx
        left = y - slope[:, None] * x - intercept[:, None]
        wrss = (w * left**2).sum(axis=1)
        variance = wrss / (late.sum() - 2)
        errors = np.sqrt(np.stack([variance / sxx, variance * (1.0 / total + mx**2 / sxx)], axis=1))
        predicted = np.full(curves.shape, np.nan)
        fitted = (area[:, late] - slope[:, None] * plasma_area[late]) / intercept[:, None]
        predicted[:, late] = (1.0 - settings.vB) * fitted + settings.vB * blood[late]
    solved = np.stack([slope, intercept], axis=1)
    units = (("VT", "mL cm^-3"), ("intercept", "min"))
    return _result("Logan", units, solved, errors, wrss, int(late.sum()), curves, weights, predicted, settings)


def _late(observation: FrameObservation, settings: GraphicalSettings) -> NDArray[np.bool_]:
    late = observation.frames.mid >= settings.t_star
    if late.sum() < 3:
        raise InputError(
            f"Only {int(late.sum())} frames lie after t* = {settings.t_star:g} min; a line with an error needs three: "
            "choose an earlier --t-star."
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
    units: tuple[tuple[str, str], ...],
    solved: Array,
    errors: Array,
    wrss: Array,
    count: int,
    curves: NDArray[np.floating],
    weights: Array,
    predicted: Array,
    settings: GraphicalSettings,
) -> FitResult:
    finite = np.asarray(np.isfinite(curves).all(axis=1))
    with np.errstate(all="ignore"):
        signal = np.sum(np.where(finite[:, None], curves, 0.0), axis=1) > 0
        percent = 100.0 * errors / np.abs(solved)
        aicc = count * np.log(wrss / count) + 6.0 + (24.0 / (count - 4) if count > 4 else np.nan)
    status = np.full(len(curves), Status.OK, np.uint8)
    status[~(percent[:, 0] <= 100.0)] = Status.NOT_IDENTIFIABLE
    status[~np.isfinite(solved).all(axis=1)] = Status.NOT_CONVERGED
    status[~signal] = Status.NO_SIGNAL
    status[~finite] = Status.NOT_FINITE
    missing = (status == Status.NO_SIGNAL) | (status == Status.NOT_FINITE) | (status == Status.NOT_CONVERGED)
    blank = np.where(missing, np.nan, 1.0)
    return FitResult(
        model=label,
        estimates=tuple(
            Estimate(symbol, unit, solved[:, i] * blank, percent[:, i] * blank)
            for i, (symbol, unit) in enumerate(units)
        ),
        chi2=wrss / (count - 2) * blank,
        aicc=aicc * blank,
        status=status,
        weights=np.asarray(weights),
        predicted=predicted if settings.keep_predicted else None,
        settings={"t_star": settings.t_star, "vB": settings.vB, "frames_used": count},
    )
