"""`petkin info` as a user meets it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from petkin.cli.info import info

app = typer.Typer()
app.command()(info)


@pytest.fixture
def one_scan(tmp_path: Path) -> Path:
    """A study of one sidecar: radionuclide spelt the other way, nothing to fit."""
    folder = tmp_path / "sub-01" / "pet"
    folder.mkdir(parents=True)
    fields = {
        "TracerName": "[methyl-18F]X",
        "TracerRadionuclide": "18F",
        "Units": "Bq/mL",
        "FrameTimesStart": [0, 600],
        "FrameDuration": [600, 600],
        "ImageDecayCorrected": True,
        "ImageDecayCorrectionTime": 0,
    }
    (folder / "sub-01_pet.json").write_text(json.dumps(fields))
    (tmp_path / "dataset_description.json").write_text('{"Name": "one scan"}')
    return tmp_path


def test_scans_and_remarks_are_printed(one_scan: Path) -> None:
    result = CliRunner().invoke(app, [str(one_scan)])
    assert result.exit_code == 0
    lines = [line.rstrip() for line in result.stdout.splitlines()]
    assert lines[0] == "one scan"
    assert lines[2].split() == ["sub-01", "[methyl-18F]X", "(F18)", "2", "20", "none", "none", "none"]
    assert lines[3] == "severe sub-01: There is neither an image nor a table of regional curves."
    assert lines[4] == "warning sub-01_pet.json: TracerRadionuclide is '18F'; read as F18, as BIDS spells it."


def test_json_holds_everything(one_scan: Path) -> None:
    result = CliRunner().invoke(app, [str(one_scan), "--json", "--participant-label", "sub-01"])
    overview = json.loads(result.stdout)
    assert overview["scans"][0]["nuclide"] == "F18"
    assert [finding["code"] for finding in overview["findings"]] == ["nothing-to-fit", "nuclide-spelling", "no-blood"]


def test_a_scan_that_cannot_be_used_is_listed(one_scan: Path) -> None:
    (one_scan / "sub-01/pet/sub-01_pet.json").write_text("{}")
    result = CliRunner().invoke(app, [str(one_scan)])
    assert result.exit_code == 0
    assert "refused sub-01_pet.json: FrameTimesStart is missing" in result.stdout
