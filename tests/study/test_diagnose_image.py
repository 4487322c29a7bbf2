"""Spatial effects of a 4-D image, made here by moving and blurring voxels, or by `petkin simulate`: named, sized in mm,
mapped."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path

import jsonschema
import nibabel as nib
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, shift

from petkin.diagnosis import Best, Cause, Contrasted, Estimate, Hypothesis, Pattern, Shape
from petkin.study.diagnose import Diagnosed, diagnose_study
from petkin.study.diagnosis import imaged
from petkin.study.diagnosis.answer import cause_entry
from petkin.study.diagnosis.imaged import _sized, _timed
from petkin.study.diagnosis.picture import Voxels
from petkin.study.diagnosis.regional import RegionalSimulator
from petkin.study.diagnosis.request import DiagnoseRequest
from petkin.study.diagnosis.resting import at_rest
from petkin.study.diagnosis.sentences import sized
from petkin.study.diagnosis.spatial import Looked
from petkin.study.simulate import simulate
from petkin.study.simulation import SimulationSettings
from petkin.study.sources import Source

SCHEMA = json.loads((files("petkin.reporting") / "schemas" / "gap-report-1.json").read_text())
VOXEL, ONSET_MIN, NOISE = 4.0, 30.0, 0.10
INCLUDES = ("blood_volume", "arterial_delay")


def planes(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    middle = (y.max() + 1) // 2
    return ((y >= middle - 1) & (y < middle + 4)).astype(float)


def rings(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """24 mm from one to the next, about the middle of the grid."""
    return np.cos(2.0 * np.pi * np.hypot(x - 0.5 * x.max(), y - 0.5 * y.max()) * VOXEL / 24.0)


def fan(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A diagonal, 16 mm from the middle and 8 mm wide."""
    return np.exp(-0.5 * (((y - 0.5 * y.max() - x + 0.5 * x.max()) * VOXEL / 2**0.5 - 16.0) / 8.0) ** 2)


SHOWN = {"planes": planes, "rings": rings, "fan": fan}


def noise_free(folder: Path) -> tuple[Path, Path]:
    usual = {"out": folder / "study", "noise": 0.0, "voxel_size": VOXEL, "tracer": "reversible"}
    study = simulate(SimulationSettings.model_validate(usual))
    return study, study / "sub-01/pet/sub-01_pet.nii.gz"


def spoilt(
    folder: Path,
    *,
    fwhm: float = 0.0,
    moved_mm: tuple[float, float, float] = (0.0, 0.0, 0.0),
    failing: float = 0.0,
    seen_by: str = "planes",
    seed: int = 3,
) -> Path:
    """A study whose head is blurred, and moves once at 30 min, or where detectors lose a share of the counts about
    then, which their planes, rings or a fan of theirs show; with noise of counts."""
    study, path = noise_free(folder)
    image = nib.load(path)
    values = np.asarray(image.dataobj, np.float64)
    sidecar = json.loads(path.with_name("sub-01_pet.json").read_text())
    start, duration = np.array(sidecar["FrameTimesStart"]), np.array(sidecar["FrameDuration"])
    rng = np.random.default_rng(seed)
    size = NOISE * np.sqrt(values.mean(axis=3).max() * 300.0 / duration)
    shown = SHOWN[seen_by](*np.meshgrid(*(np.arange(edge) for edge in values.shape[:2]), indexing="ij"))[..., None]
    for k, frame in enumerate(np.moveaxis(values, -1, 0)):
        seen = gaussian_filter(frame, fwhm / 2.3548 / VOXEL) if fwhm else frame.copy()
        if start[k] >= 60 * ONSET_MIN - 1:
            seen = shift(seen, np.array(moved_mm) / VOXEL, order=1)
        middle = (start[k] + 0.5 * duration[k]) / 60.0
        seen *= 1.0 - failing * shown * np.exp(-0.5 * ((middle - ONSET_MIN) / 8.0) ** 2)
        values[..., k] = seen + size[k] * np.sqrt(np.maximum(seen, 0.02 * seen.max())) * rng.standard_normal(seen.shape)
    nib.save(nib.Nifti1Image(values.astype(np.float32), image.affine), path)
    return study


def diagnosed(study: Path, out: Path, **options: object) -> Diagnosed:
    (one,) = diagnose_study(DiagnoseRequest(study, out=out, include=INCLUDES, **options))  # type: ignore[arg-type]
    return one


