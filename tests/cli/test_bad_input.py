"""Bad input ends in one clear line, exit status 2, and nothing written: each case runs the command itself."""

from __future__ import annotations

import gzip
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from .conftest import Ran
from .tiny_study import (
    AFFINE,
    ATLAS,
    BLOOD,
    DSEG,
    DURATIONS,
    IMAGE,
    SIDECAR_FILE,
    STARTS,
    blood_text,
    change,
    dump,
    image,
    labels,
    save,
    tree,
    write_scan,
)

Command = Callable[..., Ran]
Spoil = Callable[[Path], object]


def refuse(ran: Ran, *phrases: str) -> None:
    """One line on standard error, nothing on standard output, status 2."""
    assert ran.status == 2, ran
    assert ran.out == ""
    assert ran.err.startswith("petkin: ")
    assert ran.err.count("\n") == 1, ran.err
    assert ran.err.endswith("\n")
    assert "Traceback" not in ran.err
    for phrase in phrases:
        assert phrase in ran.err


def refused_and_unchanged(command: Command, root: Path, arguments: list[object], *phrases: str) -> None:
    """The command is refused and leaves not one file or folder behind, not even a temporary one."""
    before = tree(root)
    refuse(command(*arguments), *phrases)
    assert tree(root) == before


def _truncate(root: Path) -> None:
    path = root / IMAGE
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def _frames(root: Path, **frames: list[float]) -> None:
    change(root / SIDECAR_FILE, **frames)


def _with(values: list[int], index: int, value: float) -> list[float]:
    return [*values[:index], value, *values[index + 1 :]]


