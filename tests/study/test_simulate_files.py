"""What a simulated study holds on disk: valid PET-BIDS, complete truth, the same bytes every time."""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
import sys
from pathlib import Path

import nibabel as nib
import numpy as np
import pandas as pd
import pytest
from typer import Typer
from typer.testing import CliRunner

from petkin.cli.simulate import simulate as command
from petkin.errors import InputError
from petkin.io import read_study
from petkin.study.simulate import simulate
from petkin.study.simulation import SimulationSettings, read_settings

#: PET-BIDS 1.10, required fields of `_pet.json`.
REQUIRED = """
    Manufacturer ManufacturersModelName Units TracerName TracerRadionuclide InjectedRadioactivity
    InjectedRadioactivityUnits InjectedMass InjectedMassUnits SpecificRadioactivity SpecificRadioactivityUnits
    ModeOfAdministration TimeZero ScanStart InjectionStart FrameTimesStart FrameDuration AcquisitionMode
    ImageDecayCorrected ImageDecayCorrectionTime ReconMethodName ReconMethodParameterLabels ReconMethodParameterUnits
    ReconMethodParameterValues ReconFilterType ReconFilterSize AttenuationCorrection
"""


def digest(folder: Path) -> dict[str, str]:
    return {
        str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in sorted(folder.rglob("*"))
        if p.is_file()
    }


def small(out: Path, **options: object) -> SimulationSettings:
    return SimulationSettings(out=out, voxel_size=7.0, frames="4x30,3x120,2x600", **options)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    settings = small(tmp_path_factory.mktemp("sim") / "study", subjects=2, sessions=2, truth_tacs=True, blood_noise=3)
    return simulate(settings)


def test_every_contracted_file_is_there(study: Path) -> None:
    found = digest(study).keys()
    for sub in ("01", "02"):
        for ses in ("01", "02"):
            start = f"sub-{sub}/ses-{ses}/pet/sub-{sub}_ses-{ses}"
            raw = ["pet.nii.gz", "pet.json"]
            raw += [f"recording-{kind}_blood.{ext}" for kind in ("manual", "autosampler") for ext in ("tsv", "json")]
            truth = [f"seg-phantom_dseg.{ext}" for ext in ("nii.gz", "tsv", "json")]
            truth += [f"seg-phantom_model-2TCM_desc-truth_kinpar.{ext}" for ext in ("tsv", "json")]
            truth += [f"seg-phantom_desc-noisefree_tacs.{ext}" for ext in ("tsv", "json")]
            truth += [
                f"model-2TCM_meas-{m}_desc-truth_mimap.{ext}"
                for m in ("K1", "k2", "k3", "k4", "VB", "VT", "VND", "BPND", "Ki")
                for ext in ("nii.gz", "json")
            ]
            assert {f"{start}_{name}" for name in raw} <= found
            assert {f"derivatives/phantom/{start}_{name}" for name in [*truth, "desc-truth_report.json"]} <= found
    top = {"dataset_description.json", "participants.tsv", "participants.json", "README"}
    assert top | {"derivatives/phantom/dataset_description.json"} <= found


def test_sidecar_has_all_required_fields_and_right_decay_factors(study: Path) -> None:
    fields = json.loads((study / "sub-01/ses-01/pet/sub-01_ses-01_pet.json").read_text())
    assert not [name for name in REQUIRED.split() if name not in fields]
    assert fields["TracerRadionuclide"] == "F18"
    start, duration = np.array(fields["FrameTimesStart"]), np.array(fields["FrameDuration"])
    rate = np.log(2) / (109.77 * 60)
    expected = rate * duration / (1 - np.exp(-rate * duration)) * np.exp(rate * start)
    np.testing.assert_allclose(fields["DecayCorrectionFactor"], expected, rtol=1e-8)
    assert "effect" not in json.dumps(fields).lower()


