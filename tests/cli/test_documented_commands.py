"""Commands of README and docs run as written: those on a study against the one of a few voxels, with files of the names
that the text gives."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch

from petkin.hybrid import Settings, load_tensors, save_tensors
from petkin.imaging import FrameObservation, FrameSchedule
from petkin.learning import PAPER, drawn_curves, train_tracer

from .conftest import Ran
from .tiny_study import BLOOD, DURATIONS, IMAGE, STARTS, dump, labels, save

ROOT = Path(__file__).parents[2]
PAGES = (
    "README.md",
    *(
        f"docs/{page}.md"
        for page in (
            "diagnosing",
            "diagnosing-methods",
            "diagnosing-measured",
            "fitting",
            "learning",
            "scale",
            "simulating",
        )
    ),
)
_FENCED, _INLINE = re.compile(r"^```\w*\n(.*?)^```", re.MULTILINE | re.DOTALL), re.compile(r"`(petkin [a-z]+ [^`]+)`")
_FILES = re.compile(r"^```toml\n# (\w+\.toml)\n(.*?)^```", re.MULTILINE | re.DOTALL)
_PATTERN = re.compile(r"\b(BIDS_DIR|COMMAND|DIR|FILE|FWHM|MM|N|NAME|PERCENT|SYMBOL|VALUE)\b|tcp://")


def documented() -> list[str]:
    """Every whole command; neither mentions such as `petkin simulate --psf`, nor patterns, nor other machines."""
    found = []
    for page in PAGES:
        text = (ROOT / page).read_text()
        blocks = "\n".join(_FENCED.findall(text)).replace("\\\n", " ")
        found += [line.strip() for line in blocks.splitlines() if line.strip().startswith("petkin ")]
        found += [command for command in _INLINE.findall(_FENCED.sub("", text)) if len(shlex.split(command)) > 3]
    return list(dict.fromkeys(command for command in found if not _PATTERN.search(command)))


@pytest.fixture(scope="module")
def tracer(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A checkpoint as the text's `petkin train` leaves it, trained for a few steps."""
    path = tmp_path_factory.mktemp("tracer") / "tracer.safetensors"
    settings = Settings(steps=5, rate=1e-2, seed=0, save_every=5)
    population = replace(PAPER, observation=FrameObservation(FrameSchedule.uniform(10, 6.0), math.log(2.0) / 20.36))
    conditions, curves = drawn_curves(population, 2, 0)
    train_tracer(conditions, curves, path, settings, {}, residual="held", half_life=20.36, progress=lambda *_: None)
    return path


@pytest.fixture
def beside(study: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder with `study`, and the files of an image outside BIDS."""
    folder = study.parent
    (folder / "pet.nii.gz").write_bytes((study / IMAGE).read_bytes())
    (folder / "blood.tsv").write_text((study / BLOOD).read_text())
    dump(folder / "frames.json", {"FrameTimesStart": STARTS, "FrameDuration": DURATIONS})
    for page in PAGES:
        for name, text in _FILES.findall((ROOT / page).read_text()):
            (folder / name).write_text(text)
    for name in ("brain.nii.gz", "mask.nii.gz"):
        save(folder / name, (labels() > 0).astype(np.uint8))
    monkeypatch.setattr("petkin.reporting.render_fit_report", lambda report: "")
    monkeypatch.chdir(folder)
    return folder


@pytest.mark.parametrize("command", documented())
def test_it_runs(command: str, beside: Path, tracer: Path, petkin_command: Callable[..., Ran]) -> None:
    words = shlex.split(command)[1:]
    if "cuda" in words and not torch.cuda.is_available():
        pytest.skip("torch sees no CUDA device here")
    for seed, name in enumerate(after for before, after in pairwise(words) if before == "--checkpoint"):
        tensors, card = load_tensors(tracer)
        moved = {key: value + 1e-3 * seed * value.abs() for key, value in tensors.items()}
        save_tensors(beside / name, moved, {**card, "seed": seed})
    if words[0] == "simulate" and "study" in words:
        (beside / "study").rename(beside / "before")
    ran = petkin_command(*words)
    assert (ran.status, ran.err) == (0, "")


def test_they_are_found() -> None:
    commands = documented()
    assert "petkin fit study --pvc gtm --psf 6" in commands
    assert any(command.startswith("petkin fit pet.nii.gz --blood") for command in commands)
    assert any(command.startswith("petkin simulate") for command in commands)
