"""Effects of `--include` with more parameters than an amplitude: nothing of them is left, wherever they set in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from petkin.diagnosis import Hypothesis, Term, base_fit, of_nuisance
from petkin.diagnosis.refit import State
from petkin.effects import effect_named
from petkin.imaging import WAYS, Exchange
from petkin.io import RegionalCurves
from petkin.study.diagnose import diagnose_study
from petkin.study.diagnosis.hypotheses import hypothesis_of
from petkin.study.diagnosis.including import in_picture, settled
from petkin.study.diagnosis.preparing import prepared, sources_of
from petkin.study.diagnosis.regional import RegionalSimulator
from petkin.study.diagnosis.request import DiagnoseRequest
from petkin.study.simulate import simulate
from petkin.study.simulation import SimulationSettings

INCLUDES = ("blood_volume", "arterial_delay")
LATE, REGION = 60.0, 2


def simulated(folder: Path, *effects: str) -> Path:
    usual = {"out": folder / "study", "noise": 8.0, "voxel_size": 7.0, "tracer": "reversible", "effects": effects}
    return simulate(SimulationSettings.model_validate(usual))


def ready(study: Path, *include: str, model: str = "2TCM") -> tuple[RegionalCurves, RegionalSimulator]:
    request = DiagnoseRequest(study, model=model, include=(*INCLUDES, *include))
    return prepared(sources_of(request)[2][0], request)


def included(study: Path, out: Path, *include: str) -> tuple[str, str]:
    """Kind of the verdict, and the page."""
    (one,) = diagnose_study(DiagnoseRequest(study, include=(*INCLUDES, *include), out=out))
    return one.answer["verdict"]["kind"], one.report.read_text()


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory.mktemp("plain"))


@pytest.fixture(scope="module")
def mismatched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A gain of 20 percent in one region."""
    return simulated(tmp_path_factory.mktemp("mismatched"), f"attenuation_mismatch=0.2,onset={LATE},region={REGION}")


def test_a_step_far_from_the_usual_onset_is_taken_whole(tmp_path: Path) -> None:
    study = simulated(tmp_path, "gain_step=0.1,onset=70")
    onset = ready(study, "gain_step")[1].settings["gain_step"]["onset"]
    assert onset == pytest.approx(70.0, abs=1.0)
    kind, page = included(study, tmp_path / "out", "gain_step")
    assert kind == "none"
    assert f"onset {onset:.3g} min" in page


def test_the_answer_says_how_large_included_effects_are(tmp_path: Path) -> None:
    study = simulated(tmp_path, "gain_step=0.1,onset=70", "arterial_delay=8")
    request = DiagnoseRequest(study, include=(*INCLUDES, "gain_step"), out=tmp_path / "out")
    (one,) = diagnose_study(request)
    fitted = one.answer["simulator"]["fitted"]
    by_name = {(e["effect"], e["symbol"]): e for e in fitted}
    gain, delay = by_name["gain_step", "gain"], by_name["arterial_delay", "delay"]
    assert gain["low"] - 0.01 < 0.1 < gain["high"] + 0.01
    assert delay["low"] - 0.5 < 8.0 < delay["high"] + 0.5
    assert delay["unit"] == "s"
    assert by_name["gain_step", "onset"]["value"] == pytest.approx(70.0, abs=1.0)
    assert "low" not in by_name["gain_step", "onset"]
    volumes = [e for e in fitted if e["effect"] == "blood_volume"]
    assert [e["region"] for e in volumes] == list(prepared(sources_of(request)[2][0], request)[0].names)
    assert all(0.0 < e["low"] < e["value"] < e["high"] < 0.3 for e in volumes)
    assert f"delay {delay['value']:.3g} s ({delay['low']:.3g} to {delay['high']:.3g})" in one.report.read_text()


def test_every_region_has_its_own_amplitude(mismatched: Path, tmp_path: Path) -> None:
    curves, simulator = ready(mismatched, "attenuation_mismatch")
    assert simulator.settings["attenuation_mismatch"]["onset"] == pytest.approx(LATE, abs=2.0)
    assert simulator.shared.symbols == ("arterial_delay",)
    fit, *_ = base_fit(simulator, curves.values)
    gains = 0.3 * fit.state.own[:, simulator.own.symbols.index("attenuation_mismatch")]
    assert gains[REGION - 1] == pytest.approx(0.2, abs=0.03)
    assert np.abs(np.delete(gains, REGION - 1)).max() < 0.05
    assert included(mismatched, tmp_path / "out", "attenuation_mismatch")[0] == "none"


