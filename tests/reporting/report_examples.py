"""Made-up but plausible reports: curves from a bolus and two tissues, brains from ellipsoids. Nothing is fitted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin.fitting.results import Estimate, FitResult, Status
from petkin.imaging import FrameSchedule
from petkin.reporting import (
    BloodSamples,
    FitReport,
    InputCurves,
    MapSet,
    ModelSection,
    ParameterMap,
    RegionCurves,
    TruthRow,
)

NAMES = (
    "Frontal cortex",
    "Parietal cortex",
    "Temporal cortex",
    "Occipital cortex",
    "Anterior cingulate",
    "Hippocampus",
    "Amygdala",
    "Thalamus",
    "Caudate",
    "Putamen",
    "Cerebellum",
    "White matter",
)
UNITS = {"K1": "mL/cm3/min", "k2": "1/min", "k3": "1/min", "k4": "1/min", "vB": "", "VT": "mL/cm3", "BPND": ""}
FRAMES_S = [10] * 6 + [20] * 6 + [60] * 8 + [120] * 7 + [300] * 13


def frames(durations_s: list[int] = FRAMES_S) -> FrameSchedule:
    start = np.concatenate([[0], np.cumsum(durations_s)[:-1]])
    return FrameSchedule.from_seconds(start, durations_s)


def plasma(t: NDArray) -> NDArray:
    late = np.maximum(t - 0.4, 0)
    return 6 * ((120 * late - 8 - 3) * np.exp(-4.13 * late) + 8 * np.exp(-0.12 * late) + 3 * np.exp(-0.0104 * late))


def input_curves(end: float = 90.0) -> InputCurves:
    t = np.unique(np.concatenate([np.linspace(0, 5, 601), np.linspace(5, end, 600)]))
    parent = 0.95 / (1 + (t / 40) ** 1.3)
    aif = plasma(t)
    drawn = np.array([0.5, 0.8, 1, 1.3, 1.7, 2.2, 3, 5, 8, 12, 20, 30, 45, 60, 75, 90.0])
    late = drawn[7::2]
    rng = np.random.default_rng(3)
    total = np.interp(drawn, t, aif / parent) * rng.normal(1, 0.03, drawn.size)
    return InputCurves(
        time=t,
        aif=aif,
        whole_blood=0.75 * aif / parent,
        total_plasma=aif / parent,
        parent_fraction=parent,
        samples=(
            BloodSamples("total plasma", drawn, total),
            BloodSamples("whole blood", drawn, 0.75 * total),
            BloodSamples("parent fraction", late, 0.95 / (1 + (late / 40) ** 1.3) + 0.01),
        ),
        remarks=("The parent fraction follows a Hill curve fitted to 5 samples.",),
    )


def kinetics(count: int, seed: int = 0) -> dict[str, NDArray]:
    rng = np.random.default_rng(seed)
    k = {
        "K1": rng.uniform(0.1, 0.5, count),
        "k2": rng.uniform(0.08, 0.2, count),
        "k3": rng.uniform(0.02, 0.1, count),
        "k4": rng.uniform(0.02, 0.06, count),
        "vB": rng.uniform(0.03, 0.06, count),
    }
    k["BPND"] = k["k3"] / k["k4"]
    k["VT"] = k["K1"] / k["k2"] * (1 + k["BPND"])
    return k


def two_tissue(k: dict[str, NDArray], schedule: FrameSchedule) -> NDArray:
    """Frame averages of the two-tissue model by convolution on a one-second grid, kBq/mL."""
    t = np.arange(0, schedule.end[-1] + 1e-9, 1 / 60)
    total = k["k2"] + k["k3"] + k["k4"]
    root = np.sqrt(total**2 - 4 * k["k2"] * k["k4"])
    slow, fast = (total - root) / 2, (total + root) / 2
    first = k["K1"] * (k["k3"] + k["k4"] - slow) / root
    impulse = first[:, None] * np.exp(-np.outer(slow, t)) + (k["K1"] - first)[:, None] * np.exp(-np.outer(fast, t))
    blood = plasma(t)
    size = 2 * t.size
    tissue = np.fft.irfft(np.fft.rfft(impulse, size) * np.fft.rfft(blood, size), size)[:, : t.size] / 60
    curve = (1 - k["vB"])[:, None] * tissue + k["vB"][:, None] * blood
    edges = np.concatenate([np.zeros((len(curve), 1)), np.cumsum(curve[:, 1:] + curve[:, :-1], 1) / 120], 1)
    area = [np.interp(schedule.end, t, e) - np.interp(schedule.start, t, e) for e in edges]
    return np.array(area) / schedule.duration


def noisy(clean: NDArray, schedule: FrameSchedule, seed: int = 1) -> tuple[NDArray, NDArray]:
    """Curves with counting-like noise, and the weights 1/variance."""
    level = 0.02 * np.sqrt(np.maximum(clean, 0.02 * clean.max()) * clean.mean() / schedule.duration)
    return clean + np.random.default_rng(seed).normal(0, 1, clean.shape) * level, 1 / level.mean(0) ** 2


def regional(
    model: str, tacs: NDArray, predicted: NDArray, weights: NDArray, k: dict[str, NDArray], p: int
) -> FitResult:
    rng = np.random.default_rng(5)
    n, frames_ = tacs.shape
    wrss = (weights * (tacs - predicted) ** 2).sum(1)
    typical = {"K1": 1.2, "k2": 5, "k3": 11, "k4": 8, "vB": 6, "VT": 2.0, "BPND": 7, "Ki": 2}
    estimates = tuple(
        Estimate(s, UNITS.get(s, ""), v * rng.normal(1, typical[s] / 150, n), typical[s] * rng.uniform(0.6, 1.6, n))
        for s, v in k.items()
    )
    aicc = frames_ * np.log(wrss / frames_) + 2 * p + 2 * p * (p + 1) / (frames_ - p - 1)
    return FitResult(
        model=model,
        estimates=estimates,
        chi2=wrss / (frames_ - p),
        aicc=aicc,
        status=np.zeros(n, np.uint8),
        weights=weights,
        predicted=predicted,
        delay=0.083,
        delay_se=0.004,
        settings={"bounds": {"K1": (0.0, 2.0), "k2": (0.0, 3.0)}, "weights": "counting statistics", "mid_frame": False},
        remarks=("k3 and k4 of the thalamus are correlated (0.97): read VT, not BPND.",),
    )


def brain(shape: tuple[int, int, int]) -> NDArray:
    """Labels 0..12 of a brain-like shape."""
    axes = [np.linspace(-1, 1, n) if n > 1 else np.zeros(1) for n in shape]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    inside = (x / 0.8) ** 2 + (y / 0.93) ** 2 + (z / 0.85) ** 2 < 1
    white = (x / 0.62) ** 2 + (y / 0.75) ** 2 + (z / 0.62) ** 2 < 1
    lobe = np.where(y > 0.25, 1, np.where(z > 0.2, 2, np.where(y < -0.4, 4, 3)))
    labels = np.where(inside, np.where(white, 12, lobe), 0)
    labels[inside & (z < -0.35) & (y < -0.1)] = 11
    for label, (cx, cy, cz, r) in {
        5: (0, 0.5, 0.2, 0.14),
        6: (0.32, -0.2, -0.15, 0.13),
        7: (0.3, 0.1, -0.2, 0.1),
        8: (0.14, -0.12, 0.05, 0.15),
        9: (0.16, 0.25, 0.08, 0.12),
        10: (0.32, 0.12, 0.02, 0.15),
    }.items():
        labels[(np.abs(x) - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2 < r**2] = label
    return labels


def maps_of(
    entries: tuple[ParameterMap, ...], status: NDArray, voxel_mm: tuple[float, float, float], axes: str = ""
) -> MapSet:
    """Maps given as volumes, with a status that is OUTSIDE outside of the mask."""
    mask = np.asfortranarray(status != Status.OUTSIDE)

    def inside(volume: NDArray) -> NDArray:
        return volume.T[mask.T]

    kept = (
        ParameterMap(e.symbol, e.unit, inside(e.value), None if e.percent_se is None else inside(e.percent_se))
        for e in entries
    )
    return MapSet(tuple(kept), inside(status), mask, voxel_mm, axes, {"smoothing": "none"})


def map_set(shape: tuple[int, int, int], symbols: tuple[str, ...] = ("K1", "VT", "vB"), axes: str = "RAS") -> MapSet:
    rng = np.random.default_rng(7)
    labels, k = brain(shape), kinetics(12)
    status = np.where(labels > 0, Status.OK, Status.OUTSIDE).astype(np.uint8)
    draw = rng.random(shape)
    status[(labels > 0) & (draw < 0.03)] = Status.AT_BOUND
    status[(labels == 12) & (draw > 0.9)] = Status.NOT_IDENTIFIABLE
    status[(labels > 0) & (draw > 0.995)] = Status.NO_SIGNAL
    maps = []
    for symbol in symbols:
        truth = np.append(np.nan, k[symbol])[labels]
        value = (truth * rng.normal(1, 0.08, shape)).astype(np.float32)
        value[status == Status.NO_SIGNAL] = np.nan
        error = np.where(np.isfinite(value), 8 + 12 * rng.gamma(1.5, 0.5, shape) / (truth / np.nanmean(truth)), np.nan)
        error[status == Status.NOT_IDENTIFIABLE] = 150
        maps.append(ParameterMap(symbol, UNITS[symbol], value, error.astype(np.float32)))
    chi2 = np.where(labels > 0, rng.gamma(18, 1 / 18, shape), np.nan).astype(np.float32)
    return maps_of((*maps, ParameterMap("chi2", "", chi2)), status, (4.0, 4.0, 4.0), axes)


def report(count: int = 12, *, maps: tuple[int, int, int] | None = (20, 24, 20), models: int = 2) -> FitReport:
    """Two-tissue curves "fitted" with their truth, and with a one-tissue stand-in that misses systematically."""
    names = tuple(NAMES[i] if i < 12 else f"ctx-lh-region-{i}" for i in range(count))
    schedule, k = frames(), kinetics(count)
    clean = two_tissue(k, schedule)
    tacs, weights = noisy(clean, schedule)
    fit = regional("2TCM", tacs, clean, weights, k, 6)
    fit.status[min(7, count - 1)] = Status.AT_BOUND
    simple = {s: k[s] for s in ("K1", "k2", "vB", "VT")}
    wrong = clean * (1 + 0.04 * np.cos(np.sqrt(schedule.mid)))
    truth = tuple(
        TruthRow(name, e.symbol, e.unit, float(k[e.symbol][r]), float(e.value[r]))
        for r, name in enumerate(names)
        for e in fit.estimates
    )
    sections = (
        ModelSection(
            "2TCM",
            fit,
            map_set(maps) if maps else None,
            truth,
            equations=("dC_ND/dt = K1 C_P - (k2 + k3) C_ND + k4 C_S", "dC_S/dt = k3 C_ND - k4 C_S"),
            methods=("Two tissue compartments with blood volume, fitted to frame averages by weighted least squares.",),
            citations=("Innis RB et al. (2007) J Cereb Blood Flow Metab 27:1533, doi:10.1038/sj.jcbfm.9600493",),
        ),
        ModelSection("1TCM", regional("1TCM", tacs, wrong, weights, simple, 4)),
    )
    return FitReport(
        title="sub-01: two-tissue fit of a simulated study",
        models=sections[:models],
        regions=RegionCurves(names, schedule, tacs),
        input=input_curves(),
        scan=(
            ("Tracer", "[18F]example"),
            ("Injected", "370 MBq"),
            ("Frames", "40, 0 to 90 min"),
            ("Voxel", "4 x 4 x 4 mm"),
        ),
        command_line="petkin fit study --model 2TCM 1TCM",
        version="petkin 0.1.0",
        warnings=("Blood samples end at 75 min but the scan at 90 min: the last curve is extrapolated.",),
        limits=("Partial volume is not corrected: small regions read low.",),
        methods=("The model is averaged over each frame, decay-weighted.",),
    )
