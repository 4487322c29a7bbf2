"""Real curves: the linear methods of kinfitr, 12 scans x 6 regions, its weights, last ten frames, vB fixed at 0.05.

Its own discretisation, written out, gives its numbers; what is left between its numbers and petkin's is therefore that
discretisation: trapezoids through the middles of frames where petkin has the frames' areas.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from petkin.fitting import Choices, Given
from petkin.imaging import FrameObservation
from petkin.methods import find_method

from ..fitting.real_scans import Scan, read_scans
from .trapezoids import FRAMES_USED, as_the_reference_computes

VB = 0.05


@pytest.fixture(scope="module")
def scans(shared_data) -> list[Scan]:
    return read_scans(shared_data / "pbr28")


@pytest.fixture(scope="module")
def known(shared_data) -> pd.Series:
    table = pd.read_csv(shared_data / "pbr28/derivatives/kinfitr/kinfitr_reference_fits.tsv", sep="\t")
    return table.set_index(["PET", "region", "model", "par"])[["value", "se_pct"]]


def test_the_reference_s_discretisation_gives_its_numbers(scans, known):
    """To its six digits and more: only VT and vB of two nearly unidentifiable curves feel the rounding."""
    off: dict[tuple[str, str], list[float]] = {}
    for scan in scans:
        for region in scan.best.region:
            for key, value in as_the_reference_computes(scan, scan.curves[region].to_numpy(), VB).items():
                off.setdefault(key, []).append(abs(value / known.value[scan.name, region, *key] - 1.0))
    assert all(len(errors) == 72 for errors in off.values())
    for key, errors in off.items():
        assert np.median(errors) < 1e-5, key
        assert max(errors) < (3e-3 if key[0] == "lin2tcm" else 2e-4), key


#: Percent between petkin and kinfitr, by method, symbol and its model and parameter: median, and nine in ten below.
APART = {
    ("Logan", "VT", "logan_t10", "Vt"): (0.2, 0.3),
    ("MA1", "VT", "ma1_t10", "Vt"): (0.2, 0.3),
    ("MA2", "VT", "ma2", "Vt"): (0.15, 1.5),
    ("MA2", "K1", "ma2", "K1"): (0.2, 0.5),
    ("LS2TCM", "VT", "lin2tcm", "Vt"): (0.2, 2.0),
    ("LS2TCM", "K1", "lin2tcm", "K1"): (0.4, 1.2),
    ("LS2TCM", "vB", "lin2tcm", "vB"): (3.0, 6.0),
}


def test_petkin_agrees_within_that_discretisation(scans, known):
    apart: dict[tuple[str, str, str, str], list[float]] = {key: [] for key in APART}
    for scan in scans:
        found = {label: estimates(scan, label) for label in ("Logan", "MA1", "MA2", "LS2TCM")}
        for key, errors in apart.items():
            label, symbol, model, parameter = key
            for region, value in zip(scan.best.region, found[label][symbol]):
                errors.append(100.0 * abs(value / known.value[scan.name, region, model, parameter] - 1.0))
    for key, (middle, most) in APART.items():
        assert len(apart[key]) == 72
        assert np.median(apart[key]) < middle, key
        assert np.quantile(apart[key], 0.9) < most, key


def estimates(scan: Scan, label: str) -> dict[str, np.ndarray]:
    """Estimates of all regions in the reference's terms: ratios of the Logan plot unweighted, 1 - vB left in."""
    arterial, observation = scan.arterial().delayed(scan.shift), FrameObservation(scan.frames)
    choices = Choices(fixed={} if label == "LS2TCM" else {"vB": VB}, t_star=float(scan.frames.mid[-FRAMES_USED]) - 1e-9)
    curves = scan.curves[list(scan.best.region)].to_numpy().T
    groups = [(curves, scan.weights)]
    if label == "Logan":
        blood = np.asarray(observation.of_forcing(arterial.whole_blood))
        tissue = np.maximum((curves - VB * blood) / (1.0 - VB), 1e-2)
        groups = [(c[None], (scan.weights > 0) / t**2) for c, t in zip(curves, tissue)]
    results = [find_method(label).fit(c, Given(observation, w, arterial), choices, True) for c, w in groups]
    found = {e.symbol: np.concatenate([r[e.symbol] for r in results]) for e in results[0].estimates}
    left_in = 1.0 - found["vB"] if label == "LS2TCM" else 1.0
    return {symbol: values * (left_in if symbol in ("K1", "VT") else 1.0) for symbol, values in found.items()}


def test_patlak_agrees_in_its_standard_errors(scans, known):
    """Ki of this reversible tracer is next to zero: a relative difference says little."""
    apart = []
    for scan in scans:
        given = Given(FrameObservation(scan.frames), scan.weights, scan.arterial().delayed(scan.shift))
        choices = Choices(fixed={"vB": VB}, t_star=float(scan.frames.mid[-FRAMES_USED]) - 1e-9)
        result = find_method("Patlak").fit(scan.curves[list(scan.best.region)].to_numpy().T, given, choices, True)
        for region, Ki in zip(scan.best.region, result["Ki"]):
            reference = known.loc[(scan.name, region, "patlak_t10", "Ki")]
            apart.append((Ki / reference.value - 1.0) / (reference.se_pct / 100.0))
    assert len(apart) == 72
    assert np.median(np.abs(apart)) < 0.05
    assert np.abs(apart).max() < 0.3
