"""Which bound a fit ended on, in words and as a code."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from petkin.fitting import REGIONS, VOXELS, NonlinearSettings, Status, fit_curves
from petkin.kinetics import TWO_TISSUE, TWO_TISSUE_TRAPPING

from .fitting_problems import ARTERIAL, FRAMES, PLAIN, frame_averages


def words(result) -> list[object]:
    return list(next(c for c in result.columns if c.name == "bound").cells)


@pytest.mark.parametrize("effort", [REGIONS, VOXELS], ids=["regions", "voxels"])
def test_a_bound_is_named_with_its_side(effort):
    truth = np.array([[0.12, 0.12, 0.06, 0.03, 0.05]])
    curves = frame_averages("2TCM", truth)
    box = TWO_TISSUE.parameters.with_bounds({"K1": (0.0, 0.1), "k4": (0.05, 1.0)})
    result = fit_curves(curves, ARTERIAL, PLAIN, FRAMES.duration, NonlinearSettings(TWO_TISSUE, box, effort=effort))
    assert words(result) == ["K1 at 0.1; k4 at 0.05"]
    assert result.status[0] == Status.AT_BOUND
    free = fit_curves(curves, ARTERIAL, PLAIN, FRAMES.duration, NonlinearSettings(TWO_TISSUE, effort=effort))
    assert pd.isna(words(free)[0])
    assert free.column("bound")[0] == 0


def test_the_ends_of_the_rates_are_named():
    irreversible = frame_averages("2TCM3k", np.array([[0.1, 0.15, 0.05, 0.0]]))
    result = fit_curves(irreversible, ARTERIAL, PLAIN, FRAMES.duration, NonlinearSettings(TWO_TISSUE))
    assert words(result)[0].endswith("slowest rate at 0.001 per min")
    trapped = fit_curves(irreversible, ARTERIAL, PLAIN, FRAMES.duration, NonlinearSettings(TWO_TISSUE_TRAPPING))
    assert words(trapped) == ["vB at 0"] or pd.isna(words(trapped)[0])
    assert not any("slowest" in text for text in trapped.columns[0].levels.values())


def test_curves_with_weights_of_their_own_keep_their_bounds():
    curves = frame_averages("2TCM", np.array([[0.12, 0.12, 0.06, 0.03, 0.05], [0.2, 0.12, 0.06, 0.03, 0.05]]))
    box = TWO_TISSUE.parameters.with_bounds({"K1": (0.0, 0.15)})
    weights = np.stack([FRAMES.duration, np.ones(len(FRAMES))])
    result = fit_curves(curves, ARTERIAL, PLAIN, weights, NonlinearSettings(TWO_TISSUE, box))
    assert pd.isna(words(result)[0])
    assert words(result)[1] == "K1 at 0.15"
    assert result.estimates[0].meaning


def test_a_curve_that_is_not_fitted_reaches_no_bound():
    curves = np.zeros((2, len(FRAMES)))
    curves[1] = np.nan
    result = fit_curves(curves, ARTERIAL, PLAIN, FRAMES.duration, NonlinearSettings(TWO_TISSUE))
    assert (result.column("bound") == 0).all()
