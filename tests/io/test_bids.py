from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from petkin.errors import InputError
from petkin.io.bids import Study, read_study

Write = Callable[[Path, Any], Path]
PET = "sub-01/pet/sub-01_"
DERIVED = "derivatives/segmented/sub-01/pet/sub-01_"


def change(path: Path, **fields: Any) -> None:
    """Change fields of a JSON; None removes one."""
    content = {**json.loads(path.read_text()), **fields}
    path.write_text(json.dumps({key: value for key, value in content.items() if value is not None}))


def codes(root: Path) -> set[str]:
    return {remark.code for scan in read_study(root).scans for remark in scan.remarks}


def test_all_that_belongs_to_a_scan_is_found(study: Path) -> None:
    read = read_study(study)
    (scan,) = read.scans
    assert (read.name, read.remarks, read.refused) == ("tiny", (), ())
    assert (scan.subject, scan.session, scan.prefix, scan.nuclide) == ("01", "", "sub-01", "C11")
    assert scan.image == study / f"{PET}pet.nii.gz"
    assert (len(scan.frames), scan.body_weight) == (12, 71.5)
    assert scan.require_blood().end == 45.0
    assert [(curves.seg, curves.names) for curves in scan.curves] == [("rois", ("cortex", "cerebellum"))]
    np.testing.assert_array_equal(scan.curves[0].volumes, [np.nan, 1500])
    assert [dseg.seg for dseg in scan.dseg] == ["atlas"]
    assert scan.input_table is None
    assert scan.remarks == ()
    assert scan.open_image().count == 12


def test_images_come_in_kbq_at_time_zero(study: Path) -> None:
    change(study / f"{PET}pet.json", Units="Bq/mL", ImageDecayCorrected=False)
    frames = list(read_study(study).scans[0].open_image().frames())
    lam = np.log(2) / 20.364
    factor = lam * 5 / (1 - np.exp(-lam * 5)) * np.exp(lam * 40)  # last frame: 40 to 45 min
    stored = 12 * (3 * 4 * 2) - 1
    assert frames[-1][-1, -1, -1] == pytest.approx(stored * 1e-3 * factor, rel=1e-6)


def test_curves_follow_the_image_in_decay_unless_their_json_speaks(study: Path) -> None:
    plain = read_study(study).scans[0].curves[0].values
    change(study / f"{PET}pet.json", ImageDecayCorrectionTime=20.364 * 60)
    np.testing.assert_allclose(read_study(study).scans[0].curves[0].values, 2 * plain)
    change(study / f"{DERIVED}seg-rois_tacs.json", ImageDecayCorrected=True, ImageDecayCorrectionTime=0)
    np.testing.assert_allclose(read_study(study).scans[0].curves[0].values, plain)
    change(study / f"{DERIVED}seg-rois_tacs.json", ImageDecayCorrected="yes")
    with pytest.raises(InputError, match=r"sub-01_seg-rois_tacs.tsv: ImageDecayCorrected"):
        read_study(study)


def test_curves_and_blood_without_an_image_are_a_study(study: Path) -> None:
    (study / f"{PET}pet.nii.gz").unlink()
    (scan,) = read_study(study).scans
    assert scan.image is None
    assert len(scan.curves) == 1
    with pytest.raises(InputError, match="sub-01: there is no image"):
        scan.open_image()


def test_neither_image_nor_curves_is_severe(study: Path) -> None:
    (study / f"{PET}pet.nii.gz").unlink()
    shutil.rmtree(study / "derivatives")
    assert codes(study) == {"nothing-to-fit"}


def test_sidecars_are_inherited(study: Path, write_file: Write) -> None:
    whole = json.loads((study / f"{PET}pet.json").read_text())
    write_file(study / "pet.json", {**whole, "TracerName": "top"})
    write_file(study / "sub-01" / "sub-01_pet.json", {"Units": "Bq/mL"})
    write_file(study / "trc-other_pet.json", {"Units": "MBq/mL"})  # another tracer's
    write_file(study / f"{PET}pet.json", {"TracerName": "own"})
    write_file(
        study / "recording-manual_blood.json", json.loads((study / f"{PET}recording-manual_blood.json").read_text())
    )
    (study / f"{PET}recording-manual_blood.json").unlink()
    (scan,) = read_study(study).scans
    assert (scan.sidecar.units, scan.sidecar.tracer_name) == ("Bq/mL", "own")
    assert scan.require_blood().peak == 50.0


