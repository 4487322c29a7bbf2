"""Moments tell where spots are; a compiled rollout says what the plain one says."""

import pytest
import torch

from petkin.hybrid import Moments, RungeKutta


def _spots(places: torch.Tensor) -> torch.Tensor:
    """Series [n, T, 1, 32, 32] of round spots at places [n, T, 2]."""
    middle = (torch.arange(32) + 0.5) / 16 - 1
    across, down = (torch.exp(-0.5 * ((middle - places[..., i, None]) / 0.09) ** 2) for i in range(2))
    return (down[..., :, None] * across[..., None, :])[:, :, None]


def test_moments_tell_places_below_a_pixel():
    encoder = Moments(4, 1)
    places = 1.2 * (torch.rand(16, 4, 2, generator=torch.Generator().manual_seed(0)) - 0.5)
    said = encoder.describe(_spots(places))
    found = torch.stack([said[:, 1], said[:, 2]], dim=-1)
    # below a twentieth of a pixel: what is left is the mean brightness below which a channel counts as dark
    assert (found - places).abs().max() < 0.05 * (2 / 32) + 0.01 * places.abs().max()


def test_what_is_usual_is_told_once_and_kept():
    encoder, generator = Moments(4, 1), torch.Generator().manual_seed(0)
    series = _spots(torch.rand(64, 4, 2, generator=generator) - 0.3)
    encoder.settle(series)
    standard = encoder._standard(encoder.describe(series))
    spread = standard.var(dim=(0, 2))
    torch.testing.assert_close(standard.mean(dim=(0, 2)), torch.zeros(6), rtol=0, atol=1e-3)
    torch.testing.assert_close(spread[1:3], torch.ones(2), rtol=0.05, atol=0)
    kept = {name: value.clone() for name, value in encoder.usual.state_dict().items()}
    encoder.train()(series[:8])
    torch.testing.assert_close(encoder.usual.state_dict(), kept, rtol=0, atol=0)


def test_a_straight_line_of_the_moments_is_among_the_features():
    encoder = Moments(4, 1)
    series = _spots(torch.rand(8, 4, 2, generator=torch.Generator().manual_seed(0)) - 0.3)
    said = encoder._standard(encoder.describe(series)).flatten(1)
    features = encoder(series)
    assert features.shape == (8, encoder.features)
    assert torch.equal(features[:, -said.shape[1] :], said)
    assert Moments(4, 1, straight=False).features == encoder.features - said.shape[1]


def test_a_dark_channel_gives_finite_features_and_gradients():
    series = torch.zeros(3, 4, 2, 16, 16, requires_grad=True)
    encoder = Moments(4, 2).eval()
    encoder(series).sum().backward()
    assert series.grad is not None
    assert bool(torch.isfinite(series.grad).all())


@pytest.mark.filterwarnings("ignore:The .grad attribute")
def test_compiled_rollout_equals_the_plain_one():
    def field(t, state, forcing, p):
        return torch.stack([state[..., 1], -p[..., 0] * torch.sin(state[..., 0])], dim=-1)

    generator = torch.Generator().manual_seed(1)
    start, p = torch.randn(5, 2, generator=generator), 1.0 + torch.rand(5, 1, generator=generator)
    found = []
    for compiled in (False, True):
        stiffness = p.clone().requires_grad_()
        states = RungeKutta(2, compiled=compiled)(field, start, stiffness, torch.arange(4) * 0.3)
        (gradient,) = torch.autograd.grad(states.square().sum(), stiffness)
        found.append((states.detach(), gradient))
    for plain, fast in zip(*found):
        torch.testing.assert_close(fast, plain, rtol=1e-5, atol=1e-6)
