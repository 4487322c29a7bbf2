"""`petkin train`, and `petkin fit --model hybrid` with what it wrote."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import nibabel
import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from petkin.cli.app import app
from petkin.errors import InputError
from petkin.fitting import Choices, Status
from petkin.methods import check_choices, find_method

from .conftest import Ran


def train(*arguments: object):
    return CliRunner().invoke(app, ["train", *map(str, arguments)])


def test_a_population_is_learned_and_kept(tmp_path):
    path = tmp_path / "tracer.safetensors"
    done = train(path, "--subjects", 3, "--frames", "12x60", "--steps", 5)
    assert done.exit_code == 0, done.output
    assert path.is_file()
    assert path.with_suffix(".csv").is_file()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--range", "Q=1:2"), "choose from K1"),
        (("--residual", "C_X"), "no residual of 'C_X'"),
        (("--frames", "often"), "is no schedule"),
        (("--isotope", "X99"), "X99"),
        (("--from", "/nowhere"), "no such"),
    ],
)
def test_bad_input_is_one_line(tmp_path: Path, arguments, message):
    done = train(tmp_path / "a.safetensors", *arguments)
    assert isinstance(done.exception, InputError)
    assert message in str(done.exception)
    assert "\n" not in str(done.exception)


def test_a_learned_model_and_its_checkpoint_go_together(tmp_path):
    for methods, choices in (
        ((find_method("hybrid"),), Choices()),
        ((find_method("1TCM"),), Choices(checkpoint=tmp_path / "a.safetensors")),
    ):
        with pytest.raises(InputError, match="go together"):
            check_choices(methods, choices)


def test_what_was_learned_fits_a_study(study: Path, petkin_command: Callable[..., Ran], tmp_path: Path):
    path, out = tmp_path / "tracer.safetensors", tmp_path / "out"
    ran = petkin_command(
        "train", path, "--subjects", 2, "--frames", "2x30,1x60,1x180,8x300", "--isotope", "C11", "--steps", 5
    )
    assert (ran.status, ran.err) == (0, "")
    real = petkin_command("train", tmp_path / "b.safetensors", "--from", study, "--steps", 5)
    assert (real.status, real.err) == (0, ""), "curves come from the image and its regions"
    bare = Path(shutil.copytree(study, tmp_path / "bare"))
    for labels in bare.rglob("*_dseg.*"):
        labels.unlink()
    nothing = petkin_command("train", tmp_path / "c.safetensors", "--from", bare)
    assert nothing.status == 2
    assert "there is neither a segmentation nor curves" in nothing.err
    assert nothing.err.count("\n") == 1
    ran = petkin_command("fit", study, "--model", "hybrid", "--checkpoint", path, "--out", out)
    assert ran.status == 0, ran.err
    table = pd.read_csv(next(out.rglob("*model-hybrid_kinpar.tsv")), sep="\t")
    assert {"K1", "k2", "VB", "VT", "fNN"} <= set(table)
    assert "Learned correction against tissue" in next(out.rglob("*report.html")).read_text()
    maps = {q: next(out.rglob(f"*model-hybrid_meas-{q}_mimap.nii.gz")) for q in ("K1", "k2", "VB", "VT", "fNN")}
    status = np.asarray(nibabel.load(next(out.rglob("*model-hybrid_desc-status_mimap.nii.gz"))).dataobj)
    for path in maps.values():
        values = np.asarray(nibabel.load(path).dataobj)
        assert np.isfinite(values[status == Status.OK]).all()
    assert json.loads(Path(str(maps["fNN"]).replace(".nii.gz", ".json")).read_text())["Units"] == "kBq mL-1 min-1"
