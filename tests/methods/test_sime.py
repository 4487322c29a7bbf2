"""VND of real scans without a reference region, and what one k4 for all regions does to them."""

from __future__ import annotations

import numpy as np
import pytest

from petkin.errors import InputError
from petkin.fitting import Choices, Given
from petkin.imaging import FrameObservation
from petkin.methods import find_method

from ..fitting.real_scans import Scan, read_scans


@pytest.fixture(scope="module")
def scan(shared_data) -> Scan:
    return next(s for s in read_scans(shared_data / "pbr28") if s.name == "cgyu_2")


def fit(scan: Scan, label: str, **choices):
    curves = scan.curves[list(scan.best.region)].to_numpy().T
    given = Given(FrameObservation(scan.frames, mid_frame=True), scan.weights, scan.arterial().delayed(scan.shift))
    return find_method(label).fit(curves, given, Choices(**choices), False)


def test_VND_of_a_real_scan_is_where_the_reference_program_looks_for_it(scan):
    """kinfitr's own tests ask for 0.5 to 2 on this person's scan; all regions' K1/k2 become the one VND."""
    result = fit(scan, "SIMEVND")
    value, percent_se = result.shared["VND"]
    assert 0.5 < value < 2.0
    assert 1.0 < percent_se < 10.0
    np.testing.assert_allclose(result["K1"] / result["k2"], value, rtol=1e-9)
    np.testing.assert_allclose(result["BPND"], result["VT"] / value - 1.0, rtol=1e-9)
    np.testing.assert_allclose(result["VT"], fit(scan, "2TCM")["VT"], rtol=0.08)
    (plot,) = result.plots
    assert plot.mark == value


def test_sharing_VND_in_the_two_tissue_model_is_the_same(scan):
    shared, alone = fit(scan, "2TCM", share=("VND",)), fit(scan, "SIMEVND")
    assert shared.shared == alone.shared
    np.testing.assert_array_equal(shared["VT"], alone["VT"])
    assert (shared.model, alone.model) == ("2TCM", "SIMEVND")


def test_voxels_and_bounds_that_make_no_sense_are_refused(scan):
    with pytest.raises(InputError, match="use --level region"):
        find_method("SIMEVND").fit(np.ones((2, 3)), Given(FrameObservation(scan.frames), scan.weights), Choices(), True)
    with pytest.raises(InputError, match="K1 follows from others of 2TCM here and can be neither bounded nor held"):
        fit(scan, "2TCM", share=("VND",), bounds={"K1": (0.0, 1.0)})
