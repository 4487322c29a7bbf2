"""What every compartment model must hold; a model added to `petkin.kinetics.MODELS` inherits all of it."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from petkin.dynamics import Adaptive, PiecewiseLinear, System, solve
from petkin.imaging import FrameObservation
from petkin.inputs.input_function import InputFunction

from .compartment_cases import (
    ARTERIAL,
    BLOOD,
    BOLUS,
    C11,
    EVERY_MODEL,
    KNOTS,
    SAMPLES,
    SCHEDULE,
    TERMS,
    TIMES,
    VALUES,
    all_draws,
    at_poles,
    draw,
    frames,
    nearly_equal,
    rates_of,
    tissue,
)
from .independent_solutions import by_matrix_exponential, by_modes, by_ode, by_recursion, linear_form

# Independent solutions agree to 1e-8 relative (the figure); most do to 1e-12.
CLOSE = 1e-8


@EVERY_MODEL
class TestAgainstIndependentSolutions:
    def test_matrix_exponential_of_a_piecewise_linear_input(self, model):
        for p in all_draws(model):
            expected = by_matrix_exponential(*linear_form(model, rates_of(model, p)), KNOTS, VALUES, TIMES)
            np.testing.assert_allclose(tissue(model, p, SAMPLES), expected, rtol=1e-11)

    def test_matrix_exponential_of_an_exponential_input_and_its_poles(self, model):
        for p in all_draws(model):
            expected = by_modes(*linear_form(model, rates_of(model, p)), TERMS, 0.735, TIMES)
            np.testing.assert_allclose(tissue(model, p, BOLUS), expected, rtol=1e-10, atol=1e-13)

    def test_runge_kutta_of_the_differential_equation(self, model):
        def bolus(t: float) -> float:
            return sum(c * (t - 0.735) ** n * math.exp(e * (t - 0.735)) for c, e, n in TERMS)

        for p in np.vstack([draw(model, 3, seed=3), nearly_equal(model)[-1:], at_poles(model)[:1]]):
            A, b = linear_form(model, rates_of(model, p))
            expected = by_ode(A, b, lambda t: float(np.interp(t, KNOTS, VALUES)), KNOTS, TIMES)
            np.testing.assert_allclose(tissue(model, p, SAMPLES), expected, rtol=CLOSE)
            expected = by_ode(A, b, bolus, np.array([0.735]), TIMES[1:])
            np.testing.assert_allclose(tissue(model, p, BOLUS, TIMES[1:]), expected, rtol=CLOSE)

    def test_the_field_is_linear_in_state_and_plasma(self, model):
        rng = np.random.default_rng(0)
        for p in draw(model, 5, seed=13):
            A, b = linear_form(model, rates_of(model, p))
            state, u = rng.uniform(0.0, 50.0, len(b)), np.float64(rng.uniform(0.0, 50.0))
            found = model.field(torch.tensor(state), torch.as_tensor(u), torch.tensor(rates_of(model, p))).numpy()
            np.testing.assert_allclose(found, A @ state + b * u, rtol=1e-12)

    def test_the_engine_s_own_solver(self, model):
        p = torch.tensor(np.vstack([draw(model, 4, seed=4, fastest=1.0), nearly_equal(model)[-1:]]))
        system = System(
            model.label,
            model.states,
            model.parameters,
            lambda t, state, u, k: model.field(state, u, k[..., : model.rates]),
            (0.0,) * len(model.states),
        )
        times = torch.tensor(TIMES[:5])
        states = solve(system, times, method=Adaptive(1e-10, 1e-11), parameters=p, forcing=SAMPLES).states
        np.testing.assert_allclose(states.sum(dim=-1).numpy(), model.tissue(p, SAMPLES, times).numpy(), rtol=CLOSE)

    def test_step_by_step_recursion_and_its_decayed_integral(self, model):
        edges = np.unique(np.concatenate([SCHEDULE.start, SCHEDULE.end]))
        weight = (np.exp(-C11 * SCHEDULE.start) - np.exp(-C11 * SCHEDULE.end)) / C11
        for p in np.vstack([draw(model, 4, seed=5), nearly_equal(model)[2:], at_poles(model)[:2]]):
            phi, a = (v.numpy() for v in model.exponentials(torch.tensor(p)))
            curve, area = by_recursion(phi, a, KNOTS, VALUES, edges, C11)
            np.testing.assert_allclose(tissue(model, p, SAMPLES, edges), curve, rtol=1e-11, atol=1e-13)
            area = dict(zip(edges, area))
            mean = np.array([area[e] - area[s] for s, e in zip(SCHEDULE.start, SCHEDULE.end)]) / weight
            p = np.array([*p[:-1], 0.0])
            found = frames(model, p, ARTERIAL, FrameObservation(SCHEDULE, C11))
            np.testing.assert_allclose(found, mean, rtol=1e-10, atol=1e-13)

    def test_frame_averages_match_quadrature_of_the_curve(self, model):
        nodes, shares = np.polynomial.legendre.leggauss(20)
        p = draw(model, 6, seed=6)
        pieces = np.unique(np.concatenate([KNOTS, SCHEDULE.start, SCHEDULE.end]))
        low, high = pieces[:-1, None], pieces[1:, None]
        t = (0.5 * (high + low) + 0.5 * (high - low) * nodes).ravel()
        w = (0.5 * (high - low) * shares).ravel()
        curves = model.curve(torch.tensor(p), ARTERIAL, torch.tensor(t)).numpy()
        for decay in (0.0, C11):
            weight = w * np.exp(-decay * t)
            inside = (t >= SCHEDULE.start[:, None]) & (t < SCHEDULE.end[:, None])
            expected = (curves * weight) @ inside.T / (inside @ weight)
            np.testing.assert_allclose(
                frames(model, p, ARTERIAL, FrameObservation(SCHEDULE, decay)), expected, rtol=1e-9, atol=1e-9
            )

    def test_blood_fills_the_vessels_and_plasma_is_trapped_in_their_walls(self, model):
        """The rest of a curve, beside (1 - vB) of the tissue: by Runge-Kutta of dC_W/dt = Kb C_P."""
        plasma = lambda t: float(np.interp(t, KNOTS, VALUES))  # noqa: E731
        trapped = by_ode(np.zeros((1, 1)), np.ones(1), plasma, KNOTS, TIMES)
        for p in draw(model, 5, seed=14):
            vB = p[-1]
            vessels = np.interp(TIMES, KNOTS, 0.8 * VALUES) + (p[-2] * trapped if model.wall else 0.0)
            expected = (1.0 - vB) * tissue(model, p, SAMPLES) + vB * vessels
            found = model.curve(torch.tensor(p), ARTERIAL, torch.tensor(TIMES)).numpy()
            np.testing.assert_allclose(found, expected, rtol=1e-9)


@EVERY_MODEL
class TestMacroParameters:
    def test_constant_input_tends_to_VT_or_grows_by_Ki(self, model):
        p = draw(model, 8, seed=7, slowest=0.02, fastest=1.0)
        level = 7.0
        constant = PiecewiseLinear(torch.tensor([0.0], dtype=torch.float64), torch.tensor([level], dtype=torch.float64))
        macro = {symbol: value.numpy() for symbol, value in model.macro(torch.tensor(p)).items()}
        late = tissue(model, p, constant, np.array([90000.0, 90001.0]))
        if model.trapping:
            np.testing.assert_allclose(late[:, 1] - late[:, 0], macro["Ki"] * level, rtol=1e-9)
        else:
            np.testing.assert_allclose(late[:, 1], macro["VT"] * level, rtol=1e-9)

    def test_VT_is_the_steady_state_of_the_field(self, model):
        if model.trapping:
            pytest.skip("an irreversible model has no steady state")
        for p in draw(model, 8, seed=8):
            A, b = linear_form(model, rates_of(model, p))
            VT = float(model.macro(torch.tensor(p))["VT"])
            assert -np.linalg.solve(A, b).sum() == pytest.approx(VT, rel=1e-10)

    def test_the_first_macro_is_the_outcome_that_reports_judge_by(self, model):
        assert model.macros[0].symbol == ("Ki" if model.trapping else "VT")


@EVERY_MODEL
class TestExponentials:
    def test_amplitudes_and_rates_are_not_negative_and_ordered(self, model):
        phi, rate = model.exponentials(torch.tensor(all_draws(model)))
        assert (phi >= 0).all()
        assert (rate >= 0).all()
        assert (torch.diff(rate, dim=-1) <= 0).all()
        np.testing.assert_allclose(phi.sum(dim=-1).numpy(), all_draws(model)[:, 0], rtol=1e-15)

    def test_inversion_returns_the_rate_constants(self, model):
        p = draw(model, 40, seed=9)
        phi, rate = (v.numpy() for v in model.exponentials(torch.tensor(p)))
        back = np.stack(model.invert(*[(phi[:, m], rate[:, m]) for m in range(phi.shape[1])]), axis=1)
        np.testing.assert_allclose(back, rates_of(model, p), rtol=1e-9)

    def test_exponentials_return_from_rate_constants(self, model):
        rng = np.random.default_rng(10)
        m = model.free_rates + model.trapping
        phi = rng.uniform(0.01, 0.5, (40, m))
        rate = np.sort(np.exp(rng.uniform(np.log(1e-3), np.log(3.0), (40, m))), axis=1)[:, ::-1]
        rate[:, model.free_rates :] = 0.0
        rates = model.invert(*[(phi[:, i], rate[:, i]) for i in range(m)])
        assert all((k >= 0).all() for k in rates)
        again = model.impulse(*rates)
        np.testing.assert_allclose(np.stack([v for v, _ in again], axis=1), phi, rtol=1e-9)
        np.testing.assert_allclose(np.stack([v for _, v in again], axis=1), rate, rtol=1e-9)

    def test_no_outflow_at_all_keeps_everything(self, model):
        p = np.array([0.2, *[0.0] * (len(model.parameters) - 2), 0.05])
        expected = 0.2 * SAMPLES.integral(torch.tensor(TIMES)).numpy()
        np.testing.assert_allclose(tissue(model, p, SAMPLES), expected, rtol=1e-7)


@EVERY_MODEL
class TestBatches:
    def test_a_batch_equals_a_loop(self, model):
        p = all_draws(model)
        observation = FrameObservation(SCHEDULE, C11)
        looped = np.stack([frames(model, row, ARTERIAL, observation) for row in p])
        np.testing.assert_allclose(frames(model, p, ARTERIAL, observation), looped, rtol=1e-12, atol=1e-14)
        shaped = frames(model, p[:24].reshape(4, 6, -1), ARTERIAL, observation)
        np.testing.assert_allclose(shaped.reshape(24, -1), looped[:24], rtol=1e-12, atol=1e-14)
        macro = model.macro(torch.tensor(p[:24].reshape(4, 6, -1)))
        assert all(v.shape == (4, 6) for v in macro.values())

    def test_single_precision_follows_double_precision(self, model):
        p = draw(model, 30, seed=12)
        observation = FrameObservation(SCHEDULE, C11)
        single = InputFunction(
            PiecewiseLinear(SAMPLES.times.float(), SAMPLES.values.float()),
            PiecewiseLinear(BLOOD.times.float(), BLOOD.values.float()),
        )
        rough = model.frame_values(torch.tensor(p, dtype=torch.float32), single, observation).double().numpy()
        exact = frames(model, p, ARTERIAL, observation)
        np.testing.assert_allclose(rough, exact, rtol=2e-5, atol=2e-5 * exact.max())
