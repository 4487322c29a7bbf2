"""The automatic start of the linear part: late where the plot bends, earlier where noise outweighs the bend."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from petkin.errors import InputError
from petkin.fitting import Choices, FitResult, Given
from petkin.methods import find_method

from .fitting_problems import ARTERIAL, FRAMES, PLAIN, blood_averages, counting_sd, frame_averages, macro, uniform_truth


def regions(label: str, share: float, seed: int = 1, count: int = 12) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Curves without blood, true parameters, and weights by the mean curve's noise."""
    truth = uniform_truth(label, count, seed)
    truth[:, -1] = 0.0
    clean = frame_averages(label, truth)
    sd = counting_sd(clean, max(share, 0.01))
    noise = np.random.default_rng(seed).standard_normal(clean.shape)
    return clean + (share > 0) * sd * noise, truth, 1.0 / counting_sd(clean.mean(axis=0)[None], 0.01)[0] ** 2


def fit(method: str, curves: np.ndarray, weights: np.ndarray, t_star: float | None = None) -> FitResult:
    return find_method(method).fit(curves, Given(PLAIN, weights, ARTERIAL), Choices(t_star=t_star), False)


@pytest.mark.parametrize("method", ["Logan", "MA1"])
def test_bias_at_the_start_found_is_smaller_than_at_the_fixed_one(method):
    """Two tissues, 1 percent noise, 6 scans of 12 regions: root mean square error of VT at least a tenth lower."""
    errors: dict[float | None, list[np.ndarray]] = {None: [], 30.0: []}
    starts = []
    for seed in range(6):
        curves, truth, weights = regions("2TCM", 0.01, seed)
        for t_star, found in errors.items():
            result = fit(method, curves, weights, t_star)
            found.append(result["VT"] / macro("2TCM", "VT", truth) - 1.0)
            if t_star is None:
                starts.append(result.settings["t_star"])
    automatic, fixed = (float(np.sqrt(np.mean(np.concatenate(errors[t]) ** 2))) for t in (None, 30.0))
    assert automatic < 0.9 * fixed
    assert 30.0 < np.median(starts) < 70.0


def test_noise_brings_the_start_forward():
    medians = [
        np.median([fit("Logan", *regions("2TCM", s, seed)[::2]).settings["t_star"] for seed in range(6)])
        for s in (0.0, 0.02, 0.1)
    ]
    assert medians[0] > medians[1] > medians[2]


def test_a_line_from_the_beginning_is_used_from_early_on():
    """One tissue obeys the equation at all times: with noise the first minutes are worth having."""
    starts = [fit("Logan", *regions("1TCM", 0.02, seed)[::2]).settings["t_star"] for seed in range(6)]
    assert np.median(starts) < 20.0


def test_the_choice_is_said_and_drawn():
    curves, _, weights = regions("2TCM3k", 0.02)
    result = fit("Patlak", curves, weights)
    t_star = result.settings["t_star"]
    assert result.settings["t_star_from"] == "curves"
    assert t_star in FRAMES.start
    assert result.settings["frames_used"] == (FRAMES.start >= t_star).sum()
    line, search = result.plots
    assert (line.title, search.title) == ("Patlak plot", "Choice of t*")
    assert search.mark == t_star
    assert f"t* = {t_star:.4g} min" in line.text
    assert f"t* = {t_star:.4g} min" in search.text
    assert len(line.points) == len(search.points) == 6
    assert [name for name, _, _ in line.points] == [name for name, _, _ in line.lines]
    again = fit("Patlak", curves, weights, t_star)
    assert again["Ki"].tobytes() == result["Ki"].tobytes()
    assert again.settings["t_star_from"] == "choice"
    assert len(again.plots) == 1


@pytest.mark.parametrize("method", ["Patlak", "Logan", "MA1"])
def test_fitted_values_lie_on_the_line_of_the_plot(method):
    curves, _, weights = regions("2TCM", 0.02)
    result = fit(method, curves, weights, 30.0)
    (plot,) = result.plots
    slope = result[find_method(method).outcome]
    for name, x, y in plot.lines:
        n = int(name) - 1
        if method == "MA1":
            assert result.predicted is not None
            np.testing.assert_allclose(y, result.predicted[n][np.isfinite(result.predicted[n])])
            continue
        intercept = result[{"Patlak": "V0", "Logan": "intercept"}[method]][n]
        np.testing.assert_allclose(y, slope[n] * x + intercept, rtol=1e-9)
    values = [slope[int(name) - 1] for name, _, _ in plot.points]
    assert values == sorted(values)
    assert values[0] == slope.min()
    assert values[-1] == slope.max()


def test_curves_that_cannot_be_fitted_have_no_say():
    curves, _, weights = regions("2TCM", 0.02)
    odd = np.concatenate([curves, np.full((3, len(FRAMES)), np.nan), np.zeros((2, len(FRAMES)))])
    assert fit("Logan", odd, weights).settings["t_star"] == fit("Logan", curves, weights).settings["t_star"]
    with pytest.raises(InputError, match="Logan: no curve tells where its linear part begins; give it with --t-star"):
        fit("Logan", np.zeros((2, len(FRAMES))), weights)
    few = np.where(np.arange(len(FRAMES)) < len(FRAMES) - 4, 0.0, weights)
    with pytest.raises(InputError, match=r"Logan: 4 frames with weight are too few to find t\*; give it with --t-star"):
        fit("Logan", curves, few)


def test_blood_left_in_does_not_stop_it():
    curves, _, weights = regions("2TCM", 0.01)
    bloody = 0.95 * curves + 0.05 * blood_averages()
    result = find_method("Logan").fit(
        bloody, Given(PLAIN, weights, ARTERIAL), replace(Choices(t_star=None), fixed={"vB": 0.05}), False
    )
    assert result.settings["t_star"] == fit("Logan", curves, weights).settings["t_star"]