STUDIES: dict[str, tuple[Spoil, tuple[str, ...]]] = {
    "missing-field": (
        lambda root: change(root / SIDECAR_FILE, Units=None),
        ("sub-01_pet.json", "Units is missing", "add it"),
    ),
    "wrong-unit": (lambda root: change(root / SIDECAR_FILE, Units="g/mL"), ("sub-01_pet.json: Units", "'g/mL'", "use")),
    "nan-in-frame-times": (
        lambda root: _frames(root, FrameTimesStart=_with(STARTS, 3, float("nan"))),
        ("sub-01_pet.json", "FrameTimesStart[3] is nan"),
    ),
    "zero-duration": (
        lambda root: _frames(root, FrameDuration=_with(DURATIONS, 2, 0)),
        ("FrameDuration[2] is 0 s", "longer than 0 s"),
    ),
    "negative-duration": (
        lambda root: _frames(root, FrameDuration=_with(DURATIONS, 5, -300)),
        ("FrameDuration[5] is -300 s",),
    ),
    "overlapping-frames": (
        lambda root: _frames(root, FrameTimesStart=_with(STARTS, 4, 240)),
        ("frame 5 starts at 240 s but frame 4 ends at 300 s", "check FrameTimesStart"),
    ),
    "times-in-minutes": (
        lambda root: _frames(root, FrameTimesStart=[s / 60 for s in STARTS], FrameDuration=[d / 60 for d in DURATIONS]),
        ("looks like minutes", "multiply them by 60"),
    ),
    "fewer-times-than-frames": (
        lambda root: _frames(root, FrameTimesStart=STARTS[:-1], FrameDuration=DURATIONS[:-1]),
        ("holds 12 frames", "lists 11", "must agree"),
    ),
    "unknown-nuclide": (lambda root: change(root / SIDECAR_FILE, TracerRadionuclide="Xx9"), ("'Xx9'",)),
    "truncated-gzip": (_truncate, ("sub-01_pet.nii.gz", "truncated", "copy it again")),
    "not-a-gzip": (
        lambda root: (root / IMAGE).write_bytes(gzip.decompress((root / IMAGE).read_bytes())),
        ("is named .gz but is not a gzip file",),
    ),
    "no-image-at-all": (lambda root: (root / IMAGE).write_bytes(gzip.compress(b"x" * 9000)), ("not a NIfTI image",)),
    "three-dimensions": (lambda root: save(root / IMAGE, image()[..., 0]), ("has 3 dimensions",)),
    "dseg-of-another-shape": (
        lambda root: save(root / DSEG, labels()[:, :, :3]),
        ("is 6 x 6 x 3 voxels", "6 x 6 x 4", "resample it"),
    ),
    "dseg-off-the-grid": (
        lambda root: save(root / DSEG, labels(), AFFINE + np.array([[0, 0, 0, 5.0], *[[0.0] * 4] * 3])),
        ("5 mm off the grid", "resample it"),
    ),
    "dseg-without-label": (lambda root: save(root / DSEG, 0 * labels()), ("no label above 0",)),
    "dseg-of-fractions": (lambda root: save(root / DSEG, labels() * np.float32(0.5)), ("not integers",)),
    "no-value-is-finite": (
        lambda root: save(root / IMAGE, np.full_like(image(), np.nan)),
        ("sub-01_pet.nii.gz", "no voxel in the mask holds finite values"),
    ),
    "no-activity": (lambda root: save(root / IMAGE, 0 * image()), ("nowhere above zero",)),
    "blood-shorter-than-the-scan": (
        lambda root: dump(root / BLOOD, blood_text([0, 15, 30, 45, 60, 120, 300, 600])),
        ("blood ends at 600 s but the last frame ends at 2700 s", "add samples"),
    ),
    "blood-in-minutes": (
        lambda root: dump(root / BLOOD, blood_text().replace("\n2700\t", "\n45\t").replace("\n1800\t", "\n30.5\t")),
        ("blood ends at 1200 s",),
    ),
    "blood-without-unit": (
        lambda root: change(root / BLOOD.with_suffix(".json"), plasma_radioactivity={}),
        ("plasma_radioactivity.Units is missing", "state the unit"),
    ),
    "blood-without-json": (lambda root: (root / BLOOD.with_suffix(".json")).unlink(), ("_blood.json", "is missing")),
    "blood-without-time": (
        lambda root: dump(root / BLOOD, blood_text().replace("time", "when")),
        ("no column 'time'",),
    ),
    "blood-with-text": (
        lambda root: dump(root / BLOOD, blood_text().replace("\n45\t60\t", "\n45\tclotted\t")),
        ("column 'plasma_radioactivity', row 4 holds 'clotted'", "n/a"),
    ),
    "fraction-in-percent": (
        lambda root: dump(root / BLOOD, blood_text().replace("\t0.4298", "\t42.98").replace("\t1\n", "\t100\n")),
        ("is a fraction between 0 and 1", "percent"),
    ),
    "no-parent-at-all": (
        lambda root: dump(root / BLOOD, re.sub(r"\t[\d.]+\n", "\t0\n", blood_text())),
        ("metabolite_parent_fraction is 0 in every row", "--parent-fraction none"),
    ),
    "no-blood": (
        lambda root: [path.unlink() for path in (root / BLOOD).parent.glob("*_blood.*")],
        ("there is no blood", "give --blood"),
    ),
    "not-json": (lambda root: dump(root / SIDECAR_FILE, '{"Units": '), ("not valid JSON, line 1",)),
    "no-scan": (
        lambda root: [path.unlink() for path in (root / SIDECAR_FILE).parent.iterdir()],
        ("no PET scan found",),
    ),
}


@pytest.mark.parametrize("name", STUDIES)
def test_study_that_cannot_be_fitted(study: Path, petkin_command: Command, name: str) -> None:
    spoil, phrases = STUDIES[name]
    spoil(study)
    refused_and_unchanged(petkin_command, study.parent, ["fit", study, "--model", "1TCM"], *phrases)


