"""Curves that two sets of parameters fit alike."""

from __future__ import annotations

import itertools

import numpy as np
from scipy.optimize import least_squares, nnls

from petkin.fitting import NonlinearSettings, Status, fit_curves, tabulate
from petkin.fitting.minima import with_second_minimum
from petkin.imaging import FrameObservation
from petkin.inputs.input_function import InputFunction
from petkin.kinetics import TWO_TISSUE, VASCULAR_TRAPPING

from .fitting_problems import (
    ARTERIAL,
    FRAMES,
    PLAIN,
    basis_averages,
    blood_averages,
    bolus,
    counting_sd,
    frame_averages,
)
from .test_search_quality import FDG_EDGES, FDG_FRAMES, voxels


def test_a_second_minimum_is_one_that_an_independent_fit_ends_in():
    """Of 300 noisy FDG-like curves a few have one, which exhaustive search finds too."""
    curves, weights = voxels(300, 0.05)
    arterial, observation = InputFunction(bolus(0.0), bolus(0.0)), FrameObservation(FDG_FRAMES)
    settings = NonlinearSettings(TWO_TISSUE)
    plain = fit_curves(curves, arterial, observation, weights, settings)
    result = with_second_minimum(plain, curves, tabulate(arterial, observation, settings), settings)
    found = np.flatnonzero(result.status == Status.SECOND_MINIMUM)
    assert 1 <= len(found) <= 10
    other = result.column("VT-second")
    assert (np.isfinite(other) == (result.status == Status.SECOND_MINIMUM)).all()
    for n in found:
        assert abs(other[n] - result["VT"][n]) > 2 * result["VT"][n] * result.percent_se("VT")[n] / 100
        assert _ends_in(curves[n], weights, other[n], limit=plain.chi2[n] * (21 + 4.4))
    unchanged = result.status != Status.SECOND_MINIMUM
    assert (result.status[unchanged] == plain.status[unchanged]).all()


def _ends_in(curve: np.ndarray, weights: np.ndarray, VT: float, limit: float) -> bool:
    """Whether one of the local minima of an exhaustive search by scipy has this VT and a cost below the limit."""
    root, grid = np.sqrt(weights), np.log(np.geomspace(2e-3, 5.0, 36))
    blood, y = root * blood_averages(0.0, FDG_EDGES), root * curve

    def solve(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        atoms = np.vstack([blood, root * basis_averages(np.exp(u) - 1e-3, 0.0, FDG_EDGES)]).T
        amounts = nnls(atoms, y)[0]
        return y - atoms @ amounts, amounts

    cost = np.full((38, 38), np.inf)
    for i, j in itertools.combinations(range(36), 2):
        cost[i + 1, j + 1] = (solve(grid[[i, j]])[0] ** 2).sum()
    around = np.min([np.roll(cost, (a, b), (0, 1)) for a in (-1, 0, 1) for b in (-1, 0, 1)], axis=0)
    for i, j in np.argwhere(np.isfinite(cost) & (cost <= around)):
        start = np.clip(grid[[i - 1, j - 1]], grid[0] + 1e-6, grid[-1] - 1e-6)
        end = least_squares(lambda u: solve(u)[0], start, bounds=(grid[0], np.log(5.001)))
        vB, *phi = solve(end.x)[1]
        found = (np.array(phi) / (np.exp(end.x) - 1e-3)).sum() / (1 - vB)
        if 2 * end.cost <= limit and abs(found / VT - 1) < 0.02:
            return True
    return False


def test_well_determined_curves_have_none():
    clean = frame_averages("2TCM", np.array([[0.12, 0.12, 0.06, 0.03, 0.05]]))
    curves = clean + counting_sd(clean, 0.02) * np.random.default_rng(5).standard_normal((40, len(FRAMES)))
    settings = NonlinearSettings(TWO_TISSUE)
    result = fit_curves(curves, ARTERIAL, PLAIN, FRAMES.duration, settings)
    looked = with_second_minimum(result, curves, tabulate(ARTERIAL, PLAIN, settings), settings)
    assert (looked.status == result.status).all()
    assert np.isnan(looked.column("VT-second")).all()


def test_beside_vessel_walls_nothing_is_said():
    curves = frame_averages("2TCM", np.array([[0.12, 0.12, 0.06, 0.03, 0.05]]))
    settings = NonlinearSettings(VASCULAR_TRAPPING)
    result = fit_curves(curves, ARTERIAL, PLAIN, FRAMES.duration, settings)
    assert with_second_minimum(result, curves, tabulate(ARTERIAL, PLAIN, settings), settings) is result
