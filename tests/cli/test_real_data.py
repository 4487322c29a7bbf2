"""`petkin fit` on published human data as they are: blood tables in, kinpar.tsv out, every trap named."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from .conftest import Ran, run_command


def fit(study: Path, out: Path, *options: object) -> Ran:
    """2TCM by region with all defaults; of the reports, which take longer than the fits, only the warnings."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("petkin.reporting.render_fit_report", lambda report: "\n".join(report.warnings))
        return run_command("fit", study, "--model", "2TCM", "--out", out, *options)


@pytest.fixture(scope="module")
def pbr28(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Ran]:
    """All 12 scans of [11C]PBR28."""
    out = tmp_path_factory.mktemp("pbr28") / "out"
    return out, fit(shared_data / "pbr28", out)


@pytest.fixture(scope="module")
def mc1(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Ran]:
    """All 24 scans of 12 people with [11C]MC1, in one command."""
    out = tmp_path_factory.mktemp("mc1") / "out"
    return out, fit(shared_data / "ds004869", out)


def estimates(out: Path) -> pd.DataFrame:
    """All kinpar tables below a folder, with the scan each row belongs to."""
    tables = []
    for path in sorted(out.rglob("*_kinpar.tsv")):
        subject, session = path.parts[-4].removeprefix("sub-"), path.parts[-3].removeprefix("ses-")
        delay = json.loads(path.with_suffix(".json").read_text())["InputDelay"]
        tables.append(pd.read_csv(path, sep="\t").assign(PET=f"{subject}_{session}", delay=delay))
    return pd.concat(tables, ignore_index=True)


def test_pbr28_agrees_with_kinfitr(pbr28: tuple[Path, Ran], shared_data: Path) -> None:
    """kinfitr 0.9.1 had its own input curves, a fitted delay and mid-frame values; petkin starts from the tubes."""
    out, ran = pbr28
    assert (ran.status, ran.err) == (0, "")
    found = estimates(out)
    assert len(found) == 12 * 6
    assert np.isfinite(found[["K1", "k2", "k3", "k4", "VB", "VT", "VT-se", "chi2", "aicc"]]).all(axis=None)
    published = pd.read_csv(shared_data / "pbr28/derivatives/kinfitr/kinfitr_reference_fits.tsv", sep="\t")
    theirs = published[(published["model"] == "2tcm_fitvB") & (published["par"] == "Vt")]
    both = found.merge(theirs, left_on=["PET", "name"], right_on=["PET", "region"])
    assert len(both) == 72
    assert np.corrcoef(both["VT"], both["value"])[0, 1] > 0.99
    assert (both["VT"] / both["value"]).median() == pytest.approx(1.0, abs=0.05)
    by_scan = both.groupby("PET")[["VT", "value"]].median()
    np.testing.assert_allclose(by_scan["VT"], by_scan["value"], rtol=0.2)
    assert found["VT-se"].median() < 5


#: Mean |VT difference| of two scans of a person, percent of their mean.
TEST_RETEST = {
    "VT": {"CBL": 10.5, "FC": 14.9, "STR": 20.2, "TC": 13.6, "THA": 19.1, "WB": 13.7},
    "value": {"CBL": 11.2, "FC": 22.5, "STR": 26.9, "TC": 13.9, "THA": 18.1, "WB": 15.7},
}


def test_pbr28_test_retest_beside_kinfitr(pbr28: tuple[Path, Ran], shared_data: Path) -> None:
    """Of VT by 2TCM, as docs/fitting.md has it."""
    published = pd.read_csv(shared_data / "pbr28/derivatives/kinfitr/kinfitr_reference_fits.tsv", sep="\t")
    theirs = published[(published["model"] == "2tcm_fitvB") & (published["par"] == "Vt")]
    both = estimates(pbr28[0]).merge(theirs, left_on=["PET", "name"], right_on=["PET", "region"])
    both[["person", "session"]] = both["PET"].str.split("_", expand=True).to_numpy()
    for column, expected in TEST_RETEST.items():
        scans = both.pivot(index=["person", "region"], columns="session", values=column)
        apart = 200 * (scans["2"] - scans["1"]).abs() / (scans["2"] + scans["1"])
        assert apart.groupby("region").mean().to_dict() == pytest.approx(expected, abs=0.3)
        within = 100 * np.sqrt((np.log(scans["2"] / scans["1"]) ** 2).mean() / 2)
        assert within == pytest.approx({"VT": 13.9, "value": 16.5}[column], abs=0.3)


