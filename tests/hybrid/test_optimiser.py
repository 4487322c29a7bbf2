"""Adam along the axes of the gradients: indifferent to how a layer is turned, sooner there, resumed as it was."""

from __future__ import annotations

import pytest
import torch

from petkin.hybrid import Settings, load_tensors, train
from petkin.hybrid.optimiser import TurnedAdam

from .oscillator import data, make


def _turn(size: int, seed: int) -> torch.Tensor:
    return torch.linalg.qr(torch.randn(size, size, generator=torch.Generator().manual_seed(seed)).double())[0]


def _fit(steps: int, left: torch.Tensor, right: torch.Tensor, optimiser) -> torch.Tensor:
    """W = left X right fitted to a target through badly scaled directions, the errors of all steps."""
    generator = torch.Generator().manual_seed(0)
    target = torch.randn(6, 5, generator=generator, dtype=torch.float64)
    scales = torch.logspace(0, -2, 5, dtype=torch.float64)
    inside = torch.nn.Parameter(left.T @ torch.zeros(6, 5, dtype=torch.float64) @ right.T)
    made, errors = optimiser([inside]), []
    for step in range(steps):
        for group in made.param_groups:
            group["lr"] = 0.1 * (1.0 - step / steps)
        made.zero_grad()
        error = ((left @ inside @ right - target) * scales).square().mean()
        error.backward()
        made.step()
        errors.append(error.detach())
    return torch.stack(errors)


def test_steps_do_not_depend_on_how_the_weights_are_turned():
    plain = _fit(40, torch.eye(6).double(), torch.eye(5).double(), lambda p: TurnedAdam(p, 0.1, every=1))
    turned = _fit(40, _turn(6, 1), _turn(5, 2), lambda p: TurnedAdam(p, 0.1, every=1))
    torch.testing.assert_close(turned, plain, rtol=1e-3, atol=1e-6)


def test_mixed_directions_of_unlike_scale_are_followed_sooner_than_by_adam():
    sides = _turn(6, 1), _turn(5, 2)
    ours = _fit(200, *sides, lambda p: TurnedAdam(p, 0.1))
    adam = _fit(200, *sides, lambda p: torch.optim.Adam(p, 0.1))
    assert ours[-1] < 0.1 * adam[-1]


def test_long_sides_and_single_rows_are_stepped_too():
    long, bias, number = (torch.nn.Parameter(torch.ones(shape)) for shape in ((3, 500), (7,), ()))
    made = TurnedAdam([long, bias, number], 0.01)
    for _ in range(25):
        made.zero_grad()
        (long.square().sum() + bias.square().sum() + number.square()).backward()
        made.step()
    assert {"left_axes", "square", "left", "mean", "step"} == set(made.state[long])
    assert all(bool((p < 0.9).all()) and bool(torch.isfinite(p).all()) for p in (long, bias, number))


def test_a_resumed_run_turns_as_it_would_have(tmp_path):
    settings = Settings(steps=12, dynamics=4, series=4, save_every=5, axes=2)
    whole, path = train(make, data(), settings), tmp_path / "run.safetensors"

    def stop(step, loss):
        if step == 8:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(make, data(), settings, checkpoint=path, progress=stop)
    assert load_tensors(path)[1]["step"] == 5
    assert train(make, data(), settings, checkpoint=path).losses == whole.losses
