"""2TCM1k on real curves: kinfitr's fits reproduced where they are at their optimum, undercut elsewhere.

Its bounds, weights and mid-frame values, its input read its way (see test_pbr28). Its integral of the plasma is a
trapezium sum, here a rectangle sum half a step early as for its exponentials: hence Kb 0.2 % up and vB 0.2 % down, and
0.25 % of WRSS in the scan whose objective is steep in time.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import torch

from petkin.fitting import NonlinearSettings, fit_curves
from petkin.imaging import FrameObservation
from petkin.kinetics import VASCULAR_TRAPPING

from .real_scans import read_scans

SYMBOLS = list(VASCULAR_TRAPPING.parameters.symbols)
RATES = dict.fromkeys(("K1", "k2", "k3", "k4"), (1e-4, 0.5))
BOX = VASCULAR_TRAPPING.parameters.with_bounds(RATES | {"Kb": (1e-4, 1.0), "vB": (0.01, 0.1)})
#: Curves whose fit by kinfitr (one start) is not its optimum: all but the striatum of flfp, and some of two others.
MISSED = {
    *((f"flfp_{n}", region) for n in (1, 2) for region in ("CBL", "FC", "TC", "THA", "WB")),
    *(("kzcp_1", region) for region in ("FC", "STR", "THA", "WB")),
    *((f"rbqc_{n}", "STR") for n in (1, 2)),
}


@pytest.fixture(scope="module")
def fits(shared_data) -> pd.DataFrame:
    """A row a curve: kinfitr's WRSS and parameters, petkin's (`_mine`), petkin's WRSS at kinfitr's (`at_theirs`)."""
    table = pd.read_csv(shared_data / "pbr28" / "derivatives" / "kinfitr" / "kinfitr_reference_fits.tsv", sep="\t")
    table = table[table.model == "2tcm1k_fitvB"].pivot_table(index=["PET", "region"], columns="par", values="value")
    rows = []
    for scan in read_scans(shared_data / "pbr28"):
        theirs = table.loc[scan.name].loc[list(scan.best.region)]
        curves, observation = (
            scan.curves[list(scan.best.region)].to_numpy().T,
            FrameObservation(scan.frames, mid_frame=True),
        )
        arterial = scan.arterial_as_the_reference_reads()
        mine = fit_curves(
            curves, arterial, observation, scan.weights, NonlinearSettings(VASCULAR_TRAPPING, parameters=BOX)
        )
        assert mine.predicted is not None
        at_theirs = VASCULAR_TRAPPING.frame_values(
            torch.tensor(theirs[SYMBOLS].to_numpy()), arterial, observation
        ).numpy()
        found = {f"{s}_mine": mine[s] for s in (*SYMBOLS, "VT")} | {"WRSS_mine": scan.wrss(curves, mine.predicted)}
        rows.append(theirs.assign(PET=scan.name, at_theirs=scan.wrss(curves, at_theirs), **found))
    return pd.concat(rows).reset_index().set_index(["PET", "region"])


def test_the_models_mean_the_same(fits):
    """kinfitr's objective at its own parameters, without a fit."""
    assert len(fits) == 72
    np.testing.assert_allclose(fits.at_theirs, fits.WRSS, rtol=4e-3)
    assert np.median(np.abs(fits.at_theirs / fits.WRSS - 1)) < 3e-4


def test_optima_are_reproduced_and_the_others_undercut(fits):
    excess = fits.WRSS_mine / fits.WRSS - 1
    assert set(excess.index[excess < -0.01]) == MISSED
    assert excess[list(MISSED)].max() < -0.07
    assert excess.median() == pytest.approx(0.0, abs=3e-4)
    assert excess.max() < 2e-3


def test_parameters_agree_where_the_optimum_is_the_same(fits):
    """Not at jdcs_2 THA, whose k3 and k4 the curve hardly holds and whose Kb is 0, nor at kzcp_1, all on bounds."""
    same = fits.drop(index=[*MISSED, ("jdcs_2", "THA")])
    same = same[same.index.get_level_values("PET") != "kzcp_1"]
    for symbol, tolerance in {"K1": 3e-4, "k2": 6e-4, "k3": 1.3e-3, "k4": 8e-4, "Kb": 6e-3, "vB": 6e-3}.items():
        np.testing.assert_allclose(same[f"{symbol}_mine"], same[symbol], rtol=tolerance, err_msg=symbol)
    np.testing.assert_allclose(same.VT_mine, same.Vt, rtol=1.5e-4)


def test_the_curve_that_the_notes_pin(fits):
    mine = fits.loc[("cgyu_2", "FC")]
    expected = {"K1": 0.11681, "k2": 0.18379, "k3": 0.22632, "k4": 0.13293, "Kb": 0.15101, "vB": 0.04342, "VT": 1.71766}
    for symbol, value in expected.items():
        assert mine[f"{symbol}_mine"] == pytest.approx(value, rel=2.5e-3), symbol
    assert mine.WRSS_mine == pytest.approx(0.26925, rel=2e-3)
