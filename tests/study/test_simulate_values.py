"""Simulated values against an independent computation: an ODE solver with the frame integrals as states."""

from __future__ import annotations

import json
import math
from pathlib import Path

import nibabel as nib
import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

from petkin.errors import InputError
from petkin.study.simulate import simulate
from petkin.study.simulation import SimulationSettings, plan
from petkin.study.simulation.scene import scene, voxel_values

F18_LAMBDA = math.log(2) / 109.77


def feng(t: float, A1: float, A2: float, A3: float, rates: tuple[float, float, float], onset: float) -> float:
    s = t - onset
    if s < 0:
        return 0.0
    l1, l2, l3 = rates
    return (A1 * s - A2 - A3) * math.exp(l1 * s) + A2 * math.exp(l2 * s) + A3 * math.exp(l3 * s)


def frame_means(plasma, blood, row, start, end, decay: float, onset: float, corrected: bool) -> np.ndarray:
    """Frame values of a two-tissue region: int C e^{-decay t} dt is integrated beside the compartments."""

    def field(t: float, y: np.ndarray) -> list[float]:
        activity = (1 - row.VB) * (y[0] + y[1]) + row.VB * blood(t)
        return [
            row.K1 * plasma(t) - (row.k2 + row.k3) * y[0] + row.k4 * y[1],
            row.k3 * y[0] - row.k4 * y[1],
            activity * math.exp(-decay * t),
        ]

    edges = np.unique(np.append(start, end))
    later = edges[edges > onset]
    solution = solve_ivp(field, (onset, edges[-1]), [0.0] * 3, t_eval=later, method="DOP853", rtol=1e-11, atol=1e-11)
    area = dict(zip(later.tolist(), solution.y[2])) | dict.fromkeys(edges[edges <= onset].tolist(), 0.0)
    integral = np.array([area[b] - area[a] for a, b in zip(start.tolist(), end.tolist())])
    if not corrected:
        return integral / (end - start)
    return integral * decay / (np.exp(-decay * start) - np.exp(-decay * end))


def image_of(settings: SimulationSettings) -> np.ndarray:
    return np.asarray(nib.load(simulate(settings) / "sub-01/pet/sub-01_pet.nii.gz").dataobj)


def region_curve(study: Path, name: str) -> tuple[np.ndarray, pd.Series, dict, dict]:
    """The one voxel curve that a noise-free region holds, its true parameters, the sidecar and the record."""
    truth = study / "derivatives/phantom/sub-01/pet"
    table = pd.read_csv(next(truth.glob("*_kinpar.tsv")), sep="\t").set_index("name")
    labels = np.asarray(nib.load(truth / "sub-01_seg-phantom_dseg.nii.gz").dataobj)
    image = np.asarray(nib.load(study / "sub-01/pet/sub-01_pet.nii.gz").dataobj)
    curves = image[labels == table.loc[name, "index"]]
    assert np.ptp(curves, axis=0).max() == 0
    sidecar = json.loads((study / "sub-01/pet/sub-01_pet.json").read_text())
    record = json.loads((truth / "sub-01_desc-truth_report.json").read_text())
    return curves[0], table.loc[name], sidecar, record


@pytest.mark.parametrize("name", ["grey", "lesion"])
def test_physical_preset_agrees_with_an_ode_solver(tmp_path: Path, name: str) -> None:
    study = simulate(
        SimulationSettings(out=tmp_path / "s", noise=0, units="kBq/mL", frames="6x10,4x30,5x120,gap300,4x300")
    )
    curve, row, sidecar, record = region_curve(study, name)
    size = sidecar["InjectedRadioactivity"] / 185.0 * 75.0 / record["BodyWeight"]

    def total(t: float) -> float:
        return size * feng(t, 851.1225, 21.8798, 20.8113, (-4.133859, -0.1190996, -0.01043449), 0.4)

    def parent(t: float) -> float:
        return total(t) * (0.7 * math.exp(-0.08 * t) + 0.3 * math.exp(-0.004 * t))

    start = np.array(sidecar["FrameTimesStart"]) / 60
    end = start + np.array(sidecar["FrameDuration"]) / 60
    expected = frame_means(parent, lambda t: 0.75 * total(t), row, start, end, F18_LAMBDA, 0.4, corrected=True)
    assert curve[0] == 0
    np.testing.assert_allclose(curve, expected, rtol=1e-6, atol=1e-6)


def test_paper_preset_agrees_with_an_ode_solver(tmp_path: Path) -> None:
    study = simulate(SimulationSettings(out=tmp_path / "s", preset="paper", frames="80"))
    curve, row, sidecar, record = region_curve(study, "caudate-putamen")
    A1 = record["Plasma"]["A1"]
    assert 100 <= A1 <= 200

    def plasma(t: float) -> float:
        return 37.0 * feng(t, A1, 21.8798, 20.8113, (-4.1339, -0.1191, -0.0104), 0.0)

    edges = np.arange(81) * 0.5
    assert sidecar["FrameTimesStart"] == (edges[:-1] * 60).tolist()
    assert sidecar["ImageDecayCorrected"] is False
    assert row.VB == 0
    expected = 1e3 * frame_means(plasma, plasma, row, edges[:-1], edges[1:], 1 / 110, 0.0, corrected=False)
    np.testing.assert_allclose(curve, expected, rtol=1e-6, atol=1e-3)


def test_paper_and_physical_frames_differ_by_the_decay(tmp_path: Path) -> None:
    """The same kinetics and blood: what is not corrected has decayed with tau = 110 min."""
    curves = []
    for preset in ("paper", "physical"):
        settings = SimulationSettings(out=tmp_path / preset, preset=preset, tracer="paper", noise=0)
        curves.append(region_curve(simulate(settings), "white")[0])
    middle = np.arange(80) * 0.5 + 0.25
    np.testing.assert_allclose(curves[0] / curves[1], np.exp(-middle / 110), rtol=5e-4)


