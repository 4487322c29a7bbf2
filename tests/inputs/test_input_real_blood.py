"""Real blood: twelve [11C]PBR28 scans beside kinfitr 0.9.1's curves, and the [11C]MC1 scans of ds004869."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch

from petkin.inputs import from_blood, from_table

PBR28 = [(s, v) for s in ("cgyu", "flfp", "jdcs", "kzcp", "rbqc", "rtvg") for v in "12"]


def _read(path: Path) -> pd.DataFrame:
    table = pd.read_csv(path, sep="\t", na_values="n/a")
    return table.assign(time=table["time"] / 60)


@pytest.mark.parametrize(("subject", "session"), PBR28)
def test_pbr28_areas_lie_near_kinfitr(shared_data, subject, session):
    folder, name = Path(f"sub-{subject}/ses-{session}/pet"), f"sub-{subject}_ses-{session}"
    root = shared_data / "pbr28"
    manual = _read(root / folder / f"{name}_recording-manual_blood.tsv")
    automatic = _read(root / folder / f"{name}_recording-automatic_blood.tsv")
    theirs = _read(root / "derivatives/kinfitr" / folder / f"{name}_inputfunction.tsv")
    kinfitr = from_table(theirs.time, theirs.AIF, theirs.whole_blood_radioactivity)
    ours = from_blood(manual, automatic, dispersion=2.6 / 60, scan_end=90.0, required_until=85.0, where=name)
    until = torch.tensor([theirs.time.iloc[-1]], dtype=torch.float64)
    # Peak: the same data and correction. Later kinfitr draws straight lines between samples that lie on a convex curve,
    # which by our laboratory's truth overestimates: 2 to 5 % of the whole here, 4 to 10 % of what follows 10 min.
    assert ours.area(2.0) == pytest.approx(kinfitr.area(2.0), rel=0.03)
    assert -0.06 < ours.area(float(until)) / kinfitr.area(float(until)) - 1 < 0.005
    assert float(ours.whole_blood.integral(until)) == pytest.approx(
        float(kinfitr.whole_blood.integral(until)), rel=0.012
    )
    assert ours.plasma.knots.size < 900
    assert ours.parent_fraction_fit is not None
    assert np.abs(ours.parent_fraction_fit.fitted - ours.parent_fraction_fit.values).max() < 0.06


@pytest.mark.parametrize("subject", ["01", "04", "07", "11"])
def test_ds004869_curves_pass_their_samples(shared_data, subject):
    for path in sorted((shared_data / "ds004869" / f"sub-{subject}").glob("ses-*/pet/*_blood.tsv")):
        manual = _read(path)
        scan_end = np.ceil(manual.time.iloc[-1])
        found = from_blood(manual, scan_end=scan_end, required_until=scan_end - 6, where=path.name)
        t = torch.tensor(manual.time.to_numpy())
        np.testing.assert_allclose(found.total_plasma(t).numpy(), manual.plasma_radioactivity, rtol=1e-9)
        np.testing.assert_allclose(found.whole_blood(t).numpy(), manual.whole_blood_radioactivity, rtol=1e-9)
        measured = manual.plasma_radioactivity * manual.metabolite_parent_fraction
        late = manual.time > 2.4
        np.testing.assert_allclose(found.plasma(t).numpy()[late], measured[late], rtol=0.17)
        straight = np.trapezoid(np.append(0, measured), np.append(0, manual.time))
        assert -0.07 < found.area(manual.time.iloc[-1]) / straight - 1 < 0.0
        assert found.plasma.knots.size < 350


def test_the_common_bench_input_is_read_exactly(shared_data):
    table = pd.read_csv(shared_data / "bench" / "input_1s.tsv", sep="\t")
    found = from_table(table.time_min, table.Cp)
    assert found.area(90.0) == pytest.approx(np.trapezoid(table.Cp, table.time_min), rel=1e-6)
