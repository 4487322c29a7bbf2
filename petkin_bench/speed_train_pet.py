"""A training step on PET: regional curves read by one small encoder, against the paper's encoders of images.

Ours is a whole step of the PET table's training. Of the paper's form only its two encoders are timed, forward and
backward, on 32 x 32 images of 80 frames: its rollout, its painting of images and its optimiser come on top, so the
ratio is a least one. Both forms predict 64 scans of five regions a step.
"""

from __future__ import annotations

import time
from statistics import median

import torch

from petkin.hybrid import Dataset, Settings, SpatioTemporal, train
from petkin.learning import PAPER, draw, tissue_model
from petkin_bench.speed_train import FILTERS, Clock, Row, compare

#: Eight subjects of five regions, eight scans each, as petkin_bench.pet draws them.
_SUBJECTS, _REGIONS, _SCANS = 8, 5, 8
_FRAMES, _SIZE, _CONTEXT, _ENCODERS = 80, 32, 7, 2


def measure_pet(*, steps: int, paper_steps: int, naive_steps: int) -> list[Row]:
    """One row.

    Args:
        steps, paper_steps: not used, the time to an accuracy is not measured here.
        naive_steps: to time either form.
    """
    ours = _curves(2 * naive_steps) | _data()
    ours["data_percent"] = 100.0 * float(str(ours["data_cpu_ms"])) / float(str(ours["step_cpu_ms"]))
    return [compare("PET, f(C_T, C_P), the paper's encoders alone", ours, _images(naive_steps))]


def _curves(steps: int) -> Row:
    _, told = draw(PAPER, _SUBJECTS, _SCANS, 1)
    data = Dataset(told.states, told.truth)
    conditions = PAPER.conditions
    settings = Settings(steps=steps, dynamics=_SUBJECTS * _REGIONS, series=_SCANS, rate=1e-2, clip=100.0)
    clock = Clock(None, data)
    train(
        lambda seed: tissue_model(
            "meta_hylad", conditions, PAPER.bounds, data.states[..., 1], residual="C_T,C_P", seed=seed
        ),
        data,
        settings,
        progress=clock,
    )
    return clock.row("cpu")


def _images(steps: int) -> Row:
    """Every query brings seven context scans; they are encoded eight at a time, as often as it takes."""
    encoder = SpatioTemporal(_FRAMES, 1, _SIZE, filters=FILTERS)
    images, spent = torch.rand(_SCANS, _FRAMES, 1, _SIZE, _SIZE), []
    for _ in range(steps):
        start = time.process_time()
        encoder(images).square().mean().backward()
        spent.append(time.process_time() - start)
    passes = _ENCODERS * _SUBJECTS * _SCANS * _CONTEXT / _SCANS
    return {"form": "own contexts a query, two encoders of images alone", "step_cpu_ms": 1e3 * passes * median(spent)}


def _data() -> Row:
    """All curves of the PET table's training set, once, over its steps."""
    start = time.process_time()
    draw(PAPER, 60, 20, 1)
    spent = time.process_time() - start
    return {"data_cpu_ms": 1e3 * spent / 2000, "all_states_cpu_s": spent}
