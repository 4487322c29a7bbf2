"""Error bars on the pendulum: nine intervals in ten hold what they should, on dynamics nobody has seen."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from petkin.hybrid import context_features, errors_of, teach_error_bars, train
from petkin_bench.protocol import build, find_preset
from petkin_bench.systems import draw, find_system

_NINETY = 1.645


def _inside(errors: Tensor, spread: Tensor) -> float:
    return float((errors.abs() < _NINETY * spread).float().mean())


def test_intervals_hold_what_they_say():
    pendulum, preset = find_system("pendulum"), find_preset("tiny")
    settings = replace(preset.of("pendulum"), steps=160)
    model = train(
        lambda seed: build(pendulum, "meta_hylad", preset, seed), draw(pendulum, 30, 9, seed=1), settings
    ).model
    bars = teach_error_bars(model, draw(pendulum, 120, 9, seed=4), contexts=(1, 3, 7), physics=(0,), steps=200)
    unseen = draw(pendulum, 200, 9, seed=2)
    with torch.no_grad():
        said = model.encode(model.task.emission.observe(unseen.states))
        widths = []
        for k in (1, 7):
            spread, errors = bars(context_features(model, said, k)), errors_of(model, unseen, said, k, (0,))
            assert _inside(errors.physics, spread.physics) == pytest.approx(0.9, abs=0.08)
            assert _inside(errors.states, spread.states) == pytest.approx(0.9, abs=0.08)
            assert _inside(errors.residual, spread.residual[..., None, :]) == pytest.approx(0.9, abs=0.08)
            widths.append(float(spread.physics.mean()))
        assert widths[1] < widths[0]
        assert float(spread.physics.std()) > 0