def test_image_grid_and_labels_agree(study: Path) -> None:
    image = nib.load(study / "sub-01/ses-02/pet/sub-01_ses-02_pet.nii.gz")
    truth = study / "derivatives/phantom/sub-01/ses-02/pet"
    labels = nib.load(truth / "sub-01_ses-02_seg-phantom_dseg.nii.gz")
    assert image.shape == (32, 32, 1, 9)
    assert image.get_data_dtype() == np.float32
    np.testing.assert_array_equal(image.affine, labels.affine)
    table = pd.read_csv(truth / "sub-01_ses-02_seg-phantom_dseg.tsv", sep="\t")
    assert set(table["index"]) == set(np.unique(np.asarray(labels.dataobj))) - {0}
    VT = np.asarray(nib.load(truth / "sub-01_ses-02_model-2TCM_meas-VT_desc-truth_mimap.nii.gz").dataobj)
    kinpar = pd.read_csv(truth / "sub-01_ses-02_seg-phantom_model-2TCM_desc-truth_kinpar.tsv", sep="\t")
    for row in kinpar.itertuples():
        np.testing.assert_allclose(VT[np.asarray(labels.dataobj) == row.index], row.VT, rtol=1e-6)


def test_blood_is_sampled_as_a_laboratory_does(study: Path) -> None:
    folder = study / "sub-02/ses-01/pet"
    manual = pd.read_csv(folder / "sub-02_ses-01_recording-manual_blood.tsv", sep="\t", na_values="n/a")
    auto = pd.read_csv(folder / "sub-02_ses-01_recording-autosampler_blood.tsv", sep="\t", na_values="n/a")
    assert auto["time"].tolist() == list(range(601))
    assert manual.columns[0] == "time"
    assert manual["time"].iloc[-1] == 1680  # the end of the scan
    assert 0 < manual["metabolite_parent_fraction"].notna().sum() < len(manual)
    assert manual["metabolite_parent_fraction"].dropna().between(0, 1).all()
    assert manual["plasma_radioactivity"].notna().all()
    fields = json.loads((folder / "sub-02_ses-01_recording-manual_blood.json").read_text())
    assert fields["PlasmaAvail"] is fields["MetaboliteAvail"] is fields["WholeBloodAvail"] is True
    assert fields["plasma_radioactivity"]["Units"] == "kBq/mL"


def test_blood_without_noise_lies_on_the_curve(tmp_path: Path) -> None:
    folder = simulate(small(tmp_path / "s")) / "sub-01/pet"
    manual = pd.read_csv(folder / "sub-01_recording-manual_blood.tsv", sep="\t", na_values="n/a")
    np.testing.assert_allclose(manual["whole_blood_radioactivity"] / manual["plasma_radioactivity"], 0.75, rtol=1e-6)
    s = manual["time"] / 60
    expected = 0.7 * np.exp(-0.08 * s) + 0.3 * np.exp(-0.004 * s)
    measured = manual["metabolite_parent_fraction"]
    np.testing.assert_allclose(measured.dropna(), expected[measured.notna()], rtol=1e-5)


def test_a_dispersed_line_is_stated_and_later(tmp_path: Path) -> None:
    name = "sub-01/pet/sub-01_recording-autosampler_blood"
    sharp, smeared = (simulate(small(tmp_path / str(tau), sampler_dispersion=tau)) for tau in (0.0, 6.0))
    assert json.loads((sharp / f"{name}.json").read_text())["DispersionCorrected"] is True
    fields = json.loads((smeared / f"{name}.json").read_text())
    assert fields["DispersionCorrected"] is False
    assert fields["DispersionConstant"] == 6.0
    curves = [pd.read_csv(s / f"{name}.tsv", sep="\t") for s in (sharp, smeared)]
    peaks = [c["time"][c["whole_blood_radioactivity"].idxmax()] for c in curves]
    assert peaks[1] > peaks[0]
    assert curves[1]["whole_blood_radioactivity"].max() < 0.95 * curves[0]["whole_blood_radioactivity"].max()


def test_no_metabolites_no_fraction(tmp_path: Path) -> None:
    folder = simulate(small(tmp_path / "s", tracer="fdg")) / "sub-01/pet"
    assert "metabolite_parent_fraction" not in (folder / "sub-01_recording-manual_blood.tsv").read_text()
    assert json.loads((folder / "sub-01_recording-manual_blood.json").read_text())["MetaboliteAvail"] is False


