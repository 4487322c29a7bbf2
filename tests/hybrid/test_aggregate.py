"""Codes of several series as one: any order, any number."""

from __future__ import annotations

from collections.abc import Callable
from itertools import permutations

import pytest
import torch
from torch import Tensor

from petkin.dynamics import Parameter, ParameterSet
from petkin.hybrid import Attention, Encoded, Settings, find_strategy, mean, measure, of_others, train

from .oscillator import data, make

_PARAMETERS = ParameterSet((Parameter("w2", "1/s^2", 2.0, 0.5, 4.0),))


def _attention(trained: bool = True) -> Attention:
    attention = Attention(_PARAMETERS, 3)
    if trained:
        torch.nn.init.normal_(attention.query.weight, 0.0, 3.0, generator=torch.Generator().manual_seed(1))
    return attention


_CODES = torch.randn(4, 5, 4, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize("aggregate", [mean, _attention()])
def test_order_does_not_count_and_one_series_says_what_it_says_alone(aggregate: Callable[[Tensor], Tensor]):
    whole = aggregate(_CODES)
    for order in list(permutations(range(5)))[::17]:
        torch.testing.assert_close(aggregate(_CODES[:, list(order)]), whole, rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(aggregate(_CODES[:, :1]), _CODES[:, 0])
    assert bool((whole <= _CODES.amax(1) + 1e-6).all() and (whole >= _CODES.amin(1) - 1e-6).all())


def test_attention_begins_as_the_mean_and_leaves_it():
    torch.testing.assert_close(_attention(trained=False)(_CODES), mean(_CODES))
    assert float((_attention()(_CODES) - mean(_CODES)).detach().abs().max()) > 0.1


def test_strategies_aggregate_physics_and_code_together():
    values = torch.randn(2, 4, 3, generator=torch.Generator().manual_seed(2))
    said, attention = Encoded(values[..., :2], values[..., :1], values), _attention()
    both = of_others(torch.cat([said.physics, said.code], dim=-1), 2, attention)
    meta, mixed = find_strategy("meta")(said, 2, attention), find_strategy("mixed")(said, 2, attention)
    torch.testing.assert_close(torch.cat([meta.physics, meta.code], dim=-1), both)
    torch.testing.assert_close(mixed.code, both[..., 1:])
    assert mixed.physics is said.physics


def test_a_model_with_attention_trains_on_a_varying_number_of_contexts():
    def attentive(seed: int):
        model = make(seed)
        model.aggregate = Attention(model.task.parameters, 3)
        return model

    settings = Settings(steps=120, dynamics=6, series=6, rate=1e-2, vary=True)
    model = train(attentive, data(30, 6), settings).model
    assert isinstance(model.aggregate, Attention)
    assert float(model.aggregate.query.weight.detach().abs().max()) > 1e-3
    found = [measure(model, data(8, 6, seed=5), find_strategy("meta"), k, physics=(0,))["mse_z"] for k in (1, 5)]
    assert found[1] < found[0]
