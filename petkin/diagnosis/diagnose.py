"""The diagnosis of one data set: is there a gap, where, what causes it, how far it shrinks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis.design import Visible, foresee
from petkin.diagnosis.detect import noise_draws, p_value, tail_freedom
from petkin.diagnosis.effect import Hypothesis, Simulator, Term
from petkin.diagnosis.how_far import Interval, closure
from petkin.diagnosis.noise import Noise, first_floor, from_flexible, lowered, outlying
from petkin.diagnosis.nuisance import Projection
from petkin.diagnosis.refit import Fit, State, refit
from petkin.diagnosis.sets import confusability, probabilities, smallest_set
from petkin.diagnosis.where import Place, over
from petkin.diagnosis.which import (
    Candidate,
    Scan,
    columns_of,
    pairs,
    refitted,
    singles,
    smooth_columns,
    start,
    templates,
)

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

#: Draws of noise for the test, and the p-value at which a gap is claimed: below 5 percent, since the draws are linear
#: in what is refitted and know the law of the noise, and data do neither.
_DRAWS, CLAIM = 400, 0.03
#: Log evidence from which on an explanation's own residual tells the noise better than the first floor.
_SURE = 5.0
#: Prior odds of a gap of no name, and of two causes, against one of the catalogue (natural logarithm).
_UNKNOWN = -1.5
#: Causes listed at most, and the probability below which none is.
_LISTED, _NEGLIGIBLE = 8, 0.005
_Z90 = 1.6448536269514722


@dataclass(frozen=True)
class Estimate:
    """A fitted quantity of a cause with its 90 % interval."""

    symbol: str
    unit: str
    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Cause:
    """One explanation.

    Args:
        effects: names, one or two.
        stages: of each.
        probability: of this and no other.
        log_evidence: against no effect.
        estimates: amplitude first.
        closure: share of the gap that it closes, held out.
        fit: with it.
    """

    effects: tuple[str, ...]
    stages: tuple[str, ...]
    probability: float
    log_evidence: float
    estimates: tuple[Estimate, ...] = ()
    closure: Interval | None = None
    fit: Fit | None = None

    @property
    def label(self) -> str:
        return "+".join(self.effects)


@dataclass(frozen=True)
class Diagnosis:
    """All that was found.

    Args:
        channels: names.
        present: whether there is a gap beyond noise.
        p_value: of no gap.
        chi2_per_dof: of the simulator alone.
        noise: covariance used.
        base: the simulator's fit.
        causes: likeliest first; of a gap of no name, the nearest.
        unknown: probability of none of the catalogue.
        chosen: names in the verdict's set.
        set_probability: of the set.
        regions, frames: where.
        onset: time of it, or None.
        frame: the one sample that the leader concerns, or None.
        evidence: stage and log evidence of every single effect.
        unknown_evidence: of a gap of no name.
        visible: what this design could tell.
        alike: cosines by pair of causes.
        likely: the likeliest causes whether or not there is a gap, for what several data sets have in common.
    """

    channels: tuple[str, ...]
    present: bool
    p_value: float
    chi2_per_dof: float
    noise: Noise
    base: Fit
    causes: tuple[Cause, ...]
    unknown: float
    chosen: tuple[str, ...]
    set_probability: float
    regions: Place
    frames: Place
    onset: float | None
    frame: int | None
    evidence: dict[str, tuple[str, float]]
    unknown_evidence: float
    visible: tuple[Visible, ...]
    alike: dict[frozenset[str], float]
    likely: tuple[Cause, ...] = ()

    @property
    def kind(self) -> str:
        """none, named, ambiguous or unknown."""
        if not self.present:
            return "none"
        if not self.chosen:
            return "unknown"
        return "named" if len(self.chosen) == 1 else "ambiguous"

    @property
    def stages(self) -> dict[str, float]:
        """Probability of every stage, of the named causes."""
        found: dict[str, float] = {}
        for cause in self.causes:
            for stage in cause.stages:
                found[stage] = found.get(stage, 0.0) + cause.probability / len(cause.stages)
        total = sum(found.values())
        return {s: p / total for s, p in sorted(found.items(), key=lambda e: -e[1])} if total > 0 else {}


def _silent(_: str, __: float) -> None:
    """Tells nobody."""


def diagnose(
    simulator: Simulator,
    data: Array,
    hypotheses: Sequence[Hypothesis],
    *,
    always: frozenset[str] = frozenset(),
    seed: int = 0,
    draws: int = _DRAWS,
    progress: Progress = _silent,
) -> Diagnosis:
    """Compare data with what a simulator can produce.

    Args:
        simulator: what predicts.
        data: (C, K), finite.
        hypotheses: effects that may be missing.
        always: names that get a refit however they look in the scan.
        seed: of the draws.
        draws: how many.
        progress: told what is being done, and how far it is.
    """
    rng = np.random.default_rng(seed)
    progress("fitting", 0.05)
    base, noise, bases, loose = base_fit(simulator, data)
    progress("looking at every effect", 0.2)
    scan = _scan(simulator, noise, base, hypotheses)
    shape = data.shape
    drawn = noise_draws(rng, draws, (shape[0], shape[1]), noise.share, tail_freedom(loose), bases)
    p = p_value(float(scan.statistic(base.residual)), scan.statistic(drawn))
    progress("refitting the likely ones", 0.4)
    ranked, noise, base, scan = _ranked(simulator, data, noise, base, scan, hypotheses, always)
    progress("weighing", 0.8)
    unknown_evidence = float(scan.unknown(base.residual)) + _UNKNOWN
    return _verdict(simulator, data, noise, base, scan, ranked, unknown_evidence, hypotheses, p, drawn, rng)


def base_fit(simulator: Simulator, data: Array) -> tuple[Fit, Noise, list[Array], Array]:
    """The simulator's own best fit, the noise, what the flexible fit took, and its residual.

    Two rounds: the second weighs by the values that the first predicts.
    """
    spread = simulator.spread(np.maximum(data, 0.0))
    bends = np.diff(data / spread, n=2, axis=1) / np.sqrt(6.0)
    size = np.full(len(data), np.median(np.abs(bends)) / 0.6745)
    noise = Noise(spread, np.maximum(size, 1e-9 * np.abs(data / spread).max()), 0.0)
    shared = simulator.shared.mean
    fits = [refit(simulator, data, noise, State(own, shared)) for own in simulator.starts]
    base = min(fits, key=lambda f: f.objective)
    flexible = from_flexible(data, spread, simulator.flexible(base.state.shared))
    for _ in range(2):
        plain = simulator.spread(np.maximum(base.values, 0.0))
        spread = plain * outlying(flexible[0] * spread / plain)
        flexible = from_flexible(data, spread, simulator.flexible(base.state.shared))
        noise = first_floor((data - base.values) / spread, spread, flexible, _least(simulator, base.values, spread))
        base = refit(simulator, data, noise, base.state)
    loose, freedom, bases = flexible
    return base, noise, bases, loose / np.sqrt((loose**2).sum(axis=1) / freedom)[:, None]


def _least(simulator: Simulator, values: Array, spread: Array) -> Array:
    """Size of noise (C,) as small as the simulator's numerical errors."""
    return simulator.accuracy * np.median(np.abs(values) / spread, axis=1) + 1e-300


