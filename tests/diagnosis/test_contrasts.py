"""Contrasts of noise alone: p-values are uniform where the size of their noise is known."""

from __future__ import annotations

import numpy as np
import pytest

from petkin.diagnosis import Family, Pattern, judge_contrasts

ROWS, SAMPLES = 3, 15


COURSE = np.exp(-np.arange(SAMPLES) / 6.0)
#: What rows hold besides: each for itself, or all the same.
APART = 3.0 * np.eye(ROWS)[:, :, None] * COURSE
TOGETHER = 3.0 * np.ones((1, ROWS, 1)) * COURSE


#: Rows that share noise.
SHARED = 0.6 * np.eye(ROWS) + 0.4


def p_of_noise(rng: np.random.Generator, nuisance: np.ndarray, noise: np.ndarray) -> float:
    patterns = [
        Pattern("step", name, np.ones((ROWS, 1)) * COURSE * (np.arange(SAMPLES) >= k), {"onset": float(k)})
        for name in ("x", "y")
        for k in range(2, SAMPLES)
    ]
    families = {}
    for name in ("x", "y"):
        rows = np.linalg.cholesky(noise) @ rng.standard_normal((ROWS, SAMPLES))
        rows = rows + np.tensordot(rng.standard_normal(len(nuisance)), nuisance, 1)
        families[name] = Family(rows, nuisance, noise)
    return judge_contrasts(families, patterns, least=1e-9, draws=200, rng=rng).p_value


@pytest.mark.parametrize("noise", [np.eye(ROWS), SHARED])
@pytest.mark.parametrize("nuisance", [APART, TOGETHER])
def test_p_values_of_noise_are_uniform(nuisance: np.ndarray, noise: np.ndarray) -> None:
    rng = np.random.default_rng(1)
    found = np.array([p_of_noise(rng, nuisance, noise) for _ in range(300)])
    assert 0.02 <= np.mean(found <= 0.05) <= 0.09
    assert 0.15 <= np.mean(found <= 0.25) <= 0.35
    assert 0.4 <= np.mean(found <= 0.5) <= 0.6