def test_strong_heterogeneity_stays_within_its_limits(tmp_path: Path) -> None:
    study = simulated(tmp_path, "tissue_heterogeneity=0.6")
    curves, simulator = ready(study, "tissue_heterogeneity")
    lower, upper = hypothesis_of(effect_named("tissue_heterogeneity"), simulator).limits
    for size, spread in ((-9.0, lower), (0.5, 0.4), (9.0, upper)):
        assert simulator.model(simulator.starts[0], np.array([0.0, size])).tissue.spread == pytest.approx(spread)
    fit, *_ = base_fit(simulator, curves.values)
    assert 0.8 * fit.state.shared[1] == pytest.approx(0.6, abs=0.15)
    assert included(study, tmp_path / "out", "tissue_heterogeneity")[0] == "none"


def test_amplitudes_by_region_stay_within_their_limits(plain: Path) -> None:
    _, simulator = ready(plain, "motion_step")
    lower, upper = hypothesis_of(effect_named("motion_step"), simulator).limits
    own = simulator.starts[0].copy()
    ends = [own.copy() for _ in range(4)]
    for end, size in zip(ends, (-9.0, lower / 0.3, upper / 0.3, 9.0)):
        end[:, -1] = size
    seen = [simulator.predict(end, np.zeros(1)) for end in ends]
    assert np.array_equal(seen[0], seen[1])
    assert np.array_equal(seen[2], seen[3])


@pytest.mark.parametrize("order", [("gain_step", "flow_change"), ("flow_change", "gain_step")])
def test_two_are_found_beside_one_another_in_any_order(tmp_path: Path, order: tuple[str, str]) -> None:
    study = simulated(tmp_path, "gain_step=0.08,onset=20", "flow_change=-0.3,onset=55")
    settings = ready(study, *order)[1].settings
    assert settings["gain_step"]["onset"] == pytest.approx(20.0, abs=1.5)
    assert settings["flow_change"]["onset"] == pytest.approx(55.0, abs=3.0)


def test_what_has_an_amplitude_alone_is_as_it_was(plain: Path) -> None:
    curves, simulator = ready(plain, "vascular_trapping", "dead_time", "decay_applied_twice")
    assert settled(simulator, curves.values) is simulator
    assert not simulator.settings
    assert simulator.model(simulator.starts[0], np.zeros(2)).vascular.release == 0.0
    assert simulator.own.symbols == ("K1", "k2", "k3", "k4", "vB", "Kb")


def test_what_cannot_be_seen_has_no_setting(plain: Path) -> None:
    """Metabolites of blood that holds none."""
    curves, simulator = ready(plain)
    simulator = replace(
        simulator,
        input=replace(simulator.input, total_plasma=None),
        includes=(*simulator.includes, effect_named("tissue_metabolite")),
    )
    assert settled(simulator, curves.values).settings == {"tissue_metabolite": {}}


def test_a_second_compartment_has_rates_by_region(plain: Path) -> None:
    curves, simulator = ready(plain, "second_tissue", model="1TCM")
    k4 = simulator.settings["second_tissue"]["k4"]
    assert np.shape(k4) == (len(curves.names),)
    fit, *_ = base_fit(simulator, curves.values)
    rates = simulator.model(fit.state.own, fit.state.shared).tissue.rates
    assert np.array_equal(rates["k4"], k4)
    assert np.ptp(rates["k3"]) > 0
    assert fit.chi2 < 1.3 * fit.residual.size


