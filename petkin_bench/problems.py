"""The test problem of the speed figures: Feng's input, 26 or 80 frames, FDG-like voxels, counting noise.

Truth, log-normal a voxel: K1 median .10 (sigma of log .4), K1/k2 .75 (.25), k3 .05 (.5), k4 .008 (.5), vB .05 (.4)
clipped to [.005, .3]. Noise: sd_k = alpha sqrt(max(C_k, .01 mean_k) e^{lambda t_k} / d_k), fluorine-18, alpha such that
a 5-min frame at 45 min of the mean curve has the stated relative sd. Weights shared by all voxels:
d_k e^{-lambda t_k} / (alpha^2 mean_k).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from petkin.dynamics import ExponentialSum
from petkin.imaging import FrameObservation, FrameSchedule
from petkin.inputs import InputFunction
from petkin_bench.closed_form import FENG, ClosedForm

Array = NDArray[np.float64]

#: (count, seconds) of each stretch of frames; both schedules last an hour.
SCHEDULES = {
    26: ((8, 10), (2, 20), (2, 30), (2, 60), (2, 150), (10, 300)),
    80: ((30, 2), (12, 10), (6, 30), (12, 60), (20, 126)),
}
#: Parameters that a model draws, in the order of its parameter set.
DRAWN = {"2TCM": ("K1", "k2", "k3", "k4", "vB"), "2TCM3k": ("K1", "k2", "k3", "vB"), "1TCM": ("K1", "k2", "vB")}

SEED_TRUTH, SEED_NOISE = 0, 1
_DECAY = np.log(2.0) / 109.77  # fluorine-18, 1/min
_BLOCK = 20_000


@dataclass(frozen=True)
class FitProblem:
    """Curves to fit, and what made them.

    Args:
        name: e.g. "2TCM 26 frames 5 %".
        model: label.
        closed_form: the frames by formula.
        arterial: the same input as petkin has it.
        observation: plain frame averages.
        truth: (N, P).
        clean: curves without noise (N, K), kBq/mL.
        curves: (N, K).
        weights: (K,).
    """

    name: str
    model: str
    closed_form: ClosedForm
    arterial: InputFunction
    observation: FrameObservation
    truth: Array
    clean: Array
    curves: Array
    weights: Array

    def model_curve(self, *parameters) -> Array:
        """The model by formula, frame averages."""
        return _curve(self.closed_form, self.model)(*parameters)


def feng_input() -> InputFunction:
    """Feng's curve without delay, plasma and whole blood alike."""
    A1, A2, A3, l1, l2, l3 = FENG
    coefficients = torch.tensor([A1, -A2 - A3, A2, A3], dtype=torch.float64)
    plasma = ExponentialSum(coefficients, torch.tensor([l1, l1, l2, l3], dtype=torch.float64), (1, 0, 0, 0))
    return InputFunction(plasma, plasma)


def fit_problem(*, voxels: int = 100_000, frames: int = 26, percent: float = 5.0, model: str = "2TCM") -> FitProblem:
    """The test problem.

    Args:
        voxels: N; truth and noise depend on it.
        frames: 26 or 80.
        percent: relative sd of a 5-min frame at 45 min.
        model: 2TCM, 2TCM3k (k4 = 0) or 1TCM.
    """
    counts, seconds = zip(*SCHEDULES[frames])
    edges = np.concatenate([[0.0], np.cumsum(np.repeat(seconds, counts) / 60.0)])
    schedule = FrameSchedule(edges[:-1], edges[1:])
    closed_form = ClosedForm.at(edges)
    truth = draw_truth(voxels)[:, [DRAWN["2TCM"].index(symbol) for symbol in DRAWN[model]]]
    clean = np.concatenate(
        [_curve(closed_form, model)(*truth[i : i + _BLOCK].T[..., None]) for i in range(0, voxels, _BLOCK)]
    )
    sd, weights = counting_noise(clean, schedule, percent=percent)
    noise = np.random.default_rng(SEED_NOISE).standard_normal(clean.shape)
    return FitProblem(
        name=f"{model} {frames} frames {percent:g} %",
        model=model,
        closed_form=closed_form,
        arterial=feng_input(),
        observation=FrameObservation(schedule, 0.0),
        truth=truth,
        clean=clean,
        curves=clean + sd * noise,
        weights=weights,
    )


def counting_noise(clean: Array, frames: FrameSchedule, *, percent: float) -> tuple[Array, Array]:
    """Standard deviations (N, K) of the module's noise, and the weights (K,) that all voxels share."""
    mean = clean.mean(axis=0)
    grown = np.exp(_DECAY * frames.mid)
    near_45 = int(np.argmin(np.abs(frames.mid - 45.0)))
    alpha = percent / 100.0 * mean[near_45] / np.sqrt(mean[near_45] * np.exp(_DECAY * 45.0) / 5.0)
    sd = alpha * np.sqrt(np.maximum(clean, 0.01 * mean) * grown / frames.duration)
    return sd, frames.duration / grown / (alpha**2 * mean)


def draw_truth(voxels: int) -> Array:
    """K1, k2, k3, k4, vB of every voxel (N, 5)."""
    draw = np.random.default_rng(SEED_TRUTH)

    def log_normal(median: float, sigma: float) -> Array:
        return median * np.exp(sigma * draw.standard_normal(voxels))

    K1, ratio, k3, k4 = log_normal(0.10, 0.4), log_normal(0.75, 0.25), log_normal(0.05, 0.5), log_normal(0.008, 0.5)
    vB = np.clip(log_normal(0.05, 0.4), 0.005, 0.3)
    return np.stack([K1, K1 / ratio, k3, k4, vB], axis=1)


def _curve(closed_form: ClosedForm, model: str):
    return {"2TCM": closed_form.two_tissue, "2TCM3k": closed_form.trapping, "1TCM": closed_form.one_tissue}[model]