def test_retest_differs_a_little_and_subjects_more(study: Path) -> None:
    def VT(sub: str, ses: str) -> np.ndarray:
        place = study / f"derivatives/phantom/sub-{sub}/ses-{ses}/pet"
        return pd.read_csv(next(place.glob("*_kinpar.tsv")), sep="\t")["VT"].to_numpy()

    assert 0 < np.abs(np.log(VT("01", "01") / VT("01", "02"))).max() < 0.5
    assert not np.allclose(VT("01", "01"), VT("02", "01"))


def test_same_seed_same_bytes_and_subjects_stand_alone(study: Path, tmp_path: Path) -> None:
    again = simulate(small(tmp_path / "again", subjects=2, sessions=2, truth_tacs=True, blood_noise=3))
    assert digest(again) == digest(study)
    more = simulate(small(tmp_path / "more", subjects=3, sessions=2, truth_tacs=True, blood_noise=3))
    alone = {name: d for name, d in digest(study).items() if "sub-0" in name}
    assert alone.items() <= digest(more).items()
    other = simulate(small(tmp_path / "other", subjects=2, sessions=2, seed=1))
    image = "sub-01/ses-01/pet/sub-01_ses-01_pet.nii.gz"
    assert digest(other)[image] != digest(study)[image]


def test_the_reader_takes_the_study_without_a_complaint(study: Path) -> None:
    read = read_study(study)
    assert len(read.scans) == 4
    for scan in read.scans:
        assert [d.seg for d in scan.dseg] == ["phantom"]
        assert scan.blood is not None
        said = " ".join(str(remark) for remark in scan.remarks)
        assert "negative" not in said
        assert "DecayCorrectionFactor" not in said


def test_the_paper_preset_says_what_decay_it_holds(tmp_path: Path) -> None:
    out = simulate(SimulationSettings(out=tmp_path / "s", preset="paper"))
    fields = json.loads((out / "sub-01/pet/sub-01_pet.json").read_text())
    assert fields["RadionuclideHalfLife"] == pytest.approx(110 * np.log(2) * 60)
    assert fields["ImageDecayCorrected"] is False
    assert len(fields["FrameDuration"]) == 80


def test_frames_come_from_a_file(tmp_path: Path) -> None:
    table = tmp_path / "frames.tsv"
    table.write_text("frame_start\tframe_end\n0\t30\n30\t90\n150\t300\n")
    out = simulate(SimulationSettings(out=tmp_path / "s", frames=str(table)))
    fields = json.loads((out / "sub-01/pet/sub-01_pet.json").read_text())
    assert fields["FrameTimesStart"] == [0.0, 30.0, 150.0]
    assert fields["FrameDuration"] == [30.0, 60.0, 150.0]


def test_a_whole_brain_with_all_options(tmp_path: Path) -> None:
    out = simulate(
        SimulationSettings(
            out=tmp_path / "s", roi=16, voxel_size=8.0, frames="6x300", isotope="11C", psf=7.0, noise_fwhm=8.0,
            noise_common=0.3, voxel_spread=True, effects=("dispersion=4", "blood_volume=0.06"),
        )
    )  # fmt: skip
    fields = json.loads((out / "sub-01/pet/sub-01_pet.json").read_text())
    assert fields["TracerRadionuclide"] == "C11"
    assert fields["RadionuclideHalfLife"] == pytest.approx(20.364 * 60)
    truth = out / "derivatives/phantom/sub-01/pet"
    K1 = np.asarray(nib.load(truth / "sub-01_model-2TCM_meas-K1_desc-truth_mimap.nii.gz").dataobj)
    labels = np.asarray(nib.load(truth / "sub-01_seg-phantom_dseg.nii.gz").dataobj)
    assert np.log(K1[labels == 6]).std() == pytest.approx(0.08, rel=0.2)
    VB = np.asarray(nib.load(truth / "sub-01_model-2TCM_meas-VB_desc-truth_mimap.nii.gz").dataobj)
    np.testing.assert_allclose(VB[labels > 0], 0.06, rtol=1e-6)


def test_progress_counts_every_frame(tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    simulate(small(tmp_path / "s", subjects=2), advance=lambda done, total: told.append((done, total)))
    assert told == [(k, 18) for k in range(1, 19)]


def test_an_occupied_folder_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("keep")
    with pytest.raises(InputError, match="is not empty; give --out a new folder"):
        simulate(small(tmp_path))
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]