def foresee_design(simulator: Simulator, data: Array, hypotheses: Sequence[Hypothesis]) -> tuple[Visible, ...]:
    """What a design could tell, around the simulator's fit and with the noise of some data of it."""
    base, noise, _, _ = base_fit(simulator, data)
    return foresee(simulator, base, _scan(simulator, noise, base, hypotheses).templates)


def _scan(simulator: Simulator, noise: Noise, base: Fit, hypotheses: Sequence[Hypothesis]) -> Scan:
    found = [t for t in templates(simulator, noise, base, hypotheses) if np.any(t.columns)]
    return Scan(found, Projection.of_fit(base), smooth_columns(noise, base, simulator.times))


def _ranked(
    simulator: Simulator,
    data: Array,
    noise: Noise,
    base: Fit,
    scan: Scan,
    hypotheses: Sequence[Hypothesis],
    always: frozenset[str],
) -> tuple[list[Candidate], Noise, Fit, Scan]:
    """Single causes and pairs, best first; where one is sure, noise is first estimated again from its residual."""
    found = singles(simulator, data, noise, base, scan, always)
    leader = found[0]
    if leader.log_evidence > _SURE and leader.fit is not None:
        quieter = lowered(
            noise, data - leader.fit.values, leader.fit.jacobian.shape[1], _least(simulator, base.values, noise.spread)
        )
        if (quieter.size < 0.97 * noise.size).any() or quieter.share < noise.share - 0.05:
            noise = quieter
            base = refit(simulator, data, noise, base.state)
            scan = _scan(simulator, noise, base, hypotheses)
            found = singles(simulator, data, noise, base, scan, always)
    double = pairs(simulator, data, noise, base, scan, found) if found[0].log_evidence > 1.0 else []
    return sorted([*found, *double], key=lambda c: -c.log_evidence), noise, base, scan