OPTIONS: dict[str, tuple[list[object], tuple[str, ...]]] = {
    "model": (["--model", "3TCM"], ("no model '3TCM'", "1TCM, 2TCM")),
    "level": (["--level", "brain"], ("--level is 'brain'", "both, region, voxel")),
    "bounds-upside-down": (["--bounds", "K1=2:1"], ("Bounds of K1 are 2 to 1",)),
    "bounds-of-nothing": (["--bounds", "K1"], ("--bounds 'K1'", "SYMBOL=LOWER:UPPER")),
    "bounds-of-another-model": (["--model", "1TCM", "--bounds", "k4=0:1"], ("'k4' is no parameter of 1TCM",)),
    "bounds-infinite": (["--bounds", "K1=0:inf"], ("'inf' is not a finite number",)),
    "fix-too-large": (["--fix", "vB=1.5"], ("vB cannot be fixed at 1.5",)),
    "bounds-of-a-fraction": (["--bounds", "vB=0:3"], ("Bounds of vB reach 3",)),
    "fix-text": (["--fix", "vB=little"], ("'little' is not a finite number",)),
    "fix-no-symbol": (["--fix", "0.05"], ("SYMBOL=VALUE",)),
    "fix-and-bounds": (["--fix", "vB=0.05", "--bounds", "vB=0:0.1"], ("vB is given to --fix and to --bounds",)),
    "delay-text": (["--delay", "soon"], ("--delay 'soon'",)),
    "delay-of-another-unit": (["--delay", "30000"], ("--delay is 30000 s", "give seconds")),
    "rates": (["--rates", "5:1"], ("Rates from 5 to 1 per min are no interval",)),
    "device": (["--device", "cuda:99"], ("--device cuda:99: torch sees no such device",)),
    "rates-one": (["--rates", "5"], ("--rates '5'", "LOWER:UPPER")),
    "t-star": (["--model", "Logan", "--t-star", "44"], ("lie after t* = 44 min", "choose an earlier --t-star")),
    "t-star-nan": (["--t-star", "nan"], ("--t-star 'nan'", "not a finite number")),
    "weights": (["--weights", "uniform"], ("--weights 'uniform'", "counting or constant")),
    "observation": (["--observation", "end"], ("--observation is 'end'",)),
    "parent-fraction": (["--parent-fraction", "spline"], ("--parent-fraction is 'spline'", "hill")),
    "plasma-from": (["--plasma-from", "serum"], ("--plasma-from is 'serum'",)),
    "dispersion": (["--dispersion", "-2"], ("--dispersion is -2",)),
    "dispersion-of-nothing": (["--dispersion", "3"], ("no autosampler to correct",)),
    "subject": (["--subject", "99"], ("no PET scan of 99 found",)),
    "session": (["--session", "late"], ("no scan of session late",)),
    "seg": (["--seg", "lobes"], ("'lobes'", "there is atlas")),
    "isotope-of-a-study": (["--isotope", "F18"], ("--isotope is for an image outside BIDS",)),
}


@pytest.mark.parametrize("name", OPTIONS)
def test_option_that_cannot_be(study: Path, petkin_command: Command, name: str) -> None:
    arguments, phrases = OPTIONS[name]
    refused_and_unchanged(petkin_command, study.parent, ["fit", study, *arguments], *phrases)


def test_empty_mask(study: Path, petkin_command: Command) -> None:
    mask = save(study.parent / "mask.nii.gz", 0 * labels())
    refused_and_unchanged(
        petkin_command, study.parent, ["fit", study, "--mask", mask], "mask.nii.gz: the mask is empty"
    )


def test_mask_without_image(study: Path, petkin_command: Command) -> None:
    table = _tacs(study)
    (study / IMAGE).unlink()
    mask = save(study.parent / "mask.nii.gz", labels())
    arguments: list[object] = ["fit", study, "--mask", mask, "--tacs", table]
    refused_and_unchanged(petkin_command, study.parent, arguments, "--mask lies on an image and there is none")


def test_voxels_without_image(study: Path, petkin_command: Command) -> None:
    dump(study / ATLAS / "sub-01_seg-rois_tacs.tsv", _tacs(study).read_text())
    (study / IMAGE).unlink()
    refused_and_unchanged(
        petkin_command, study.parent, ["fit", study, "--level", "voxel"], "no image to fit by voxel", "--level region"
    )


def test_curves_of_other_frames_than_the_image(study: Path, petkin_command: Command) -> None:
    (study / DSEG).unlink()
    short, late = _tacs(study, rows=11), _tacs(study, shift_s=20)
    refused_and_unchanged(
        petkin_command, study.parent, ["fit", study, "--tacs", short], "has 11 frames but the image has 12"
    )
    refused_and_unchanged(
        petkin_command, study.parent, ["fit", study, "--tacs", late], "differ by up to 20 s", "--level region"
    )