def test_pbr28_delays_are_those_of_kinfitr(pbr28: tuple[Path, Ran], shared_data: Path) -> None:
    """kinfitr fits the whole brain too (inpshift, min); one of the 12 has two minima, one met its bound of 30 s."""
    published = pd.read_csv(shared_data / "pbr28/derivatives/kinfitr/multistart_2tcm_same_bounds.tsv", sep="\t")
    theirs = published.groupby("PET")["inpshift"].first() * 60
    mine = estimates(pbr28[0]).groupby("PET")["delay"].first()
    off = (mine - theirs).abs()
    assert off.median() < 2
    assert (off < 5).sum() >= 11


def test_pbr28_traps_are_named(pbr28: tuple[Path, Ran]) -> None:
    out, ran = pbr28
    for phrase in (
        "not corrected for dispersion in its lines; its time constant is 2.6 s",
        "Blood ends at 5390 s, 219 s before the last frame does; the input function is extrapolated",
        "(and 11 more alike, see the reports)",
    ):
        assert phrase in ran.out
    for path in out.rglob("*_report.html"):
        assert "its time constant is 2.6 s" in path.read_text()
    assert max(len(line) for line in ran.out.splitlines()[:13]) < 80


def test_pbr28_row_of_zero_duration(shared_data: Path, tmp_path: Path) -> None:
    """As kinfitr ships the curves: a row from 0 to 0 s before the first frame."""
    here, there = tmp_path / "study", shared_data / "pbr28"
    for part in ("sub-cgyu/ses-1", "derivatives/rois/sub-cgyu/ses-1"):
        shutil.copytree(there / part, here / part)
    path = here / "derivatives/rois/sub-cgyu/ses-1/pet/sub-cgyu_ses-1_seg-rois_tacs.tsv"
    path.chmod(0o644)
    heading, *rows = path.read_text().splitlines()
    path.write_text("\n".join([heading, "\t".join(["0"] * len(heading.split("\t"))), *rows]) + "\n")
    ran = fit(here, tmp_path / "out")
    assert ran.status == 0
    assert "1 leading row(s) of no duration hold only zeros; they are no frames and were left out" in ran.out


def test_mc1_is_fitted_in_every_region(mc1: tuple[Path, Ran]) -> None:
    out, ran = mc1
    assert (ran.status, ran.err) == (0, "")
    found = estimates(out)
    regions = found.groupby("PET")["name"].count()
    assert len(regions) == 24
    assert regions.between(107, 109).all()
    usable = found[found["PET"] != "01_blocked"]
    assert np.isfinite(usable[["K1", "VT"]]).all(axis=None)
    assert usable["VT"].between(0.3, 30).mean() > 0.98
    assert (usable["status"] == 0).mean() > 0.9
    assert usable["VT-se"].median() < 5


def test_mc1_traps_are_named(mc1: tuple[Path, Ran]) -> None:
    """The blood of sub-01, blocked, says Bq/mL but is in kBq/mL: nothing of it may look like a result."""
    out, ran = mc1
    for phrase in (
        "InjectedRadioactivity is 653790 Bq but RadionuclideTotalDose is 6.5416e+08 Bq, 1001 times as much",
        "InjectedRadioactivity is 710400 Bq = 0.7104 MBq, which is hard to believe",
        "TracerRadionuclide is '11C'; read as C11",
        "implies a decay reference 4.0 to 6.1 s before ImageDecayCorrectionTime (0 s)",
        "Blood is in kBq/mL, the image in Bq/mL; both are converted",
        "severe sub-01_ses-blocked_recording-manual_blood.tsv: Blood peaks at 0.0775 kBq/mL but tissue at 34.4 kBq/mL",
        "a unit is almost certainly wrong (the blood says Bq/mL), and with it K1 and VT",
        "Blood ends at 7191 s, 9 s before the last frame does",
    ):
        assert phrase in ran.out
    blocked = estimates(out).query("PET == '01_blocked'")
    assert (blocked["status"] != 0).all()
    report = out / "sub-01/ses-blocked/pet/sub-01_ses-blocked_desc-fit_report.html"
    assert "a unit is almost certainly wrong" in report.read_text()
