"""The baseline of the training benchmark computes what petkin does, and its table says what is projected."""

from __future__ import annotations

import copy

import pytest
import torch

from petkin.hybrid import Settings
from petkin.hybrid.gradients import loss_of
from petkin_bench.naive import Naive, train_naive
from petkin_bench.protocol import build, find_preset
from petkin_bench.speed_train import TARGET, Clock, compare, projection
from petkin_bench.speed_train_pet import measure_pet
from petkin_bench.systems import draw, find_system
from petkin_bench.tables import print_training

_PENDULUM = find_system("pendulum")


def _model():
    return build(_PENDULUM, "meta_hylad", find_preset("tiny"), 0).eval()


def test_the_naive_form_has_the_same_loss_for_the_same_contexts():
    model, data = _model(), draw(_PENDULUM, 2, 4, seed=0)
    pictures = _PENDULUM.emission.observe(data.states)
    others = torch.stack([torch.tensor([i for i in range(4) if i != j]) for j in range(4)])
    contexts, queries = pictures[:, others].flatten(0, 1), pictures.flatten(0, 1)
    with torch.no_grad():
        _, shared, _ = loss_of(model, data, 3, Settings(steps=1, series=4), 0)
        for apart in (None, copy.deepcopy(model.context)):
            torch.testing.assert_close(Naive(model, apart)(contexts, queries), shared, rtol=1e-4, atol=1e-9)


def test_naive_training_lowers_the_loss():
    torch.manual_seed(0)
    naive, losses = Naive(_model(), None), []
    settings = Settings(steps=60, dynamics=1, series=4, rate=3e-3)
    one = draw(_PENDULUM, 1, 4, seed=0)  # the same four series at every step, so that only learning changes the loss
    train_naive(naive.train(), one, settings, lambda step, loss: losses.append(loss))
    assert sum(losses[-10:]) < 0.9 * sum(losses[:10])


def test_a_clock_finds_when_the_target_was_reached():
    clock = Clock(_model, draw(_PENDULUM, 1, 8, seed=0))
    clock.steps = [1.0, 0.2, 0.2, 0.4]
    clock.checks = [(2, 1.2, 1.0), (3, 1.4, TARGET / 2), (4, 1.8, TARGET / 3)]
    row = clock.row("cpu")
    assert (row["steps_to_accuracy"], row["cpu_s_to_accuracy"], row["first_step_cpu_s"]) == (3, 1.4, 1.0)
    assert row["step_cpu_ms"] == pytest.approx(200.0)


def test_projected_times_are_said_to_be_so(capsys):
    ours = {"form": "cpu", "step_cpu_ms": 10.0, "cpu_s_to_accuracy": 20.0, "best_mse_z": 1e-3, "steps": 2000}
    naive = {"form": "naive", "step_cpu_ms": 2000.0}
    for reached, words in ((3000, "counted"), ("", "at least")):
        shared = {"steps_to_accuracy": reached, "steps": 1000}
        row = compare("pendulum", ours, naive) | projection(ours, shared, naive)
        assert row["ratio_step"] == pytest.approx(200.0)
        assert row["ratio_to_accuracy"] == pytest.approx((reached or 1000) * 2.0 / 20.0)
        print_training([row])
        assert words in capsys.readouterr().out


def test_curves_are_read_far_sooner_than_images():
    (row,) = measure_pet(steps=0, paper_steps=0, naive_steps=3)
    assert float(str(row["ratio_step"])) > 20
    assert float(str(row["data_percent"])) < 10
