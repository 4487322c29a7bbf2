"""Every option of `petkin fit` does what its help says, on a study of a few voxels."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import nibabel
import numpy as np
import pandas as pd
import pytest

from .conftest import Ran
from .tiny_study import (
    ATLAS,
    BLOOD,
    DSEG,
    DURATIONS,
    IMAGE,
    PET,
    SIDECAR_FILE,
    STARTS,
    blood_text,
    change,
    differences,
    dump,
    image,
    labels,
    plasma_at,
    rates,
    save,
    tree,
    write_scan,
)

Command = Callable[..., Ran]
RESULTS = Path("derivatives/petkin") / PET


@pytest.fixture(autouse=True)
def _no_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """The report has tests of its own and takes longer than all the rest."""
    monkeypatch.setattr("petkin.reporting.render_fit_report", lambda report: "\n".join(report.warnings))


@pytest.fixture
def exact(study: Path) -> Path:
    """The study with a dense ready input function instead of samples, so that only the fit itself is in question."""
    t = np.arange(0, 2701.0)
    parent = plasma_at(t / 60) * (0.4 + 0.6 * np.exp(-t / 900))
    table = pd.DataFrame({"time": t, "AIF": parent, "whole_blood_radioactivity": 0.8 * plasma_at(t / 60)})
    table.to_csv(study / BLOOD, sep="\t", index=False)
    change(study / BLOOD.with_suffix(".json"), AIF={"Units": "kBq/mL"}, PlasmaAvail=None, MetaboliteAvail=None)
    return study


def fit(command: Command, target: Path, *options: object) -> Ran:
    ran = command("fit", target, *options)
    assert ran.status == 0, ran
    assert ran.err == ""
    return ran


def kinpar(study: Path, model: str = "1TCM", seg: str = "_seg-atlas") -> tuple[pd.DataFrame, dict]:
    path = study / RESULTS / f"sub-01{seg}_model-{model}_kinpar.tsv"
    return pd.read_csv(path, sep="\t"), json.loads(path.with_suffix(".json").read_text())


def a_map(study: Path, name: str) -> np.ndarray:
    return nibabel.load(study / RESULTS / f"sub-01_model-1TCM_{name}_mimap.nii.gz").get_fdata()  # type: ignore[attr-defined]


def test_every_value_lies_on_its_own_voxel(exact: Path, petkin_command: Command) -> None:
    """K1 and k2 of this study rise differently along each axis, and the image's x axis points left."""
    fit(petkin_command, exact, "--model", "1TCM", "--delay", "0")
    inside = labels() > 0
    K1, k2 = rates()
    np.testing.assert_allclose(a_map(exact, "meas-K1")[inside], K1[inside], rtol=2e-3)
    np.testing.assert_allclose(a_map(exact, "meas-k2")[inside], k2[inside], rtol=2e-3)
    np.testing.assert_allclose(a_map(exact, "meas-VT")[inside], (K1 / k2)[inside], rtol=1e-3)
    assert np.isnan(a_map(exact, "meas-VT")[~inside]).all()
    assert (a_map(exact, "desc-status") == np.where(inside, 0, 1)).all()
    for name in ("meas-K1_desc-se", "desc-chi2"):
        assert (np.isfinite(a_map(exact, name)) == inside).all()
    written, raw = (
        nibabel.load(path) for path in (exact / RESULTS / "sub-01_model-1TCM_meas-K1_mimap.nii.gz", exact / IMAGE)
    )
    np.testing.assert_array_equal(written.affine, raw.affine)  # type: ignore[attr-defined]