def _tacs(study: Path, rows: int = 12, shift_s: float = 0) -> Path:
    lines = [
        f"{s + shift_s}\t{s + d + shift_s}\t{10 + s / 100}"
        for s, d in zip(STARTS[:rows], DURATIONS[:rows], strict=True)
    ]
    path = study.parent / f"rois{rows}-{shift_s}_tacs.tsv"
    dump(path.with_suffix(".json"), {"Units": "kBq/mL"})
    return dump(path, "\n".join(["frame_start\tframe_end\tcortex", *lines]) + "\n")


@pytest.mark.parametrize("where", ["file", "below-a-file", "/proc/petkin", "/proc/no/such/petkin"])
def test_output_that_cannot_be_written(study: Path, petkin_command: Command, where: str) -> None:
    """As root every folder can be written, so a file stands where a folder is due, or /proc."""
    taken = dump(study.parent / "taken", "mine")
    out = {"file": taken, "below-a-file": taken / "results"}.get(where, Path(where))
    refused_and_unchanged(
        petkin_command, study.parent, ["fit", study, "--out", out], "choose another output folder", str(out)[:8]
    )
    refused_and_unchanged(petkin_command, study.parent, ["tacs", study, "--out", out], "choose another output folder")


def test_results_never_replace_a_raw_data_set(study: Path, petkin_command: Command) -> None:
    refused_and_unchanged(petkin_command, study.parent, ["fit", study, "--out", study], "holds another dataset")


def test_blood_of_the_last_scan_is_read_before_the_first_is_fitted(study: Path, petkin_command: Command) -> None:
    write_scan(study, "02")
    dump(study / str(BLOOD).replace("01", "02"), blood_text([0, 15, 30, 45, 60, 120, 300, 600]))
    refused_and_unchanged(petkin_command, study.parent, ["fit", study], "sub-02_recording-manual_blood.tsv", "600 s")


def test_blood_for_one_of_two_scans(study: Path, petkin_command: Command) -> None:
    write_scan(study, "02")
    arguments: list[object] = ["fit", study, "--blood", study / BLOOD]
    refused_and_unchanged(petkin_command, study.parent, arguments, "--blood belongs to one scan but there are 2")


PLAIN: dict[str, tuple[list[str], tuple[str, ...]]] = {
    "no-frames": (["--isotope", "C11"], ("give --frames",)),
    "no-isotope": (["--frames", "frames.tsv"], ("give --isotope",)),
    "unknown-isotope": (["--frames", "frames.tsv", "--isotope", "C12"], ("'C12'",)),
    "two-isotopes": (["--frames", "pet.json", "--isotope", "F18"], ("--isotope is F18", "says C11")),
    "two-units": (["--frames", "pet.json", "--units", "Bq/mL"], ("--units is Bq/mL", "says kBq/mL")),
    "unknown-unit": (["--frames", "frames.tsv", "--isotope", "C11", "--units", "SUV"], ("--units: unit 'SUV'",)),
    "no-blood": (["--frames", "pet.json"], ("there is no blood", "give --blood")),
    "nan-frames": (["--frames", "nan.tsv", "--isotope", "C11"], ("nan.tsv", "missing in row 2")),
    "no-such-frames": (["--frames", "absent.tsv", "--isotope", "C11"], ("absent.tsv", "No such file")),
    "subject-of-a-file": (["--frames", "pet.json", "--subject", "01"], ("--subject chooses within a study",)),
}


