"""The compiled least squares of every curve: numpy's answer, whatever the columns, the type and the neighbours."""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np
import pytest

from petkin.errors import InputError
from petkin.fitting.linear import LinearDesign, LinearSolver
from petkin.fitting.regression import Quantity, Regression, fit_linear
from petkin.fitting.results import Status

K = 26
RNG = np.random.default_rng(7)
ONCE = np.tril(np.ones((K, K))) - 0.5 * np.eye(K)
OWN = (ONCE, ONCE @ ONCE)
LATE = np.where(np.arange(K) >= 12, 0.5 + RNG.random(K), 0.0)
NOISE = 0.5 + RNG.random(K)
CURVES = (5.0 + RNG.random((150, K))) * np.linspace(1.0, 3.0, 150)[:, None]
COLUMNS = pytest.mark.parametrize(("shared", "own"), [(2, 0), (1, 1), (0, 1), (2, 1), (2, 2), (3, 2)])


def design(shared: int, own: int, weights: np.ndarray = LATE, **rest) -> LinearDesign:
    rng = np.random.default_rng(3)
    columns = np.cumsum(np.abs(rng.standard_normal((shared, K))), axis=1)
    operators = np.array(OWN[:own]).reshape(own, K, K)
    return LinearDesign(columns, operators, np.eye(K), weights, NOISE, rest.pop("offset", np.zeros(K)), **rest)


def by_numpy(d: LinearDesign, curve: np.ndarray) -> tuple[np.ndarray, float, np.ndarray, float]:
    """Unknowns, WRSS, covariance at unit noise and mean WRSS at unit noise, with matrices written out."""
    y = (curve - d.offset) * d.scale
    root = np.sqrt(d.weights[d.used])
    columns = np.array([*d.shared, *(operator @ y for operator in d.own)])[:, d.used].T * root[:, None]
    theta, wrss, *_ = np.linalg.lstsq(columns, (d.response @ y)[d.used] * root)
    left = d.response - sum((t * o for t, o in zip(theta[len(d.shared) :], d.own)), np.zeros((K, K)))
    left = (left * np.sqrt(d.noise))[d.used] * root[:, None]
    solve = np.linalg.pinv(columns)
    off = np.eye(len(root)) - columns @ solve
    return theta, wrss[0], solve @ left @ left.T @ solve.T, np.trace(off @ left @ left.T)


@COLUMNS
def test_unknowns_residuals_and_covariance_are_numpy_s(shared, own):
    d = design(shared, own, offset=np.linspace(0.0, 1.0, K), scale=1.25)
    solved = LinearSolver.prepare(d, "x").solve(np.ascontiguousarray(CURVES.T), slice(0, len(CURVES)))
    for n in range(0, len(CURVES), 7):
        theta, wrss, covariance, freedom = by_numpy(d, CURVES[n])
        np.testing.assert_allclose(solved.theta[:, n], theta, rtol=1e-8)
        np.testing.assert_allclose(solved.wrss[n], wrss, rtol=1e-9)
        np.testing.assert_allclose(solved.covariance[:, :, n], covariance, rtol=1e-6)
        np.testing.assert_allclose(solved.freedom[n], freedom, rtol=1e-8)


@pytest.mark.parametrize(("shared", "own"), [(2, 0), (1, 0)])
def test_with_the_weights_noise_the_covariance_is_the_usual_one(shared, own):
    d = replace(design(shared, own), noise=np.divide(1.0, LATE, out=np.ones(K), where=LATE > 0))
    solved = LinearSolver.prepare(d, "x").solve(np.ascontiguousarray(CURVES.T), slice(0, 3))
    columns = d.shared[:, d.used].T * np.sqrt(LATE[d.used])[:, None]
    np.testing.assert_allclose(solved.covariance[:, :, 1], np.linalg.inv(columns.T @ columns), rtol=1e-8)
    np.testing.assert_allclose(solved.freedom, len(d.used) - shared, rtol=1e-10)


@pytest.mark.parametrize(("shared", "own"), [(2, 0), (1, 1), (2, 1), (2, 2), (3, 2)])
def test_a_curve_of_the_equation_is_solved_to_rounding(shared, own):
    """Response made of the columns: theta comes back although sums of squares would have lost it."""
    d = design(shared, own, np.ones(K))
    theta = np.linspace(0.4, -0.23, shared + own)
    left = np.eye(K) - sum((t * o for t, o in zip(theta[shared:], d.own)), np.zeros((K, K)))
    curves = np.linalg.solve(left, theta[:shared] @ d.shared)[None]
    solved = LinearSolver.prepare(d, "x").solve(np.ascontiguousarray(curves.T), slice(0, 1))
    np.testing.assert_allclose(solved.theta[:, 0], theta, rtol=1e-7)
    assert solved.wrss[0] < 1e-24 * (curves**2).sum()


def test_a_curve_s_bytes_do_not_depend_on_neighbours_place_or_threads():
    d = design(2, 2)
    regression = Regression("x", (Quantity("a", "", ""), Quantity("b", "", "")))
    many = np.tile(CURVES, (300, 1))
    before = numba.get_num_threads()
    whole = fit_linear(many, d, regression, settings={}, keep_predicted=False)
    try:
        numba.set_num_threads(min(2, numba.config.NUMBA_NUM_THREADS))
        threads = fit_linear(many, d, regression, settings={}, keep_predicted=False)
    finally:
        numba.set_num_threads(before)
    alone = [fit_linear(c[None], d, regression, settings={}, keep_predicted=False) for c in CURVES[:5]]
    for symbol in ("a", "b"):
        assert whole[symbol].tobytes() == threads[symbol].tobytes()
        assert whole[symbol].tobytes() == np.tile(whole[symbol][: len(CURVES)], 300).tobytes()
        assert np.concatenate([r[symbol] for r in alone]).tobytes() == whole[symbol][:5].tobytes()
        assert np.concatenate([r.percent_se(symbol) for r in alone]).tobytes() == whole.percent_se(symbol)[:5].tobytes()