def deviations(one: Diagnosed) -> np.ndarray:
    """z of the voxels in the regions."""
    z = np.asarray(nib.load(next(one.report.parent.glob("*_desc-gapz_mimap.nii.gz"))).dataobj)
    return z[np.isfinite(z)]


@pytest.fixture(scope="module")
def moved(tmp_path_factory: pytest.TempPathFactory) -> Diagnosed:
    """3 mm along y, in an image without blur to speak of."""
    folder = tmp_path_factory.mktemp("moved")
    return diagnosed(spoilt(folder, moved_mm=(0.0, 3.0, 0.0)), folder / "out")


def test_motion_is_named_with_its_size_and_onset(moved: Diagnosed) -> None:
    answer = moved.answer
    jsonschema.validate(answer, SCHEMA)
    assert answer["verdict"]["set"] == ["motion_step"]
    estimate = answer["causes"][0]["estimate"]
    assert estimate["amplitude"]["unit"] == "mm"
    assert estimate["amplitude"]["value"] == pytest.approx(3.0, abs=1.0)
    assert estimate["onset_min"]["value"] == pytest.approx(ONSET_MIN, abs=3.0)
    assert estimate["axis"]["value"] == 1
    assert "mm along the image's y axis from" in answer["verdict"]["sentence"]
    assert {stage["stage"] for stage in answer["where"]["stages"]} >= {"imaging"}


@pytest.mark.parametrize(
    ("effect", "axis", "within"),
    [("motion_step=2,axis=2,onset=30", 2, 0.35), ("motion_drift=4,axis=3", 3, 0.35), ("motion_drift=9,axis=1", 1, 0.2)],
)
def test_motion_that_was_simulated_is_named(tmp_path: Path, effect: str, axis: int, within: float) -> None:
    """A long drift makes kinetics within regions seem to vary, which would hide much of it."""
    settings = SimulationSettings(
        out=tmp_path / "study", phantom="brain3d", voxel_size=7.0, noise=8.0, psf=5.0, effects=(effect,)
    )
    includes = ("blood_volume", "partial_volume")
    (one,) = diagnose_study(DiagnoseRequest(simulate(settings), include=includes))
    name, _, size = effect.partition("=")
    assert one.answer["verdict"]["set"] == [name]
    estimate = one.answer["causes"][0]["estimate"]
    assert estimate["amplitude"]["value"] == pytest.approx(float(size.split(",")[0]), rel=within)
    assert estimate["axis"]["value"] == axis


def test_the_map_shows_edges_of_both_signs(moved: Diagnosed) -> None:
    path = next(moved.report.parent.glob("*_desc-gapz_mimap.nii.gz"))
    z = np.asarray(nib.load(path).dataobj)
    inside = np.isfinite(z)
    assert inside.any()
    assert not inside.all()
    assert z[inside].max() > 5
    assert z[inside].min() < -5
    sidecar = json.loads(path.with_name(path.name.replace(".nii.gz", ".json")).read_text())
    assert "motion_step" in sidecar["Cause"]
    assert "Gap by voxel" in moved.report.read_text()


@pytest.mark.parametrize("seed", [3, 12])
def test_motion_that_is_included_is_no_gap_of_the_image(moved: Diagnosed, tmp_path: Path, seed: int) -> None:
    """Neither motion of another course nor a gap of no name stands where it stood, and its edges leave the map.

    With the second seed what motion lowers is much the same either way, and only one of them fits.
    """
    study = spoilt(tmp_path, moved_mm=(0.0, 3.0, 0.0), seed=seed)
    request = DiagnoseRequest(study, out=tmp_path / "out", include=(*INCLUDES, "motion_step"))
    (one,) = diagnose_study(request)
    assert one.answer["verdict"]["kind"] == "none"
    onset = next(e for e in one.answer["simulator"]["fitted"] if (e["effect"], e["symbol"]) == ("motion_step", "onset"))
    assert onset["value"] == pytest.approx(ONSET_MIN, abs=2.0)
    left, was = (float((deviations(each) ** 2).mean()) - 1.0 for each in (one, moved))
    assert was > 1.0
    assert left < 0.2 * was


def test_behind_included_motion_another_gap_of_the_image_is_seen(tmp_path: Path) -> None:
    study = spoilt(tmp_path, moved_mm=(0.0, 3.0, 0.0), failing=0.3)
    request = DiagnoseRequest(study, out=tmp_path / "out", include=(*INCLUDES, "motion_step"))
    (one,) = diagnose_study(request)
    assert one.answer["verdict"]["kind"] == "unknown"
    assert one.answer["where"]["state"][0]["evidence"] > 10.0


