"""Contrasts of noise alone: p-values are uniform where the size of their noise is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from petkin.diagnosis import Family, Pattern, judge_contrasts
from petkin.diagnosis.families import _gained, _whitened

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
        families[name] = Family.of(rows, nuisance, noise, 1e-9)
    return judge_contrasts(families, patterns, draws=200, rng=rng).p_value


@pytest.mark.parametrize("noise", [np.eye(ROWS), SHARED])
@pytest.mark.parametrize("nuisance", [APART, TOGETHER])
def test_p_values_of_noise_are_uniform(nuisance: np.ndarray, noise: np.ndarray) -> None:
    rng = np.random.default_rng(1)
    found = np.array([p_of_noise(rng, nuisance, noise) for _ in range(300)])
    assert 0.02 <= np.mean(found <= 0.05) <= 0.09
    assert 0.15 <= np.mean(found <= 0.25) <= 0.35
    assert 0.4 <= np.mean(found <= 0.5) <= 0.6


@pytest.mark.parametrize("noise", [np.eye(ROWS), SHARED])
@pytest.mark.parametrize("nuisance", [APART, TOGETHER])
def test_likelihood_is_that_of_a_normal_distribution(nuisance: np.ndarray, noise: np.ndarray) -> None:
    """How much likelier rows are that may hold it than rows of noise."""
    rows = np.random.default_rng(2).standard_normal((ROWS, SAMPLES))
    alone = np.kron(noise, np.eye(SAMPLES))
    flat = nuisance.reshape(len(nuisance), -1)
    held, none = (multivariate_normal(cov=cov).logpdf(rows.ravel()) for cov in (alone + flat.T @ flat, alone))
    family = Family.of(rows, nuisance, noise, 1e-9)
    (white,) = _whitened(family.white, rows[None])
    assert _gained(family.nuisance @ white, family.inner) == pytest.approx(held - none, rel=1e-9)


@pytest.mark.parametrize("noise", [np.eye(ROWS), SHARED])
@pytest.mark.parametrize("times", [1.0, 30.0, 1e5])
def test_scores_are_those_of_the_whole_covariance(noise: np.ndarray, times: float) -> None:
    """As its singular values give them, however large nuisance is, and though some of its columns are nearly alike."""
    rng = np.random.default_rng(4)
    rows, columns = rng.standard_normal((ROWS, SAMPLES)), rng.standard_normal((2, ROWS * SAMPLES))
    nuisance = times * np.concatenate([APART, TOGETHER, APART * np.linspace(0.9, 1.1, SAMPLES)])
    white = np.linalg.inv(np.kron(np.linalg.cholesky(noise), np.eye(SAMPLES)))
    axes, size, _ = np.linalg.svd(white @ nuisance.reshape(len(nuisance), -1).T)
    size = np.pad(size, (0, len(axes) - len(size)))
    seen, shown = axes.T @ white @ columns.T, axes.T @ white @ rows.ravel()
    score, information = Family.of(rows, nuisance, noise, 1e-9).scored(columns)
    np.testing.assert_allclose(score, seen.T @ (shown / (1.0 + size**2)), rtol=1e-6)
    np.testing.assert_allclose(information, (seen.T / (1.0 + size**2)) @ seen, rtol=1e-6)


@pytest.mark.parametrize(("mixed", "least", "most"), [(0.0, 0.1, 0.1), (0.3, 0.2, 0.4), (5.0, 1.2, 1.2)])
def test_a_family_holds_as_much_besides_as_it_shows(mixed: float, least: float, most: float) -> None:
    """The median of what several hold, each told by its three rows alone."""
    rng = np.random.default_rng(3)
    further = 20.0 * np.eye(ROWS)[:, :, None] * np.exp(-np.arange(SAMPLES) / 2.0)
    shares = []
    for _ in range(40):
        besides = mixed * np.tensordot(rng.standard_normal(ROWS), further, 1)
        bare = Family.of(rng.standard_normal((ROWS, SAMPLES)) + besides, APART[:0], np.eye(ROWS), 1e-9)
        shares.append(np.abs(bare.holding(further, times=2.0).nuisance).max() / np.abs(further).max())
    assert least - 1e-9 <= np.median(shares) / 2.0 <= most + 1e-9


def test_what_a_column_leaves_of_noise_is_one_a_degree_of_freedom() -> None:
    rng, column = np.random.default_rng(3), np.ones((ROWS, SAMPLES)) * COURSE
    drawn = [np.linalg.cholesky(SHARED) @ rng.standard_normal((ROWS, SAMPLES)) for _ in range(200)]
    families = [Family.of(rows + APART[0] + 5.0 * column, APART, SHARED, 1e-9) for rows in drawn]
    assert np.mean([family.misfit(column) for family in families]) == pytest.approx(1.0, abs=0.05)
    odd = 3.0 * np.ones((ROWS, 1)) * (-1.0) ** np.arange(SAMPLES)
    assert np.mean([replace(f, rows=f.rows + odd).misfit(column) for f in families[:20]]) > 4.0


def test_a_size_is_that_of_a_usual_pattern_and_no_surer_than_what_it_leaves() -> None:
    """Half of the course is liked more; the whole one says how much, what it leaves of the contrasts in its error."""
    rng = np.random.default_rng(4)
    early = np.ones((ROWS, 1)) * (np.arange(SAMPLES) < SAMPLES // 2)
    whole = np.ones((ROWS, SAMPLES))
    patterns = [Pattern("drift", "x", whole, {}), Pattern("drift", "x", early, {}, usual=False)]
    rows = 4.0 * early + rng.standard_normal((ROWS, SAMPLES))
    family = Family.of(rows, np.zeros((0, ROWS, SAMPLES)), np.eye(ROWS), 1e-9)
    found = judge_contrasts({"x": family}, patterns, draws=50, rng=rng)
    assert found.settings["drift"][1][1] > found.settings["drift"][0][1]
    best = found.best["drift"]
    assert best.pattern is patterns[0]
    assert best.value == pytest.approx(4.0 * (SAMPLES // 2) / SAMPLES, abs=0.3)
    assert best.high - best.low > 2.5 * 1.645 * whole.size**-0.5 * 1.5
    assert best.detectability == pytest.approx(whole.size**0.5)
    assert set(found.drawn) == {"drift"}


def test_a_size_is_read_though_nuisance_that_looks_like_it_was_told_too_large() -> None:
    """Rows that are short of the pattern just where nuisance is not: beside all of it little would be left."""
    time = np.linspace(0.0, 1.0, SAMPLES)
    pattern, alike = np.ones((ROWS, 1)) * time, np.ones((ROWS, 1)) * time**2
    apart = pattern - (pattern * alike).sum() / (alike**2).sum() * alike
    family = Family.of(20.0 * (pattern - apart), 2.0 * alike[None], np.eye(ROWS), 1e-9)
    found = judge_contrasts({"x": family}, [Pattern("drift", "x", pattern, {})], draws=50, rng=np.random.default_rng(0))
    scores, information = family.scored(pattern.reshape(1, -1))
    assert float(scores[0] / information[0, 0]) < 8.0
    assert found.best["drift"].value > 14.0


def test_places_that_follow_courses_score_as_their_columns_do() -> None:
    rng = np.random.default_rng(4)
    rows, noise = rng.standard_normal((5, 12)), rng.standard_normal((5, 5))
    family = Family.of(rows, rng.standard_normal((9, 5, 12)), noise @ noise.T + np.eye(5), 1e-9)
    places, courses = rng.standard_normal((4, 5, 12)), rng.standard_normal((3, 12))
    others = rng.standard_normal((2, 60))
    columns = np.concatenate([(places[:, None] * courses[None, :, None]).reshape(-1, 60), others])
    for found, expected in zip(family.scored_over_time(places, courses, others), family.scored(columns), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10)
