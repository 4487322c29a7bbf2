"""Which effect: full refits of what the scan finds likely, and their evidence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis.covariance import Noise
from petkin.diagnosis.effect import Hypothesis, Simulator, Term, foreknown
from petkin.diagnosis.occam import after_refit, columns_of, spared
from petkin.diagnosis.refit import Fit, State, begun, refit
from petkin.diagnosis.scan import Scan, starts

Array = NDArray[np.float64]

#: Hypotheses within this many log units of the best are refitted, or within this share of it, since templates are
#: linear and strong effects are not; no more than so many.
_WITHIN, _SHARE, _MOST = 14.0, 0.4, 12
#: A hypothesis that was not refitted ranks at least this far below the best that was.
_BELOW = 3.0
#: Chi-square beyond that of noise from which on flags and `always` are refitted however weak their templates look; the
#: share of its range at which what is looked for from afar begins.
_BLATANT, _FAR = 40.0, 0.3
#: Chi-square beyond that of noise from which on no template is weak, and the scan only says whom to refit first.
_GLARING = 1000.0
#: Settings at which a refit begins, and the log evidence beyond which scan and refit do not speak of the same.
_STARTS, _APART = 3, 6.0
#: Share of the best gain that a refit may lack after its first steps, besides, and still be followed to its end.
_LAGGING = 0.35
#: Iterations of a refit, those of one with the whole way before it, and after how many the simulator's own derivatives
#: are taken again. 11 blunders of training scans are reached from usual values after 6 to 15.
_STEPS, _WAY, _RENEWED = 4, 16, 3


@dataclass(frozen=True)
class Candidate:
    """An explanation after its refit.

    Args:
        names: of one or two hypotheses, sorted.
        fit: the refit.
        log_evidence: against no effect.
        gain: fall of the objective.
        terms: what was fitted.
        spared: how much of that is since what it leaves is likelier the noise of single channels than the whole gap is.
    """

    names: tuple[str, ...]
    fit: Fit | None
    log_evidence: float
    gain: float = 0.0
    terms: tuple[Term, ...] = ()
    spared: float = 0.0

    @property
    def label(self) -> str:
        return "+".join(self.names)

    @property
    def bare(self) -> float:
        """log evidence where no noise of single channels is in it, as the scan has it: what else explains that is not
        counted twice."""
        return self.log_evidence - self.spared


def singles(
    simulator: Simulator, data: Array, noise: Noise, base: Fit, scan: Scan, always: frozenset[str] = frozenset()
) -> list[Candidate]:
    """Every hypothesis with its evidence, the promising ones after a full refit; best first.

    A refit begins anew at other settings, unless it holds what the scan promised and that is far behind the best; one
    that is far behind after its first steps, and falls slowly, is not followed.

    Who is refitted goes by what the best refit reached, where that is less than the scan promised of it.

    What is likelier than the rest before any data gets a refit, and where a gap is blatant so do flags and `always`: a
    weak template says little of them at full strength. A flag's begins at the simulator's usual values: its own fit is
    then far from where it would be with the flag. Where a gap is glaring, all that the scan puts first is refitted,
    from all its settings and to the end.
    """
    each = scan.each(base.residual)
    by_name = {name: float(value) for name, value in scan.by_hypothesis(each).items()}
    order = sorted(by_name, key=lambda name: -by_name[name])
    best = by_name[order[0]]
    flags = {t.hypothesis.name for t in scan.templates if t.hypothesis.flag}
    foreseen = {t.hypothesis.name for t in scan.templates if t.hypothesis.log_odds > 0}
    blatant, glaring = excess(base) > _BLATANT, excess(base) > _GLARING
    strong = foreseen | (always | flags if blatant else frozenset())
    found, ahead, top = [], -np.inf, -np.inf
    for i, name in enumerate(order):
        promising = i < _MOST and (glaring or by_name[name] > _least(min(best, top)))
        if not promising and name not in strong:
            continue
        tried: list[Candidate] = []
        terms = starts(scan, base.residual, each, name, _STARTS)
        blunder = name in flags and blatant
        patient = not blunder and (glaring or name in flags)
        if blunder:
            usual = _at_usual_values(simulator, base, (terms[0],))
            tried.append(refitted(simulator, data, noise, base, usual, ahead, steps=_WAY))
            ahead, top = max(ahead, tried[-1].gain), max(top, tried[-1].log_evidence)
        for term in (*terms, *_other_way(terms[0])):
            start = begun(simulator, data, noise, base, (term,))
            tried.append(refitted(simulator, data, noise, base, start, -np.inf if patient else ahead))
            ahead, top = max(ahead, tried[-1].gain), max(top, tried[-1].log_evidence)
            if not patient and by_name[name] < tried[-1].log_evidence < top - _APART:
                break
        sighting = terms[0].hypothesis.sighting
        if sighting is not None:
            seen = (*base.state.terms, Term(terms[0].hypothesis, sighting.amplitude, sighting.setting))
            tried.append(refitted(simulator, data, noise, base, State(sighting.own, sighting.shared, seen)))
            ahead, top = max(ahead, tried[-1].gain), max(top, tried[-1].log_evidence)
        near = max(tried, key=lambda c: c.gain)
        promised = by_name[name] + foreknown(terms[:1])
        lead = -np.inf if patient else ahead
        if not blunder:
            near = as_promised(simulator, data, noise, base, near, (terms[0],), promised, lead)
        if name in always and name not in flags:
            near = _from_afar(simulator, data, noise, base, near, lead)
        found.append(_averaged(near, scan, each, by_name[name]))
    return _with_rest(found, by_name)


def _other_way(term: Term) -> tuple[Term, ...]:
    """A term of as much with the other sign, where that does much the same."""
    return (replace(term, amplitude=-term.amplitude),) if term.hypothesis.folded else ()


def _least(best: float) -> float:
    """The log evidence from which on a hypothesis may be the cause, where the best has so much."""
    return best - max(_WITHIN, _SHARE * best)


def excess(fit: Fit) -> float:
    """Chi-square beyond that of noise alone."""
    return fit.chi2 - fit.freedom


def again(
    simulator: Simulator, data: Array, noise: Noise, base: Fit, scan: Scan, before: list[Candidate]
) -> list[Candidate]:
    """The likely ones of `before` under other noise, from where they were."""
    each = scan.each(base.residual)
    by_name = {name: float(value) for name, value in scan.by_hypothesis(each).items()}
    least = _least(before[0].log_evidence)
    likely = [c for c in before if c.fit is not None and c.log_evidence > least]
    renewed = (refitted(simulator, data, noise, base, c.fit.state) for c in likely if c.fit is not None)
    found = [_averaged(c, scan, each, by_name[c.names[0]]) for c in renewed]
    known = {c.names[0]: before[0].log_evidence - c.log_evidence for c in before if c.fit is not None}
    return _with_rest(found, by_name, known)


def _with_rest(
    found: list[Candidate], by_name: dict[str, float], known: Mapping[str, float] | None = None
) -> list[Candidate]:
    """Those with a fit, and below them those that only the scan has judged, or of which it is known how far they are
    behind."""
    top = max(found, key=lambda c: c.log_evidence)
    fitted = {c.names[0] for c in found}
    behind = {name: top.bare - value for name, value in by_name.items()} | dict(known or {})
    rest = [Candidate((n,), None, top.log_evidence - max(by, _BELOW)) for n, by in behind.items() if n not in fitted]
    return sorted([*found, *rest], key=lambda c: -c.log_evidence)


def _from_afar(simulator: Simulator, data: Array, noise: Noise, base: Fit, near: Candidate, ahead: float) -> Candidate:
    """The best of a refit that began at the simulator's own fit and others, from its usual values at full strength.

    Near the simulator's own fit what is strong and bends may end in a side valley, however little it gains there.
    """
    (term,) = near.terms
    strength = _FAR * (term.hypothesis.upper if np.mean(term.amplitude) >= 0 else term.hypothesis.lower)
    middle = {s.symbol: 0.0 * term.setting[s.symbol] + np.sqrt(s.lower * s.upper) for s in term.hypothesis.shapes}
    term = replace(term, amplitude=0.0 * term.amplitude + strength, setting={**term.setting, **middle})
    terms = (*base.state.terms, term)
    states = [replace(base.state, own=own, terms=terms) for own in simulator.starts]
    found = [refitted(simulator, data, noise, base, state, ahead) for state in states]
    return max(near, *found, key=lambda c: c.gain)


def _at_usual_values(simulator: Simulator, base: Fit, terms: tuple[Term, ...]) -> State:
    """Where a refit with more terms begins that does not trust the simulator's own fit."""
    return State(simulator.starts[0], base.state.shared, (*base.state.terms, *terms))