@dataclass(frozen=True)
class LongWay:
    """9 mm along x: the study, what was said of it, and the noise of the picture laid at rest by that recorded."""

    study: Path
    said: Diagnosed
    ratios: list[np.ndarray]


@pytest.fixture(scope="module")
def long_way(tmp_path_factory: pytest.TempPathFactory) -> LongWay:
    folder, ratios = tmp_path_factory.mktemp("long_way"), []

    def kept(source: Source, voxels: Voxels, simulator: RegionalSimulator) -> Voxels | None:
        rest = at_rest(source, voxels, simulator)
        if rest is not None:
            ratios.append(np.median(rest.spread / voxels.spread, axis=1))
        return rest

    study = spoilt(folder, moved_mm=(9.0, 0.0, 0.0))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(imaged, "at_rest", kept)
        return LongWay(study, diagnosed(study, folder / "out"), ratios)


def test_a_long_way_is_named(long_way: LongWay) -> None:
    """Two voxels and more: slopes of a picture of both places tell neither how far nor what that adds to regions."""
    answer = long_way.said.answer
    assert answer["verdict"]["set"] == ["motion_step"]
    estimate = answer["causes"][0]["estimate"]
    assert estimate["amplitude"]["value"] == pytest.approx(9.0, abs=1.0)
    assert estimate["onset_min"]["value"] == pytest.approx(ONSET_MIN, abs=1.0)
    assert estimate["axis"]["value"] == 0


def test_a_long_way_is_no_gap_once_included(long_way: LongWay, tmp_path: Path) -> None:
    request = DiagnoseRequest(long_way.study, out=tmp_path / "in", include=(*INCLUDES, "motion_step"))
    (one,) = diagnose_study(request)
    assert one.answer["verdict"]["kind"] == "none"
    moved = next(e for e in one.answer["simulator"]["fitted"] if (e["effect"], e["symbol"]) == ("motion_step", "moved"))
    assert moved["value"] == pytest.approx(9.0, abs=1.0)


def test_a_picture_at_rest_has_the_noise_of_what_was_recorded(long_way: LongWay) -> None:
    """Frames that are laid back between voxels are smoother; their curves are asked as they were recorded."""
    (ratio,) = long_way.ratios
    np.testing.assert_allclose(ratio, 1.0, atol=0.25)


def test_blur_is_named_with_its_width(tmp_path: Path) -> None:
    answer = diagnosed(spoilt(tmp_path, fwhm=8.0), tmp_path / "out").answer
    assert "partial_volume" in answer["verdict"]["set"][0]
    estimate = answer["causes"][0]["estimate"]["amplitude"]
    assert estimate["unit"] == "mm"
    assert estimate["value"] == pytest.approx(8.0, abs=2.0)
    assert estimate["low"] < estimate["value"] < estimate["high"]


@pytest.mark.parametrize("without", [(), ("partial_volume", "motion_step", "motion_drift", "attenuation_mismatch")])
def test_failing_planes_are_a_gap_of_no_name_within_regions(tmp_path: Path, without: tuple[str, ...]) -> None:
    answer = diagnosed(spoilt(tmp_path, failing=0.3), tmp_path / "out", without=without).answer
    jsonschema.validate(answer, SCHEMA)
    assert answer["verdict"]["kind"] == "unknown"
    assert "within regions" in answer["verdict"]["sentence"]
    assert answer["where"]["state"][0]["evidence"] > 10.0


@pytest.mark.parametrize(("seen_by", "failing"), [("rings", 0.06), ("fan", 0.10)])
def test_what_detectors_in_a_ring_lose_is_a_gap_of_no_name(tmp_path: Path, seen_by: str, failing: float) -> None:
    """Such gains are too fine for fields along the axes of the grid."""
    answer = diagnosed(spoilt(tmp_path, failing=failing, seen_by=seen_by), tmp_path / "out").answer
    assert answer["verdict"]["kind"] == "unknown"
    assert "within regions" in answer["verdict"]["sentence"]


def test_an_image_in_order_has_no_gap_and_a_map_of_noise(tmp_path: Path) -> None:
    one = diagnosed(spoilt(tmp_path), tmp_path / "out")
    assert one.answer["verdict"]["kind"] == "none"
    assert np.std(deviations(one)) == pytest.approx(1.0, abs=0.15)


