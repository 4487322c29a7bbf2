"""The blind check's own parts: the generator against closed forms, its strengths, its splits, its scores."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from petkin.errors import InputError
from petkin_bench.withheld import run as runs
from petkin_bench.withheld.cases import SPLITS, case
from petkin_bench.withheld.causes import KNOWN, OTHER_FORMS, UNKNOWN, draw
from petkin_bench.withheld.changes import smeared
from petkin_bench.withheld.judge import ideal
from petkin_bench.withheld.noise import law, noisy
from petkin_bench.withheld.observe import Change, observe, tissue
from petkin_bench.withheld.run import Plan
from petkin_bench.withheld.score import Judged, auroc, calibration_error, metrics, text_of
from petkin_bench.withheld.subject import Subject, draw_subject
from petkin_bench.withheld.visibility import Simulator, perpendicular, seen


@pytest.fixture(scope="module")
def subject() -> Subject:
    return draw_subject(np.random.default_rng(4), 3)


def test_tissue_under_a_constant_input_is_the_closed_form() -> None:
    K1, k2, k3, k4 = 0.2, 0.15, 0.05, 0.03
    t = np.linspace(0.0, 60.0, 600)
    curve, _ = tissue(
        t, np.ones(2 * t.size - 1), np.array([[K1, k2, k3, k4]]), np.ones((1, 4, 1)), np.zeros(1), False, 0.0
    )
    both = np.roots([1.0, -(k2 + k3 + k4), k2 * k4])
    fast, slow = both.max(), both.min()
    weights = K1 * np.array([fast - k3 - k4, k3 + k4 - slow]) / (fast - slow)
    expected = sum(w / a * (1 - np.exp(-a * t)) for w, a in zip(weights, (fast, slow)))
    np.testing.assert_allclose(curve[0], expected, rtol=1e-7, atol=1e-9)


def test_smearing_keeps_the_area_and_lags_by_tau() -> None:
    t = np.linspace(0.0, 60.0, 6001)
    u = np.exp(-0.5 * ((t - 20.0) / 2.0) ** 2)
    out = smeared(t, u, 1.5)
    assert out.sum() == pytest.approx(u.sum(), rel=1e-3)
    assert (t * out).sum() / out.sum() == pytest.approx(21.5, abs=0.01)


def test_a_shorter_step_changes_nothing(subject: Subject) -> None:
    """Frame values under twice as many blood samples, which lie on the same straight lines."""
    blood = subject.blood
    t = np.sort(np.concatenate([blood.t, 0.5 * (blood.t[1:] + blood.t[:-1])]))
    total, whole = np.interp(t, blood.t, blood.total), np.interp(t, blood.t, blood.whole)
    finer = replace(blood, t=t, total=total, whole=whole, parent=np.interp(t, blood.t, blood.parent))
    np.testing.assert_allclose(observe(replace(subject, blood=finer)), observe(subject), rtol=2e-3, atol=1e-6)


@pytest.mark.parametrize("cause", [*KNOWN, *OTHER_FORMS["scored"], *UNKNOWN["scored"]], ids=lambda c: c.name or "none")
def test_every_cause_changes_the_curves_and_vanishes_with_its_size(cause, subject: Subject) -> None:
    drawn = draw(np.random.default_rng(2), subject)
    plain = observe(subject)
    size = 1.0 if cause.flag else 0.2 * cause.most
    changed = observe(subject, (cause.build(size, drawn),))
    assert np.isfinite(changed).all()
    assert np.abs(changed - plain).max() > 1e-6 * plain.max()
    if not cause.flag and cause.name != "dispersion":
        nothing = observe(subject, (cause.build(1e-9, drawn),))
        np.testing.assert_allclose(nothing, plain, rtol=1e-4, atol=1e-6 * plain.max())


def test_what_the_simulator_can_do_is_not_visible(subject: Subject) -> None:
    """Other kinetics, blood volume and delay are refitted; a step of gain is not."""
    other = replace(subject, rates=subject.rates * 1.2, vB=subject.vB * 0.8, delay=subject.delay + 0.05)
    values = observe(other)
    noise = law(values, subject.frames, 2.0, 0.0)
    assert seen(values, Simulator(), subject, noise).detectability < 0.1
    step = np.where(subject.frames.mid > 40.0, 1.05, 1.0)
    assert seen(values * step, Simulator(), subject, noise).detectability > 3.0


@pytest.mark.parametrize("size", [1.0, 2.0, 3.0])
def test_strength_is_what_the_refit_leaves_even_where_rates_go_to_zero(size: float, subject: Subject) -> None:
    """Trapping drives k4 to zero: the straight line on from there would need it negative."""
    trapping = next(c for c in KNOWN if c.name == "vascular_trapping")
    values = observe(subject, (trapping.build(size, draw(np.random.default_rng(2), subject)),))
    noise = law(values, subject.frames, 2.0, 0.0)
    found = seen(values, Simulator(), subject, noise)
    left = np.linalg.norm(noise.whiten(values - observe(found.fitted)))
    assert found.fitted.rates[:, 3].min() < 1e-4
    assert found.detectability == pytest.approx(left, rel=0.01)


def test_noise_has_its_size_share_and_tails(subject: Subject) -> None:
    rng = np.random.default_rng(0)
    noise = law(observe(subject), subject.frames, 2.0, 0.6)
    drawn = np.stack([noisy(np.zeros_like(noise.sd), noise, 0, rng) / noise.sd for _ in range(400)])
    assert drawn.std() == pytest.approx(1.0, abs=0.02)
    assert (drawn[:, 0] * drawn[:, 1]).mean() == pytest.approx(0.6, abs=0.05)
    assert noise.whiten(drawn * noise.sd).std() == pytest.approx(1.0, abs=0.02)
    rough = law(observe(subject), subject.frames, 2.0, 0.6, subject.noisiness)
    np.testing.assert_allclose(rough.sd, subject.noisiness[:, None] * noise.sd)


def test_regions_are_not_equally_noisy() -> None:
    each = np.log([draw_subject(np.random.default_rng(seed), 5).noisiness for seed in range(200)])
    assert each.std() == pytest.approx(0.2, abs=0.02)
    assert each.mean() == pytest.approx(0.0, abs=0.02)


def test_what_is_beyond_the_others() -> None:
    left = np.array([3.0, 4.0, 12.0])
    assert perpendicular(left, [np.array([1.0, 0.0, 0.0])]) == pytest.approx(np.hypot(4.0, 12.0))
    assert perpendicular(left, [np.array([1.0, 0, 0]), np.array([1.0, 0, 1.0])]) == pytest.approx(4.0)


def test_a_case_follows_from_its_numbers_alone() -> None:
    first, again, other = (case(split, 3, 1)[0].values for split in ("scored", "scored", "training"))
    np.testing.assert_array_equal(first, again)
    assert first.shape != other.shape or np.abs(first - other).max() > 0
    assert len(set(SPLITS.values())) == len(SPLITS)


def test_strengths_lie_in_their_bins() -> None:
    for index in range(12):
        _, answer = case("training", 11, index)
        if answer.kind in ("known", "other form"):
            assert answer.detectability > 3.5
            assert answer.names[0] in answer.classes[0]
        if answer.kind == "pair":
            assert answer.perpendicular >= 6.0
        if answer.kind == "unknown":
            assert 0.0 <= answer.perpendicular <= answer.detectability


def judged(**cells: object) -> Judged:
    usual = {
        "kind": "known", "noise": "iid", "classes": "a|b", "stages": "clock", "detectability": 9.0, "ceiling": 0.97,
        "perpendicular": 0.0, "frame": -1, "region": -1, "verdict": "named", "leader": "a", "leader_probability": 0.9,
        "set": "a", "set_probability": 0.95, "unknown_probability": 0.02, "stage": "clock", "onset_frame": -1,
        "regions": "", "closure": 0.9, "closure_low": 0.7, "closure_high": 1.0, "closed": 0.95, "seconds": 1.0,
        "names": "a", "size": 0.0, "sets_in": -1.0, "amplitude": "", "amplitude_low": "", "amplitude_high": "",
        "onset": "", "onset_low": "", "onset_high": "",
    }  # fmt: skip
    return Judged({name: str(value) for name, value in (usual | cells).items()})


def test_a_cause_is_right_when_it_is_of_the_class() -> None:
    assert judged().right
    assert judged(leader="b").right
    assert not judged(leader="c").right
    assert not judged(verdict="none").right
    pair = judged(kind="pair", classes="a|b;c", leader="a+c", set="a;a+c")
    assert pair.right
    assert pair.covered
    assert not judged(kind="pair", classes="a|b;c", leader="a", set="a").covered


def test_scores_stand_beside_their_bars() -> None:
    nulls = [
        judged(kind="none", classes="", verdict=v, leader="", set="", detectability=0.0) for v in ("none", "named")
    ]
    found = {m.name: m for m in metrics([judged(), judged(leader="c", set="c"), *nulls])}
    assert found["class first, d' 8-12"].value == 0.5
    assert found["class first, d' 8-12"].met is False
    assert found["false alarms, iid"].value == 0.5
    assert found["set covers, d' >= 6, at least"].cases == 2
    assert found["pairs: both named"].met is None
    assert "class first" in text_of(list(found.values()))


def test_sizes_are_those_of_the_very_name_whatever_their_sign() -> None:
    """One that is near and held, one whose interval misses it, one of another name, one of another form."""
    step = {
        "names": "gain_step",
        "leader": "gain_step",
        "classes": "gain_step|gain_drift",
        "size": 0.05,
        "sets_in": 30.0,
    }
    held = {"amplitude": -0.046, "amplitude_low": -0.052, "amplitude_high": -0.04}
    missed = {"amplitude": 0.09, "amplitude_low": 0.08, "amplitude_high": 0.1}
    early = {"onset": 28.0, "onset_low": 27.0, "onset_high": 29.0}
    late = {"onset": 31.0, "onset_low": 29.0, "onset_high": 32.0}
    cases = [
        judged(**step | held | late),
        judged(**step | missed | early),
        judged(**step | missed | early | {"leader": "gain_drift"}),
        judged(**step | missed | late | {"kind": "other form"}),
    ]
    found = {m.name: (m.value, m.cases) for m in metrics(cases)}
    assert found["amplitude within 0.20"] == (0.5, 2)
    assert found["amplitude interval holds it"] == (0.5, 2)
    assert found["onset interval holds it"] == (0.5, 2)


def test_an_answer_says_how_large_and_from_when_on() -> None:
    answers = [case("training", 11, index)[1] for index in range(12)]
    for answer in answers:
        assert (answer.onset >= 0) == (answer.onset > 0)
        assert answer.onset < 0 or answer.frame >= 0
        assert (answer.size > 0) <= (answer.kind not in ("none", "pair"))
    assert any(answer.onset > 0 for answer in answers)
    assert any(answer.size > 0 for answer in answers)


def test_areas_and_calibration_by_hand() -> None:
    assert auroc(np.array([0.9, 0.5]), np.array([0.1, 0.5])) == pytest.approx(0.875)
    assert calibration_error(np.full(10, 0.8), np.array([1.0] * 8 + [0.0] * 2)) == pytest.approx(
        0.4 * 0.8 + 0.6 * 0.2, abs=0.2
    )
    assert calibration_error(np.array([0.0, 1.0]), np.array([0.0, 1.0])) == 0.0


def test_a_run_goes_on_where_it_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def told(plan: runs.Plan, index: int) -> tuple[dict[str, object], dict[str, object]]:
        asked.append(index)
        return {"index": index, "kind": "none"}, {"index": index, "verdict": "none"}

    monkeypatch.setattr(runs, "judged", told)
    plan = runs.Plan("training", 0, 2, 5, 40)
    runs.run(plan, tmp_path, told=lambda _: None)
    verdicts, answers = runs.run(replace(plan, cases=4), tmp_path, told=lambda _: None)
    assert asked == [0, 1, 2, 3]
    assert len(verdicts.read_text().splitlines()) == len(answers.read_text().splitlines()) == 5


def test_an_unknown_split_is_one_line() -> None:
    with pytest.raises(ValueError, match="--split 'test': give training or scored"):
        runs.Plan("test", 0, 2, 5, 40)


def test_changes_add_up(subject: Subject) -> None:
    """Two scanners in a row are one after the other; no change at all is the subject."""
    double = Change(scanner=lambda x, _: 2.0 * x)
    np.testing.assert_allclose(observe(subject, (double, double)), 4.0 * observe(subject))


def test_a_reader_who_must_find_the_settings_is_asked_of_single_causes_alone() -> None:
    told = {}
    for index in range(8):
        scan, answer = case("training", 5, index)
        told[index] = (answer, ideal(scan, answer, seed=index))
    asked = {index: (answer, row) for index, (answer, row) in told.items() if row["ideal"] != ""}
    assert asked
    assert all(answer.kind in ("known", "other form") for answer, _ in asked.values())
    shares = np.array([[row["ideal"], row["ideal_claimed"]] for _, row in asked.values()], float)
    assert ((shares >= 0.0) & (shares <= 1.0)).all()
    assert (shares[:, 1] <= shares[:, 0]).all()
    assert shares[:, 0].max() > 1.0 / len(KNOWN)
    strong = [row for answer, row in asked.values() if answer.detectability > 8.0]
    assert strong
    assert all(row["ideal_claimed"] == row["ideal"] for row in strong)


@pytest.mark.parametrize(("regions", "frames"), [(1, "clinical"), (2, "short"), (20, "clinical")])
def test_scans_of_one_region_many_regions_and_short_frames(regions: int, frames: str) -> None:
    """The last has a refit that leads to where curves explode, which explains nothing."""
    for index in (0, 4, 56):
        scan, answer = case("training", 48, index, regions, frames)
        assert scan.values.shape == (regions, 80 if frames == "short" else scan.frames.start.size)
        assert np.isfinite(scan.values).all()
        assert answer.kind == "none" or answer.detectability > 0


def test_frames_of_no_schedule_are_refused() -> None:
    with pytest.raises(InputError, match="--frames 'long'"):
        Plan("scored", 3, 1, 5, 100, frames="long")
