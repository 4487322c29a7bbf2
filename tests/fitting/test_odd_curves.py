"""Curves and settings that are not what a fit hopes for: codes for curves, one clear line for settings."""

from __future__ import annotations

import numba
import numpy as np
import pytest
import torch

from petkin.dynamics import PiecewiseLinear
from petkin.errors import InputError
from petkin.fitting import REGIONS, VOXELS, FitResult, NonlinearSettings, Status, fit_curves
from petkin.inputs.input_function import InputFunction
from petkin.kinetics import MODELS, ONE_TISSUE, TWO_TISSUE, TWO_TISSUE_TRAPPING

from .fitting_problems import (
    ARTERIAL,
    EDGES,
    FRAMES,
    PLAIN,
    basis_averages,
    blood_averages,
    counting_sd,
    frame_averages,
    uniform_truth,
)

K = len(FRAMES)
GOOD = frame_averages("2TCM", np.array([[0.12, 0.12, 0.06, 0.03, 0.05]]))[0]
EFFORTS = pytest.mark.parametrize("effort", [REGIONS, VOXELS], ids=["regions", "voxels"])


def fit(curves, weights=FRAMES.duration, model=TWO_TISSUE, **settings) -> FitResult:
    return fit_curves(np.atleast_2d(curves), ARTERIAL, PLAIN, weights, NonlinearSettings(model, **settings))


def noisy(count: int = 40, share: float = 0.05) -> np.ndarray:
    clean = frame_averages("2TCM", uniform_truth("2TCM", count))
    return clean + counting_sd(clean, share) * np.random.default_rng(7).standard_normal(clean.shape)


def same(one: FitResult, other: FitResult, order=slice(None)) -> bool:
    """Whether every number is the same to the bit."""
    pairs = [(a.value, b.value) for a, b in zip(one.estimates, other.estimates)]
    pairs += [(a.percent_se, b.percent_se) for a, b in zip(one.estimates, other.estimates)]
    pairs += [(one.chi2, other.chi2), (one.aicc, other.aicc), (one.status, other.status)]
    if one.predicted is not None and other.predicted is not None:
        pairs.append((one.predicted, other.predicted))
    return all(a[order].tobytes() == b.tobytes() for a, b in pairs)


@EFFORTS
@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.label)
class TestStatusCodes:
    def test_curves_that_cannot_be_fitted_say_why_and_spare_their_neighbours(self, model, effort):
        infinite = np.where(np.arange(K) == 3, np.inf, GOOD)
        odd = np.stack([GOOD, np.full(K, np.nan), infinite, np.zeros(K), -GOOD, np.full(K, 1e300), GOOD])
        result = fit(odd, model=model, effort=effort)
        not_finite, no_signal = Status.NOT_FINITE, Status.NO_SIGNAL
        assert result.status[1:6].tolist() == [not_finite, not_finite, no_signal, no_signal, not_finite]
        for estimate in result.estimates:
            assert np.isnan(estimate.value[1:6]).all()
            assert np.isnan(estimate.percent_se[1:6]).all()
        assert np.isnan(result.chi2[1:6]).all()
        alone = fit(GOOD, model=model, effort=effort)
        assert result["K1"][0] == result["K1"][6] == alone["K1"][0]

    def test_strange_but_finite_curves_are_fitted_inside_all_bounds(self, model, effort):
        blood = blood_averages()
        strange = [
            GOOD[::-1],
            np.ones(K),
            np.r_[np.zeros(K - 1), 1.0],
            1e-12 * GOOD,
            np.where(EDGES[1:] < 1, -3.0, GOOD),
        ]
        strange += [0.5 * blood, blood, 5.0 * blood, 100.0 * GOOD, 1e12 * GOOD, np.full(K, 1e-320)]
        result = fit(np.stack(strange), model=model, effort=effort)
        assert np.isin(result.status, (Status.OK, Status.AT_BOUND, Status.NOT_IDENTIFIABLE)).all()
        box = model.parameters
        values = np.stack([result[s] for s in box.symbols], axis=1)
        assert ((values >= box.lower) & (values <= box.upper)).all()
        assert (result.chi2 >= 0).all()

    def test_more_blood_than_a_voxel_holds_ends_on_the_bound(self, model, effort):
        """vB above 1 was called a curve without signal: a voxel in a large vein, or activity in another unit."""
        noise = 0.01 * blood_averages() * np.random.default_rng(0).standard_normal((20, K))
        result = fit(1.02 * blood_averages() + noise, model=model, effort=effort)
        assert np.isin(result.status, (Status.AT_BOUND, Status.NOT_IDENTIFIABLE)).all()
        assert (result["vB"] > 0.9).all()

    def test_blood_alone_is_told_from_nothing(self, model, effort):
        result = fit(0.3 * blood_averages(), model=model, effort=effort)
        assert result["vB"][0] == pytest.approx(0.3, rel=1e-4)
        assert result["K1"][0] == pytest.approx(0.0, abs=1e-4)
        assert result.status[0] in (Status.AT_BOUND, Status.NOT_IDENTIFIABLE)