@pytest.mark.parametrize("order", ["C", "F"])
def test_single_precision_in_either_order_is_double_precision_of_the_same_numbers(order):
    d, regression = design(2, 1), Regression("x", (Quantity("a", "", ""),))
    single = np.asarray(CURVES, np.float32, order=order)
    double = fit_linear(single.astype(np.float64), d, regression, settings={}, keep_predicted=False)
    assert fit_linear(single, d, regression, settings={}, keep_predicted=False)["a"].tobytes() == double["a"].tobytes()


def test_columns_in_common_are_fitted_in_the_precision_of_the_curves():
    """Rounding stays far below the standard errors, and no verdict turns on it."""
    d, regression = design(2, 0), Regression("x", (Quantity("a", "", ""), Quantity("b", "", "")))
    single = np.asarray(CURVES, np.float32)
    double = fit_linear(single.astype(np.float64), d, regression, settings={}, keep_predicted=False)
    found = fit_linear(single, d, regression, settings={}, keep_predicted=False)
    assert found.status.tobytes() == double.status.tobytes()
    np.testing.assert_allclose(found.chi2, double.chi2, rtol=1e-4)
    np.testing.assert_allclose(found.aicc, double.aicc, atol=1e-2)
    for mine, exact in zip(found.estimates, double.estimates):
        assert mine.value.dtype == np.float32
        error = np.abs(exact.value) * exact.percent_se / 100.0
        assert (np.abs(mine.value - exact.value) < 1e-3 * error).all()
        np.testing.assert_allclose(mine.percent_se, exact.percent_se, rtol=1e-3)


def test_columns_that_depend_on_each_other_have_no_answer_and_say_so():
    """An own column that is a multiple of a shared one: not identifiable, and neighbours do not feel it."""
    d = design(1, 1)
    curves = CURVES[:3].copy()
    curves[1] = np.linalg.solve(ONCE, d.shared[0])
    result = fit_linear(curves, d, Regression("x", (Quantity("a", "", ""),)), settings={}, keep_predicted=True)
    assert result.status[1] == Status.NOT_IDENTIFIABLE
    assert np.isnan([result["a"][1], result.percent_se("a")[1], result.chi2[1], result.aicc[1]]).all()
    assert result.predicted is not None
    assert np.isnan(result.predicted[1]).all()
    assert np.isfinite(result["a"][[0, 2]]).all()


def test_errors_are_those_of_quantities_by_the_delta_method():
    d = design(1, 1)

    def read(theta):
        one = np.ones_like(theta[0])
        slopes = [[one / theta[1], -theta[0] / theta[1] ** 2], [0 * one, one]]
        return np.stack([theta[0] / theta[1], theta[1]]), np.array(slopes)

    quantities = Quantity("ratio", "", ""), Quantity("b", "", "")
    result = fit_linear(CURVES, d, Regression("x", quantities, read), settings={"c": 1}, keep_predicted=False)
    theta, wrss, covariance, freedom = by_numpy(d, CURVES[4])
    slope = np.array([1 / theta[1], -theta[0] / theta[1] ** 2])
    error = np.sqrt(slope @ covariance @ slope * wrss / freedom)
    assert result["ratio"][4] == pytest.approx(theta[0] / theta[1], rel=1e-9)
    assert result.percent_se("ratio")[4] == pytest.approx(100 * error / abs(theta[0] / theta[1]), rel=1e-6)
    assert result.settings == {"c": 1, "frames_used": 14}


def test_the_fitted_curve_solves_the_equation_where_the_curve_stands_outside_integrals():
    cases = ((np.zeros((0, K, K)), np.eye(K), 1.0), (OWN[:1], np.eye(K), 1.0), ([np.eye(K)], ONCE, None))
    for own, response, share in cases:
        d = LinearDesign(design(1, 0).shared, np.asarray(own), response, LATE, NOISE, np.full(K, 0.3), 1.1)
        result = fit_linear(CURVES[:4], d, Regression("x", (Quantity("a", "", ""),)), settings={}, keep_predicted=True)
        assert result.predicted is not None
        for curve, fitted in zip(CURVES, result.predicted):
            y, (theta, *_) = (curve - 0.3) * 1.1, by_numpy(d, curve)
            left = response @ y - theta[0] * d.shared[0] - sum(t * (o @ y) for t, o in zip(theta[1:], own))
            expected = (y - left / (share or -theta[1])) / 1.1 + 0.3
            np.testing.assert_allclose(fitted[d.used], expected[d.used], rtol=1e-9)
            assert np.isnan(fitted[LATE == 0]).all()


def test_what_cannot_be_solved_is_refused():
    with pytest.raises(InputError, match="x has 4 unknowns but only 4 frames"):
        LinearSolver.prepare(design(2, 2, np.where(np.arange(K) < 4, 1.0, 0.0)), "x")
    empty = LinearDesign(np.zeros((1, K)), np.eye(K)[None], ONCE, LATE, NOISE, np.zeros(K))
    with pytest.raises(InputError, match="x: the input says nothing in the 14 frames used"):
        LinearSolver.prepare(empty, "x")
