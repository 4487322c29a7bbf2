"""The state map of a diagnosis: its table, its entry of the answer, its page, and what it is refused for."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import jsonschema
import pandas as pd
import pytest
import torch

from petkin.errors import InputError
from petkin.hybrid import Settings, load_tensors, save_tensors
from petkin.imaging import FrameObservation, FrameSchedule
from petkin.learning import PAPER, drawn_curves, train_tracer
from petkin.study.diagnose import Diagnosed, diagnose_study
from petkin.study.diagnosis.request import DiagnoseRequest
from petkin.study.simulate import simulate
from petkin.study.simulation import SimulationSettings

SCHEMA = json.loads((files("petkin.reporting") / "schemas" / "gap-report-1.json").read_text())
_HALF_LIFE = 109.77
_FRAMES = 12
#: K1 and k2 of the simulated ligand's regions too.
_RANGES = {**PAPER.ranges, "K1": (0.05, 0.3), "vB": (0.02, 0.06)}


@pytest.fixture(scope="module")
def members(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ...]:
    """One short training, and four that are a little off it: seeds of a long one differ about as much."""
    folder = tmp_path_factory.mktemp("members")
    first = folder / "0.safetensors"
    observation = FrameObservation(FrameSchedule.uniform(_FRAMES, 7.5), math.log(2.0) / _HALF_LIFE)
    population = replace(PAPER, observation=observation, ranges=_RANGES, rise=(400.0, 1000.0), noise=2.0)
    conditions, curves = drawn_curves(population, 5, 0)
    settings = Settings(steps=100, rate=1e-2)
    train_tracer(
        conditions, curves, first, settings, {}, residual="held", half_life=_HALF_LIFE, progress=lambda *_: None
    )
    tensors, card = load_tensors(first)
    generator = torch.Generator().manual_seed(0)
    paths = [first]
    for seed in range(1, 5):
        moved = {
            name: value + 0.02 * value.abs() * torch.randn(value.shape, generator=generator)
            if name.startswith("prior.hyper")
            else value
            for name, value in tensors.items()
        }
        paths.append(folder / f"{seed}.safetensors")
        save_tensors(paths[-1], moved, {**card, "seed": seed})
    return tuple(paths)


def simulated(folder: Path, **options: object) -> Path:
    usual = {"out": folder / "study", "noise": 8.0, "voxel_size": 7.0, "tracer": "reversible", "frames": str(_FRAMES)}
    return simulate(SimulationSettings.model_validate({**usual, **options}))


def diagnosed(study: Path, out: Path, members: tuple[Path, ...], **options: Any) -> Diagnosed:
    usual: dict[str, Any] = {"model": "1tcm", "include": ("blood_volume",), "out": out, "checkpoints": members}
    (one,) = diagnose_study(DiagnoseRequest(study, **{**usual, **options}))
    return one


@pytest.fixture(scope="module")
def lacking(tmp_path_factory: pytest.TempPathFactory, members: tuple[Path, ...]) -> tuple[Path, Diagnosed]:
    """Two compartments in the data, one in the simulator."""
    folder = tmp_path_factory.mktemp("lacking")
    study = simulated(folder)
    return study, diagnosed(study, folder / "out", members)


def table_of(one: Diagnosed) -> pd.DataFrame:
    return pd.read_csv(one.report.with_name("sub-01_desc-state_gap.tsv"), sep="\t")


def test_a_missing_compartment_is_mapped(lacking: tuple[Path, Diagnosed]) -> None:
    one = lacking[1]
    table = table_of(one)
    assert list(table) == ["region", "frame_start", "frame_end", "C_T", "flux", "low", "high", "claimed"]
    assert len(table) == _FRAMES * len(one.answer["where"]["regions"])
    assert table.claimed.isin([0, 1]).all()
    claimed = table[table.claimed == 1]
    assert len(claimed) > 0.05 * len(table)
    assert ((claimed.low > 0) | (claimed.high < 0)).all()
    assert ((table.low <= table.flux) & (table.flux <= table.high)).all()


def test_the_answer_says_which_state_lacks_what(lacking: tuple[Path, Diagnosed]) -> None:
    written = json.loads(lacking[1].report.with_suffix(".json").read_text())
    jsonschema.validate(written, SCHEMA)
    (entry,) = [entry for entry in written["where"]["state"] if entry["term"].startswith("learned residual")]
    assert entry["state"] == "C_T"
    assert entry["evidence"] > 10
    assert "second tissue" in entry["term"]


def test_the_table_says_what_it_holds(lacking: tuple[Path, Diagnosed]) -> None:
    told = json.loads(lacking[1].report.with_name("sub-01_desc-state_gap.json").read_text())
    assert told["flux"]["Units"] == "kBq mL-1 min-1"
    assert told["C_T"]["Units"] == "kBq/mL"
    assert told["Members"] == 5
    assert max(told["Cosines"], key=told["Cosines"].get) == "second_tissue"
    assert any("names no cause" in remark for remark in told["Remarks"])


def test_the_page_draws_it(lacking: tuple[Path, Diagnosed]) -> None:
    page = lacking[1].report.read_text()
    assert "What the law of the tissue lacks" in page
    assert "names no cause" in page


def test_the_same_seed_gives_the_same_bytes(
    lacking: tuple[Path, Diagnosed], members: tuple[Path, ...], tmp_path: Path
) -> None:
    study, first = lacking
    again = diagnosed(study, tmp_path / "out", members)
    for name in ("sub-01_desc-state_gap.tsv", "sub-01_desc-state_gap.json", "sub-01_desc-gap_report.html"):
        assert first.report.with_name(name).read_bytes() == again.report.with_name(name).read_bytes()


def test_nothing_is_claimed_where_one_compartment_is_enough(members: tuple[Path, ...], tmp_path: Path) -> None:
    one = diagnosed(
        simulated(tmp_path, model="1TCM", tracer=_one_tissue(tmp_path), noise=30.0, voxel_spread=False),
        tmp_path / "out",
        members,
    )
    assert one.answer["verdict"]["kind"] == "none"
    assert not table_of(one).claimed.any()
    assert not any(entry["term"].startswith("learned") for entry in one.answer["where"]["state"])
    assert "claim nothing" in one.report.read_text()


def _one_tissue(folder: Path) -> str:
    """The ligand without its second compartment."""
    from petkin.phantoms.reading import catalogue_folder

    text = (catalogue_folder() / "populations" / "reversible.toml").read_text()
    lines = ["k3 = 0.0" if line.startswith("k3 = ") else line for line in text.splitlines()]
    path = folder / "one.toml"
    path.write_text("\n".join(lines).replace('model = "2TCM"', 'model = "1TCM"'))
    return str(path)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"model": "2tcm"}, "the simulator is 2TCM; use --model 1tcm"),
        ({"include": ("second_tissue",)}, "--include second_tissue: beside --checkpoint"),
        ({"checkpoints": (Path("a"), Path("b"))}, "2 of at least 5; bands of fewer would hold the noise of the scan"),
        ({"checkpoints": tuple(Path(f"{i}") for i in range(5))}, "0: no such checkpoint"),
    ],
)
def test_ensembles_that_cannot_be(
    options: dict[str, Any], message: str, lacking: tuple[Path, Diagnosed], members: tuple[Path, ...], tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=message) as refused:
        diagnosed(lacking[0], tmp_path, members, **options)
    assert "\n" not in str(refused.value)


def test_another_radionuclide_is_refused(
    lacking: tuple[Path, Diagnosed], members: tuple[Path, ...], tmp_path: Path
) -> None:
    others = []
    for path in members:
        tensors, card = load_tensors(path)
        others.append(tmp_path / path.name)
        save_tensors(others[-1], tensors, {**card, "half_life_min": 20.36})
    with pytest.raises(InputError, match="learned with a half-life of 20"):
        diagnosed(lacking[0], tmp_path, tuple(others))