def test_silence_of_the_image_counts_only_as_far_as_the_effect_would_show() -> None:
    """A gain in one region alone tilts nothing; every blur shows. Strong evidence is lent nearly whole."""
    names = ("attenuation_mismatch", "motion_step", "partial_volume")
    silent = Looked(Contrasted(dict.fromkeys(names, -9.0), {}, {}, 0.5), 0.0).log_odds
    assert silent["attenuation_mismatch"] > silent["motion_step"] > silent["partial_volume"]
    assert silent["attenuation_mismatch"] == pytest.approx(np.log(0.5), abs=1e-3)
    loud = Looked(Contrasted(dict.fromkeys(names, 40.0), {}, {}, 0.5), 0.0).log_odds
    assert min(loud.values()) > 39.0


def test_the_image_says_which_settings_are_likely() -> None:
    """Weights have a mean of one over settings, follow axis and onset, and none falls below what may not show."""
    seen = [
        ({"axis": float(a), "onset": t}, 8.0 if (a, t) == (1, 30.0) else -2.0) for a in (0, 1) for t in (20.0, 30.0)
    ]
    looked = Looked(Contrasted({"motion_step": 6.6}, {"motion_step": seen}, {}, 0.5), 0.0)
    settings = tuple({"axis": float(a), "onset": t} for a in (0, 1) for t in (20.0, 25.0, 30.0))
    hypothesis = Hypothesis("motion_step", "imaging", "moved", "mm", -10.0, 10.0, settings)
    told = looked.told(hypothesis)
    assert (told.log_odds, told.witness) == (looked.log_odds["motion_step"], "image")
    weights = np.exp(told.told)
    assert weights.mean() == pytest.approx(1.0)
    assert list(np.argsort(weights)[-2:]) == [4, 5]
    assert np.ptp(weights[[0, 1, 2, 3]]) < 1e-12
    beside = replace(hypothesis, name="gain_step")
    assert looked.told(beside) is beside


@pytest.mark.parametrize(("edge", "end"), [(0.0, ""), (1.0, ", whose end slipped")])
def test_the_frame_that_is_wrong_is_said(edge: float, end: str) -> None:
    known = [Estimate(s, "1", v, v, v, effect="frame_duration") for s, v in (("amplitude", 0.1), ("frame", 20.0))]
    cause = Cause(("frame_duration",), ("clock",), 0.9, 30.0, (*known, Estimate("edge", "1", edge, edge, edge)))
    assert sized(cause) == f"Frame duration of 0.1 in frame 20{end}"


def test_an_axis_is_said_of_the_motion_whose_size_is_said() -> None:
    """Of a pair each effect has its own size, place and time."""
    gain = Estimate("amplitude", "1", 0.05, 0.05, 0.05, effect="gain_step", channel="Putamen")
    onset = Estimate("onset", "min", 40.0, 38.0, 42.0, effect="gain_step")
    mm, axis = (
        Estimate(symbol, unit, size, size, size, effect="motion_drift")
        for symbol, unit, size in (("amplitude", "mm", 3.0), ("axis", "1", 1.0))
    )
    pair = Cause(("gain_step", "motion_drift"), ("imaging", "imaging"), 0.9, 30.0, (gain, onset, mm, axis))
    motion = "otion drift of 3 mm along the image's y axis"
    assert sized(pair) == f"Gain step of 0.05 in Putamen from 40 min on and m{motion}"
    alone = Cause(("motion_drift",), ("imaging",), 0.9, 30.0, (mm, axis))
    assert sized(alone) == f"M{motion}"
    said = cause_entry(pair)["estimate"]
    assert list(said) == ["amplitude", "onset_min", "second_amplitude", "second_axis"]
    assert said["amplitude"]["region"] == "Putamen"


@pytest.mark.parametrize(("evidence", "error", "told"), [(1.0, 6.0, True), (1.0, 0.1, False), (9.0, 0.1, True)])
def test_mm_are_those_of_whoever_is_surer(evidence: float, error: float, told: bool) -> None:
    """Unless the image is sure of the effect: then they are its own."""
    pattern = Pattern("motion_drift", "motion 2", np.ones((1, 3)), {"axis": 2.0})
    seen = Contrasted(
        {"motion_drift": evidence}, {"motion_drift": []}, {"motion_drift": Best(pattern, -0.3, -0.4, -0.2)}, 0.5
    )
    regional = Estimate("amplitude", "mm", 0.0, -error, error, effect="motion_drift")
    axis = Estimate("axis", "1", 0.0, 0.0, 0.0, effect="motion_drift")
    cause = Cause(("motion_drift",), ("imaging",), 0.5, 1.0, (regional, axis))
    found = {e.symbol: e.value for e in _sized(cause, Looked(seen, 0.0)).estimates}
    assert found == ({"amplitude": 0.3, "axis": 2.0} if told else {"amplitude": 0.0, "axis": 0.0})


