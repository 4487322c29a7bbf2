"""Which effect: templates of all hypotheses against the residual, then full refits of the best, then of pairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from petkin.diagnosis import evidence
from petkin.diagnosis.effect import Hypothesis, Simulator, Term
from petkin.diagnosis.noise import Noise
from petkin.diagnosis.nuisance import Projection
from petkin.diagnosis.refit import Fit, State, parts, refit
from petkin.diagnosis.unknown import discrepancies

Array = NDArray[np.float64]

#: Hypotheses within this many log units of the best are refitted, no more than so many; so are some pairs.
_WITHIN, _MOST, _PAIRS, _LEADERS = 14.0, 12, 5, 4
#: A hypothesis that was not refitted ranks at least this far below the best that was.
_BELOW = 3.0
#: What a second effect costs in log evidence: most gaps have one cause.
_SECOND = 6.0
#: Pairs are refitted where the scan puts them within this of the best single cause.
_PAIR_WITHIN = 4.0
_MOST_OCCAM = 4.0
#: Gain of the objective from which on a gap is so large that a refit may end in a side valley; where it begins anew.
_BLATANT, _FAR = 40.0, 0.3
#: Iterations of a refit.
_STEPS = 6


@dataclass(frozen=True)
class Template:
    """What a hypothesis adds at a weak amplitude, per unit of it: whitened columns (n, 1), or one a channel (n, C)."""

    hypothesis: Hypothesis
    setting: dict[str, float]
    columns: Array


@dataclass(frozen=True)
class Candidate:
    """An explanation after its refit.

    Args:
        names: of one or two hypotheses, sorted.
        fit: the refit.
        log_evidence: against no effect.
        gain: fall of the objective.
    """

    names: tuple[str, ...]
    fit: Fit | None
    log_evidence: float
    gain: float = 0.0
    terms: tuple[Term, ...] = ()

    @property
    def label(self) -> str:
        return "+".join(self.names)


def templates(simulator: Simulator, noise: Noise, fit: Fit, hypotheses: Sequence[Hypothesis]) -> tuple[Template, ...]:
    """Whitened templates of all hypotheses at all their settings, around a fit."""
    found = []
    count = len(simulator.channels)
    base = fit.state.terms
    for hypothesis in hypotheses:
        for setting in hypothesis.settings:
            size = hypothesis.typical
            term = Term(hypothesis, np.full(count, size) if hypothesis.by_channel else size, dict(setting))
            moved = simulator.predict(fit.state.own, fit.state.shared, (*base, term))
            change = (moved - fit.values) / size
            columns = np.eye(count)[:, :, None] * change[None] if hypothesis.by_channel else change[None]
            found.append(Template(hypothesis, dict(setting), noise.whiten(columns).T))
    return tuple(found)


class Scan:
    """All templates at once against residuals, and against as many draws of noise as are wanted."""

    def __init__(
        self, found: Sequence[Template], projection: Projection, smooth: Array | None, *, weights: Array | None = None
    ) -> None:
        self.templates = tuple(found)
        self.columns = np.concatenate([t.columns for t in found], axis=1)
        axes = projection.axes[: projection.rows]
        self.projected = self.columns - axes @ (axes.T @ self.columns)
        ends = np.cumsum([t.columns.shape[1] for t in found])
        self._places = [slice(end - t.columns.shape[1], end) for t, end in zip(found, ends)]
        self._information = [self.columns[:, p].T @ self.projected[:, p] for p in self._places]
        self._smooth = None
        if smooth is not None:
            projected = smooth - axes @ (axes.T @ smooth)
            self._smooth = (projected, smooth.T @ projected)

    def strength(self, index: int) -> Array:
        """d' per unit amplitude of a template, one or one a channel."""
        return np.sqrt(np.maximum(np.diag(self._information[index]), 0.0))

    def amplitude(self, index: int, residual: Array) -> Array:
        """Linear fit of a template's amplitude to a residual, one or one a channel."""
        information, hypothesis = self._information[index], self.templates[index].hypothesis
        ridged = information + np.eye(len(information)) * hypothesis.width**-2.0
        return np.linalg.solve(ridged, residual @ self.projected[:, self._places[index]])

    def each(self, residuals: Array) -> Array:
        """log evidence of every template for residuals (..., n): (..., templates)."""
        scores = residuals @ self.projected
        found = np.empty((*residuals.shape[:-1], len(self.templates)))
        for i, (template, place) in enumerate(zip(self.templates, self._places)):
            found[..., i] = _evidence(template.hypothesis, scores[..., place], self._information[i])
        return found

    def unknown(self, residuals: Array) -> Array:
        """log evidence of a smooth discrepancy (...)."""
        if self._smooth is None:
            return np.full(residuals.shape[:-1], -np.inf)
        projected, information = self._smooth
        return evidence.spread(residuals @ projected, information)

    def by_hypothesis(self, each: Array) -> dict[str, Array]:
        """Evidence averaged over the settings of every hypothesis."""
        found, place = {}, 0
        for name, group in groupby(self.templates, key=lambda t: t.hypothesis.name):
            count = len(list(group))
            found[name] = logsumexp(each[..., place : place + count], axis=-1) - np.log(count)
            place += count
        return found

    def statistic(self, residuals: Array) -> Array:
        """One number that grows with any gap: evidence averaged over hypotheses, a smooth discrepancy among them."""
        found = [*self.by_hypothesis(self.each(residuals)).values(), self.unknown(residuals)]
        return logsumexp(np.stack(found), axis=0) - np.log(len(found))