def test_regions_carry_their_labels(exact: Path, petkin_command: Command) -> None:
    fit(petkin_command, exact, "--model", "1TCM", "--delay", "0", "--level", "region")
    table, sidecar = kinpar(exact)
    assert list(table.columns) == [
        "index", "name", "K1", "K1-se", "k2", "k2-se", "VB", "VB-se", "VT", "VT-se", "chi2", "aicc", "status", "bound",
        "VT-second", "asymmetric", "gap",
    ]  # fmt: skip
    assert list(table["index"]) == [1, 4]
    assert list(table["name"]) == ["cortex", "cerebellum"]
    K1, k2 = rates()
    for label, found in zip((1, 4), table["VT"], strict=True):
        assert found == pytest.approx((K1 / k2)[labels() == label].mean(), rel=0.02)
    units = {name: sidecar[name]["Units"] for name in ("K1", "k2", "VB", "VT", "K1-se")}
    assert units == {"K1": "mL cm-3 min-1", "k2": "min-1", "VB": "unitless", "VT": "mL cm-3", "K1-se": "percent"}
    assert sidecar["ModelName"] == "1TCM"
    assert sidecar["SoftwareName"] == "petkin"
    assert sidecar["CommandLine"].startswith("petkin fit /")
    assert sidecar["Sources"][:2] == ["bids:raw:sub-01/pet/sub-01_pet.json", "bids:raw:sub-01/pet/sub-01_pet.nii.gz"]
    assert "counting" in sidecar["Weights"]
    assert sidecar["InputDelay"] == 0


def test_regions_of_unlucky_names_stay_apart(study: Path, petkin_command: Command) -> None:
    """Names become columns beside frame_start and frame_end."""
    dump(study / ATLAS / "sub-01_seg-atlas_dseg.tsv", "index\tname\n1\tframe_start\n4\tframe_end\n")
    assert petkin_command("tacs", study).status == 0
    table = pd.read_csv(study / RESULTS / "sub-01_seg-atlas_tacs.tsv", sep="\t")
    assert list(table.columns) == ["frame_start", "frame_end", "frame_start-1", "frame_end-4"]
    assert list(table["frame_start"]) == STARTS


def test_level(study: Path, petkin_command: Command) -> None:
    fit(petkin_command, study, "--model", "1TCM", "--level", "region", "--out", study.parent / "r")
    fit(petkin_command, study, "--model", "1TCM", "--level", "voxel", "--out", study.parent / "v")
    by_region, by_voxel = (sorted(path.name for path in (study.parent / out).rglob("sub-*.*")) for out in "rv")
    assert not [name for name in by_region if "mimap" in name]
    assert [name for name in by_region if name.endswith("kinpar.tsv")]
    assert [name for name in by_voxel if name.endswith("meas-VT_mimap.nii.gz")]
    assert not [name for name in by_voxel if "kinpar" in name or "tacs" in name]


def test_fixed_values_and_bounds(study: Path, petkin_command: Command) -> None:
    options = ["--model", "1TCM", "--level", "region", "--fix", "VB=0.05", "--bounds", "K1=0:0.15", "--delay", "0"]
    fit(petkin_command, study, *options)
    table, sidecar = kinpar(study)
    assert (table["VB"] == 0.05).all()
    assert (table["VB-se"] == 0).all()
    assert table["K1"].to_numpy() == pytest.approx(0.15)
    assert (table["status"] == 4).all()
    assert (sidecar["InputValuesLabels"], sidecar["InputValues"], sidecar["InputValuesUnits"]) == (
        ["VB"],
        [0.05],
        ["unitless"],
    )
    assert sidecar["Settings"]["bounds"]["K1"] == [0, 0.15]


@pytest.mark.parametrize("option", ["estimate", "0", "-3", "7.5"])
def test_delay(study: Path, petkin_command: Command, option: str) -> None:
    """The blood of this study does not arrive late."""
    fit(petkin_command, study, "--model", "1TCM", "--level", "region", "--delay", option)
    _, sidecar = kinpar(study)
    if option == "estimate":
        assert abs(sidecar["InputDelay"]) < 3
        assert 0 < sidecar["InputDelaySE"] < 3
    else:
        assert (sidecar["InputDelay"], sidecar["InputDelaySE"]) == (float(option), None)
    curve = pd.read_csv(study / RESULTS / "sub-01_inputfunction.tsv", sep="\t").set_index("time")
    peak = 45 + sidecar["InputDelay"]
    assert curve["AIF"].idxmax() == pytest.approx(peak, abs=1.0)
    assert curve.index[-1] == 2700


def test_weights(study: Path, petkin_command: Command) -> None:
    table = study.parent / "weights.tsv"
    table.write_text("weight\n" + "\n".join(["0"] * 3 + ["1"] * 9) + "\n")
    found = {}
    for option in ("counting", "constant", table):
        fit(petkin_command, study, "--model", "1TCM", "--level", "region", "--weights", option, "--delay", "0")
        values, sidecar = kinpar(study)
        found[sidecar["Weights"].split()[0]] = values["VT"].to_numpy()
    assert list(found) == ["w_k", "all", "from"]
    assert not np.array_equal(found["w_k"], found["all"])
    for values in found.values():
        np.testing.assert_allclose(values, found["w_k"], rtol=0.03)


