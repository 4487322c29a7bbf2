from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

from petkin.errors import InputError
from petkin.io.sidecar import read_sidecar

Write = Callable[..., Path]


@pytest.mark.parametrize(
    "field", ["FrameTimesStart", "FrameDuration", "Units", "TracerRadionuclide", "ImageDecayCorrected"]
)
def test_a_missing_field_is_named_with_its_file(sidecar_file: Write, field: str) -> None:
    with pytest.raises(InputError, match=rf"^sub-01_pet\.json: {field} is missing; [^\n]+$"):
        read_sidecar(sidecar_file(**{field: None}))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"FrameTimesStart": [0, float("nan")]}, r"FrameTimesStart\[1\] is nan; input should be a finite number"),
        ({"FrameDuration": ["long"] * 12}, r"FrameDuration\[0\] is 'long'; input should be a valid number"),
        ({"FrameDuration": [30, 30, 60, 180, 300, 300, 300, 0, 300, 300, 300, 300]}, r"FrameDuration\[7\] is 0 s"),
        ({"FrameDuration": [-30, 30, 60, 180, 300, 300, 300, 300, 300, 300, 300, 300]}, r"FrameDuration\[0\] is -30 s"),
        ({"Units": "", "ImageDecayCorrected": 3}, r"Units is ''; .* \(1 more field\(s\) are wrong\)"),
        ({"FrameDuration": [30, 30]}, "12 values in FrameTimesStart but 2 in FrameDuration"),
        ({"FrameTimesStart": [], "FrameDuration": []}, "FrameTimesStart is \\[\\]"),
        ({"Units": "SUV"}, "Units: unit 'SUV' is not an activity concentration"),
        ({"Units": ""}, "Units is ''"),
        ({"TracerRadionuclide": "Xx99"}, "TracerRadionuclide: Radionuclide 'Xx99' has no half-life"),
        ({"ImageDecayCorrected": "perhaps"}, "ImageDecayCorrected is 'perhaps'"),
        ({"ImageDecayCorrectionTime": "soon"}, "ImageDecayCorrectionTime is 'soon'"),
    ],
)
def test_a_wrong_field_is_one_line_with_file_field_and_value(
    sidecar_file: Write, changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message) as caught:
        read_sidecar(sidecar_file(**changes))
    assert str(caught.value).startswith("sub-01_pet.json: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [("[1, 2]", "holds a list"), ("{", "not valid JSON, line 1"), (b"\xff\xfe{", "not UTF-8"), ("[" * 99999, "nested")],
)
def test_what_is_no_json_object_is_refused(tmp_path: Path, content: str | bytes, message: str) -> None:
    path = tmp_path / "sub-01_pet.json"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError, match=message):
        read_sidecar(path)


def test_overlapping_frames_are_refused_by_file(sidecar_file: Write) -> None:
    starts = [0, 20, 60, 120, 300, 600, 900, 1200, 1500, 1800, 2100, 2400]
    with pytest.raises(InputError, match=r"sub-01_pet.json: frame 2 starts at 20 s but frame 1 ends at 30 s"):
        read_sidecar(sidecar_file(FrameTimesStart=starts)).frames  # noqa: B018


def test_fields_that_no_number_needs_may_be_unreadable(sidecar_file: Write) -> None:
    sidecar = read_sidecar(
        sidecar_file(InjectedRadioactivity="n/a", BodyWeight="heavy", DecayFactor=["x"], TracerName=7)
    )
    assert sidecar.injected_radioactivity is None
    assert sidecar.body_weight is None
    assert sidecar.decay_factor is None
    assert sidecar.tracer_name == "7"


@pytest.mark.parametrize("spelling", ["11C", "C-11", "c11", "C11"])
def test_nuclides_get_bids_spelling(sidecar_file: Write, spelling: str) -> None:
    assert read_sidecar(sidecar_file(TracerRadionuclide=spelling)).nuclide == "C11"


def test_doses_come_in_megabecquerel(sidecar_file: Write) -> None:
    sidecar = read_sidecar(sidecar_file(InjectedRadioactivity=10, InjectedRadioactivityUnits="mCi"))
    assert sidecar.dose_mbq == pytest.approx(370.0)


def test_lower_sidecars_override_higher_ones(tmp_path: Path, sidecar_file: Write) -> None:
    lower = sidecar_file(Units=None)
    higher = tmp_path / "pet.json"
    higher.write_text(json.dumps({"Units": "Bq/mL", "TracerName": "other"}))
    sidecar = read_sidecar([higher, lower])
    assert (sidecar.units, sidecar.tracer_name, sidecar.where) == ("Bq/mL", "DASB", "sub-01_pet.json")


def test_uncorrected_frames_are_brought_back_exactly(sidecar_file: Write) -> None:
    """A constant corrected activity of 1: each frame stores its mean of e^{-lam t}, by quadrature."""
    sidecar = read_sidecar(sidecar_file(ImageDecayCorrected=False))
    lam, frames = np.log(2) / 20.364, sidecar.frames
    stored = [
        quad(lambda t: np.exp(-lam * t), start, end, epsabs=0, epsrel=1e-13)[0] / (end - start)
        for start, end in zip(frames.start, frames.end, strict=True)
    ]
    np.testing.assert_allclose(sidecar.to_time_zero(frames) * stored, 1.0, rtol=1e-12)


def test_an_image_corrected_to_another_time_is_brought_to_time_zero(sidecar_file: Write) -> None:
    sidecar = read_sidecar(sidecar_file(ImageDecayCorrectionTime=20.364 * 60))
    np.testing.assert_allclose(sidecar.to_time_zero(sidecar.frames), 2.0, rtol=1e-12)
