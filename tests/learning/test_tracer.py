"""What a population teaches: resumed to the same numbers, used within its card, refused beyond it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from petkin.errors import InputError
from petkin.hybrid import Settings, load_tensors, save_tensors
from petkin.imaging import FrameObservation, FrameSchedule
from petkin.inputs import paper_plasma
from petkin.learning import PAPER, Known, Measured, draw, drawn_curves, identify_scan, train_tracer, try_out

_HALF_LIFE = 110.0
_SEEN = FrameObservation(FrameSchedule.uniform(15, 2.0), 0.0063)
_POPULATION = replace(PAPER, observation=_SEEN, ranges={**PAPER.ranges, "vB": (0.02, 0.06)}, noise=1.0)
_SETTINGS = Settings(steps=60, rate=1e-2, save_every=20)


class StoppedError(Exception):
    """Stands for a process that was ended."""


def learned(path: Path, stop: int = 0) -> None:
    conditions, curves = drawn_curves(_POPULATION, 4, 0)

    def told(step: int, misfit: float) -> None:
        if step == stop:
            raise StoppedError

    train_tracer(
        conditions,
        curves,
        path,
        _SETTINGS,
        {"from": "simulation"},
        residual="C_T,C_P",
        half_life=_HALF_LIFE,
        progress=told,
    )


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("tracer") / "whole.safetensors"
    learned(path)
    return path


def scan(seed: int = 5) -> Measured:
    _, measured = draw(_POPULATION, 1, 1, seed)
    plasma = paper_plasma(100.0 * measured.states[0, 0, 0, 3].double())
    return Measured(measured.states[:, 0, :, 1].double(), torch.ones(15), Known(plasma, plasma, _SEEN))


def test_a_stopped_training_goes_on_to_the_same_numbers(checkpoint, tmp_path):
    path = tmp_path / "stopped.safetensors"
    with pytest.raises(StoppedError):
        learned(path, stop=50)
    assert load_tensors(path)[1]["step"] == 40
    learned(path)
    (ours, card), (theirs, other) = load_tensors(path), load_tensors(checkpoint)
    assert card == other
    assert all(torch.equal(ours[name], theirs[name]) for name in theirs)
    assert len(path.with_suffix(".csv").read_text().splitlines()) == 1 + _SETTINGS.steps
    before = path.read_bytes()
    learned(path)
    assert path.read_bytes() == before, "what is finished is left as it is"


def test_curves_are_explained_and_errors_are_told(checkpoint):
    given = scan()
    found = identify_scan(checkpoint, given, half_life=_HALF_LIFE)
    off = (found.predicted - given.values).square().mean(dim=1).sqrt() / given.values.mean(dim=1)
    assert float(off.max()) < 0.1
    assert len(found.remarks) == 1
    assert "no known truth" in found.remarks[0]
    assert found.quantities.shape == (5, 5)
    assert bool((found.percent_se[:, :3] > 0).all())
    told = torch.isfinite(found.quantities[:, 3])
    assert bool((found.quantities[told, 3] > 0).all())
    assert bool(torch.isfinite(found.learned).all())
    twice = identify_scan(checkpoint, replace(given, values=2.0 * given.values), half_life=_HALF_LIFE)
    torch.testing.assert_close(twice.quantities[:, 1], found.quantities[:, 1], rtol=0.5, atol=0.05)


def test_errors_are_no_smaller_than_those_on_unseen_tissue(checkpoint, tmp_path):
    path = tmp_path / "tried.safetensors"
    path.write_bytes(checkpoint.read_bytes())
    try_out(path, _POPULATION, 3)
    trial, seed = load_tensors(path)[1]["trial"], _SETTINGS.seed + 1
    clean, measured = draw(_POPULATION, 3, 1, seed)
    before, after = [], []
    weights = drawn_curves(_POPULATION, 3, seed)[1].weights
    for i in range(3):
        own = slice(5 * i, 5 * i + 5)
        plasma = paper_plasma(100.0 * measured.states[5 * i, 0, 0, 3].double())
        given = Measured(measured.states[own, 0, :, 1].double(), weights[own].double(), Known(plasma, plasma, _SEEN))
        before.append(identify_scan(checkpoint, given, half_life=_HALF_LIFE))
        after.append(identify_scan(path, given, half_life=_HALF_LIFE))
    off = 100.0 * (torch.cat([found.quantities[:, 0] for found in before]) / clean.truth[:, 0] - 1.0)
    assert trial["K1"] == pytest.approx([float(off.median()), float(off.abs().quantile(0.683))], rel=0.1, abs=1.0)
    for plain, tried in zip(before, after):
        torch.testing.assert_close(
            tried.percent_se[:, :2], plain.percent_se[:, :2].clamp_min(torch.tensor([trial["K1"][1], trial["k2"][1]]))
        )
        assert f"K1 {trial['K1'][0]:+.3g} %" in tried.remarks[-1]


def test_what_is_unlike_the_card_is_refused_or_said(checkpoint, tmp_path):
    given = scan()
    with pytest.raises(InputError, match="half-life of 110 min, the scan's is 20"):
        identify_scan(checkpoint, given, half_life=20.4)
    with pytest.raises(InputError, match="no such checkpoint"):
        identify_scan(tmp_path / "none.safetensors", given, half_life=_HALF_LIFE)
    other = tmp_path / "other.safetensors"
    save_tensors(other, {"x": torch.ones(1)}, {"kind": "else"})
    with pytest.raises(InputError, match="not one of petkin train"):
        identify_scan(other, given, half_life=_HALF_LIFE)
    tensors, card = load_tensors(checkpoint)
    save_tensors(other, tensors, {**card, "step": 3})
    with pytest.raises(InputError, match="trained for 3 of 60 steps"):
        identify_scan(other, given, half_life=_HALF_LIFE)
    save_tensors(other, tensors, {**card, "end_min": 10.0})
    assert "extrapolated" in identify_scan(other, given, half_life=_HALF_LIFE).remarks[0]
    with pytest.raises(InputError, match="a checkpoint of another training"):
        train_tracer(
            *drawn_curves(_POPULATION, 2, 0),
            checkpoint,
            _SETTINGS,
            {},
            residual="C_T",
            half_life=1.0,
            progress=lambda step, misfit: None,
        )
