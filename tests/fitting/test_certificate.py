"""Proofs that no fit is better: never above what exhaustive search finds, and near to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import nnls

from petkin.fitting import REGIONS, VOXELS, NonlinearSettings, fit_curves, tabulate
from petkin.fitting.certificate import certify, hulls
from petkin.fitting.nonlinear import squeeze
from petkin.fitting.sensitivity import read_basis
from petkin.imaging import FrameObservation
from petkin.inputs.input_function import InputFunction
from petkin.kinetics import MODELS, ONE_TISSUE, TWO_TISSUE

from .fitting_problems import ARTERIAL, FRAMES, PLAIN, bolus, counting_sd, frame_averages, uniform_truth
from .test_search_quality import FDG_FRAMES, best_known, voxels

FDG = InputFunction(bolus(0.0), bolus(0.0))
SCANNED = FrameObservation(FDG_FRAMES)


@pytest.mark.parametrize("share", [0.05, 0.15])
def test_no_bound_lies_above_the_best_that_exhaustive_search_finds(share):
    """Also where the fit at hand is made to look worse than it is, so that the proof has to stop at the truth."""
    curves, weights = voxels(12, share)
    settings = NonlinearSettings(TWO_TISSUE)
    result, table = fit_curves(curves, FDG, SCANNED, weights, settings), tabulate(FDG, SCANNED, settings)
    best = best_known(curves, weights)
    for worse in (1.0, 1.01, 1.3):
        spoilt = replace(result, chi2=worse * result.chi2)
        gap = certify(curves, spoilt, table, settings, within=1e-5, most=3000).values
        bound = spoilt.chi2 * (len(weights) - 5) * (1.0 - gap / 100.0)
        assert (bound <= best * (1 + 1e-6)).all()
        assert (gap >= 100.0 * (1.0 - 1.0 / worse) - 1e-3).all()


@pytest.mark.parametrize(("share", "proven"), [(0.15, 0.98), (0.05, 0.98)])
def test_nearly_every_voxel_is_proven(share, proven):
    curves, weights = voxels(400, share)
    settings = NonlinearSettings(TWO_TISSUE, effort=VOXELS)
    result = fit_curves(curves, FDG, SCANNED, weights, settings)
    gap = certify(curves, result, tabulate(FDG, SCANNED, settings), settings).values
    assert np.mean(gap <= 0.1) >= proven
    assert np.mean(gap <= 1.0) >= 0.995


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.label)
def test_regions_of_every_model_are_proven(model):
    """To 1e-5 of the cost where the table begins at the slowest rate; beside a wall it begins at 0."""
    clean = frame_averages("2TCM", uniform_truth("2TCM", 10))
    curves = clean + counting_sd(clean, 0.03) * np.random.default_rng(3).standard_normal(clean.shape)
    settings = NonlinearSettings(model)
    result = fit_curves(curves, ARTERIAL, PLAIN, FRAMES.duration, settings)
    gap = certify(curves, result, tabulate(ARTERIAL, PLAIN, settings), settings, within=1e-5, most=3000).values
    assert (gap[~model.wall :] <= 2e-3).all() if not model.wall else np.median(gap) < 0.1


def test_a_held_blood_volume_is_part_of_the_proof():
    clean = frame_averages("1TCM", uniform_truth("1TCM", 5))
    curves = clean + counting_sd(clean, 0.03) * np.random.default_rng(4).standard_normal(clean.shape)
    held = NonlinearSettings(ONE_TISSUE, ONE_TISSUE.parameters.with_fixed({"vB": 0.1}))
    result = fit_curves(curves, ARTERIAL, PLAIN, FRAMES.duration, held)
    table = tabulate(ARTERIAL, PLAIN, held)
    gap = certify(curves, result, table, held, within=1e-5, most=3000).values
    assert (gap <= 2e-3).all()
    free = fit_curves(curves, ARTERIAL, PLAIN, FRAMES.duration, NonlinearSettings(ONE_TISSUE))
    assert (free.chi2 < 0.9 * result.chi2).any()  # which a proof that forgot the held value would have found


def test_curves_without_a_fit_have_no_proof():
    curves = np.zeros((2, len(FRAMES)))
    curves[1] = np.nan
    settings = NonlinearSettings(TWO_TISSUE)
    result = fit_curves(curves, ARTERIAL, PLAIN, FRAMES.duration, settings)
    assert np.isnan(certify(curves, result, tabulate(ARTERIAL, PLAIN, settings), settings).values).all()


def test_each_interval_of_the_table_lies_in_the_cone_of_its_control_points():
    settings = NonlinearSettings(TWO_TISSUE, effort=REGIONS)
    packed = squeeze(tabulate(ARTERIAL, PLAIN, settings), FRAMES.duration, settings)
    hull = hulls(packed, blood=True)
    u = np.random.default_rng(0).uniform(packed.u[0], packed.u[-1], 200)
    curves, _ = read_basis(packed, np.exp(u) - 1e-3)
    for at, curve in zip(((u - packed.u[0]) / (packed.u[1] - packed.u[0])).astype(int), curves):
        _, left = nnls(hull.atoms[3 * at : 3 * at + 4].T, curve / np.linalg.norm(curve))
        assert left < 1e-9
    every = np.vstack([hull.atoms[: 3 * len(packed.u) - 2], hull.atoms[-1:]])
    assert (every @ hull.raised >= 1.0 - 1e-12).all()