def _evidence(hypothesis: Hypothesis, score: Array, information: Array) -> Array:
    if hypothesis.flag:
        return score[..., 0] - 0.5 * information[0, 0]
    ridged = information + np.eye(len(information)) * hypothesis.width**-2.0
    if hypothesis.by_channel:
        return evidence.by_channel(score, ridged)
    t = score[..., 0] / np.sqrt(ridged[0, 0])
    return evidence.two_sided(t) if hypothesis.signed else evidence.one_sided(t)


def singles(
    simulator: Simulator, data: Array, noise: Noise, base: Fit, scan: Scan, always: frozenset[str] = frozenset()
) -> list[Candidate]:
    """Every hypothesis with its evidence, the promising ones after a full refit; best first."""
    each = scan.each(base.residual)
    by_name = {name: float(value) for name, value in scan.by_hypothesis(each).items()}
    order = sorted(by_name, key=lambda name: -by_name[name])
    best = by_name[order[0]]
    flags = {t.hypothesis.name for t in scan.templates if t.hypothesis.flag}
    chosen = [n for i, n in enumerate(order) if (i < _MOST and by_name[n] > best - _WITHIN) or n in always | flags]
    found = [refitted(simulator, data, noise, base, (start(scan, base.residual, each, name),)) for name in chosen]
    strong = [_from_afar(simulator, data, noise, base, c) if c.names[0] in always else c for c in found]
    found = [_averaged(c, scan, each) for c in strong]
    top = max(c.log_evidence for c in found)
    rest = [Candidate((n,), None, min(by_name[n], top - _BELOW)) for n in order if n not in chosen]
    return sorted([*found, *rest], key=lambda c: -c.log_evidence)


def _from_afar(simulator: Simulator, data: Array, noise: Noise, base: Fit, near: Candidate) -> Candidate:
    """The better of a refit that began at the simulator's own fit and one that began away from it, at full strength."""
    (term,) = near.terms
    if term.hypothesis.flag or near.gain < _BLATANT:
        return near
    strength = _FAR * (term.hypothesis.upper if np.mean(term.amplitude) >= 0 else term.hypothesis.lower)
    middle = {s.symbol: 0.0 * term.setting[s.symbol] + np.sqrt(s.lower * s.upper) for s in term.hypothesis.shapes}
    far = replace(term, amplitude=0.0 * term.amplitude + strength, setting={**term.setting, **middle})
    begin = replace(base, state=replace(base.state, own=simulator.starts[-1]))
    found = refitted(simulator, data, noise, base, (far,), begin)
    return found if found.gain > near.gain else near


def _averaged(candidate: Candidate, scan: Scan, each: Array) -> Candidate:
    """Less what choosing the best setting gained over an average one, and with what is known beforehand."""
    mine = [(t.hypothesis, e) for t, e in zip(scan.templates, each) if t.hypothesis.name == candidate.names[0]]
    values = np.array([e for _, e in mine])
    excess = float(values.max() - (logsumexp(values) - np.log(len(values))))
    return replace(candidate, log_evidence=candidate.log_evidence - excess + mine[0][0].log_odds)


def start(scan: Scan, residual: Array, each: Array, name: str) -> Term:
    """A hypothesis at the setting that the scan likes best, with the amplitude of a linear fit to the residual.

    Args:
        scan: of the residual.
        residual: whitened.
        each: log evidence of every template.
        name: of the hypothesis.
    """
    places = [i for i, t in enumerate(scan.templates) if t.hypothesis.name == name]
    best = max(places, key=lambda i: each[i])
    return _start(scan.templates[best], scan.amplitude(best, residual))


def _start(template: Template, amplitude: Array) -> Term:
    hypothesis, count = template.hypothesis, template.columns.shape[1]
    local = {s.symbol: np.full(count, template.setting[s.symbol]) for s in hypothesis.shapes if s.by_channel}
    if hypothesis.flag:
        return Term(hypothesis, 1.0, template.setting)
    low, high = hypothesis.limits
    inside = np.clip(amplitude, low if hypothesis.signed else min(hypothesis.typical, high), high)
    return Term(hypothesis, inside if hypothesis.by_channel else float(inside[0]), {**template.setting, **local})


