"""Where refits begin, and how much of their evidence counts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from petkin.diagnosis import Shape, Term
from petkin.diagnosis.covariance import Noise
from petkin.diagnosis.diagnose import _Explained, _explained, scan_of
from petkin.diagnosis.nominal import base_fit
from petkin.diagnosis.occam import _apart, after_refit
from petkin.diagnosis.refit import Fit, State, _within, refit
from petkin.diagnosis.scan import Scan, starts
from petkin.diagnosis.which import Candidate, _with_rest, as_promised, halfway, refitted

from .decaying_channels import AVERAGED, HYPOTHESES, TRUTH, DecayingChannels, hypothesis, measured


def test_a_refit_begins_at_settings_that_look_otherwise() -> None:
    simulator = DecayingChannels()
    data = measured(np.random.default_rng(3), Term(hypothesis("ripple"), 0.3, {"pitch": 3.0}))
    base, noise, _, _ = base_fit(simulator, data)
    scan = scan_of(simulator, noise, base, HYPOTHESES)
    each = scan.each(base.residual)
    (only,) = starts(scan, base.residual, each, "ripple")
    assert only.setting["pitch"] == 3.0
    steps = starts(scan, base.residual, each, "step", 3)
    looks = [scan.look(_place(scan, term), base.residual) for term in steps]
    assert 1 <= len(steps) <= 3
    assert all(abs(a @ b) < 0.8 for i, a in enumerate(looks) for b in looks[:i])
    values = [each[_place(scan, term)] for term in steps]
    assert values == sorted(values, reverse=True)
    assert values[0] == max(e for t, e in zip(scan.templates, each) if t.hypothesis.name == "step")


def _place(scan: Scan, term: Term) -> int:
    return next(
        i
        for i, t in enumerate(scan.templates)
        if t.hypothesis.name == term.hypothesis.name and t.setting == dict(term.setting)
    )


def test_evidence_lies_between_scan_and_refit_but_near_the_refit() -> None:
    weak, flag = (Term(hypothesis("offset"), 0.1, {}),), (Term(hypothesis("clipped"), 1.0, {}),)
    assert halfway(12.0, 10.0, weak) == 11.0
    assert halfway(10.0, 12.0, weak) == 11.0
    assert halfway(100.0, 10.0, weak) == pytest.approx(97.0)
    assert halfway(100.0, 10.0, flag) == 100.0


def test_a_refit_that_failed_is_no_evidence() -> None:
    """Given up far from any minimum it fits worse than no effect, and its evidence is no more than half that loss."""
    simulator = DecayingChannels()
    data = measured(np.random.default_rng(3), Term(hypothesis("offset"), 0.1, {}))
    base, noise, _, _ = base_fit(simulator, data)
    scan = scan_of(simulator, noise, base, HYPOTHESES)
    (term,) = starts(scan, base.residual, scan.each(base.residual), "step")
    strong = replace(term, amplitude=term.amplitude + 5.0)
    begin = State(base.state.own, base.state.shared, (strong,))
    left = refit(simulator, data, noise, begin, iterations=1, behind=-np.inf)
    followed = refit(simulator, data, noise, begin, iterations=1)
    assert followed.objective < left.objective
    gain = base.objective - left.objective
    assert gain < 0
    assert after_refit(base, left, len(simulator.channels), 0) <= 0.5 * gain + 4.0  # what volumes may add


def test_what_is_not_refitted_is_held_against_the_best_as_the_scan_has_both() -> None:
    """Without what the best is spared since its residual may be noise of single channels, which no scan knows."""
    best = Candidate(("a",), None, 100.0, spared=-50.0)
    ranked = {c.label: c.log_evidence for c in _with_rest([best], {"a": 160.0, "b": 120.0, "c": 149.0})}
    assert ranked == {"a": 100.0, "c": 97.0, "b": 70.0}
    known = {c.label: c.log_evidence for c in _with_rest([best], {"a": 160.0, "b": 120.0}, {"b": 41.0})}
    assert known == {"a": 100.0, "b": 59.0}


def test_shapes_of_each_channel_cost_what_their_prior_loses() -> None:
    """ln of the mean of a likelihood over priors of the shapes, less that of the best, for all channels but one."""
    rng, sd = np.random.default_rng(5), 0.7
    pitch = replace(hypothesis("ripple"), by_channel=True, shapes=(Shape("pitch", 0.5, 6.0, by_channel=True, sd=sd),))
    term = Term(pitch, np.full(3, 0.2), {"pitch": np.full(3, 2.0)})
    columns = np.zeros((3, 3, 8))
    columns[range(3), range(3)] = np.array([[0.3], [2.0], [9.0]]) * rng.standard_normal((3, 8)) / 8**0.5
    jacobian = np.concatenate([np.zeros((24, 3)), columns.reshape(3, 24).T], axis=1)
    penalty = np.array([1.0, 1.0, 1.0, *[sd**-2.0] * 3])
    state = State(np.zeros((3, 0)), np.zeros(0), (term,))
    fit = Fit(state, np.zeros((3, 8)), np.zeros(24), penalty, np.zeros(6), 0.0, jacobian, 0)
    told = (jacobian[:, 3:] ** 2).sum(axis=0)
    each = [quad(lambda z, i=i: norm.pdf(z, 0.0, sd) * np.exp(-0.5 * i * z * z), -8.0, 8.0)[0] for i in told]
    assert _apart(term, fit, {"": slice(0, 3), "pitch": slice(3, 6)}) == pytest.approx(-2.0 / 3.0 * np.log(each).sum())
    assert _apart(term, replace(fit, jacobian=0.0 * jacobian), {"": slice(0, 3), "pitch": slice(3, 6)}) < 1e-9


def test_a_step_that_meets_a_limit_goes_on_along_it() -> None:
    """Cutting what leaves the room would undo the rest of the step; with all else free again it is lower."""
    rng = np.random.default_rng(8)
    better = 0
    for _ in range(50):
        root, slope = rng.standard_normal((9, 6)), 3.0 * rng.standard_normal(6)
        normal, lower, upper = root.T @ root, np.full(6, -0.2), np.full(6, np.inf)
        lower[:3] = -np.inf

        def fall(step: np.ndarray, normal: np.ndarray = normal, slope: np.ndarray = slope) -> float:
            return float(slope @ step - 0.5 * step @ normal @ step)

        step, cut = _within(normal, slope, lower, upper), np.clip(np.linalg.solve(normal, slope), lower, upper)
        assert (step >= lower).all()
        assert fall(step) > fall(cut) - 1e-9
        assert fall(step) > 0
        better += fall(step) > fall(cut) + 1e-6
    assert better > 20


def _sets_in(seed: int, onset: float, amplitude: float) -> tuple[DecayingChannels, np.ndarray, Term]:
    """Data in which all channels change at once, strongly, within a sample."""
    simulator, truth = DecayingChannels(count=20), Term(AVERAGED, amplitude, {"onset": onset})
    values = simulator.predict(TRUTH, np.zeros(0), (truth,))
    return simulator, values + 0.05 * np.random.default_rng(seed).standard_normal(values.shape), truth


@pytest.mark.parametrize(
    ("seed", "onset", "amplitude", "begin"), [(0, 6.99, 0.4, 6.52), (0, 6.99, 0.4, 6.78), (3, 6.69, -0.4, 6.52)]
)
def test_a_weak_step_grows_into_a_strong_one(seed: int, onset: float, amplitude: float, begin: float) -> None:
    """The objective has a kink between two samples, at which a refit must not end for want of a slope."""
    simulator, data, truth = _sets_in(seed, onset, amplitude)
    base, noise, _, _ = base_fit(simulator, data)
    best = refit(simulator, data, noise, State(TRUTH, base.state.shared, (truth,)))
    weak = Term(AVERAGED, 0.1 * amplitude, {"onset": begin})
    found = refit(simulator, data, noise, State(base.state.own, base.state.shared, (weak,)))
    assert base.objective > best.objective + 100.0
    assert found.objective < best.objective + 5.0


def test_a_refit_that_holds_less_than_was_promised_begins_anew() -> None:
    simulator, data, truth = _sets_in(3, 2.51, -0.4)
    base, noise, _, _ = base_fit(simulator, data)
    best = refitted(simulator, data, noise, base, State(TRUTH, base.state.shared, (truth,)))
    stray = State(base.state.own, base.state.shared, (replace(truth, setting={"onset": 8.0}),))
    astray = refitted(simulator, data, noise, base, stray)
    assert astray.gain < best.gain - 200.0
    terms = (replace(truth, setting={"onset": 2.4}),)
    assert as_promised(simulator, data, noise, base, astray, terms, astray.log_evidence) is astray
    renewed = as_promised(simulator, data, noise, base, astray, terms, best.log_evidence)
    assert renewed.gain > best.gain - 10.0


def _ranked(data: np.ndarray, doubt: float) -> dict[str, float]:
    """log evidence of everything, where all channels are taken to have the noise that most of them have."""
    simulator, count = DecayingChannels(count=30), len(data)
    noise = Noise(np.ones_like(data), np.full(count, 0.05), 0.0, doubt=np.full(count, doubt))
    base = refit(simulator, data, noise, State(simulator.starts[0], np.zeros(0)))
    first = _Explained(noise, base, scan_of(simulator, noise, base, HYPOTHESES), [])
    return {c.label: c.log_evidence for c in _explained(simulator, data, first, frozenset()).ranked}


def _lead(found: dict[str, float]) -> float:
    """By how much the step alone is likelier than the likeliest pair."""
    return found["step"] - max([value for label, value in found.items() if "+" in label], default=-np.inf)


def test_the_noise_of_one_channel_is_no_second_cause() -> None:
    """One channel scatters 2.7 times as much as it is taken to: what it alone shows may be noise, unless it is seen
    in a channel that does not."""
    step, jump = (
        Term(hypothesis("step"), 0.1, {"onset": 4.0}),
        Term(hypothesis("local step"), np.zeros(4), {"onset": 6.5}),
    )
    sure, unsure, beside = [], [], []
    for seed in range(12):
        noise = 0.05 * np.random.default_rng(seed).standard_normal((4, 30))
        loud = np.array([1.0, 1.0, 2.7, 1.0])[:, None]
        both = (step, replace(jump, amplitude=np.array([0.0, 0.3, 0.0, 0.0])))
        simulator = DecayingChannels(count=30)
        alone, together = (simulator.predict(TRUTH, np.zeros(0), terms) for terms in ((step,), both))
        sure.append(_lead(_ranked(alone + loud * noise, 0.0)))
        unsure.append(_lead(_ranked(alone + loud * noise, 0.15)))
        beside.append(_lead(_ranked(together + noise, 0.15)))
    assert min(sure) < 0.0
    assert min(unsure) > 5.0
    assert max(beside) < -5.0