def as_promised(
    simulator: Simulator,
    data: Array,
    noise: Noise,
    base: Fit,
    found: Candidate,
    terms: tuple[Term, ...],
    score: float,
    ahead: float = -np.inf,
) -> Candidate:
    """A refit, or a better one that began at the simulator's usual values with the terms as the scan has them.

    That is tried where the refit holds far less than the score that the scan gave it: a strong gap drives the
    simulator's own fit far off, from where the way may lead into a side valley.
    """
    if found.bare > score - _APART:
        return found
    other = refitted(simulator, data, noise, base, _at_usual_values(simulator, base, terms), ahead)
    return other if other.gain > found.gain else found


def _averaged(candidate: Candidate, scan: Scan, each: Array, linear: float) -> Candidate:
    """Less what choosing the best setting gained over an average one, and halfway to what the scan says."""
    value = candidate.bare - scan.excess(each, candidate.names[0])
    value = halfway(value, linear + foreknown(candidate.terms), candidate.terms)
    return replace(candidate, log_evidence=value + candidate.spared)


def halfway(refitted: float, linear: float, terms: tuple[Term, ...]) -> float:
    """log evidence between that of a refit and that of the scan, near the refit's where they differ much.

    The scan averages over settings and amplitudes, but takes effects for weak; a refit does not, but stands at the one
    setting that suits the noise best. A flag's template says nothing of it at full strength.
    """
    if any(term.hypothesis.flag for term in terms):
        return refitted
    return refitted - 0.5 * float(np.clip(refitted - linear, -_APART, _APART))


