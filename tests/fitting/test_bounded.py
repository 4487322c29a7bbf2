"""Fits inside a box against scipy: the optimum, the interval of rates, and a blood volume that is known."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.optimize import least_squares

from petkin.fitting import REGIONS, VOXELS, NonlinearSettings, Status, fit_curves
from petkin.kinetics import ONE_TISSUE, TWO_TISSUE, TWO_TISSUE_TRAPPING

from .fitting_problems import ARTERIAL, PLAIN, counting_sd, frame_averages

TRUTH = {
    "1TCM": [0.12, 0.1, 0.05],
    "2TCM3k": [0.12, 0.15, 0.05, 0.05],
    "2TCM": [0.12, 0.12, 0.06, 0.03, 0.05],
}
EFFORTS = pytest.mark.parametrize("effort", [REGIONS, VOXELS], ids=["regions", "voxels"])


def noisy(label: str, count: int, share: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
    clean = frame_averages(label, np.array([TRUTH[label]]))
    sd = counting_sd(clean, share)
    return clean + sd * np.random.default_rng(3).standard_normal((count, clean.shape[1])), 1.0 / sd[0] ** 2


def least_cost(label: str, curve: np.ndarray, weights: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> float:
    """Best of `least_squares` from all corners of a smaller box, by formulas that are not petkin's."""
    root = np.sqrt(weights)
    starts = itertools.product(*(lo + (hi - lo) * np.array([0.15, 0.7]) for lo, hi in zip(lower, upper)))

    def residual(p: np.ndarray) -> np.ndarray:
        return root * (frame_averages(label, p[None])[0] - curve)

    bounds = (lower, upper)
    return min(2.0 * least_squares(residual, x, bounds=bounds, x_scale="jac", ftol=1e-10).cost for x in starts)


@EFFORTS
@pytest.mark.parametrize(
    ("model", "bounds"),
    [
        (ONE_TISSUE, {"K1": (0.01, 0.11), "k2": (0.02, 1.0), "vB": (0.0, 0.3)}),
        (TWO_TISSUE_TRAPPING, {"K1": (0.01, 0.5), "k2": (0.2, 1.0), "k3": (0.01, 0.05), "vB": (0.0, 0.3)}),
        (
            TWO_TISSUE,
            {"K1": (0.01, 0.5), "k2": (0.02, 0.9), "k3": (0.01, 0.05), "k4": (0.01, 0.025), "vB": (0.06, 0.3)},
        ),
    ],
    ids=lambda value: getattr(value, "label", ""),
)
def test_the_optimum_is_that_of_scipy(model, bounds, effort):
    curves, weights = noisy(model.label, 4)
    box = model.parameters.with_bounds(bounds)
    result = fit_curves(curves, ARTERIAL, PLAIN, weights, NonlinearSettings(model, parameters=box, effort=effort))
    least = np.array([least_cost(model.label, curve, weights, box.lower, box.upper) for curve in curves])
    freedom = curves.shape[1] - len(box)
    np.testing.assert_allclose(result.chi2 * freedom, least, rtol=1e-3 if effort is VOXELS else 1e-5)
    assert np.isin(result.status, (Status.OK, Status.AT_BOUND, Status.NOT_IDENTIFIABLE)).all()


@EFFORTS
def test_rates_keep_their_interval_whatever_the_box(effort):
    curves, weights = noisy("2TCM", 200, 0.15)
    box = TWO_TISSUE.parameters.with_bounds({"K1": (0.0, 0.11), "k4": (0.0, 0.02)})
    settings = NonlinearSettings(TWO_TISSUE, parameters=box, rate_bounds=(0.005, 1.0), effort=effort)
    result = fit_curves(curves, ARTERIAL, PLAIN, weights, settings)
    (_, fast), (_, slow) = TWO_TISSUE.impulse(*(result[s] for s in ("K1", "k2", "k3", "k4")))
    assert slow.min() > 0.005 * (1 - 1e-3)
    assert fast.max() < 1.0 * (1 + 1e-3)
    values = np.stack([result[s] for s in box.symbols], axis=1)
    assert ((values >= box.lower) & (values <= box.upper)).all()
    assert result.count(Status.NOT_CONVERGED) == 0


def test_bounds_that_nothing_touches_change_nothing():
    curves, weights = noisy("2TCM", 300, 0.02)
    wide = TWO_TISSUE.parameters.with_bounds({"K1": (0.0, 2.0), "k2": (0.0, 3.0), "k3": (0.0, 1.0), "k4": (0.0, 0.5)})
    free, boxed = (
        fit_curves(curves, ARTERIAL, PLAIN, weights, NonlinearSettings(TWO_TISSUE, parameters=box, effort=VOXELS))
        for box in (None, wide)
    )
    np.testing.assert_allclose(boxed["VT"], free["VT"], rtol=5e-3)
    np.testing.assert_allclose(boxed.chi2, free.chi2, rtol=1e-4)


@pytest.mark.parametrize("model", [ONE_TISSUE, TWO_TISSUE_TRAPPING, TWO_TISSUE], ids=lambda m: m.label)
def test_a_known_blood_volume_is_searched_without(model):
    """Against the bounded fit of the same, which blood volumes in a hair's breadth come to."""
    curves, weights = noisy(model.label, 100)
    near = model.parameters.with_bounds({"vB": (0.05 - 1e-7, 0.05 + 1e-7)})
    known, held = (
        fit_curves(curves, ARTERIAL, PLAIN, weights, NonlinearSettings(model, parameters=box, effort=VOXELS))
        for box in (model.parameters.with_fixed({"vB": 0.05}), near)
    )
    assert (known["vB"] == 0.05).all()
    freedom = curves.shape[1] - len(model.parameters)
    cost, bounded = known.chi2 * (freedom + 1), held.chi2 * freedom
    np.testing.assert_allclose(cost, bounded, rtol=1e-3)


def test_neighbours_do_not_change_a_bit():
    curves, weights = noisy("2TCM", 90, 0.15)
    box = TWO_TISSUE.parameters.with_bounds({"K1": (0.0, 0.1), "k4": (0.0, 0.02)})
    settings = NonlinearSettings(TWO_TISSUE, parameters=box, effort=VOXELS)
    whole = fit_curves(curves, ARTERIAL, PLAIN, weights, settings)
    for part in (slice(0, 1), slice(33, 70)):
        alone = fit_curves(curves[part], ARTERIAL, PLAIN, weights, settings)
        for symbol in box.symbols:
            assert alone[symbol].tobytes() == whole[symbol][part].tobytes(), symbol