class TestBoundsAndFixedValues:
    @EFFORTS
    @pytest.mark.parametrize("value", [0.05, 0.0, 0.08])
    def test_a_fixed_blood_volume_is_taken_off_and_the_rest_recovered(self, value, effort):
        truth = uniform_truth("2TCM", 50)
        truth[:, -1] = value
        box = TWO_TISSUE.parameters.with_fixed({"vB": value})
        result = fit(frame_averages("2TCM", truth), parameters=box, effort=effort)
        assert (result.status == Status.OK).all()
        assert (result["vB"] == value).all()
        for symbol, known in zip(TWO_TISSUE.parameters.symbols[:-1], truth.T):
            np.testing.assert_allclose(result[symbol], known, rtol=2e-3)
        assert (np.nan_to_num(result.percent_se("vB")) == 0).all()

    @EFFORTS
    @pytest.mark.parametrize("symbol", ["K1", "k2", "k3", "k4"])
    def test_any_parameter_can_be_fixed_to_the_truth(self, symbol, effort):
        truth = np.array([[0.12, 0.12, 0.06, 0.03, 0.05]])
        known = dict(zip(TWO_TISSUE.parameters.symbols, truth[0]))
        box = TWO_TISSUE.parameters.with_fixed({symbol: known[symbol]})
        result = fit(GOOD, parameters=box, effort=effort)
        found = {s: float(result[s][0]) for s in known}
        assert found == pytest.approx(known, rel=1e-3)
        assert found[symbol] == known[symbol]

    @EFFORTS
    @pytest.mark.parametrize(
        "bounds",
        [{"K1": (0.0, 0.1)}, {"k4": (0.05, 0.1)}, {"k3": (0.08, 0.2), "vB": (0.0, 0.02)}, {"k2": (0.2, 0.3)}],
    )
    def test_bounds_hold_and_are_told(self, bounds, effort):
        box = TWO_TISSUE.parameters.with_bounds(bounds)
        result = fit(np.vstack([GOOD, noisy()]), parameters=box, effort=effort)
        values = np.stack([result[s] for s in box.symbols], axis=1)
        assert ((values >= box.lower) & (values <= box.upper)).all()
        assert result.status[0] == Status.AT_BOUND
        for symbol, (low, high) in bounds.items():
            end = np.isclose(result[symbol], low, atol=1e-9) | np.isclose(result[symbol], high, atol=1e-9)
            assert np.isnan(result.percent_se(symbol)[end]).all()
            assert np.isin(result.status[end], (Status.AT_BOUND, Status.NOT_IDENTIFIABLE)).all()
        assert result.settings["bounds"]["K1"] == list(bounds.get("K1", (0.0, 10.0)))

    def test_k4_fixed_at_zero_is_the_trapping_model(self):
        curves = noisy(10, 0.02)
        fixed = fit(curves, parameters=TWO_TISSUE.parameters.with_fixed({"k4": 0.0}))
        trapping = fit(curves, model=TWO_TISSUE_TRAPPING)
        for symbol in ("K1", "k2", "k3", "vB", "Ki"):
            np.testing.assert_allclose(fixed[symbol], trapping[symbol], rtol=1e-4)
        # An infinite VT came with an error of 0 percent.
        assert np.isinf(fixed["VT"]).all()
        assert np.isposinf(fixed.percent_se("VT")).all()
        assert (fixed.status == Status.NOT_IDENTIFIABLE).all()

    def test_k3_fixed_at_zero_is_the_one_tissue_model(self):
        curves = noisy(10, 0.02)
        fixed = fit(curves, parameters=TWO_TISSUE.parameters.with_fixed({"k3": 0.0, "k4": 0.1}))
        single = fit(curves, model=ONE_TISSUE)
        for symbol in ("K1", "k2", "vB", "VT"):
            np.testing.assert_allclose(fixed[symbol], single[symbol], rtol=1e-4)
            np.testing.assert_allclose(fixed.percent_se(symbol), single.percent_se(symbol), rtol=1e-3)

    def test_everything_fixed_gives_the_cost_there(self):
        values = {"K1": 0.1, "k2": 0.1, "k3": 0.05, "k4": 0.03, "vB": 0.04}
        result = fit(GOOD, parameters=TWO_TISSUE.parameters.with_fixed(values))
        predicted = frame_averages("2TCM", np.array([list(values.values())]))[0]
        expected = (FRAMES.duration * (GOOD - predicted) ** 2).sum() / K
        assert result.chi2[0] == pytest.approx(expected, rel=1e-6)
        assert {s: float(result[s][0]) for s in values} == values