def test_region_names_are_inherited_from_the_top_of_a_pipeline(study: Path) -> None:
    shutil.move(study / f"{DERIVED}seg-atlas_dseg.tsv", study / "derivatives/segmented/seg-atlas_dseg.tsv")
    (dseg,) = read_study(study).scans[0].dseg
    assert [path.name for path in dseg.tables] == ["seg-atlas_dseg.tsv"]


def test_a_scan_without_any_sidecar_is_refused(study: Path) -> None:
    (study / f"{PET}pet.json").unlink()
    with pytest.raises(InputError, match=r"sub-01_pet.json: no such file, and none above it"):
        read_study(study)


def test_blood_without_its_json_is_refused(study: Path) -> None:
    (study / f"{PET}recording-manual_blood.json").unlink()
    with pytest.raises(InputError, match=r"sub-01_recording-manual_blood.json: is missing; it states the Units"):
        read_study(study)


def test_blood_that_ends_early_is_told_and_refused_when_asked_for(study: Path, write_file: Write) -> None:
    write_file(study / f"{PET}recording-manual_blood.tsv", "time\tplasma_radioactivity\n0\t0\n60\t50\n600\t8\n")
    change(study / f"{PET}recording-manual_blood.json", MetaboliteAvail=False, WholeBloodAvail=False)
    (scan,) = read_study(study).scans
    (remark,) = [remark for remark in scan.remarks if remark.code == "blood-cover"]
    assert remark.text.startswith("Blood ends at 600 s but the last frame ends at 2700 s")
    with pytest.raises(InputError, match="blood ends at 600 s"):
        scan.require_blood()


def test_no_blood_leaves_reference_models(study: Path) -> None:
    for path in (study / "sub-01/pet").glob("*blood*"):
        path.unlink()
    (scan,) = read_study(study).scans
    assert [remark.code for remark in scan.remarks] == ["no-blood"]
    with pytest.raises(InputError, match="sub-01: there is no blood"):
        scan.require_blood()


def test_sessions_and_runs_are_scans_of_their_own(study: Path, write_file: Write) -> None:
    sidecar = json.loads((study / f"{PET}pet.json").read_text())
    blood = (study / f"{PET}recording-manual_blood.tsv").read_text()
    fields = json.loads((study / f"{PET}recording-manual_blood.json").read_text())
    for run in ("1", "2"):
        write_file(study / f"sub-02/ses-b/pet/sub-02_ses-b_run-{run}_pet.json", sidecar)
    write_file(study / "sub-02/ses-b/pet/sub-02_ses-b_run-2_recording-manual_blood.tsv", blood)
    write_file(study / "sub-02/ses-b/pet/sub-02_ses-b_run-2_recording-manual_blood.json", fields)
    curves = (study / f"{DERIVED}seg-rois_tacs.tsv").read_text()
    write_file(study / "derivatives/segmented/sub-02/ses-b/pet/sub-02_ses-b_run-1_seg-rois_tacs.tsv", curves)
    scans = {scan.prefix: scan for scan in read_study(study).scans}
    assert list(scans) == ["sub-01", "sub-02_ses-b_run-1", "sub-02_ses-b_run-2"]
    first, second = scans["sub-02_ses-b_run-1"], scans["sub-02_ses-b_run-2"]
    assert (first.blood is None, second.blood is None) == (True, False)
    assert (len(first.curves), len(second.curves)) == (1, 0)
    assert "tacs-unit" in {remark.code for remark in first.remarks}
    assert [scan.prefix for scan in read_study(study, subjects=["01"]).scans] == ["sub-01"]


def test_own_results_are_read_only_where_there_is_nothing_else(study: Path) -> None:
    own = study / "derivatives/petkin/sub-01/pet"
    own.mkdir(parents=True)
    for name in ("tacs.tsv", "tacs.json"):
        shutil.copy(study / f"{DERIVED}seg-rois_{name}", own / f"sub-01_seg-mine_{name}")
    assert [curves.seg for curves in read_study(study).scans[0].curves] == ["rois"]
    shutil.rmtree(study / "derivatives/segmented")
    assert [curves.seg for curves in read_study(study).scans[0].curves] == ["mine"]