@pytest.mark.parametrize(("evidence", "between"), [(9.0, (25.0, 35.0)), (1.0, (2.0, 80.0))])
def test_what_is_included_sets_in_when_the_image_says(evidence: float, between: tuple[float, float]) -> None:
    """Regions that hardly show it would have it at any time; an image that is not sure leaves it to them."""
    seen = [({"axis": 1.0, "onset": t}, 9.0 if t == 30.0 else -3.0) for t in (20.0, 25.0, 30.0, 35.0, 40.0)]
    pattern = Pattern("motion_step", "motion 1", np.ones((1, 3)), {"axis": 1.0, "onset": 30.0}, course=np.ones(3))
    best = {"motion_step": Best(pattern, 0.4, 0.3, 0.5)}
    looked = Looked(Contrasted({"motion_step": evidence}, {"motion_step": seen}, best, 0.5), 0.0)
    settings = tuple({"axis": 1.0, "onset": t} for t in (20.0, 30.0, 40.0))
    shapes = (Shape("onset", 2.0, 80.0, sd=np.inf, kinked=True),)
    hypothesis = Hypothesis("motion_step", "imaging", "moved", "mm", -10.0, 10.0, settings, shapes)
    (shape,) = _timed(looked, hypothesis).shapes
    assert (shape.lower, shape.upper) == between


def test_voxels_without_a_value_are_said(tmp_path: Path) -> None:
    study = spoilt(tmp_path)
    path = study / "sub-01/pet/sub-01_pet.nii.gz"
    image, labels = nib.load(path), nib.load(next(study.rglob("*_dseg.nii.gz")))
    values = np.asarray(image.dataobj, np.float32).copy()
    values[(*np.argwhere(np.asarray(labels.dataobj) == 1)[0], slice(5, 9))] = np.nan
    nib.save(nib.Nifti1Image(values, image.affine), path)
    one = diagnosed(study, tmp_path / "out")
    assert any("1 voxels of" in str(remark) and "NaN" in str(remark) for remark in one.remarks)
    assert "hold NaN or infinite values" in one.report.read_text()


def test_what_one_image_shows_is_a_gap_of_the_cohort(tmp_path: Path) -> None:
    """Two heads that move, seen within regions, among four scans: regions alone hardly show it."""
    study = spoilt(tmp_path, moved_mm=(0.0, 3.0, 0.0))
    for i, label in enumerate(("02", "03", "04")):
        other = tmp_path / label
        other.mkdir()
        source = spoilt(other, moved_mm=(0.0, 3.0, 0.0) if i == 0 else (0.0, 0.0, 0.0))
        for path in sorted(source.rglob("*sub-01*")):
            if path.is_file():
                place = study / str(path.relative_to(source)).replace("sub-01", f"sub-{label}")
                place.parent.mkdir(parents=True, exist_ok=True)
                place.write_bytes(path.read_bytes())
    *scans, group = diagnose_study(DiagnoseRequest(study, out=tmp_path / "out", include=INCLUDES))
    assert [one.answer["verdict"]["kind"] for one in scans] == ["named", "named", "none", "none"]
    assert group.answer["gap"]["present"]
    leader = group.answer["causes"][0]
    assert leader["effects"] == ["motion_step"]
    assert leader["amplitude"]["unit"] == "mm"
    assert leader["amplitude"]["value"] == pytest.approx(3.0, abs=1.0)


def test_a_region_of_one_voxel_is_judged_with_the_rest(tmp_path: Path) -> None:
    """No contrast within it sees anything."""
    study = spoilt(tmp_path)
    path = next(study.rglob("*_dseg.nii.gz"))
    image = nib.load(path)
    labels = np.asarray(image.dataobj).copy()
    labels[tuple(np.argwhere(labels == 2)[1:].T)] = 0
    nib.save(nib.Nifti1Image(labels, image.affine, image.header), path)
    assert diagnosed(study, tmp_path / "out").answer["verdict"]["kind"] == "none"
