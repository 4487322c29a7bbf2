"""A learned observation: what it sees, and that it is learned."""

from __future__ import annotations

import torch

from petkin.hybrid import Decoder, Identifier, Settings, find_strategy, measure, train

from .oscillator import FRAMES, Flat, data, make, task


def test_a_decoder_sees_what_it_is_given_and_nothing_else():
    torch.manual_seed(0)
    decoder = Decoder(lambda s, u, p: torch.stack([s[..., 0], p[..., 0]]), 2, (3, 4), widths=(8,))
    states, physics = torch.randn(5, 6, 2), torch.rand(5, 1)
    seen = decoder(states, physics)
    assert seen.shape == (5, 6, 3, 4)
    blind = torch.stack([states[..., 0], torch.zeros(5, 6)], dim=-1)
    assert torch.equal(decoder(blind, physics), seen)
    assert not torch.equal(decoder(states, physics + 1.0), seen)


def test_an_observation_is_learned_with_the_dynamics():
    def learned(seed: int) -> Identifier:
        torch.manual_seed(seed)
        decoder = Decoder(lambda s, u, p: s.movedim(-1, 0), 2, (2,), widths=(16,))
        generator = torch.Generator().manual_seed(seed)
        return Identifier(task(), Flat(FRAMES), Flat(2), code=3, generator=generator, decoder=decoder)

    seen, unseen = data(30, 6, seed=1), data(8, 6, seed=2)
    settings = Settings(steps=150, dynamics=6, series=6, rate=1e-2)
    before, after = learned(0), train(learned, seen, settings).model
    errors = [measure(model, unseen, find_strategy("meta"), 5, physics=())["mse_x"] for model in (before, after)]
    assert errors[1] < 0.2 * errors[0]


def test_without_a_decoder_the_emission_observes():
    model, states = make(0), data().states
    found = model.encode(states)
    assert torch.equal(model.observe(found, states), states)
    expected = model.task.emission.squared_error(states + 1.0, states)
    assert torch.equal(model.squared_error(found, states + 1.0, states), expected)