def test_weights_are_no_curves_and_repeated_segmentations_count_once(study: Path, write_file: Write) -> None:
    write_file(study / f"{DERIVED}desc-weights_tacs.tsv", "frame_start\tframe_end\tweight\n0\t30\t1\n")
    shutil.copytree(study / "derivatives/segmented", study / "derivatives/another")
    scan = read_study(study).scans[0]
    assert (len(scan.curves), len(scan.dseg)) == (1, 1)
    assert [remark.code for remark in scan.remarks] == ["seg-repeated", "seg-repeated"]


def test_segmentations_in_another_space_give_way(study: Path) -> None:
    shutil.copy(study / f"{DERIVED}seg-atlas_dseg.nii.gz", study / f"{DERIVED}space-T1w_seg-fine_dseg.nii.gz")
    assert [dseg.seg for dseg in read_study(study).scans[0].dseg] == ["atlas"]
    assert codes(study) == {"dseg-space"}
    (study / f"{DERIVED}seg-atlas_dseg.nii.gz").unlink()
    assert [dseg.seg for dseg in read_study(study).scans[0].dseg] == ["fine"]


def test_curves_with_other_frames_are_remarked(study: Path, write_file: Write) -> None:
    write_file(study / f"{DERIVED}seg-rois_tacs.tsv", "frame_start\tframe_end\tcortex\n0\t30\t1\n30\t60\t2\n")
    scan = read_study(study).scans[0]
    assert [remark.text for remark in scan.remarks] == [
        "It has 2 frames but sub-01_pet.json has 12; the table's are used."
    ]
    assert len(scan.curves[0].frames) == 2


def test_curves_with_frames_in_minutes_are_refused(study: Path, write_file: Write) -> None:
    rows = "".join(f"{k * 0.5}\t{k * 0.5 + 0.5}\t1\n" for k in range(12))
    write_file(study / f"{DERIVED}seg-rois_tacs.tsv", f"frame_start\tframe_end\tcortex\n{rows}")
    with pytest.raises(InputError, match=r"tacs.tsv: .*looks like minutes; frame_start and frame_end are in seconds"):
        read_study(study)


def test_an_image_with_other_frames_is_refused(study: Path) -> None:
    sidecar = json.loads((study / f"{PET}pet.json").read_text())
    change(
        study / f"{PET}pet.json",
        FrameTimesStart=sidecar["FrameTimesStart"][:-1],
        FrameDuration=sidecar["FrameDuration"][:-1],
    )
    with pytest.raises(InputError, match=r"sub-01_pet.nii.gz: holds 12 frames but sub-01_pet.json lists 11"):
        read_study(study).scans[0].open_image()


def test_bad_scans_can_be_listed_instead(study: Path) -> None:
    shutil.copytree(study / "sub-01", study / "sub-02")
    for path in (study / "sub-02/pet").iterdir():
        path.rename(path.with_name(path.name.replace("sub-01", "sub-02")))
    change(study / "sub-02/pet/sub-02_pet.json", Units=None)
    with pytest.raises(InputError, match=r"sub-02_pet.json: Units is missing"):
        read_study(study)
    read = read_study(study, refuse=False)
    assert [scan.prefix for scan in read.scans] == ["sub-01"]
    assert read.refused == ("sub-02_pet.json: Units is missing; add it to the sidecar (PET-BIDS requires it).",)


def test_what_is_no_study_is_refused(tmp_path: Path, study: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere: no such folder"):
        read_study(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"empty: no PET scan found; expected sub-<label>"):
        read_study(tmp_path / "empty")
    with pytest.raises(InputError, match="no PET scan of 02, 03 found"):
        read_study(study, subjects=["03", "02"])


def test_a_study_without_description_is_remarked(study: Path) -> None:
    (study / "dataset_description.json").unlink()
    read = read_study(study)
    assert (read.name, [remark.code for remark in read.remarks]) == ("study", ["no-description"])


def test_the_real_studies_are_read_as_they_are(pbr28: Study, mc1: Study) -> None:
    assert [len(study.scans) for study in (pbr28, mc1)] == [12, 24]
    assert all(scan.require_blood() and scan.curves for study in (pbr28, mc1) for scan in study.scans)
    assert all(scan.input_table is not None for scan in pbr28.scans)
    assert {scan.body_weight for scan in mc1.scans if scan.subject == "04"} == {62.0}
    names = {curves.seg for scan in pbr28.scans for curves in scan.curves}
    assert names == {"rois"}  # kinfitr's desc-weights tables are no curves
