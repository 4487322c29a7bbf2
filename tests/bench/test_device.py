"""Nothing of a training stays on the processor when the model is elsewhere: mixed devices are an error on any."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from petkin.hybrid import Dataset, Settings, device, train
from petkin.hybrid.gradients import Gradients, loss_of
from petkin_bench.cli import main
from petkin_bench.protocol import build, find_preset
from petkin_bench.systems import SYSTEMS, draw, find_system


@pytest.mark.parametrize("physics", SYSTEMS, ids=lambda physics: physics.name)
@pytest.mark.parametrize("dynamics", ["full_physics", "purely_neural", "meta_hylad"])
def test_a_step_of_every_system_runs_on_another_device(physics, dynamics):
    """Over a few moments: further ones do the same again."""
    physics = replace(physics, times=physics.times[:4])
    model = build(physics, dynamics, find_preset("tiny"), 0).place_on("meta")
    states = torch.zeros(2, 3, len(physics.times), len(physics.states))
    batch = Dataset(states, torch.zeros(2, len(physics.ranges))).to("meta")
    loss, _, _ = loss_of(model, batch, 2, Settings(steps=10, norm=1e-4, orthogonality=1e-4), 0)
    loss.backward()
    assert loss.device.type == model.device.type == "meta"
    assert all(p.grad is None or p.grad.device.type == "meta" for p in model.parameters())


@pytest.mark.parametrize("decoder", ["neural_prior", "neural", "adaptive"])
def test_learned_decoders_go_with_the_model(decoder):
    physics = find_system("pendulum")
    model = build(physics, "meta_hylad", find_preset("tiny"), 0, decoder).place_on("meta")
    batch = Dataset(torch.zeros(2, 3, 25, 2), torch.zeros(2, 2)).to("meta")
    loss_of(model, batch, 2, Settings(steps=10), 0)[0].backward()


def test_training_on_a_named_device_is_training():
    physics, preset = find_system("pendulum"), find_preset("tiny")
    data = draw(physics, 6, 6, seed=1)
    settings = replace(preset.of("pendulum"), steps=3)
    here, there = (
        train(lambda seed: build(physics, "meta_hylad", preset, seed), data, settings, **where)
        for where in ({}, {"device": "cpu"})
    )
    assert here.losses == there.losses
    assert device() == "cpu" or torch.cuda.is_available()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--device", "nonsense"], "torch sees no such device here"),
        (["--table", "pet", "--device", "cpu"], "trained on the processor"),
    ],
)
def test_a_device_that_cannot_be_used_is_one_line(options, said, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["petkin-bench", "run", "--preset", "tiny", *options])
    with pytest.raises(SystemExit) as ended:
        main()
    told = capsys.readouterr().err
    assert (ended.value.code, told.count("\n")) == (2, 1)
    assert said in told


@pytest.mark.skipif(not torch.cuda.is_available(), reason="torch sees no CUDA device here")
@pytest.mark.parametrize("physics", SYSTEMS, ids=lambda physics: physics.name)
@pytest.mark.parametrize("name", ["cpu", "paper"])
def test_a_replayed_step_has_the_gradients_of_single_kernels(physics, name, monkeypatch):
    preset, settings = replace(find_preset(name), compiled=False), Settings(steps=10, dynamics=3, series=4)
    model = build(physics, "meta_hylad", preset, 0).place_on("cuda").train()
    drawn = [draw(physics, 3, 4, seed=seed).to("cuda") for seed in (1, 2, 3)]
    replayed, single = Gradients(model, settings), Gradients(model, settings)
    monkeypatch.setattr(single, "_alike", lambda step: False)
    for batch in drawn:
        said, gradients = zip(*(_taken(each, model, batch) for each in (replayed, single)))
        assert torch.allclose(*said, rtol=1e-4)
        assert (gradients[0] - gradients[1]).norm() < 1e-3 * gradients[1].norm()


def _taken(gradients: Gradients, model, batch: Dataset) -> tuple[torch.Tensor, torch.Tensor]:
    said = gradients([(batch, 2)], 9).clone()
    return said, torch.cat([p.grad.flatten().clone() for p in model.parameters() if p.grad is not None])