@pytest.mark.parametrize("tracer", ["reversible", "fdg", "paper"])
def test_voxel_table_is_exact_to_float32(tmp_path: Path, tracer: str) -> None:
    planned = plan(SimulationSettings(out=tmp_path, voxel_spread=True, tracer=tracer, voxel_size=7.0))
    drawn = scene(planned, 1, 1)
    assert drawn.voxels is not None
    exact = drawn.voxels.frame_values().numpy()
    np.testing.assert_allclose(voxel_values(drawn.voxels), exact, rtol=2e-7, atol=1e-6 * exact.max())


def test_noise_is_the_percent_asked_for(tmp_path: Path) -> None:
    quiet, noisy = (image_of(SimulationSettings(out=tmp_path / str(p), noise=p)) for p in (0, 10))
    labels = np.asarray(nib.load(tmp_path / "0/derivatives/phantom/sub-01/pet/sub-01_seg-phantom_dseg.nii.gz").dataobj)
    sidecar = json.loads((tmp_path / "0/sub-01/pet/sub-01_pet.json").read_text())
    start, duration = np.array(sidecar["FrameTimesStart"]), np.array(sidecar["FrameDuration"])
    k = int(np.flatnonzero((start <= 2700) & (start + duration >= 2700))[0])
    inside = labels > 0
    error, mean = (noisy - quiet)[inside], quiet[inside][:, k].mean()
    relative = error[:, k:] / np.sqrt(mean * quiet[inside][:, k:])  # 10 percent of the mean in frame k, as sqrt(C)
    assert relative[:, 0].std() == pytest.approx(0.1, rel=0.06)
    growth = math.sqrt(math.exp(F18_LAMBDA * (start[-1] - start[k]) / 60) * duration[k] / duration[-1])
    assert relative[:, -1].std() / 0.1 == pytest.approx(growth, rel=0.06)


def test_frame_common_noise_moves_whole_frames(tmp_path: Path) -> None:
    def mean_error(share: float) -> float:
        quiet, noisy = (
            image_of(SimulationSettings(out=tmp_path / f"{share}-{p}", noise=p, noise_common=share))[24:40, 24:40].sum(
                (0, 1, 2)
            )
            for p in (0, 5)
        )
        return float(np.abs(noisy[8:] / quiet[8:] - 1).mean())

    assert mean_error(0.6) > 4 * mean_error(0.0)


def test_point_spread_mixes_regions_and_keeps_activity(tmp_path: Path) -> None:
    sharp, blurred = (image_of(SimulationSettings(out=tmp_path / str(p), noise=0, psf=p)) for p in (0, 6))
    np.testing.assert_allclose(blurred.sum((0, 1, 2)), sharp.sum((0, 1, 2)), rtol=1e-5)
    assert blurred.max() < sharp.max()


def test_fractional_edges_keep_activity(tmp_path: Path) -> None:
    whole, shared = (image_of(SimulationSettings(out=tmp_path / str(n), noise=0, subsamples=n)).sum() for n in (1, 4))
    assert shared == pytest.approx(whole, rel=0.02)


def test_one_tissue_keeps_the_distribution_volume(tmp_path: Path) -> None:
    tables = []
    for model in ("1TCM", "2TCM"):
        study = simulate(SimulationSettings(out=tmp_path / model, model=model, frames="3x60"))
        tables.append(pd.read_csv(next((study / "derivatives/phantom/sub-01/pet").glob("*_kinpar.tsv")), sep="\t"))
    np.testing.assert_allclose(tables[0]["VT"], tables[1]["VT"], rtol=1e-8)
    np.testing.assert_allclose(tables[0]["K1"], tables[1]["K1"], rtol=1e-8)


def test_effects_are_in_the_image_and_not_in_the_record(tmp_path: Path) -> None:
    plain = simulate(SimulationSettings(out=tmp_path / "plain", noise=0))
    late = simulate(SimulationSettings(out=tmp_path / "late", noise=0, effects=("arterial_delay=20",)))
    for name in ("sub-01_pet.json", "sub-01_recording-manual_blood.tsv", "sub-01_recording-autosampler_blood.tsv"):
        assert (plain / "sub-01/pet" / name).read_bytes() == (late / "sub-01/pet" / name).read_bytes()
    early = [region_curve(study, "grey")[0][:12] for study in (plain, late)]
    assert (early[1][3:] < early[0][3:]).all()
    record = region_curve(late, "grey")[3]
    assert record["Effects"] == [
        {"Name": "arterial_delay", "Stage": "input", "Values": {"delay": {"Value": 20.0, "Units": "s"}}}
    ]


def test_second_tissue_changes_the_truth_that_is_written(tmp_path: Path) -> None:
    study = simulate(SimulationSettings(out=tmp_path / "s", model="1TCM", effects=("second_tissue=0.06,k4=0.02",)))
    table = pd.read_csv(
        study / "derivatives/phantom/sub-01/pet/sub-01_seg-phantom_model-2TCM_desc-truth_kinpar.tsv", sep="\t"
    )
    np.testing.assert_allclose(table["k3"], 0.06)
    np.testing.assert_allclose(table["VT"], table["K1"] / table["k2"] * 4, rtol=1e-8)


def test_vessel_walls_are_in_no_population(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="2TCM1k cannot be simulated: there is no Kb"):
        plan(SimulationSettings(preset="physical", out=tmp_path, model="2TCM1k"))
