"""The speed promised, and the quality promised with it, measured small."""

from __future__ import annotations

import json
import subprocess

import numpy as np
import pandas as pd
import pytest

from petkin.errors import InputError
from petkin.fitting import Choices, Given
from petkin.methods import find_method
from petkin_bench import provenance
from petkin_bench.accuracy import SETS, measure_accuracy
from petkin_bench.by_hand import costs_of, fit_by_hand
from petkin_bench.graphical import measure_graphical, patlak_in_numpy
from petkin_bench.problems import DRAWN, fit_problem
from petkin_bench.provenance import append_rows
from petkin_bench.speed import as_read, measure_model
from petkin_bench.whole_image import measure_image


def test_two_tissue_voxels_with_errors_are_500_times_faster_than_by_hand_and_fit_as_well() -> None:
    row = measure_model("2TCM", frames=26, percent=15.0, voxels=40_000, by_hand=12, judged=200)
    assert float(str(row["ratio_cpu"])) >= 500.0, json.dumps(row)
    assert float(str(row["within_0.1_percent"])) >= 98.0
    assert float(str(row["within_1_percent"])) >= 99.5


def test_the_formula_by_hand_is_the_model_of_petkin() -> None:
    problem = fit_problem(voxels=50, percent=5.0)
    import torch

    from petkin.kinetics import compartment_model

    ours = compartment_model("2TCM").frame_values(torch.tensor(problem.truth), problem.arterial, problem.observation)
    np.testing.assert_allclose(problem.clean, ours.numpy(), rtol=1e-9)


def test_by_hand_finds_the_truth_without_noise() -> None:
    problem = fit_problem(voxels=400, percent=1e-6, model="1TCM")
    found = fit_by_hand(problem, DRAWN["1TCM"], 3)
    np.testing.assert_allclose(found.parameters, problem.truth[:3], rtol=1e-3)
    assert np.isinf(costs_of(problem, np.full((1, 3), np.nan))).all()


def test_graphical_methods_are_timed_against_a_matrix_product() -> None:
    row = measure_graphical("Patlak", voxels=5000)
    assert float(str(row["voxels_per_s"])) > 10_000


def test_numpy_s_patlak_delivers_what_petkin_s_does() -> None:
    problem = fit_problem(voxels=200)
    late, area = problem.observation.frames.mid >= 20.0, problem.closed_form.basis(0.0)
    values, percent, chi2, finite = patlak_in_numpy(problem, as_read(problem), late, area)
    given = Given(problem.observation, problem.weights, problem.arterial)
    ours = find_method("Patlak").fit(as_read(problem), given, Choices(t_star=20.0), True)
    assert finite.all()
    np.testing.assert_allclose(values, [ours["Ki"], ours["V0"]], rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose(percent[0], ours.percent_se("Ki"), rtol=1e-2)
    np.testing.assert_allclose(chi2, ours.chi2, rtol=1e-2)


def test_a_whole_image_goes_from_file_to_maps(tmp_path) -> None:
    row = measure_image(tmp_path, by_hand_cpu_us=8000.0, shape=(12, 12, 8))
    assert int(str(row["voxels"])) > 250
    assert list((tmp_path / "out").rglob("*meas-VT_mimap.nii.gz"))


def test_rows_keep_their_provenance_and_old_rows_stay(tmp_path) -> None:
    append_rows("speed", [{"fit": "a", "x": 1.0}], tmp_path)
    table = pd.read_csv(append_rows("speed", [{"fit": "b", "y": 2.0}], tmp_path))
    assert list(table["fit"]) == ["a", "b"]
    assert table[["petkin", "commit", "date", "cpu", "cores", "python", "libraries"]].notna().all(axis=None)


def test_results_are_no_change_of_the_program(tmp_path, monkeypatch) -> None:
    """A second table of one run is of the same commit as the first; of changed code it is not."""

    def git(*words: str) -> None:
        subprocess.run(["git", "-c", "user.name=n", "-c", "user.email=e", *words], cwd=tmp_path, check=True)

    package = tmp_path / "package"
    results = package / "results"
    results.mkdir(parents=True)
    (package / "code.py").write_text("1\n")
    (results / "speed.csv").write_text("fit\na\n")
    git("init", "-q")
    git("add", ".")
    git("commit", "-qm", "one")
    monkeypatch.setattr(provenance, "RESULTS", results)
    monkeypatch.setattr(provenance, "__file__", str(package / "code.py"))

    def commit() -> str:
        table = pd.read_csv(append_rows("speed", [{"fit": "b"}], results), dtype=str)  # one may be all digits
        return str(table["commit"].iloc[-1])

    first, second = commit(), commit()
    assert first == second
    assert not first.endswith("+")
    (package / "code.py").write_text("2\n")
    assert commit() == f"{first}+"


def test_accuracy_needs_the_curves(tmp_path) -> None:
    with pytest.raises(InputError, match=r"frames\.tsv"):
        measure_accuracy(tmp_path)


def test_accuracy_on_the_benchmark_curves(shared_data) -> None:
    rows = measure_accuracy(shared_data / "bench")
    assert all(row["failed"] == 0 for row in rows)
    own = [row for row in rows if row["curves"] == "clean" and row["model"] == SETS[str(row["set"])][0]]
    outcomes = [row for row in own if row["quantity"] in ("K1", "VT", "Ki", "BPND")]
    assert {row["set"] for row in outcomes} == set(SETS)
    assert all(float(str(row["median_error_percent"])) <= 0.01 for row in outcomes)
    assert all(float(str(row["p90_error_percent"])) <= 0.05 for row in outcomes)