def refitted(
    simulator: Simulator, data: Array, noise: Noise, base: Fit, terms: tuple[Term, ...], begin: Fit | None = None
) -> Candidate:
    """Terms fitted with everything else, from the base fit or another, and their evidence."""
    origin = (begin or base).state
    fit = refit(
        simulator, data, noise, State(origin.own, origin.shared, (*base.state.terms, *terms)), iterations=_STEPS
    )
    known = len(base.state.terms)
    return Candidate(
        tuple(sorted(t.hypothesis.name for t in terms)),
        fit,
        _after_refit(base, fit, len(simulator.channels), known),
        base.objective - fit.objective,
        fit.state.terms[known:],
    )


def columns_of(fit: Fit, channels: int, known: int) -> list[dict[str, slice]]:
    """Where the parts of the terms after the first `known` stand in the Jacobian, the amplitude under ""."""
    place, found = fit.nuisance, []
    for i, term in enumerate(fit.state.terms):
        mine = {}
        for part, width in parts(term, channels):
            mine[part] = slice(place, place + width)
            place += width
        if i >= known:
            found.append(mine)
    return found


def _after_refit(base: Fit, fit: Fit, channels: int, known: int) -> float:
    """Half the gain, less what averaging over amplitudes costs, less the change of the nuisance's volume."""
    gain = base.objective - fit.objective
    size = base.jacobian.shape[1]
    total = 0.5 * gain if all(t.hypothesis.flag for t in fit.state.terms[known:]) else 0.0
    places = columns_of(fit, channels, known)
    moving = [(t, p[""]) for t, p in zip(fit.state.terms[known:], places) if not t.hypothesis.flag]
    for term, place in moving:
        total += _averaging(term, fit, place, max(gain, 0.0) / len(moving))
    volume = _log_volume(fit.jacobian[:, :size], fit.penalty[:size]) - _log_volume(base.jacobian, base.penalty)
    return total - float(np.clip(0.5 * volume, -_MOST_OCCAM, _MOST_OCCAM))


def _averaging(term: Term, fit: Fit, place: slice, gain: float) -> float:
    hypothesis = term.hypothesis
    if not hypothesis.by_channel:
        t = np.sqrt(gain)
        return float(evidence.two_sided(t) if hypothesis.signed else evidence.one_sided(t))
    others = np.ones(fit.jacobian.shape[1], bool)
    others[place] = False
    nuisance = Projection.of(fit.jacobian[:, others], fit.penalty[others])
    columns = fit.jacobian[:, place]
    information = nuisance.inner(columns, columns) + np.diag(fit.penalty[place])
    amplitude = np.asarray(term.amplitude, np.float64)
    linear = float(amplitude @ information @ amplitude)
    return float(evidence.by_channel(information @ amplitude, information)) + 0.5 * (gain - linear)


def _log_volume(jacobian: Array, penalty: Array) -> float:
    return float(np.linalg.slogdet(jacobian.T @ jacobian + np.diag(penalty))[1])


def pairs(
    simulator: Simulator, data: Array, noise: Noise, base: Fit, scan: Scan, leaders: Sequence[Candidate]
) -> list[Candidate]:
    """The leaders with the best second effect that their residual asks for, fully refitted; best first.

    Templates stay those around the simulator's own fit; only what they are projected off is each leader's.
    """
    wanted: dict[tuple[str, ...], tuple[float, Candidate, Term]] = {}
    best = leaders[0].log_evidence
    for leader in [c for c in leaders if c.fit is not None and c.log_evidence > best - _WITHIN / 2][:_LEADERS]:
        fit = leader.fit
        assert fit is not None
        others = [t for t in scan.templates if t.hypothesis.name not in leader.names]
        beside = Scan(others, Projection.of_fit(fit), None)
        each = beside.each(fit.residual)
        for name, value in beside.by_hypothesis(each).items():
            key = tuple(sorted((*leader.names, name)))
            score = leader.log_evidence + float(value)
            if key not in wanted or score > wanted[key][0]:
                wanted[key] = (score, leader, start(beside, fit.residual, each, name))
    likely = sorted(wanted.values(), key=lambda entry: -entry[0])[:_PAIRS]
    found = []
    for score, leader, term in likely:
        if score - _SECOND < best - _PAIR_WITHIN:
            continue
        assert leader.fit is not None
        pair = refitted(simulator, data, noise, base, (*leader.terms, term), leader.fit)
        assert pair.fit is not None
        second = _after_refit(leader.fit, pair.fit, len(simulator.channels), len(leader.fit.state.terms))
        found.append(replace(pair, log_evidence=leader.log_evidence + second + term.hypothesis.log_odds - _SECOND))
    return sorted(found, key=lambda c: -c.log_evidence)


def smooth_columns(noise: Noise, fit: Fit, times: Array) -> Array:
    """Whitened columns of the smooth discrepancy."""
    return noise.whiten(discrepancies(fit.values, times)).T
