"""A field that is known in part: limits, gradients, order of the flow."""

from __future__ import annotations

import pytest
import torch

from petkin.dynamics import Adaptive, Parameter, ParameterSet, System, solve
from petkin.errors import InputError
from petkin.hybrid import HybridField, HyperNetwork, Network, Residual, RungeKutta, into_rows, run_layers

from .oscillator import RESIDUAL, full, known

_P = torch.tensor([[2.0, 0.3], [1.1, 0.7], [3.0, 0.1]], dtype=torch.float64)
_START = torch.tensor([[1.0, 0.2], [-0.4, 0.9], [0.3, -1.0]], dtype=torch.float64)
_TIMES = torch.linspace(0.0, 4.0, 9, dtype=torch.float64)


def test_a_residual_of_zero_leaves_the_known_physics_to_the_bit():
    zero = torch.zeros(RESIDUAL.network.weights, 3, dtype=torch.float64)
    field = HybridField(known, RESIDUAL, zero)
    assert torch.equal(field(_TIMES[0], _START, None, _P), known(_TIMES[0], _START, None, _P))
    flow = RungeKutta(2)
    assert torch.equal(flow(field, _START, _P, _TIMES), flow(known, _START, _P, _TIMES))


def test_a_network_has_as_many_weights_as_the_papers_and_equals_usual_layers():
    network = Network(1, 1)
    assert network.weights == 241
    weights = network.draw(torch.Generator().manual_seed(0), last=1.0)
    layers = []
    for (out, into), (matrix, bias) in zip(network.sizes, network.layers(weights[:, None])):
        layer = torch.nn.Linear(into, out)
        layer.load_state_dict({"weight": matrix[..., 0], "bias": bias[..., 0]})
        layers += [layer, torch.nn.SiLU()]
    x = torch.linspace(-2, 2, 7)
    residual = Residual(lambda s, u, p: s[..., 0][None], 1, 1, into_rows(0), bound=1e6)
    ours = residual.value(network.layers(weights[:, None]), x[:, None], None, x[:, None])
    theirs = torch.nn.Sequential(*layers[:-1])(x[:, None])
    torch.testing.assert_close(ours[0], theirs[:, 0], rtol=1e-5, atol=1e-6)


def test_the_hypernetwork_reaches_every_weight_of_f_nn():
    network = Network(2, 2)
    hyper = HyperNetwork(4, network, torch.Generator().manual_seed(1))
    here, there = hyper(torch.zeros(1, 4)), hyper(torch.ones(1, 4))
    assert here.shape == (network.weights, 1)
    assert bool((here != there).all())
    # and every weight reaches the value of f_NN
    weights = network.draw(torch.Generator().manual_seed(2), last=1.0)[:, None].requires_grad_()
    residual = Residual(lambda s, u, p: s.movedim(-1, 0), 2, 2, into_rows(0, 1), bound=5.0)
    state = torch.randn(20, 2, generator=torch.Generator().manual_seed(3))
    residual.value(network.layers(weights), state, None, state).square().sum().backward()
    assert weights.grad is not None
    assert bool((weights.grad != 0).all())


def test_the_bound_holds_and_small_values_pass():
    layers = Network(1, 1).layers(1e3 * torch.ones(241, 1))
    assert float(RESIDUAL.value(layers, torch.ones(1, 2), None, _P).abs()) <= RESIDUAL.bound
    small = Network(1, 1).draw(torch.Generator().manual_seed(0), last=1e-3)[:, None]
    loose = Residual(RESIDUAL.sees, 1, 1, into_rows(1), bound=1e6)
    arguments = (Network(1, 1).layers(small), torch.ones(1, 2), None, _P)
    torch.testing.assert_close(RESIDUAL.value(*arguments), loose.value(*arguments), rtol=1e-5, atol=0.0)


def test_gradients_through_the_flow_are_exact():
    weights = RESIDUAL.network.draw(torch.Generator().manual_seed(5), last=1.0).double()[:, None]

    def end(initial, parameters, w):
        return RungeKutta(1)(HybridField(known, RESIDUAL, w), initial, parameters, _TIMES[:4])

    inputs = (_START[:1], _P[:1], weights.expand(-1, 1).clone())
    assert torch.autograd.gradcheck(end, tuple(x.clone().requires_grad_() for x in inputs), fast_mode=True)


def test_the_flow_converges_with_fourth_order_to_the_adaptive_solution():
    parameters = ParameterSet((Parameter("w2", "", 1.0, 0.0, 9.0), Parameter("b", "", 0.1, 0.0, 9.0)))
    system = System("oscillator", ("x", "v"), parameters, full, (0.0, 0.0))
    exact = solve(system, _TIMES, method=Adaptive(1e-11, 1e-13), parameters=_P, initial=_START).states
    errors = [float((RungeKutta(n)(full, _START, _P, _TIMES) - exact).abs().max()) for n in (2, 4, 8)]
    assert 12 < errors[0] / errors[1] < 20
    assert 13 < errors[1] / errors[2] < 19


def test_weights_of_another_size_are_refused():
    with pytest.raises(InputError, match="A network of 241 weights was given 240"):
        Network(1, 1).layers(torch.zeros(240, 1))


@pytest.mark.parametrize(("dtype", "rtol"), [(torch.float32, 1e-5), (torch.float64, 1e-13)])
@pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
def test_what_rests_is_the_networks_difference_from_nought(batch, dtype: torch.dtype, rtol: float) -> None:
    residual = Residual(lambda s, u, p: s.movedim(-1, 0), 2, 1, into_rows(0), bound=2.0, rests=True)
    generator = torch.Generator().manual_seed(4)
    weights = torch.randn(residual.network.weights, *batch, generator=generator).to(dtype).requires_grad_()
    state = torch.randn(*batch, 2, generator=generator).to(dtype)
    layers, inputs = residual.network.layers(weights), state.movedim(-1, 0)
    expected = 2.0 * torch.tanh((run_layers(layers, inputs) - run_layers(layers, torch.zeros_like(inputs))) / 2.0)
    found = residual.value(residual.layers(weights), state, None, state)
    torch.testing.assert_close(found, expected, rtol=rtol, atol=rtol)
    (slopes,), (known,) = (torch.autograd.grad(value.sum(), weights) for value in (found, expected))
    torch.testing.assert_close(slopes, known, rtol=10 * rtol, atol=10 * rtol)
    assert not HybridField(None, residual, weights)(state[..., 0], 0.0 * state, None, state).any()