class TestRefusals:
    @pytest.mark.parametrize(
        ("curves", "weights", "message"),
        [
            (GOOD, FRAMES.duration, "Curves of shape .46,. do not match 46 frames"),
            (GOOD[None, :-1], FRAMES.duration, "Curves of shape .1, 45. do not match 46 frames"),
            (GOOD[None, None], FRAMES.duration, "do not match 46 frames; give one row a curve"),
            (GOOD[None], FRAMES.duration[1:], "Weights of shape .45,. match neither"),
            (GOOD[None], np.ones((2, K)), "Weights of shape .2, 46. match neither"),
            (GOOD[None], -FRAMES.duration, "must be finite and not negative"),
            (GOOD[None], np.where(EDGES[1:] > 5, np.nan, 1.0), "must be finite and not negative"),
            (
                GOOD[None],
                np.where(np.arange(K) < 6, 1.0, 0.0),
                "2TCM has 5 free parameters but only 6 frames have weight",
            ),
        ],
    )
    def test_what_does_not_fit_together_is_refused_in_one_line(self, curves, weights, message):
        with pytest.raises(InputError, match=message) as refusal:
            fit_curves(curves, ARTERIAL, PLAIN, weights, NonlinearSettings(TWO_TISSUE))
        assert "\n" not in str(refusal.value)

    def test_one_frame_more_than_too_few_is_enough(self):
        weights = np.where(np.isin(np.arange(K), [3, 5, 7, 12, 20, 30, 45]), 1.0, 0.0)
        assert fit(GOOD, weights).status[0] in (Status.OK, Status.NOT_IDENTIFIABLE)

    def test_one_curve_with_too_few_frames_among_good_ones_is_refused(self):
        weights = np.tile(FRAMES.duration, (3, 1))
        weights[1, 6:] = 0.0
        with pytest.raises(InputError, match="only 6 frames have weight"):
            fit(np.tile(GOOD, (3, 1)), weights)

    def test_bounds_that_exclude_each_other_are_refused(self):
        with pytest.raises(InputError, match="k2"):
            TWO_TISSUE.parameters.with_bounds({"k2": (0.3, 0.2)})
        with pytest.raises(InputError, match="no parameter 'K2'"):
            TWO_TISSUE.parameters.with_fixed({"K2": 0.1})