def refitted(
    simulator: Simulator,
    data: Array,
    noise: Noise,
    base: Fit,
    start: State,
    ahead: float = -np.inf,
    *,
    steps: int = _STEPS,
) -> Candidate:
    """Terms fitted with everything else, from a start; their evidence and what is known beforehand.

    Refits that after so many steps stay far behind the gain of one that is `ahead` are not followed to their end.
    """
    behind = base.objective - (1.0 - _LAGGING) * ahead + 2.0 * _WITHIN
    fit = refit(simulator, data, noise, start, iterations=steps, renewed=_RENEWED, behind=behind)
    channels, known = len(simulator.channels), len(base.state.terms)
    one = None
    if any(_is_about_one(term.hypothesis) for term in fit.state.terms[known:]):
        one = refit(simulator, data, noise, _as_one(fit, channels, known), iterations=_STEPS, renewed=_RENEWED)
        if one.objective < fit.objective:  # one number went further than as many: they stood in a side valley
            many = refit(simulator, data, noise, _as_many(one, fit), iterations=_STEPS, renewed=_RENEWED)
            fit = min(fit, many, key=lambda f: f.objective)
    none = spared(noise, base)
    noisy = spared(noise, fit) - none
    value = after_refit(base, fit, channels, known) + noisy
    if one is not None:
        other = after_refit(base, one, channels, known) + spared(noise, one) - none
        value = float(np.logaddexp(value, other) - np.log(2.0))
    terms = fit.state.terms[known:]
    names = tuple(sorted(t.hypothesis.name for t in terms))
    return Candidate(names, fit, value + foreknown(terms), base.objective - fit.objective, terms, noisy)


def _is_about_one(hypothesis: Hypothesis) -> bool:
    """Whether it has an amplitude a channel that may be the same in all."""
    return hypothesis.by_channel and hypothesis.alike


def _as_one(fit: Fit, channels: int, known: int) -> State:
    """Where a refit may begin whose amplitudes are the same in all channels, if they are about the same: their mean by
    what tells of each."""
    terms = list(fit.state.terms)
    for i, places in enumerate(columns_of(fit, channels, known), known):
        if _is_about_one(terms[i].hypothesis):
            tells = (fit.jacobian[:, places[""]] ** 2).sum(axis=0) + 1e-300
            mean = float(tells @ np.asarray(terms[i].amplitude) / tells.sum())
            terms[i] = replace(terms[i], hypothesis=replace(terms[i].hypothesis, by_channel=False), amplitude=mean)
    return replace(fit.state, terms=tuple(terms))


def _as_many(one: Fit, like: Fit) -> State:
    """Where a refit may begin whose amplitudes differ between channels as another's do: where that with one stands."""
    terms = tuple(
        replace(term, hypothesis=other.hypothesis, amplitude=np.zeros_like(other.amplitude) + term.amplitude)
        for term, other in zip(one.state.terms, like.state.terms)
    )
    return replace(one.state, terms=terms)