def test_an_empty_folder_may_be_given(tmp_path: Path) -> None:
    assert (simulate(small(tmp_path)) / "participants.tsv").is_file()


def test_a_run_that_dies_leaves_nothing(tmp_path: Path) -> None:
    def die(done: int, total: int) -> None:
        if done == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate(small(tmp_path / "s"), advance=die)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"roi": 7}, "no phantom has that many"),
        ({"roi": 5, "phantom": "brain3d"}, "has 16 regions; drop one"),
        ({"tracer": "fdg", "model": "2TCM"}, "use 2TCM3k"),
        ({"effects": ("second_tissue",)}, "has a second compartment already"),
        ({"effects": ("blood_volume=7",)}, "5 percent is 0.05"),
        ({"frames": "absent.tsv"}, "absent.tsv"),
        ({"isotope": "C12"}, "has no half-life here"),
        ({"model": "9TCM"}, "9TCM"),
        ({"voxel_spread": True, "subsamples": 2}, "one subsample"),
        ({"voxel_size": 60.0}, "leave no voxel for"),
    ],
)
def test_what_cannot_be_simulated_is_refused_and_leaves_nothing(
    tmp_path: Path, options: dict[str, object], message: str
) -> None:
    with pytest.raises(InputError, match=message) as error:
        simulate(SimulationSettings(out=tmp_path / "s", **options))  # type: ignore[arg-type]
    assert "\n" not in str(error.value)
    assert list(tmp_path.iterdir()) == []


def test_early_frames_are_refused(tmp_path: Path) -> None:
    table = tmp_path / "frames.tsv"
    table.write_text("frame_start\tframe_end\n-30\t0\n0\t60\n")
    with pytest.raises(InputError, match="starts before injection"):
        simulate(SimulationSettings(out=tmp_path / "s", frames=str(table)))


@pytest.mark.parametrize(
    "option", [{"subjects": 0}, {"noise": -1.0}, {"preset": "ideal"}, {"units": "uCi"}, {"out": 3}]
)
def test_options_out_of_range_name_themselves(option: dict[str, object]) -> None:
    with pytest.raises(InputError, match=f"--{next(iter(option))}"):
        read_settings(**({"out": Path("x")} | option))


def test_the_command_simulates(tmp_path: Path) -> None:
    app = Typer()
    app.command()(command)
    result = CliRunner().invoke(
        app,
        ["--roi", "5", "--frames", "80", "--out", str(tmp_path / "s"), "--effect", "arterial_delay=5", "--psf", "5"],
    )
    assert result.exit_code == 0, result.output
    image = nib.load(tmp_path / "s/sub-01/pet/sub-01_pet.nii.gz")
    assert image.shape == (64, 64, 1, 80)
    assert "Wrote 1 scan" in result.output


def test_the_module_of_the_command_is_light() -> None:
    heavy = (
        "import sys, petkin.cli.simulate; print({'torch', 'numpy', 'pandas', 'nibabel', 'scipy'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", heavy], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


@pytest.mark.skipif(
    shutil.which("bids-validator-deno", path=Path(sys.executable).parent) is None,
    reason="the BIDS validator is not installed",
)
@pytest.mark.parametrize("options", [{"subjects": 2, "sessions": 2}, {"preset": "paper"}, {"tracer": "fdg"}])
def test_the_bids_validator_finds_no_error(tmp_path: Path, options: dict[str, object]) -> None:
    out = simulate(SimulationSettings(out=tmp_path / "s", sampler_dispersion=2.5, **options))  # type: ignore[arg-type]
    program = shutil.which("bids-validator-deno", path=Path(sys.executable).parent)
    done = subprocess.run(
        [str(program), "--format", "json", str(out)], capture_output=True, text=True, timeout=60, check=False
    )
    issues = json.loads(done.stdout)["issues"]["issues"]
    errors = [(i["code"], i.get("subCode"), i.get("location")) for i in issues if i["severity"] == "error"]
    assert errors == []
    assert len(issues) > 0  # it looked: recommended fields are missing
