"""The PET table end to end, tiny: trained, fitted, kept, not done again, printed beside the published."""

from __future__ import annotations

import pandas as pd
import pytest
from typer.testing import CliRunner

from petkin.errors import InputError
from petkin_bench.cli import app
from petkin_bench.pet import MODELS, find_preset, pet_jobs
from petkin_bench.pet_tables import closed_share, compare_pet


def test_the_table_is_run_once_and_compared(tmp_path):
    options = ["--preset", "tiny", "--results", str(tmp_path)]
    done = CliRunner().invoke(app, ["run", "--table", "pet", "--work", str(tmp_path), *options])
    assert done.exit_code == 0, done.output
    rows = pd.read_csv(tmp_path / "learning_pet.csv", keep_default_na=False)
    assert set(rows["model"]) == {row[0] for row in MODELS}
    assert set(rows["sees"]) == {row[1] for row in MODELS}
    assert {"mse_x", "mse_z", "psnr_x", "mse_cp", "cpu_s", "commit", "settings"} <= set(rows)
    found = compare_pet(tmp_path, "tiny").set_index(["model", "sees", "noise_train", "noise_test", "split", "test"])
    exact = found.loc[("fit_2TCM", "", 0, 0, "unseen", "others")]
    assert exact["mse_z"] < 1e-6, "the true model without noise"
    assert found.loc[("fit_1TCM", "", 0, 0, "unseen", "itself"), "mse_z"] > 1.0
    assert found.loc[("fit_2TCM", "", 5, 5, "unseen", "others"), "mse_z"] > 1e-3
    meta = found.loc[("meta_hylad", "C_T", 0, 0, "unseen", "others")]
    assert meta["mse_z_published"] == pytest.approx(0.113)
    assert found["mse_z_published"].notna().sum() == 8
    assert closed_share(compare_pet(tmp_path, "tiny"), "C_T,C_P") < 1.5
    again = CliRunner().invoke(app, ["run", "--table", "pet", "--work", str(tmp_path), *options])
    assert f"{len(MODELS)} runs, {len(MODELS)} of them done." in again.output


def test_fits_are_not_repeated_for_seeds():
    assert len(pet_jobs(3)) == 3 * len(MODELS) - 2 * sum(row[3] == 0 for row in MODELS)
    with pytest.raises(InputError, match="choose one of tiny, cpu"):
        find_preset("paper")
