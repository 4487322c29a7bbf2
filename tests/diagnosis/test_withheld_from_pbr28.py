"""Published human [11C]PBR28 scans: effects that the simulator is denied are in the set that the diagnosis gives.

What else a real scan holds has no ground truth, so an effect often comes with a second one.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from petkin.diagnosis import diagnose
from petkin.diagnosis.nominal import base_fit
from petkin.effects import EFFECTS, effect_named
from petkin.io import RegionalCurves
from petkin.study.diagnose import ALWAYS
from petkin.study.diagnosis.hypotheses import hypotheses
from petkin.study.diagnosis.preparing import prepared, sources_of
from petkin.study.diagnosis.regional import RegionalSimulator
from petkin.study.diagnosis.request import FITTED, RECORDED, DiagnoseRequest

SUBJECTS = ("cgyu", "flfp")
SCANS = 4


def scans(
    folder: Path, model: str, *include: str, subjects: tuple[str, ...] = SUBJECTS, blood: str = RECORDED
) -> list[tuple[RegionalCurves, RegionalSimulator]]:
    request = DiagnoseRequest(folder / "pbr28", model, include, subjects=subjects, seg="rois", blood=blood)
    return [prepared(source, request) for source in sources_of(request)[2]]


def names_in_set(curves: RegionalCurves, simulator: RegionalSimulator) -> set[str]:
    candidates = hypotheses(EFFECTS, simulator, without=frozenset())
    answer = diagnose(simulator, curves.values, candidates, always=ALWAYS, draws=100)
    return {name for label in answer.chosen for name in label.split("+")}


def test_a_second_compartment(shared_data: Path) -> None:
    """18 of 20 in the published comparison; with a second effect beside it in most of these."""
    kept = scans(shared_data, "1tcm", "blood_volume", "arterial_delay", "vascular_trapping")
    assert len(kept) == SCANS
    assert sum("second_tissue" in names_in_set(*scan) for scan in kept) >= 3


def test_a_clock_ten_seconds_off(shared_data: Path) -> None:
    """The blood record is moved to where it fits, and 10 s beyond; clocks of frames and blood cannot be told apart."""
    found = 0
    for curves, simulator in scans(shared_data, "2tcm", "blood_volume", "vascular_trapping"):
        timed = replace(simulator, includes=(*simulator.includes, effect_named("arterial_delay")))
        fit, *_ = base_fit(timed, curves.values)
        seconds = 50.0 * float(fit.state.shared[0])
        late = replace(simulator, input=simulator.input.delayed((seconds + 10.0) / 60.0))
        found += bool({"arterial_delay", "frame_offset"} & names_in_set(curves, late))
    assert found == pytest.approx(SCANS)


def test_what_is_trapped_and_returns_is_told_from_what_stays(shared_data: Path) -> None:
    """Curves of two fits of a scan, with noise as it has: walls that let go, and walls that do not."""
    walls = ("blood_volume", "arterial_delay", "vascular_trapping")
    kept = scans(shared_data, "2tcm", *walls, "vascular_release", subjects=("jdcs",), blood=FITTED)
    for curves, leaking in kept:
        tight = replace(leaking, includes=tuple(effect_named(name) for name in walls))
        candidates = hypotheses(EFFECTS, tight, without=frozenset())
        rng = np.random.default_rng(1)
        for simulator, returns in ((leaking, True), (tight, False)):
            fit, noise, *_ = base_fit(simulator, curves.values)
            drawn = noise.coloured(rng.standard_normal(fit.values.size))
            answer = diagnose(tight, fit.values + drawn, candidates)
            assert answer.chosen == (("vascular_release",) if returns else ())
            if returns:
                released = answer.causes[0].estimates[0]
                kr = 0.1 * float(fit.state.shared[leaking.shared.symbols.index("vascular_release")])
                assert 0.02 < kr < 0.05
                assert released.low < kr < released.high


def test_a_parent_fraction_measured_with_care_is_seldom_far_off(shared_data: Path) -> None:
    """Chromatography with its recovery corrected, as these sidecars say: a tenth of the range is likely, else all."""
    _, simulator = scans(shared_data, "2tcm", "blood_volume", "arterial_delay")[0]
    careful, careless = (
        next(h for h in hypotheses(EFFECTS, one, without=frozenset()) if h.name == "parent_fraction")
        for one in (simulator, replace(simulator, measured=frozenset()))
    )
    assert careful.width == pytest.approx(0.1 * careless.width)