def _verdict(
    simulator: Simulator,
    data: Array,
    noise: Noise,
    base: Fit,
    scan: Scan,
    ranked: list[Candidate],
    unknown_evidence: float,
    hypotheses: Sequence[Hypothesis],
    p: float,
    drawn: Array,
    rng: np.random.Generator,
) -> Diagnosis:
    shape = (data.shape[0], data.shape[1])
    projection = Projection.of_fit(base)
    probability, unknown = probabilities({c.label: c.log_evidence for c in ranked}, unknown_evidence)
    present = p <= CLAIM
    listed = [c for c in ranked if probability[c.label] > _NEGLIGIBLE][:_LISTED] or ranked[:1]
    listed = [c if c.fit is not None else _with_fit(simulator, data, noise, base, scan, c) for c in listed]
    gaps = {c.label: noise.whiten(c.fit.values - base.values) for c in listed if c.fit is not None}
    alike = _alike(gaps, projection)
    chosen: tuple[str, ...] = ()
    if present and unknown < 0.5:
        chosen = smallest_set({c.label: probability[c.label] for c in listed}, alike)
    leader = listed[0]
    stage = {h.name: h.stage for h in hypotheses}
    causes = tuple(
        Cause(
            c.names,
            tuple(stage[n] for n in c.names),
            probability[c.label],
            c.log_evidence,
            _estimates(c, simulator, base),
            closure(base, c.fit, shape, rng) if c.fit is not None else None,
            c.fit,
        )
        for c in listed
    )
    axes = projection.axes[: projection.rows]
    left = (drawn - (drawn @ axes) @ axes.T).reshape(-1, *shape)
    gap = gaps.get(leader.label, base.residual)
    gap = (gap - axes @ (axes.T @ gap)).reshape(shape)
    residual = base.residual.reshape(shape)
    regions, frames = over(residual, left, gap, 0), over(residual, left, gap, 1)
    return Diagnosis(
        channels=tuple(simulator.channels),
        present=present,
        p_value=p,
        chi2_per_dof=base.chi2 / max(base.residual.size - base.jacobian.shape[1], 1),
        noise=noise,
        base=base,
        causes=causes if present else (),
        unknown=unknown,
        chosen=chosen,
        set_probability=sum(probability[name] for name in chosen),
        regions=_regions(leader, regions, base, simulator) if present else regions,
        frames=frames,
        onset=_setting(leader, "onset") if present else None,
        frame=None if not present or (frame := _setting(leader, "frame")) is None else int(frame),
        evidence={c.label: (stage[c.label], c.log_evidence) for c in ranked if len(c.names) == 1},
        unknown_evidence=unknown_evidence,
        visible=foresee(simulator, base, scan.templates),
        alike=alike,
        likely=causes,
    )