class TestShapesAndTypes:
    @EFFORTS
    @pytest.mark.parametrize("model", MODELS, ids=lambda m: m.label)
    def test_no_curves_give_empty_results(self, model, effort):
        for weights in (FRAMES.duration, np.ones((0, K))):
            result = fit_curves(np.empty((0, K)), ARTERIAL, PLAIN, weights, NonlinearSettings(model, effort=effort))
            assert result["K1"].shape == (0,)
            assert result.status.shape == (0,)
            assert result.predicted is not None
            assert result.predicted.shape == (0, K)

    @EFFORTS
    def test_number_types_and_memory_orders_do_not_matter(self, effort):
        curves = noisy().astype(np.float32)
        plain = fit(curves.astype(np.float64), effort=effort)
        assert same(plain, fit(curves, effort=effort))
        assert same(plain, fit(np.asfortranarray(curves), effort=effort))
        assert same(plain, fit(curves.astype(">f4"), effort=effort))
        whole = np.round(100 * curves).astype(np.int16)
        assert same(fit(whole.astype(np.float64), effort=effort), fit(whole, effort=effort))

    def test_a_single_precision_input_function_is_fitted_as_a_double_one(self):
        time = torch.linspace(0, 90, 400, dtype=torch.float32)
        value = 30.0 * time * torch.exp(-0.5 * time)
        single = PiecewiseLinear(time, value)
        double = PiecewiseLinear(time.double(), value.double())
        settings = NonlinearSettings(ONE_TISSUE)
        found = [
            fit_curves(GOOD[None], InputFunction(f, f), PLAIN, FRAMES.duration, settings) for f in (single, double)
        ]
        assert found[0]["K1"][0] == pytest.approx(found[1]["K1"][0], rel=1e-4)
        assert found[0]["VT"][0] == pytest.approx(found[1]["VT"][0], rel=1e-4)

    def test_frames_without_weight_do_not_count(self):
        spoilt = GOOD.copy()
        spoilt[[2, 20, 45]] = 1e4
        weights = FRAMES.duration.copy()
        weights[[2, 20, 45]] = 0.0
        result = fit(spoilt, weights)
        assert result["K1"][0] == pytest.approx(0.12, rel=1e-4)
        assert result["VT"][0] == pytest.approx(3.0, rel=1e-4)
        assert result.predicted is not None
        assert np.isnan(result.predicted[0, [2, 20, 45]]).all()
        np.testing.assert_allclose(np.delete(result.predicted[0], [2, 20, 45]), np.delete(GOOD, [2, 20, 45]), atol=1e-3)

    def test_own_weights_equal_to_shared_ones_give_the_shared_fit(self):
        curves = noisy(6)
        own = fit(curves, np.tile(FRAMES.duration, (6, 1)))
        assert same(fit(curves), own)
        mixed = np.tile(FRAMES.duration, (6, 1))
        mixed[::2] *= np.linspace(1.0, 3.0, K)
        result = fit(curves, mixed)
        assert same(fit(curves[1::2]), fit(curves[1::2], mixed[1::2]))
        assert result["K1"][1] == own["K1"][1]
        assert result["K1"][0] != own["K1"][0]

    def test_predicted_curves_are_the_model_at_the_estimates(self):
        result = fit(noisy(10))
        p = np.stack([result[s] for s in TWO_TISSUE.parameters.symbols], axis=1)
        expected = frame_averages("2TCM", p)
        assert result.predicted is not None
        np.testing.assert_allclose(result.predicted, expected, rtol=2e-5, atol=1e-4 * GOOD.max())


class TestReproducibility:
    @EFFORTS
    def test_order_company_and_repetition_do_not_change_a_bit(self, effort):
        curves = np.vstack([noisy(150, 0.1), np.zeros((2, K)), -noisy(3)])
        first = fit(curves, effort=effort)
        assert same(first, fit(curves, effort=effort))
        order = np.random.default_rng(3).permutation(len(curves))
        assert same(first, fit(curves[order], effort=effort), order)
        assert same(first, fit(curves[:70], effort=effort), slice(0, 70))
        assert same(first, fit(curves[37:38], effort=effort), slice(37, 38))

    def test_the_number_of_threads_does_not_change_a_bit(self):
        before = numba.get_num_threads()
        curves = noisy(300, 0.1)
        try:
            numba.set_num_threads(1)
            single = fit(curves, effort=VOXELS)
            numba.set_num_threads(min(2, numba.config.NUMBA_NUM_THREADS))
            assert same(single, fit(curves, effort=VOXELS))
        finally:
            numba.set_num_threads(before)

    def test_another_unit_of_activity_gives_the_same_rates(self):
        """Bq for kBq in curves and input alike."""
        thousand = InputFunction(*[_scaled(f, 1000.0) for f in (ARTERIAL.plasma, ARTERIAL.whole_blood)])
        curves = noisy(20)
        one = fit(curves)
        other = fit_curves(1000.0 * curves, thousand, PLAIN, FRAMES.duration, NonlinearSettings(TWO_TISSUE))
        for symbol in ("K1", "k2", "k3", "k4", "vB", "VT"):
            np.testing.assert_allclose(other[symbol], one[symbol], rtol=1e-4)


def _scaled(forcing, factor: float):
    return type(forcing)(factor * forcing.coefficients, forcing.exponents, forcing.powers, forcing.onset)


def test_the_table_reads_a_basis_function_between_its_nodes():
    """A curve of one exponential at any rate is recovered: the table's own error."""
    rates = np.exp(np.random.default_rng(4).uniform(np.log(2e-3), np.log(4.0), 60))
    curves = 0.1 * basis_averages(rates)
    for effort, close in ((REGIONS, 1e-5), (VOXELS, 1e-3)):
        result = fit(curves, model=ONE_TISSUE, effort=effort)
        np.testing.assert_allclose(result["k2"], rates, rtol=close)
        np.testing.assert_allclose(result["K1"], 0.1, rtol=close)