def test_later_frames_are_forecast(exact: Path, petkin_command: Command) -> None:
    options = ("--model", "1TCM", "--model", "Logan", "--level", "region", "--until", 30, "--t-star", 10, "--delay", 0)
    fit(petkin_command, exact, *map(str, options))
    before, sidecar = kinpar(exact)
    assert (before["forecast"] < 0.5).all(), "curves are one tissue without noise"
    assert "after 30 min" in sidecar["forecast"]["Description"]
    assert "forecast, not fitted" in sidecar["Weights"]
    assert "forecast" not in kinpar(exact, "Logan")[0], "a plot does not say what frames hold"
    late = np.add(STARTS, DURATIONS) > 30 * 60
    save(exact / IMAGE, np.where(late, 1.5, 1.0) * image())
    fit(petkin_command, exact, *map(str, options))
    after, _ = kinpar(exact)
    np.testing.assert_allclose(after[["K1", "VT"]], before[["K1", "VT"]], rtol=1e-3)
    np.testing.assert_allclose(after["forecast"], 100.0 * (1.0 - 1.0 / 1.5), rtol=0.05)


@pytest.mark.parametrize(("minutes", "said"), [(0, "--until is 0"), (0.1, "none to fit"), (600, "none to forecast")])
def test_what_cannot_be_forecast_is_told_in_a_line(study: Path, petkin_command: Command, minutes, said) -> None:
    ran = petkin_command("fit", study, "--model", "1TCM", "--until", minutes)
    assert (ran.status, ran.err.count("\n")) == (2, 1)
    assert said in ran.err


@pytest.mark.parametrize("observation", ["frame", "plain", "mid"])
def test_observation(exact: Path, petkin_command: Command, observation: str) -> None:
    """The image holds decay-weighted means; other ways to read a frame leave residuals."""
    options = ["--model", "1TCM", "--level", "voxel", "--delay", "0", "--fix", "vB=0", "--observation", observation]
    fit(petkin_command, exact, *options)
    sidecar = json.loads((exact / RESULTS / "sub-01_model-1TCM_meas-K1_mimap.json").read_text())
    assert sidecar["Observation"] == observation
    lowest, highest = {"frame": (0, 1e-9), "plain": (1e-8, 1e-5), "mid": (1e-5, 1e-2)}[observation]
    inside = labels() > 0
    relative = a_map(exact, "desc-chi2")[inside] / image()[inside].max(axis=-1) ** 2
    assert ((relative >= lowest) & (relative < highest)).all(), (relative.min(), relative.max())


def test_mask_and_given_segmentation(study: Path, petkin_command: Command) -> None:
    few, swapped = np.zeros((6, 6, 4), np.uint8), labels()[::-1].copy()
    few[2:4, 2, 1] = 1
    mask, dseg = save(study.parent / "mask.nii", few), save(study.parent / "sub-01_seg-mine_dseg.nii.gz", swapped)
    fit(petkin_command, study, "--model", "1TCM", "--mask", mask, "--dseg", dseg, "--delay", "0")
    assert (np.isfinite(a_map(study, "meas-VT")) == (few > 0)).all()
    table, sidecar = kinpar(study, seg="_seg-mine")
    assert list(table["name"]) == ["label-1", "label-4"]
    assert sidecar["Sources"][-2:] == ["sub-01_seg-mine_dseg.nii.gz", "mask.nii"]


