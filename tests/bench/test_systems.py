"""The physics systems: laws against each other, energy, pictures, starts and ranges."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp

from petkin.errors import InputError
from petkin.hybrid import HybridField
from petkin_bench.systems import DYNAMICS, SYSTEMS, draw, find_system
from petkin_bench.systems.bouncing_ball import BOUNCING_BALL, Bounces
from petkin_bench.systems.cube import rotation

EACH = pytest.mark.parametrize("system", SYSTEMS, ids=lambda s: s.name)


@EACH
def test_data_agree_with_an_independent_integration(system):
    data = draw(system, 3, 2, seed=5)
    places = list(system.places(system.full))
    for m, s in ((0, 0), (2, 1)):
        p = data.truth[m, places].double()

        def law(t, y, p=p):
            return system.law(torch.tensor(t), torch.from_numpy(y), None, p).numpy()

        start = data.states[m, s, 0].double().numpy()
        times = system.times.double().numpy()
        if system is BOUNCING_BALL:
            times = times[: _first_hit(data.states[m, s])]
        found = solve_ivp(law, (0.0, times[-1]), start, t_eval=times, rtol=1e-10, atol=1e-12).y.T
        np.testing.assert_allclose(data.states[m, s, : len(times)], found, rtol=2e-5, atol=2e-5)


def _first_hit(states):
    """Frames before the first hit of a wall: where a velocity turns against the pull."""
    turned = (states[1:, 2:] * states[1:2, 2:] < 0).any(-1)
    return int(turned.nonzero()[0]) + 1 if bool(turned.any()) else len(states)


@EACH
def test_energy_is_kept_where_nothing_is_lost(system):
    data = draw(system, 4, 3, seed=2)
    if "beta" in [r.symbol for r in system.ranges]:
        start, truth = data.states[:, :, 0].double(), data.truth.double().clone()
        truth[:, 1] = 0.0
        states = type(system.flow)(32)(system.law, start, truth[:, None], system.times.double())
    else:
        states, truth = data.states.double(), data.truth.double()
    energy = system.energy(states, truth[:, None, None])
    assert float((energy - energy[..., :1]).abs().max()) < 1e-5 * float(energy.abs().max() + 1.0)


@EACH
def test_what_is_missing_is_the_full_law_less_the_partial_one(system):
    data = draw(system, 5, 2, seed=3)
    states, truth = data.states.double(), data.truth.double()[:, None, None].expand(*data.states.shape[:3], -1)
    t = torch.zeros((), dtype=torch.float64)
    full = system.law(t, states, None, truth[..., list(system.places(system.full))])
    partial = system.partial(t, states, None, truth[..., list(system.places(system.known))])
    gap = system.residual.acts(system.missing(states, truth), states)
    torch.testing.assert_close(full - partial, gap, rtol=1e-6, atol=1e-6)


@EACH
def test_pictures_are_bright_inside_and_their_errors_agree_with_them(system):
    data = draw(system, 2, 3, seed=4)
    images = system.emission.observe(data.states)
    assert images.shape == (
        *data.states.shape[:3],
        system.emission.channels,
        system.emission.size,
        system.emission.size,
    )
    assert 0.0 <= float(images.min()) <= float(images.max()) <= 1.001
    assert float(images.amax(dim=(-3, -2, -1)).min()) > 0.5
    other = data.states.flip(1)
    direct = (images - images.flip(1)).square().mean(dim=(-3, -2, -1))
    torch.testing.assert_close(system.emission.squared_error(data.states, other), direct, rtol=1e-4, atol=1e-6)


@EACH
@pytest.mark.parametrize("dynamics", DYNAMICS)
def test_every_way_of_modelling_has_finite_gradients(system, dynamics):
    task = system.task(dynamics)
    data = draw(system, 2, 2, seed=6)
    places = list(system.places(task.parameters.symbols))
    physics = data.truth[:, None, places].expand(2, 2, -1).clone().requires_grad_()
    start = data.states[:, :, 0].clone().requires_grad_()
    field = task.known
    if task.residual is not None:
        weights = task.residual.network.draw(torch.Generator().manual_seed(0))[:, None, None].requires_grad_()
        field = HybridField(task.known, task.residual, weights)
    times = task.times[:6]
    states = task.flow(field, start, physics, times)
    task.emission.squared_error(states, data.states[:, :, :6] + 0.05).mean().backward()
    assert bool(start.grad.isfinite().all())
    assert float(start.grad.abs().sum()) > 0
    if task.residual is not None:
        assert bool(weights.grad.isfinite().all())
        assert float(weights.grad.abs().sum()) > 0
    elif places:
        assert float(physics.grad.abs().sum()) > 0


@EACH
def test_draws_stay_in_their_ranges_and_repeat(system):
    for outside in (False, True):
        data = draw(system, 30, 1, seed=7, outside=outside)
        for value, r in zip(data.truth.T, system.ranges):
            low, high = r.outside if outside else r.inside
            assert low - 1e-5 <= float(value.min()) <= float(value.max()) <= high + 1e-5
        assert torch.equal(data.states, draw(system, 30, 1, seed=7, outside=outside).states)


def test_a_bounce_by_hand():
    """Dropped from y = 4 under g = -5: hits the floor at -5 after sqrt(18/5) s, at rest after twice that."""
    half = math.sqrt(18.0 / 5.0)
    times = torch.tensor([0.0, half - 0.1, half + 0.1, 2 * half], dtype=torch.float64)
    field = find_system("bouncing_ball").law
    start, pull = (
        torch.tensor([1.0, 4.0, 0.0, 0.0], dtype=torch.float64),
        torch.tensor([0.0, -5.0], dtype=torch.float64),
    )
    states = Bounces()(field, start, pull, times)
    assert states[1, 1] == pytest.approx(float(states[2, 1]))
    assert states[1, 3] == pytest.approx(-float(states[2, 3]))
    assert states[3].tolist() == pytest.approx([1.0, 4.0, 0.0, 0.0], abs=1e-12)
    # without pull it runs from wall to wall
    states = Bounces()(field, torch.tensor([0.0, 0.0, 7.0, 0.0]), torch.zeros(2), torch.tensor([0.0, 1.0, 2.0, 3.0]))
    assert states[:, 0].tolist() == pytest.approx([0.0, 3.0, -4.0, 1.0], abs=1e-5)


def test_bounce_times_have_exact_gradients():
    times = torch.linspace(0.0, 2.4, 7, dtype=torch.float64)
    inputs = (
        torch.tensor([[3.0, -2.0, 1.5, -2.0]], dtype=torch.float64, requires_grad=True),
        torch.tensor([[2.0, -4.0]], dtype=torch.float64, requires_grad=True),
    )
    assert torch.autograd.gradcheck(lambda x, p: Bounces()(BOUNCING_BALL.law, x, p, times), inputs)


def test_rotations_are_rotations():
    q = torch.randn(9, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    R = rotation(q)
    torch.testing.assert_close(R @ R.mT, torch.eye(3, dtype=torch.float64).expand(9, 3, 3))
    torch.testing.assert_close(torch.linalg.det(R), torch.ones(9, dtype=torch.float64))
    torch.testing.assert_close(rotation(torch.tensor([0.0, 0.0, 0.0, 2.0])), torch.eye(3))
    torch.testing.assert_close(rotation(torch.tensor([0.0, 0.0, 1.0, 1.0])) @ torch.eye(3)[0], torch.eye(3)[1])


def test_unknown_names_are_refused_with_the_choices():
    with pytest.raises(InputError, match="choose one of pendulum, mass_spring"):
        find_system("triple_pendulum")
    with pytest.raises(InputError, match="choose one of full_physics"):
        find_system("pendulum").task("magic")
