"""The law of the noise as scans tell it together: against a dense solve, on scans of any law, beside a shared gap."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from petkin.diagnosis import base_fit
from petkin.effects import EFFECTS
from petkin.study.diagnose import diagnose_study
from petkin.study.diagnosis.hypotheses import hypotheses
from petkin.study.diagnosis.judging import law_of_noise, laws_in_common
from petkin.study.diagnosis.noise_law import COUNTS, NoiseLaw
from petkin.study.diagnosis.preparing import prepared, sources_of
from petkin.study.diagnosis.regional import RegionalSimulator
from petkin.study.diagnosis.request import DiagnoseRequest
from petkin.study.diagnosis.scatter import Exponents, Scatter
from petkin.study.diagnosis.shared_law import SharedLaw, of_all, shared_law
from petkin.study.simulate import simulate
from petkin.study.simulation import SimulationSettings

INCLUDES = ("blood_volume", "arterial_delay")
PERCENT = NoiseLaw(2.0, 0.0, 0.0)
Array = NDArray[np.float64]


def looks(departures: Array, error: float, seed: int) -> tuple[Scatter, ...]:
    """What scans say whose exponents depart from counts so far (n, 3)."""
    rng, found = np.random.default_rng(seed), []
    for apart in departures:
        root = rng.standard_normal((3, 3)) / error + np.eye(3)
        information = root @ root.T
        said = apart + np.linalg.cholesky(np.linalg.inv(information)) @ rng.standard_normal(3)
        found.append(Scatter.of(Exponents(information, information @ said)))
    return tuple(found)


def law_of(apart: Array) -> NoiseLaw:
    return NoiseLaw(*map(float, np.add(COUNTS, apart)))


def test_the_mean_of_all_scans_is_said_in_words() -> None:
    laws = [SharedLaw(NoiseLaw(a, 0.4, 1.0), np.zeros((3, 3)), False, 2) for a in (0.2, 0.6)]
    assert of_all(laws).startswith("Noise as 2 scans tell together: variance as value^0.4 e^(0.4 lambda t)")
    assert "as of counts" in of_all([SharedLaw(COUNTS, np.zeros((0, 3)), False, 2)] * 2)
    assert "each is asked alone" in of_all([None, None])


@pytest.mark.parametrize("spread", [0.0, 0.3])
def test_it_is_what_a_dense_solve_of_all_scans_gives(spread: float) -> None:
    count = 30
    rng = np.random.default_rng(1)
    told = looks(np.array([-1.5, 0.4, -0.7]) + spread * rng.standard_normal((count, 3)), 0.05, seed=2)
    found = shared_law(told)
    assert found is not None
    covariance = np.tile(np.eye(3), (count, count)) + np.kron(np.eye(count), spread**2 * np.eye(3))
    errs = np.zeros_like(covariance)
    said = []
    for i, one in enumerate(told):
        errs[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = np.linalg.inv(one.exponents.information)
        said.append(np.linalg.solve(one.exponents.information, one.exponents.score))
    gain = covariance @ np.linalg.inv(covariance + errs)
    apart, left = gain @ np.concatenate(said), covariance - gain @ covariance
    for i, one in enumerate(found):
        here = slice(3 * i, 3 * i + 3)
        assert one.law == pytest.approx(law_of(apart[here]), abs=1e-4)
        assert one.errors.T @ one.errors == pytest.approx(left[here, here], abs=1e-5)


def test_scans_of_counts_say_so_together_and_too_few_say_nothing() -> None:
    none = np.zeros((20, 3))
    found = shared_law(looks(none, 0.4, seed=3))
    assert found is not None
    assert {one.law for one in found} == {COUNTS}
    assert not any(len(one.errors) or one.flatter for one in found)
    assert shared_law(looks(none[:2], 4.0, seed=3)) is None


def test_a_flatter_law_has_its_name_and_another_has_none() -> None:
    flat, other = -0.8 * np.ones((6, 3)), np.tile([1.0, -1.0, -1.0], (6, 1))
    for departures, flatter in ((flat, True), (other, False)):
        found = shared_law(looks(departures, 0.3, seed=4))
        assert found is not None
        assert all(one.flatter == flatter for one in found)


def scan_of(folder: Path, *effects: str, include: tuple[str, ...] = INCLUDES) -> tuple[Array, RegionalSimulator]:
    given = {"out": folder / "study", "noise": 0.01, "tracer": "reversible", "effects": effects}
    study = simulate(SimulationSettings.model_validate(given))
    request = DiagnoseRequest(study, include=include)
    curves, simulator = prepared(sources_of(request)[2][0], request)
    return curves.values, simulator


def noisy(values: Array, simulator: RegionalSimulator, law: NoiseLaw, count: int) -> list[Array]:
    """Scans with noise by a law, of 2 % of the values after the 20th frame."""
    sd = replace(simulator, law=law).spread(values)
    sd = 0.02 * sd / np.median(sd[:, 20:] / values[:, 20:], axis=1, keepdims=True)
    return [values + sd * np.random.default_rng(seed).standard_normal(sd.shape) for seed in range(count)]


def together(scans: list[Array], simulator: RegionalSimulator) -> tuple[SharedLaw | None, ...]:
    candidates = hypotheses(EFFECTS, simulator, without=frozenset())
    return laws_in_common([(simulator, values, candidates) for values in scans], seed=0)


def test_six_scans_tell_a_law_that_none_is_sure_of(tmp_path: Path) -> None:
    values, simulator = scan_of(tmp_path)
    law = NoiseLaw(0.2, 0.6, 0.9)
    scans = noisy(values, simulator, law, 6)
    candidates = hypotheses(EFFECTS, simulator, without=frozenset())
    alone = [law_of_noise(simulator, one, candidates, seed=0)[0] for one in scans]
    assert sum(one is not None and one.odds > 0.95 for one in alone) <= 3
    for shared, one in zip(together(scans, simulator), scans, strict=True):
        assert shared is not None
        assert np.abs(np.subtract(shared.law, law)).max() < 0.5
        assert np.sqrt((shared.errors**2).sum(axis=0))[[0, 2]].max() < 0.15  # 18F hardly decays in 90 min
        told, under, _ = law_of_noise(simulator, one, candidates, seed=0, shared=shared)
        assert told is None
        assert under.law == shared.law


@pytest.mark.parametrize("law", [COUNTS, PERCENT])
def test_a_gap_that_all_scans_have_bends_no_law(tmp_path: Path, law: NoiseLaw) -> None:
    """12 s of delay that is not modelled makes early frames uneven in all scans alike."""
    values, simulator = scan_of(tmp_path, "arterial_delay=12", include=("blood_volume",))
    scans = noisy(values, simulator, law, 6)
    found = together(scans, simulator)
    without = together([one - values + base_fit(simulator, values)[0].values for one in scans], simulator)
    assert without[0] is not None
    assert np.abs(np.subtract(without[0].law, law)).max() < 0.5
    for one in found:
        assert one is None or np.abs(np.subtract(one.law, law)).max() < 0.6
    assert law is COUNTS or found[0] is not None


def test_the_page_says_how_many_scans_tell_it(tmp_path: Path) -> None:
    given = {"out": tmp_path / "study", "noise": 20.0, "tracer": "reversible", "subjects": 4, "voxel_size": 7.0}
    study = simulate(SimulationSettings.model_validate({**given, "effects": ("noise_variance=1",)}))
    *scans, _ = diagnose_study(DiagnoseRequest(study, include=INCLUDES, out=tmp_path / "out"))
    assert all("as 4 scans tell together" in one.report.read_text() for one in scans)
    assert all("noise_variance" in one.answer["verdict"]["set"][0] for one in scans)
    request = DiagnoseRequest(study, include=INCLUDES, without=("noise_variance",), out=tmp_path / "other")
    *scans, _ = diagnose_study(request)
    assert all("variance as of counts" in one.report.read_text() for one in scans)
    assert not any("scans tell together" in one.report.read_text() for one in scans)