def test_motion_takes_the_form_that_a_picture_gives_it(plain: Path) -> None:
    curves, simulator = ready(plain, "motion_step")
    count, axis = len(curves.names), 2.0
    shares = 0.01 * np.random.default_rng(0).standard_normal((WAYS, count, count))
    far = np.array([-10.0, 0.0, 10.0])
    simulator = replace(simulator, moves=Exchange(far, far[:, None, None] * shares[:, None]))
    moving = replace(simulator, includes=simulator.includes[:2])
    fit, *_ = base_fit(moving, curves.values)
    motion = hypothesis_of(effect_named("motion_step").form("moved"), moving)
    values = curves.values + _change(moving, fit.state.own, fit.state.shared, motion, onset=LATE, axis=axis)
    found, _ = in_picture(simulator, values, base_fit(simulator, values))
    assert found.includes[-1].amplitude.symbol == "moved"
    assert found.settings["motion_step"]["axis"] == axis
    assert found.settings["motion_step"]["onset"] == pytest.approx(LATE, abs=2.0)
    assert in_picture(found, values, (based := base_fit(found, values)))[1] is based


def test_a_fit_begins_at_the_motion_that_was_found(plain: Path) -> None:
    """What motion does to small regions is much the same either way: from none of it a fit would go wrong."""
    curves, simulator = ready(plain, "motion_step")
    count, axis, moved = len(curves.names), 1.0, 4.0
    far = np.array([-8.0, -4.0, -2.0, 0.0, 2.0, 4.0, 8.0])
    # the first region loses either way, but gains from a little of the right one; the second tells which it was
    even, odd = -0.012 * far**2 + 0.024 * far, 0.006 * far
    shares = np.zeros((WAYS, len(far), count, count))
    shares[int(axis), :, 0, 0], shares[int(axis), :, 1, 1] = even, odd
    simulator = replace(simulator, moves=Exchange(far, shares))
    moving = replace(simulator, includes=simulator.includes[:2])
    fit, *_ = base_fit(moving, curves.values)
    motion = hypothesis_of(effect_named("motion_step").form("moved"), moving)
    place = {"onset": LATE, "axis": axis}
    values = moving.predict(fit.state.own, fit.state.shared, (Term(motion, moved, place),))
    values += curves.values - fit.values
    found, (base, *_) = in_picture(simulator, values, base_fit(simulator, values))
    sizes = dict(zip(found.shared.symbols, base.state.shared * 10.0, strict=True))
    assert sizes["motion_step"] == pytest.approx(moved, abs=1.0)
    from_none = replace(found, begun={})
    assert base.objective < base_fit(from_none, values)[0].objective - 10.0


def _change(
    simulator: RegionalSimulator, own: np.ndarray, shared: np.ndarray, motion: Hypothesis, **setting: float
) -> np.ndarray:
    """What a motion of 5 mm changes."""
    moved = simulator.predict(own, shared, (Term(motion, 5.0, setting),))
    return moved - simulator.predict(own, shared)


def test_what_stands_at_its_limit_still_knows_the_way_back(plain: Path) -> None:
    """A derivative of nought there would leave it where a gap has driven it, whatever explains the gap."""
    _, simulator = ready(plain, "vascular_trapping", "vascular_release")
    place = simulator.shared.symbols.index("vascular_release")
    shared = simulator.shared.mean.copy()
    shared[place] = simulator.limits["vascular_release"][1] / 0.1
    own = simulator.starts[0]
    values, step = simulator.predict(own, shared), simulator.shared.step[place]
    back = shared.copy()
    back[place] -= step
    slope = of_nuisance(simulator, State(own, shared), values)[own.size + place]
    np.testing.assert_allclose(slope, (values - simulator.predict(own, back)) / step, rtol=1e-6)
    assert np.abs(slope).max() > 0.0


def test_a_region_at_its_limit_still_knows_the_way_back(plain: Path) -> None:
    _, simulator = ready(plain, "attenuation_mismatch")
    place, region = simulator.own.symbols.index("attenuation_mismatch"), 1
    own, shared = simulator.starts[0].copy(), simulator.shared.mean
    own[region, place] = simulator.limits["attenuation_mismatch"][1] / 0.3
    values, step = simulator.predict(own, shared), simulator.own.step[place]
    back = own.copy()
    back[region, place] -= step
    slope = of_nuisance(simulator, State(own, shared), values)[region * len(simulator.own.symbols) + place]
    np.testing.assert_allclose(slope, (values - simulator.predict(back, shared)) / step, rtol=1e-6, atol=1e-12)
    assert np.abs(slope[region]).max() > 0.0
