"""Tissue known in part: limits, an independent solver, gradients, frames by quadrature."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.integrate import quad

from petkin.dynamics import Adaptive, System, solve
from petkin.errors import InputError
from petkin.hybrid import HybridField
from petkin.imaging import FrameObservation, FrameSchedule
from petkin.inputs import InputFunction, paper_plasma
from petkin.kinetics import ONE_TISSUE, TWO_TISSUE
from petkin.learning import PAPER, RESIDUALS, Conditions, Known, draw, tissue_model, tissue_task
from petkin.learning.grid import Grid
from petkin.learning.tissue import SCALE

#: A short scan: tables and solvers take less, nothing else differs.
SHORT = replace(PAPER, observation=FrameObservation(FrameSchedule.uniform(12, 1.0), 1.0 / 110.0, corrected=False))
CONDITIONS = SHORT.conditions
BOUNDS = SHORT.bounds
#: A1/100 of two scans, and rates near the input's own poles, where the naive formula divides by zero.
AMOUNTS = torch.tensor([[1.0, 1.2], [1.0, 1.9], [1.0, 1.5]])
RATES = torch.tensor([[0.2, 0.1191], [0.15, 0.0104], [0.3, 0.25]])


def started(amounts: torch.Tensor) -> torch.Tensor:
    return torch.nn.functional.pad(amounts, (2, 0))


def weights_of(name: str, seed: int = 0, count: int = 3, last: float = 2.0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.stack([RESIDUALS[name].network.draw(generator, last=last) for _ in range(count)], dim=-1)


def test_a_residual_of_zero_is_one_tissue_in_closed_form():
    task = tissue_task("meta_hylad", CONDITIONS, BOUNDS)
    assert task.residual is not None
    zero = HybridField(task.known, task.residual, torch.zeros(task.residual.network.weights, 3))
    states = task.flow(zero, started(AMOUNTS), RATES, task.times)
    assert torch.equal(states, task.flow(task.known, started(AMOUNTS), RATES, task.times))  # type: ignore[arg-type]
    for i, amounts in enumerate(AMOUNTS.double()):
        plasma = paper_plasma(100.0 * amounts[1])
        rates = torch.nn.functional.pad(RATES[i].double(), (0, 1))
        ends = torch.tensor(SHORT.observation.frames.end)
        exact = ONE_TISSUE.tissue(rates, plasma, ends)
        frames = ONE_TISSUE.frame_values(rates, InputFunction(plasma, plasma), SHORT.observation)
        torch.testing.assert_close(states[i, :, 0].double(), exact, rtol=2e-6, atol=1e-5)
        torch.testing.assert_close(states[i, :, 1].double(), frames, rtol=2e-6, atol=1e-5)


@pytest.mark.parametrize(
    ("name", "seed", "last"), [("C_T", 0, 2.0), ("C_T,C_P", 6, 4.0), ("held", 11, 8.0), ("hidden", 0, 2.0)]
)
def test_the_flow_is_what_a_general_solver_finds(name, seed, last):
    task = tissue_task("meta_hylad", CONDITIONS, BOUNDS, residual=name)
    assert task.residual is not None
    weights = weights_of(name, seed, last=last)
    states = task.flow(HybridField(task.known, task.residual, weights), started(AMOUNTS), RATES, task.times)
    count = task.residual.outputs
    field = HybridField(task.known, task.residual, weights.double())
    system = System("tissue", ("C_T", "hidden")[:count], task.parameters, field, (0.0,) * count)
    plasma = paper_plasma(100.0 * AMOUNTS[:, 1].double())
    times = torch.tensor(SHORT.observation.frames.end)
    found = solve(system, times, parameters=RATES.double(), forcing=plasma, method=Adaptive(1e-7, 1e-7))
    plain = task.flow(task.known, started(AMOUNTS), RATES, task.times)[..., 0]  # type: ignore[arg-type]
    exact = found.states[..., 0]
    change, off = (exact - plain).abs().amax(dim=1), (states[..., 0] - exact).abs().amax(dim=1)
    assert float(change.min()) > 0.3, "the residual must matter"
    assert bool((off < 0.01 * change).all()), (off, change)


@pytest.mark.parametrize("name", ["C_T,C_P", "held"])
def test_of_no_tracer_comes_nothing(name):
    residual, task = RESIDUALS[name], tissue_task("meta_hylad", CONDITIONS, BOUNDS, residual=name)
    field = HybridField(task.known, residual, weights_of(name))
    nothing = torch.zeros(3, residual.outputs)
    assert not field(torch.zeros(()), nothing, torch.zeros(3), RATES).any()


def test_where_nothing_is_known_tracer_may_come_from_the_network():
    task = tissue_task("purely_neural", CONDITIONS, BOUNDS, residual="C_T")
    assert task.residual is not None
    field = HybridField(task.known, task.residual, weights_of("C_T"))
    assert bool(field(torch.zeros(()), torch.zeros(3, 1), torch.zeros(3), torch.zeros(3, 0)).all())
    with pytest.raises(InputError, match="washes out with k2"):
        tissue_task("purely_neural", CONDITIONS, BOUNDS, residual="held")


def test_two_tissues_are_what_holds_tracer_back_in_proportion():
    rates, k3, k4 = torch.tensor([[0.2, 0.15]]), 0.05, 0.02
    residual, state = RESIDUALS["held"], torch.tensor([[9.0, 4.0]])
    value = residual.value(((torch.tensor([[[k3 * SCALE], [-k4 * SCALE]]]), torch.zeros(1, 1)),), state, None, rates)
    flow = k3 * 5.0 - k4 * 4.0
    np.testing.assert_allclose(value[:, 0], [0.15 * 4.0, flow], rtol=1e-3)


def test_frames_are_those_of_quadrature():
    seen = FrameObservation(FrameSchedule.uniform(5, 2.3), 0.02)
    grid = Grid.of([seen])
    nodes = grid.nodes.numpy()
    values, slopes = np.sin(0.3 * nodes), 0.3 * np.cos(0.3 * nodes)
    ends, frames = grid.read(torch.tensor(values).float(), torch.tensor(slopes).float(), torch.ones(1))
    np.testing.assert_allclose(ends, np.sin(0.3 * seen.frames.end), atol=2e-4)
    for k, (a, b) in enumerate(zip(seen.frames.start, seen.frames.end)):
        top = quad(lambda t: np.sin(0.3 * t) * np.exp(-0.02 * t), a, b)[0]
        below = quad(lambda t: np.exp(-0.02 * t), a, b)[0]
        assert float(frames[k]) == pytest.approx(top / below, abs=2e-4)


@pytest.mark.parametrize("name", RESIDUALS)
def test_gradients_are_those_of_differences(name):
    task = tissue_task("meta_hylad", CONDITIONS, BOUNDS, residual=name)
    assert task.residual is not None
    weights, generator = weights_of(name), torch.Generator().manual_seed(3)
    way_w, way_p = torch.randn(weights.shape, generator=generator), 0.1 * torch.rand(RATES.shape, generator=generator)

    def loss(s: torch.Tensor) -> torch.Tensor:
        field = HybridField(task.known, task.residual, weights + s * way_w)  # type: ignore[arg-type]
        return task.flow(field, started(AMOUNTS), RATES + s * way_p, task.times)[..., :2].square().mean()

    s = torch.zeros((), requires_grad=True)
    loss(s).backward()
    assert s.grad is not None
    h = 2e-3
    with torch.no_grad():
        numeric = (loss(torch.tensor(h)) - loss(torch.tensor(-h))) / (2 * h)
    assert float(s.grad) == pytest.approx(float(numeric), rel=2e-2)


def test_the_full_model_is_the_truth_and_regions_share_their_input():
    clean, measured = draw(replace(SHORT, noise=5.0), 2, 3, seed=4)
    task = tissue_task("full_physics", CONDITIONS, BOUNDS)
    amounts = clean.states[:, :, 0, 2:]
    states = task.flow(task.known, started(amounts), clean.truth[:, None].expand(-1, 3, -1), task.times)  # type: ignore[arg-type]
    torch.testing.assert_close(states, clean.states, rtol=1e-5, atol=2e-5)
    assert bool((amounts[:5] == amounts[:1]).all())
    assert not bool((amounts[5:] == amounts[:1]).any(dim=(0, 1))[1])
    off = (measured.states - clean.states)[..., 1]
    assert 0.02 < float(off.std() / clean.states[..., 1].mean()) < 0.1
    assert torch.equal(measured.states[..., 0], clean.states[..., 0])


def test_the_encoder_sees_curves_in_their_own_spread():
    clean, _ = draw(SHORT, 10, 4, seed=1)
    model = tissue_model("meta_hylad", CONDITIONS, BOUNDS, clean.states[..., 1])
    seen = (clean.states[..., 1].flatten(0, 1) - model.context.mean) @ model.context.axes  # type: ignore[operator]
    spread = seen.std(dim=0)
    assert float(spread[0]) == pytest.approx(1.0, abs=0.05)
    assert bool((spread < 1.1).all())
    found = model.encode(model.task.emission.observe(clean.states))
    assert found.physics.shape == (50, 4, 2)
    assert torch.equal(found.initial[..., 2:], clean.states[:, :, 0, 2:])


def test_bad_choices_are_one_line():
    with pytest.raises(InputError, match="choose one of full_physics"):
        tissue_task("magic", CONDITIONS, BOUNDS)
    with pytest.raises(InputError, match="no residual of 'C_X'"):
        tissue_task("meta_hylad", CONDITIONS, BOUNDS, residual="C_X")
    other = FrameObservation(FrameSchedule.uniform(3, 1.0))
    plasma = paper_plasma()
    with pytest.raises(InputError, match="cannot be learned together"):
        Conditions.of(
            [Known(plasma, plasma, other), Known(plasma, plasma, SHORT.observation)], torch.eye(2), highest=0.5
        )
    assert TWO_TISSUE.rates == 4