@pytest.mark.parametrize("name", PLAIN)
def test_plain_image_with_half_of_what_it_needs(
    study: Path, petkin_command: Command, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    folder = study.parent
    monkeypatch.chdir(folder)
    (folder / "image.nii.gz").write_bytes((study / IMAGE).read_bytes())
    dump(folder / "pet.json", json.loads((study / SIDECAR_FILE).read_text()))
    rows = [f"{s}\t{s + d}" for s, d in zip(STARTS, DURATIONS, strict=True)]
    dump(folder / "frames.tsv", "\n".join(["frame_start\tframe_end", *rows]) + "\n")
    dump(folder / "nan.tsv", "\n".join(["frame_start\tframe_end", rows[0], "n/a\t60", *rows[2:]]) + "\n")
    arguments, phrases = PLAIN[name]
    refused_and_unchanged(petkin_command, folder, ["fit", "image.nii.gz", *arguments], *phrases)


SIMULATED: dict[str, tuple[list[str], tuple[str, ...]]] = {
    "frames": (["--frames", "12 by 10"], ("12 by 10",)),
    "no-frames": (["--frames", "0"], ("0",)),
    "isotope": (["--isotope", "C12"], ("'C12'",)),
    "effect": (["--effect", "gravity=1"], ("gravity",)),
    "effect-of-text": (["--effect", "dispersion=much"], ("dispersion=much",)),
    "model": (["--model", "9TCM"], ("9TCM",)),
    "phantom": (["--phantom", "lung"], ("lung",)),
    "roi": (["--roi", "7"], ("7",)),
    "noise": (["--noise", "-1"], ("--noise",)),
    "preset": (["--preset", "paperback"], ("--preset",)),
}


@pytest.mark.parametrize("name", SIMULATED)
def test_simulation_that_cannot_be(tmp_path: Path, petkin_command: Command, name: str) -> None:
    arguments, phrases = SIMULATED[name]
    refused_and_unchanged(petkin_command, tmp_path, ["simulate", *arguments, "--out", tmp_path / "s"], *phrases)


@pytest.mark.parametrize("verb", ["simulate", "demo"])
def test_a_study_is_never_overwritten(tmp_path: Path, petkin_command: Command, verb: str) -> None:
    dump(tmp_path / "mine" / "notes.txt", "years of work")
    refused_and_unchanged(petkin_command, tmp_path, [verb, "--out", tmp_path / "mine"], "mine is not empty")


@pytest.mark.parametrize("verb", ["fit", "tacs", "info"])
def test_nothing_there(tmp_path: Path, petkin_command: Command, verb: str) -> None:
    refused_and_unchanged(petkin_command, tmp_path, [verb, tmp_path / "absent"], "absent: no such f")


def test_curves_without_segmentation(study: Path, petkin_command: Command) -> None:
    (study / DSEG).unlink()
    refused_and_unchanged(petkin_command, study.parent, ["tacs", study], "--dseg")


PROCESSES: dict[str, tuple[Spoil, list[str], tuple[str, ...]]] = {
    "truncated-gzip": (_truncate, [], ("truncated",)),
    "overlapping-frames": (*STUDIES["overlapping-frames"][:1], [], ("frames must not overlap",)),
    "blood-shorter": (*STUDIES["blood-shorter-than-the-scan"][:1], [], ("blood ends at 600 s",)),
    "unwritable": (lambda root: None, ["--out", "/proc/petkin"], ("cannot be written",)),
    "no-finite-value": (*STUDIES["no-value-is-finite"][:1], [], ("no voxel in the mask holds finite values",)),
}


@pytest.mark.parametrize("name", PROCESSES)
def test_as_a_process(study: Path, petkin_process: Command, name: str) -> None:
    spoil, options, phrases = PROCESSES[name]
    spoil(study)
    refused_and_unchanged(petkin_process, study.parent, ["fit", study, "--model", "1TCM", *options], *phrases)


def test_usage_errors_have_no_traceback(study: Path, petkin_process: Command) -> None:
    ran = petkin_process("fit", study, "--modle", "2TCM")
    assert ran.status == 2
    assert "--modle" in ran.err
    assert "Traceback" not in ran.err


def test_an_ensemble_of_hybrids_is_whole_or_refused(study: Path, petkin_command: Command) -> None:
    ask: list[object] = ["diagnose", study, "--model", "1tcm"]
    few = [*ask, "--checkpoint", "a.safetensors", "--checkpoint", "b.safetensors"]
    refused_and_unchanged(petkin_command, study, few, "2 of at least 5")
    text = [word for _ in range(5) for word in ("--checkpoint", study / SIDECAR_FILE)]
    refused_and_unchanged(petkin_command, study, [*ask, *text], "not a checkpoint of petkin")
    refused_and_unchanged(petkin_command, study, ["diagnose", study, *text], "use --model 1tcm")