def test_plain_image_gives_the_numbers_of_the_study(study: Path, petkin_command: Command) -> None:
    folder = study.parent
    (folder / "scan.nii.gz").write_bytes((study / IMAGE).read_bytes())
    rows = [f"{s}\t{s + d}" for s, d in zip(STARTS, DURATIONS, strict=True)]
    dump(folder / "frames.tsv", "\n".join(["frame_start\tframe_end", *rows]) + "\n")
    given = ["--blood", study / BLOOD, "--dseg", study / DSEG, "--model", "1TCM", "--units", "kBq/mL"]
    fit(petkin_command, study, "--model", "1TCM")
    fit(petkin_command, folder / "scan.nii.gz", "--frames", folder / "frames.tsv", "--isotope", "11C", *given)
    plain = folder / "scan-petkin" / "sub-scan" / "pet"
    names = ["seg-atlas_model-1TCM_kinpar.tsv", "seg-atlas_tacs.tsv", "inputfunction.tsv"]
    names += [f"model-1TCM_{what}_mimap.nii.gz" for what in ("meas-VT", "meas-K1_desc-se", "desc-status", "desc-chi2")]
    for name in names:
        assert (plain / f"sub-scan_{name}").read_bytes() == (study / RESULTS / f"sub-01_{name}").read_bytes(), name
    assert json.loads((plain / "sub-scan_inputfunction.json").read_text())["Sources"][0] == "scan.nii.gz"


def test_plain_image_without_unit_or_regions(study: Path, petkin_command: Command) -> None:
    """A whole _pet.json stands for --frames, --isotope and --units; activity stands for a mask."""
    scan = study.parent / "sub-07_scan.nii.gz"
    scan.write_bytes((study / IMAGE).read_bytes())
    ran = fit(
        petkin_command,
        scan,
        "--frames",
        study / SIDECAR_FILE,
        "--blood",
        study / BLOOD,
        "--model",
        "1TCM",
        "--delay",
        "0",
    )
    assert "unit is not stated" not in ran.out
    results = study.parent / "sub07scan-petkin/sub-07/pet"
    assert (results / "sub-07_model-1TCM_meas-VT_mimap.nii.gz").is_file()
    assert not list(results.glob("*kinpar*"))
    frames = dump(study.parent / "frames.json", {"FrameTimesStart": STARTS, "FrameDuration": DURATIONS})
    options = ["--frames", frames, "--isotope", "C11", "--blood", study / BLOOD, "--model", "1TCM", "--delay", "0"]
    assert "Its unit is not stated; it is taken to be in kBq/mL" in fit(petkin_command, scan, *options).out


def test_becquerels_are_converted(study: Path, petkin_command: Command) -> None:
    fit(petkin_command, study, "--model", "1TCM", "--out", study.parent / "kilo", "--delay", "0", "--level", "region")
    save(study / IMAGE, 1000 * image())
    change(study / SIDECAR_FILE, Units="Bq/mL")
    ran = fit(petkin_command, study, "--model", "1TCM", "--delay", "0", "--level", "region")
    assert "Blood is in kBq/mL, the image in Bq/mL" in ran.out
    kilo = pd.read_csv(study.parent / "kilo" / PET / "sub-01_seg-atlas_model-1TCM_kinpar.tsv", sep="\t")
    np.testing.assert_allclose(kinpar(study)[0]["K1"], kilo["K1"], rtol=1e-5)


def test_a_unit_that_is_off_by_a_thousand_is_named(study: Path, petkin_command: Command) -> None:
    save(study / IMAGE, 1000 * image())
    ran = fit(petkin_command, study, "--model", "1TCM", "--delay", "0")
    assert "a unit is almost certainly wrong" in ran.out


def test_odd_voxels_get_a_status(study: Path, petkin_command: Command) -> None:
    values = image().copy()
    values[1, 1, 1, 4], values[1, 2, 1] = np.nan, 0
    save(study / IMAGE, values)
    ran = fit(petkin_command, study, "--model", "1TCM", "--delay", "0")
    assert "1 voxels in the mask hold NaN or infinite values" in ran.out
    status = a_map(study, "desc-status")
    assert (status[1, 1, 1], status[1, 2, 1], status[1, 3, 1], status[0, 0, 0]) == (2, 3, 0, 1)
    assert np.isnan(a_map(study, "meas-K1")[1, 1:3, 1]).all()


