"""What the product says of a scan: the one file here that uses it."""

from __future__ import annotations

import time

import numpy as np
import torch
from numpy.typing import NDArray

from petkin.diagnosis import PART, Cohort, Diagnosis, Simulator
from petkin.diagnosis.covariance import Noise
from petkin.diagnosis.detect import statistic
from petkin.diagnosis.diagnose import scan_of
from petkin.diagnosis.refit import State, refit
from petkin.dynamics import PiecewiseLinear
from petkin.effects import EFFECTS, effect_named
from petkin.imaging import FrameObservation, FrameSchedule
from petkin.inputs import InputFunction
from petkin.study.diagnose import ALWAYS
from petkin.study.diagnosis.answer import onset_frame
from petkin.study.diagnosis.blood import read_at, reading_nodes
from petkin.study.diagnosis.hypotheses import hypotheses
from petkin.study.diagnosis.judging import diagnose_curves
from petkin.study.diagnosis.regional import RegionalSimulator
from petkin_bench.withheld.cases import Answer, Scan
from petkin_bench.withheld.noise import KINDS, law

Array = NDArray[np.float64]

#: Noise draws of the ideal reader, with a gap and without, and the share of the latter that it takes for one.
_READ, _ALARMS = 300, 0.05


def simulator_of(scan: Scan) -> RegionalSimulator:
    """The simulator that the scan names, with the blood record as it stands."""
    blood, frames = scan.blood, scan.frames
    t = torch.from_numpy(blood.t)

    def lines(values: Array) -> PiecewiseLinear:
        return PiecewiseLinear(t, torch.from_numpy(np.ascontiguousarray(values)))

    arterial = InputFunction(
        lines(blood.total * blood.parent),
        lines(blood.whole),
        total_plasma=lines(blood.total),
        parent_fraction=lines(blood.parent),
    )
    nodes = reading_nodes(arterial, float(frames.end[-1]))
    clock = FrameObservation(FrameSchedule(frames.start, frames.end), frames.decay)
    included = tuple(effect_named(name) for name in scan.includes)
    label = {"1tcm": "1TCM", "2tcm": "2TCM"}[scan.model]
    return RegionalSimulator(scan.regions, label, read_at(arterial, nodes), clock, included, nodes)


def verdict(scan: Scan, clean: Array, *, seed: int, draws: int) -> dict[str, object]:
    """One row: the verdict and, beside it, the share of the gap in the noise-free values that its leader closes.

    Args:
        scan: what the product sees.
        clean: values without noise (R, K); looked at when the verdict is final.
        seed, draws: of the product's own noise draws.
    """
    started = time.process_time()
    simulator = simulator_of(scan)
    candidates = hypotheses(EFFECTS, simulator, without=frozenset())
    found, simulator, _ = diagnose_curves(simulator, scan.values, candidates, always=ALWAYS, seed=seed, draws=draws)
    seconds = time.process_time() - started
    leader = found.causes[0] if found.causes else None
    closed = None if leader is None else leader.closure
    frame = onset_frame(found, simulator)
    return said_of(found) | {
        "unknown_probability": found.unknown,
        "stage": next(iter(found.stages), ""),
        "onset_frame": -1 if frame is None else frame,
        "regions": ";".join(str(r) for r in np.flatnonzero(found.claims(found.regions) <= PART)),
        **sizes_of(found),
        "evidence": ";".join(f"{c.label}:{c.log_evidence:.3f}" for c in found.causes),
        "unknown_evidence": round(found.unknown_evidence, 3),
        "closure": "" if closed is None else closed.value,
        "closure_low": "" if closed is None else closed.low,
        "closure_high": "" if closed is None else closed.high,
        "closed": "" if leader is None else closed_by(found, simulator, clean),
        "seconds": round(seconds, 3),
    }


def sizes_of(found: Diagnosis) -> dict[str, object]:
    """Amplitude and onset of a likeliest cause that is one effect, each with its interval; "" where there is none."""
    leader = found.causes[0] if found.causes else None
    known = {e.symbol: e for e in leader.estimates} if leader is not None and len(leader.effects) == 1 else {}
    row: dict[str, object] = {}
    for symbol in ("amplitude", "onset"):
        one = known.get(symbol)
        row |= {symbol: "", f"{symbol}_low": "", f"{symbol}_high": ""}
        if one is not None:
            row |= {symbol: one.value, f"{symbol}_low": one.low, f"{symbol}_high": one.high}
    return row


def said_of(found: Diagnosis | Cohort) -> dict[str, object]:
    """The verdict on a scan or on several."""
    leader = found.causes[0] if found.causes else None
    return {
        "verdict": found.kind,
        "p_value": found.p_value,
        "leader": "" if leader is None else leader.label,
        "leader_probability": 0.0 if leader is None else leader.probability,
        "set": ";".join(found.chosen),
        "set_probability": found.set_probability,
    }


def closed_by(found: Diagnosis, simulator: Simulator, clean: Array) -> float:
    """1 - what the leader leaves of the gap in noise-free values, both after a refit."""
    fit = found.causes[0].fit
    if fit is None:
        return 0.0
    base = refit(simulator, clean, found.noise, found.base.state)
    with_it = refit(simulator, clean, found.noise, State(fit.state.own, fit.state.shared, fit.state.terms))
    return float(np.clip(1.0 - with_it.chi2 / max(base.chi2, 1e-12), 0.0, 1.0))


def ideal(scan: Scan, answer: Answer, *, seed: int) -> dict[str, object]:
    """Shares of noise draws in which the class has the highest evidence (`ideal`), and a gap is claimed besides
    (`ideal_claimed`), for a reader who is told the noise-free curves' fit and the law of the noise, but must find
    onset, region, frame and shape for itself; "" where it is not one cause.

    The product's templates of weak effects, each averaged over its settings, without a refit: of strong effects, which
    are not linear, a real reader may name more, and of blunders it says nothing. It claims a gap where all templates
    together, each less what noise seldom gives it, have more evidence than in all but 0.05 of draws without one.
    """
    nothing: dict[str, object] = {"ideal": "", "ideal_claimed": ""}
    if answer.kind not in ("known", "other form"):
        return nothing
    simulator = simulator_of(scan)
    given = law(answer.clean, scan.frames, answer.percent, KINDS[answer.noise][0], answer.noisiness)
    noise = Noise(given.sd, np.ones(len(given.sd)), given.share)
    fits = [refit(simulator, answer.clean, noise, State(own, simulator.shared.mean)) for own in simulator.starts]
    base = min(fits, key=lambda fit: fit.objective)
    candidates = hypotheses(EFFECTS, simulator, without=frozenset())
    if any(h.flag for h in candidates if h.name in answer.names):
        return nothing
    looked = scan_of(simulator, noise, base, candidates)
    drawn = np.random.default_rng(seed).standard_normal((2 * _READ, base.residual.size))
    left = looked.projection.left(drawn, np.zeros((2 * _READ, base.jacobian.shape[1])))
    seen = base.residual + left[:_READ]
    found = looked.by_hypothesis(looked.each(seen))
    names = list(found)
    first = np.stack([found[name] for name in names], axis=1).argmax(axis=1)
    right = np.array([names[k] in answer.classes[0] for k in first])
    null = looked.evidence(left[_READ:])
    claimed = statistic(looked.evidence(seen), null) > np.quantile(statistic(null, null), 1.0 - _ALARMS)
    return {"ideal": round(float(right.mean()), 4), "ideal_claimed": round(float((right & claimed).mean()), 4)}