def _with_fit(
    simulator: Simulator, data: Array, noise: Noise, base: Fit, scan: Scan, candidate: Candidate
) -> Candidate:
    """A candidate that only the scan has judged, with a refit for its estimates; its evidence stays."""
    each = scan.each(base.residual)
    terms = tuple(start(scan, base.residual, each, name) for name in candidate.names)
    fitted = refitted(simulator, data, noise, base, terms)
    return replace(candidate, fit=fitted.fit, terms=fitted.terms, gain=fitted.gain)


def _alike(gaps: dict[str, Array], projection: Projection) -> dict[frozenset[str], float]:
    names = list(gaps)
    if len(names) < 2:
        return {}
    cosine = confusability([gaps[n] for n in names], projection)
    return {frozenset((a, b)): float(cosine[i, j]) for i, a in enumerate(names) for j, b in enumerate(names) if i < j}


def _estimates(candidate: Candidate, simulator: Simulator, base: Fit) -> tuple[Estimate, ...]:
    fit = candidate.fit
    if fit is None:
        return ()
    known = len(base.state.terms)
    covariance = np.linalg.pinv(fit.jacobian.T @ fit.jacobian + np.diag(fit.penalty))
    error = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    found: list[Estimate] = []
    for term, place in zip(fit.state.terms[known:], columns_of(fit, len(simulator.channels), known)):
        found.append(_amplitude(term, error[place[""]] if "" in place else np.zeros(0)))
        if "onset" in term.setting:
            width = _Z90 * float(error[place["onset"]][0]) if "onset" in place else 0.0
            onset = float(term.setting["onset"])
            found.append(Estimate("onset", "min", onset, max(onset - width, 0.0), onset + width))
        if "frame" in term.setting:
            found.append(Estimate("frame", "1", *(3 * [float(term.setting["frame"])])))
    return tuple(found)


def _amplitude(term: Term, errors: Array) -> Estimate:
    hypothesis = term.hypothesis
    if hypothesis.flag:
        return Estimate("amplitude", "flag", 1.0, 1.0, 1.0)
    values = np.atleast_1d(np.asarray(term.amplitude, np.float64))
    errors = np.maximum(errors, 1e-12)
    weight = errors**-2.0 / (errors**-2.0).sum()
    mean, error = float(weight @ values), float((errors**-2.0).sum() ** -0.5)
    if hypothesis.by_channel and np.ptp(values / errors) > 4.0 * _Z90:  # not one amplitude for all: the clearest one
        clearest = int(np.argmax(np.abs(values) / errors))
        mean, error = float(values[clearest]), float(errors[clearest])
    return Estimate("amplitude", hypothesis.unit, mean, mean - _Z90 * error, mean + _Z90 * error)


def _regions(leader: Candidate, found: Place, base: Fit, simulator: Simulator) -> Place:
    """Of an effect that has an amplitude a channel, each amplitude's own test."""
    from scipy.special import erfc

    from petkin.diagnosis.where import benjamini_hochberg

    fit = leader.fit
    known = len(base.state.terms)
    if fit is None or len(leader.terms) != 1 or not leader.terms[0].hypothesis.by_channel:
        return found
    place = columns_of(fit, len(simulator.channels), known)[0][""]
    covariance = np.linalg.pinv(fit.jacobian.T @ fit.jacobian + np.diag(fit.penalty))
    error = np.sqrt(np.maximum(np.diag(covariance)[place], 1e-300))
    z = np.abs(np.asarray(leader.terms[0].amplitude)) / error
    return Place(benjamini_hochberg(erfc(z / np.sqrt(2.0))), found.shares)


def _setting(leader: Candidate, symbol: str) -> float | None:
    """Value of a parameter of the leader that has it."""
    return next((float(t.setting[symbol]) for t in leader.terms if symbol in t.setting), None)
