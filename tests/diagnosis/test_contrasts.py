"""Contrasts of noise alone: p-values are uniform where the size of their noise is known."""

from __future__ import annotations

import numpy as np

from petkin.diagnosis import Family, Pattern, judge_contrasts

ROWS, SAMPLES = 3, 15


def p_of_noise(rng: np.random.Generator) -> float:
    courses = np.exp(-np.arange(SAMPLES) / 6.0) * np.ones((ROWS, 1))
    patterns = [
        Pattern("step", name, courses * (np.arange(SAMPLES) >= k), {"onset": float(k)})
        for name in ("x", "y")
        for k in range(2, SAMPLES)
    ]
    families = {
        name: Family(
            rng.standard_normal((ROWS, SAMPLES)) + 3.0 * rng.standard_normal((ROWS, 1)) * courses,
            3.0 * courses[:, :, None],
            np.ones(ROWS),
        )
        for name in ("x", "y")
    }
    return judge_contrasts(families, patterns, least=1e-9, draws=200, rng=rng).p_value


def test_p_values_of_noise_are_uniform() -> None:
    rng = np.random.default_rng(0)
    found = np.array([p_of_noise(rng) for _ in range(200)])
    assert 0.02 <= np.mean(found <= 0.05) <= 0.09
    assert 0.15 <= np.mean(found <= 0.25) <= 0.35
    assert 0.4 <= np.mean(found <= 0.5) <= 0.6
