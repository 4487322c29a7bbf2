"""A model as a differential equation, solved by the engine, is the model in closed form."""

from __future__ import annotations

import pytest
import torch

from petkin.dynamics import Adaptive, PiecewiseLinear, solve
from petkin.kinetics import MODELS, CompartmentModel

TIMES = torch.tensor([0.0, 0.3, 0.5, 1.0, 2.5, 10.0, 60.0], dtype=torch.float64)
PLASMA = PiecewiseLinear(
    torch.tensor([0.2, 0.5, 0.5, 1.5, 8.0, 60.0], dtype=torch.float64),
    torch.tensor([0.0, 90.0, 60.0, 30.0, 12.0, 3.0], dtype=torch.float64),
)


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.label)
def test_the_engine_solves_the_differential_equation_to_the_closed_form(model: CompartmentModel) -> None:
    parameters = torch.tensor(model.parameters.start) * torch.tensor([[1.0], [0.4], [2.5]], dtype=torch.float64)
    rates = parameters[:, : model.rates]
    path = solve(model.system, TIMES, parameters=rates, forcing=PLASMA, method=Adaptive(rtol=1e-10, atol=1e-12))
    torch.testing.assert_close(path.states.sum(dim=-1), model.tissue(parameters, PLASMA, TIMES), rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.label)
def test_a_system_leaves_the_blood_out(model: CompartmentModel) -> None:
    assert model.system.parameters.symbols == model.parameters.symbols[: model.rates]
    assert model.system.initial == (0.0,) * len(model.states)
