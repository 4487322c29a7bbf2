"""Refinement starts where the encoders do, and only ever gains."""

from __future__ import annotations

import sys
from dataclasses import replace

import pytest
import torch

from petkin.hybrid import (
    Decoder,
    Encoded,
    Identifier,
    Settings,
    find_strategy,
    measure,
    measure_refined,
    refine,
    train,
)
from petkin.hybrid.refine import _Search, _step

from .oscillator import data, make

_UNSEEN = data(6, 4, seed=2)


@pytest.fixture(scope="module")
def model() -> Identifier:
    return train(make, data(30, 6, seed=1), Settings(steps=150, dynamics=6, series=6, rate=1e-2)).model


@pytest.fixture(scope="module")
def said(model: Identifier) -> Encoded:
    with torch.no_grad():
        return model.encode(_UNSEEN.states)


def test_an_unseen_set_is_fitted_better_and_its_parameters_with_it(model, said):
    found = refine(model, said, _UNSEEN.states)
    assert bool((found.after < found.before).all())
    assert found.after.mean() < 0.1 * found.before.mean()
    with torch.no_grad():
        off = (model.predict(found.found) - _UNSEEN.states).square().flatten(1).mean(dim=1)
    torch.testing.assert_close(off, found.after)
    truth = _UNSEEN.truth[:, None, :1]
    assert (found.found.physics - truth).square().mean() < 0.1 * (said.physics - truth).square().mean()
    assert bool((found.found.physics == found.found.physics[:, :1]).all())


def test_sets_do_not_know_of_each_other(model, said):
    both = refine(model, said, _UNSEEN.states, steps=5)
    part = replace(said, initial=said.initial[:2], physics=said.physics[:2], code=said.code[:2])
    alone = refine(model, part, _UNSEEN.states[:2], steps=5)
    torch.testing.assert_close(alone.after, both.after[:2], rtol=1e-4, atol=1e-8)


def test_a_start_is_found_alone_under_the_dynamics_that_are_given(model, said):
    with torch.no_grad():
        seen = model.predict(said)[:, :, :3]
    found = refine(model, replace(said, initial=said.initial + 0.1), seen, dynamics=False)
    torch.testing.assert_close(found.found.initial, said.initial, rtol=0, atol=1e-4)
    torch.testing.assert_close(found.found.physics, said.physics)
    assert torch.equal(found.found.code, said.code)


def test_it_is_never_worse_than_the_start(model, said):
    wild = replace(said, initial=said.initial + 1e3)
    found = refine(model, wild, _UNSEEN.states, steps=3)
    assert bool((found.after <= found.before).all())
    none = refine(model, said, _UNSEEN.states, steps=0)
    assert torch.equal(none.after, none.before)


def test_refined_dynamics_predict_other_series_better(model):
    unseen = data(6, 7, seed=3)
    found = measure_refined(model, unseen, 4, 3, physics=(0,))
    plain = measure(model, unseen, find_strategy("meta"), 4, physics=(0,))
    assert found["mse_z"] < 0.2 * plain["mse_z"]
    assert found["mse_cp"] < 0.2 * plain["mse_cp"]


def test_early_frames_suffice(model, said):
    found = refine(model, said, _UNSEEN.states[:, :, :5])
    assert bool((found.after < found.before).all())


@pytest.mark.parametrize("dynamics", [True, False])
def test_a_step_is_that_of_gauss_and_newton(model, said, dynamics):
    """The move without damping against the least squares of the whole Jacobian of all observations."""
    few = replace(said, initial=said.initial[:1, :2], physics=said.physics[:1, :2], code=said.code[:1, :2])
    search = _Search(model, few, _UNSEEN.states[:1, :2])
    moves = 0.1 * torch.randn(1, 2, 6, generator=torch.Generator().manual_seed(0))
    units, free = 6 if dynamics else 2, 2

    def off(own: torch.Tensor, shared: torch.Tensor) -> torch.Tensor:
        at = moves + torch.cat([own, shared.expand(2, -1)], dim=-1)
        return (search.observed - model.predict(search.moved(at)))[0].flatten()

    none = torch.zeros(2, free), torch.zeros(4)
    own, shared = torch.func.jacrev(off, argnums=(0, 1))(*none)
    jacobian = torch.cat([own.flatten(1), shared], dim=1)[:, : None if dynamics else 2 * free]
    damping = 1e-2
    with torch.no_grad():
        found = _step(search, moves, units, torch.tensor([damping]))[0]
        curve = (jacobian.mT @ jacobian).double()
        damped = curve + torch.diag(damping * curve.diagonal() + 1e-7 * curve.diagonal().max())
        expected = torch.linalg.solve(damped, -(jacobian.mT @ off(*none)).double()).to(found)
    torch.testing.assert_close(found[:, :free].flatten(), expected[: 2 * free], rtol=1e-3, atol=1e-5)
    if dynamics:
        torch.testing.assert_close(found[:, free:], expected[2 * free :].expand(2, -1), rtol=1e-3, atol=1e-5)
    else:
        assert not found[:, free:].any()


def test_a_decoder_that_sees_c_p_and_a_start_that_is_held(model):
    torch.manual_seed(0)
    decoder = Decoder(lambda state, forcing, p: torch.cat([state, p], dim=-1).movedim(-1, 0), 3, (4,), widths=(8,))
    held = replace(model.task, reach=torch.tensor([1.0, 0.0]))
    drawn = Identifier(
        held, model.context, model.first, code=3, generator=torch.Generator().manual_seed(0), decoder=decoder
    )
    with torch.no_grad():
        said = drawn.encode(_UNSEEN.states)
        observed = drawn.observe(said, _UNSEEN.states)
        found = refine(drawn, said, observed)
    assert bool((found.after < found.before).all())
    assert torch.equal(found.found.initial[..., 1], said.initial[..., 1])


def test_many_pictures_are_looked_at_in_parts(model, said, monkeypatch):
    whole = refine(model, said, _UNSEEN.states, steps=3)
    monkeypatch.setattr(sys.modules[refine.__module__], "_NUMBERS", 20)
    parts = refine(model, said, _UNSEEN.states, steps=3)
    torch.testing.assert_close(parts.after, whole.after, rtol=1e-3, atol=1e-9)
