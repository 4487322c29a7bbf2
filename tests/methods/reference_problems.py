"""A tissue and a reference region under one plasma curve, by an ODE solver that petkin does not use."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp

from petkin.fitting import Given, ReferenceCurve
from petkin.imaging import FrameObservation, FrameSchedule

DURATIONS = np.repeat([1 / 6, 1 / 3, 0.5, 1.0, 2.0, 5.0], [12, 6, 6, 3, 5, 14])
END = np.cumsum(DURATIONS)
FRAMES = FrameSchedule(END - DURATIONS, END)
DECAY = np.log(2) / 20.364
OBSERVATION = FrameObservation(FRAMES, DECAY)
#: K1' and k2' of the reference region.
K1_REFERENCE, K2_REFERENCE = 0.1, 0.12
ARRIVAL = 0.6


@dataclass(frozen=True)
class Tissue:
    """Rate constants relative to the reference region; k3 = k4 = 0 is one compartment."""

    R1: float
    k2: float
    k3: float = 0.0
    k4: float = 0.0

    @property
    def K1(self) -> float:
        return self.R1 * K1_REFERENCE


def one_tissue(R1: float, BPND: float, k2prime: float = K2_REFERENCE) -> Tissue:
    """What SRTM takes a region for: one compartment with k2a = R1 k2' / (1 + BPND)."""
    return Tissue(R1, R1 * k2prime / (1.0 + BPND))


def plasma(t: float) -> float:
    s = max(t - ARRIVAL, 0.0)
    return (
        400.0 * s * np.exp(-4.0 * s)
        + 25.0 * (np.exp(-0.12 * s) - np.exp(-4.0 * s))
        + 12.0 * s / (s + 0.3) * (np.exp(-0.012 * s))
    )


def curves(tissues: list[Tissue]) -> tuple[np.ndarray, np.ndarray]:
    """Decay-weighted frame means of the reference region (K,) and of the tissues (N, K), kBq/mL."""
    K1, k2, k3, k4 = np.array([(t.K1, t.k2, t.k3, t.k4) for t in tissues]).T
    count = len(tissues)

    def slope(t, state):
        reference, free, bound = state[0], state[1 : 1 + count], state[1 + count : 1 + 2 * count]
        C_P = plasma(t)
        d_reference = K1_REFERENCE * C_P - K2_REFERENCE * reference
        d_free = K1 * C_P - (k2 + k3) * free + k4 * bound
        seen = np.append(reference, free + bound) * np.exp(-DECAY * t)
        return np.concatenate([[d_reference], d_free, k3 * free - k4 * bound, seen])

    state = np.zeros(1 + 2 * count + 1 + count)
    edges = np.unique(np.concatenate([[0.0, ARRIVAL], FRAMES.start, FRAMES.end]))
    at = {0.0: np.zeros(1 + count)}
    for start, end in pairwise(edges):
        solved = solve_ivp(slope, (start, end), state, method="DOP853", rtol=1e-11, atol=1e-11)
        state = solved.y[:, -1]
        at[end] = state[1 + 2 * count :].copy()
    areas = np.array([at[end] - at[start] for start, end in zip(FRAMES.start, FRAMES.end)])
    weight = (np.exp(-DECAY * FRAMES.start) - np.exp(-DECAY * FRAMES.end)) / DECAY
    values = (areas / weight[:, None]).T
    return values[0], values[1:]


def given_for(reference: np.ndarray, weights: np.ndarray | None = None) -> Given:
    weights = DURATIONS * np.exp(-DECAY * FRAMES.mid) if weights is None else weights
    return Given(OBSERVATION, weights / weights.mean(), reference=ReferenceCurve("cerebellum", reference))


def noisy(clean: np.ndarray, share: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Curves with counting-like noise, `share` on average after 10 min, and the weights that belong to it."""
    mean = np.maximum(clean.mean(axis=0), 0.02 * clean.mean(axis=0).max())
    sd = np.sqrt(mean * np.exp(DECAY * FRAMES.mid) / DURATIONS)
    late = FRAMES.mid > 10
    sd *= share / np.mean(sd[late] / mean[late])
    return clean + sd * np.random.default_rng(seed).standard_normal(clean.shape), 1.0 / sd**2