def test_the_same_command_gives_the_same_bytes(
    study: Path, petkin_command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.undo()  # the report too
    runs = []
    for _ in range(2):
        assert petkin_command("fit", study, "--model", "1TCM", "--model", "Logan", "--t-star", "10").status == 0
        runs.append(tree(study))
    assert not differences(*runs)


def test_results_are_not_taken_for_data(study: Path, petkin_command: Command) -> None:
    """Curves that an earlier run wrote, and a simulation's truth, are no measurements."""
    noisefree = study / "derivatives/phantom" / PET / "sub-01_seg-atlas_desc-noisefree_tacs.tsv"
    dump(
        noisefree, "frame_start\tframe_end\ttruth\n" + "\n".join(f"{s}\t{s + d}\t1" for s, d in zip(STARTS, DURATIONS))
    )
    (study / DSEG).unlink()
    fit(petkin_command, study, "--model", "1TCM", "--delay", "0")
    assert not list((study / RESULTS).glob("*kinpar*"))
    assert list((study / RESULTS).glob("*mimap*"))


def test_graphical_models(exact: Path, petkin_command: Command) -> None:
    options = ["--model", "Patlak", "--model", "logan", "--model", "Logan", "--t-star", "15", "--delay", "0"]
    fit(petkin_command, exact, *options)
    logan, _ = kinpar(exact, "Logan")
    K1, k2 = rates()
    for label, found in zip((1, 4), logan["VT"], strict=True):
        assert found == pytest.approx((K1 / k2)[labels() == label].mean(), rel=0.02)
    patlak, sidecar = kinpar(exact, "Patlak")
    assert list(patlak.columns[:6]) == ["index", "name", "Ki", "Ki-se", "V0", "V0-se"]
    assert (sidecar["Ki"]["Units"], sidecar["V0"]["Units"]) == ("mL cm-3 min-1", "mL cm-3")
    assert sidecar["Settings"]["t_star"] == 15
    assert len(list((exact / RESULTS).glob("*model-Logan_kinpar.tsv"))) == 1


def test_multilinear_models(exact: Path, petkin_command: Command) -> None:
    """One-tissue curves: MA1 finds their VT, models of two tissues their K1."""
    options = ["--model", "MA1", "--model", "MA2", "--model", "LS2TCM", "--t-star", "15", "--delay", "0"]
    fit(petkin_command, exact, *options)
    K1, k2 = rates()
    expected = {"MA1": ("VT", K1 / k2), "MA2": ("K1", K1), "LS2TCM": ("K1", K1)}
    columns = {"MA1": "VT intercept", "MA2": "VT VS VND K1", "LS2TCM": "K1 k2 k3 k4 VT VB"}
    for label, (symbol, truth) in expected.items():
        table, sidecar = kinpar(exact, label)
        for region, found in zip((1, 4), table[symbol], strict=True):
            assert found == pytest.approx(truth[labels() == region].mean(), rel=0.01)
        assert all(sidecar[column]["Units"] and f"{column}-se" in table for column in columns[label].split())
        assert (exact / RESULTS / f"sub-01_model-{label}_meas-VT_mimap.nii.gz").exists()


def test_the_start_of_the_linear_part_is_told_by_regions_and_passed_to_voxels(
    study: Path, petkin_command: Command
) -> None:
    ran = fit(petkin_command, study, "--model", "MA1", "--t-star", "auto", "--delay", "0")
    assert "MA1" in ran.out
    _, sidecar = kinpar(study, "MA1")
    settings = sidecar["Settings"]
    assert settings["t_star_from"] == "curves"
    (maps,) = (study / RESULTS).glob("*model-MA1_meas-VT_mimap.json")
    assert json.loads(maps.read_text())["Settings"]["t_star"] == settings["t_star"]
    alone = study.parent / "alone"
    fit(petkin_command, study, "--model", "MA1", "--t-star", "auto", "--level", "voxel", "--delay", "0", "--out", alone)
    assert list(alone.rglob("*model-MA1_meas-VT_mimap.nii.gz"))
    refused = petkin_command("fit", study, "--model", "MA1", "--t-star", "soon")
    assert refused.status == 2
    assert "--t-star 'soon': 'soon' is not a finite number" in refused.err


def test_two_scans_and_their_choice(study: Path, petkin_command: Command) -> None:
    write_scan(study, "02")
    options = ["--model", "1TCM", "--level", "region", "--delay", "0"]
    fit(petkin_command, study, *options, "--subject", "sub-02", "--out", study.parent / "one")
    assert not (study.parent / "one" / "sub-01").exists()
    ran = fit(petkin_command, study, *options)
    lines = [line for line in ran.out.splitlines() if line.startswith("sub-0")]
    assert [line.split()[:3] for line in lines] == [["sub-01", "1TCM", "region"], ["sub-02", "1TCM", "region"]]
    assert max(map(len, ran.out.splitlines()[:3])) < 100
    assert ran.out.count("Report: ") == 2


def test_input_function_can_be_given_back(study: Path, petkin_command: Command) -> None:
    """What a fit wrote as its input serves as --blood, and gives the same answer."""
    fit(petkin_command, study, "--model", "1TCM", "--level", "region")
    first, _ = kinpar(study)
    written = study.parent / "input.tsv"
    written.write_text((study / RESULTS / "sub-01_inputfunction.tsv").read_text())
    fit(petkin_command, study, "--model", "1TCM", "--level", "region", "--blood", written, "--delay", "0")
    again, _ = kinpar(study)
    np.testing.assert_allclose(again["VT"], first["VT"], rtol=2e-3)
    np.testing.assert_allclose(again["K1"], first["K1"], rtol=5e-3)


def test_blood_that_ends_a_little_early_is_extended(study: Path, petkin_command: Command) -> None:
    dump(study / BLOOD, blood_text([0, 15, 30, 45, 60, 90, 120, 180, 300, 600, 1200, 1800, 2500]))
    ran = fit(petkin_command, study, "--model", "1TCM", "--level", "region", "--delay", "0")
    assert "Blood ends at 2500 s, 200 s before the last frame does; the input function is extrapolated" in ran.out
    curve = pd.read_csv(study / RESULTS / "sub-01_inputfunction.tsv", sep="\t").set_index("time")
    assert 0.7 < curve["AIF"][2700] / curve["AIF"][2500] < 0.95


def test_a_parameter_shared_by_regions(study: Path, petkin_command: Command) -> None:
    fit(petkin_command, study, "--level", "region", "--model", "1TCM", "--share", "k2", "--delay", 0)
    table = pd.read_csv(study / RESULTS / "sub-01_seg-atlas_model-1TCM_kinpar.tsv", sep="\t")
    assert table["k2"].nunique() == 1
    assert table["VT"].nunique() == 2
    settings = json.loads((study / RESULTS / "sub-01_seg-atlas_model-1TCM_kinpar.json").read_text())["Settings"]
    assert settings["shared"] == ["k2"]


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (("--share", "k7"), "'k7' cannot be shared over regions by 2TCM; K1, k2, k3, k4, vB, VND can."),
        (("--share", "k2", "--share", "k4"), "--share is given k2 and k4; one parameter can be shared at a time."),
        (("--share", "k4"), "--share k4 fits regions alone; add --level region."),
        (("--model", "SIMEVND"), "SIMEVND fits regions alone; add --level region."),
        (
            ("--share", "delay", "--delay", 5),
            "The delay is given (5 s) and to be shared; drop --delay or --share delay.",
        ),
    ],
)
def test_what_cannot_be_shared_is_told_in_a_line(
    study: Path, petkin_command: Command, options: tuple[object, ...], line: str
) -> None:
    ran = petkin_command("fit", study, *options)
    assert ran.status == 2
    assert line in ran.err


def test_a_delay_from_all_regions(study: Path, petkin_command: Command) -> None:
    fit(petkin_command, study, "--level", "region", "--model", "1TCM", "--share", "delay")
    sidecar = json.loads((study / RESULTS / "sub-01_seg-atlas_model-1TCM_kinpar.json").read_text())
    assert abs(sidecar["InputDelay"]) < 10.0
    assert sidecar["InputDelaySE"] > 0


def test_a_device_is_told_neither_in_sidecars_nor_to_what_is_finished(
    study: Path, petkin_command: Callable[..., Ran]
) -> None:
    arguments = ["fit", study, "--level", "voxel", "--model", "2TCM"]
    ran = petkin_command(*arguments, "--device", "cpu")
    assert (ran.status, ran.err) == (0, "")
    written = {path: path.stat().st_mtime_ns for path in (study / "derivatives").rglob("*") if path.is_file()}
    assert not any("--device" in path.read_text() for path in written if path.suffix == ".json")
    assert petkin_command(*arguments).status == 0
    assert {path: path.stat().st_mtime_ns for path in written} == written
