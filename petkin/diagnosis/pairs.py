"""Two effects at once: beside the leaders, and jointly, since two together may look like a third.

For columns g, h of two templates, projected, with t = g'Pr / |Pg| and c their cosine, both explain

    (t_g^2 + t_h^2 - 2 c t_g t_h) / (1 - c^2)

of the residual; all pairs of columns are looked at as one matrix.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis import evidence
from petkin.diagnosis.covariance import Noise
from petkin.diagnosis.effect import Hypothesis, Simulator, Term, foreknown
from petkin.diagnosis.evidence import SECOND
from petkin.diagnosis.nuisance import Projection
from petkin.diagnosis.occam import after_refit
from petkin.diagnosis.refit import Fit, begun
from petkin.diagnosis.scan import Scan, Template, starts
from petkin.diagnosis.which import Candidate, as_promised, excess, halfway, refitted

Array = NDArray[np.float64]

#: Causes that a second effect could bring within this of the best are given one; pairs refitted of those found beside
#: them, jointly, and of those that share a name with the best of them where it beats every single one.
_WITHIN, _BESIDE, _JOINTLY, _AKIN = 7.0, 6, 8, 4
#: Pairs are refitted where the scan puts them within this of the best single cause.
_CLOSE = 4.0
#: Columns of a hypothesis that take part in the joint look, what an amplitude costs there, and cosines beyond which two
#: columns are one.
_COLUMNS, _AMPLITUDE, _ONE = 10, 2.5, 0.98


@dataclass(frozen=True)
class _Wanted:
    """A pair to refit: what the scan gives it, from where, with which terms, less what their choice gained."""

    score: float
    terms: tuple[Term, ...]
    begin: Candidate | None
    excess: float


def pairs(
    simulator: Simulator, data: Array, noise: Noise, base: Fit, scan: Scan, leaders: Sequence[Candidate]
) -> list[Candidate]:
    """Likely pairs, fully refitted; best first; none of one hypothesis alone."""
    if len(leaders) < 2:
        return []
    best = max(leader.bare for leader in leaders)
    beside, jointly = _beside(scan, leaders), _jointly(scan, base.residual)
    alone = {leader.label: leader for leader in leaders if leader.fit is not None}
    found: dict[tuple[str, ...], Candidate] = {}
    for wanted in (*_likeliest(beside, best, _BESIDE), *_likeliest(jointly, best, _JOINTLY)):
        pair = _refitted(simulator, data, noise, base, wanted, alone)
        if pair.names not in found or pair.log_evidence > found[pair.names].log_evidence:
            found[pair.names] = pair
    first = max(found.values(), key=lambda c: c.log_evidence, default=None)
    if first is not None and first.log_evidence > leaders[0].log_evidence:
        akin = {key: w for key, w in (jointly | beside).items() if key not in found and set(key) & set(first.names)}
        for wanted in _likeliest(akin, best, _AKIN):
            pair = _refitted(simulator, data, noise, base, wanted, alone)
            found[pair.names] = pair
    return sorted(found.values(), key=lambda c: -c.log_evidence)


def _likeliest(wanted: dict[tuple[str, ...], _Wanted], best: float, most: int) -> list[_Wanted]:
    close = [w for w in wanted.values() if w.score - SECOND > best - _CLOSE]
    return sorted(close, key=lambda w: -w.score)[:most]


def _refitted(
    simulator: Simulator, data: Array, noise: Noise, base: Fit, wanted: _Wanted, alone: Mapping[str, Candidate]
) -> Candidate:
    """A pair after its refit, as it was found: beside one of both, or jointly. `alone`: those that were refitted."""
    first, terms = wanted.begin, wanted.terms
    if first is None or first.fit is None:
        return _refitted_jointly(simulator, data, noise, base, wanted, alone)
    start = begun(simulator, data, noise, first.fit, terms[-1:])
    pair = refitted(simulator, data, noise, base, start)
    pair = as_promised(simulator, data, noise, base, pair, terms, wanted.score)
    second = _second(first, pair, len(simulator.channels)) - wanted.excess
    second = halfway(second, wanted.score - first.bare, terms[-1:])
    return replace(pair, log_evidence=first.bare + second + pair.spared - SECOND)


def _refitted_jointly(
    simulator: Simulator, data: Array, noise: Noise, base: Fit, wanted: _Wanted, alone: Mapping[str, Candidate]
) -> Candidate:
    """Two that may each act in some channels alone have no more evidence than the likelier with the other beside it.

    Where amplitudes of both do the same to a channel and nearly cancel, each beside the other says little of what both
    cost.
    """
    terms, first = wanted.terms, None
    if all(term.hypothesis.by_channel and not term.hypothesis.alike for term in terms):
        known = (alone[term.hypothesis.name] for term in terms if term.hypothesis.name in alone)
        first = max(known, key=lambda c: c.log_evidence, default=None)
    if first is not None:
        terms = tuple(sorted(terms, key=lambda term: term.hypothesis.name != first.label))
    start = begun(simulator, data, noise, base, terms)
    pair = refitted(simulator, data, noise, base, start)
    pair = as_promised(simulator, data, noise, base, pair, terms, wanted.score)
    value = halfway(pair.bare - wanted.excess, wanted.score, terms)
    if first is not None:
        value = min(value, first.bare + _second(first, pair, len(simulator.channels)))
    return replace(pair, log_evidence=value + pair.spared - SECOND)


def _second(first: Candidate, pair: Candidate, channels: int) -> float:
    """What the second effect of a pair adds to the log evidence of the first, but for noise of single channels."""
    assert first.fit is not None
    assert pair.fit is not None
    more = foreknown(pair.terms) - foreknown(first.terms)
    return after_refit(first.fit, pair.fit, channels, len(first.fit.state.terms)) + more


def _beside(scan: Scan, leaders: Sequence[Candidate]) -> dict[tuple[str, ...], _Wanted]:
    """Every refitted cause with the second effect that its residual asks for.

    A cause that is true beside another may rank far below one that takes part of both; what counts is what it reaches
    with the second. It is not asked where it would stay behind if that left noise alone. Templates stay those around
    the simulator's own fit; only what they are projected off is each leader's.
    """
    wanted: dict[tuple[str, ...], _Wanted] = {}
    best = max(leader.bare for leader in leaders)
    for leader in leaders:
        fit = leader.fit
        if fit is None or leader.bare + 0.5 * excess(fit) < best - _WITHIN:
            continue
        others = [t for t in scan.templates if t.hypothesis.name not in leader.names]
        projection = Projection.of_fit(fit)
        second, residual = Scan(others, projection, None), projection.left_of(fit)
        each = second.each(residual)
        for name, value in second.by_hypothesis(each).items():
            key = tuple(sorted((*leader.names, name)))
            term = starts(second, residual, each, name)[0]
            more = foreknown((*leader.terms, term)) - foreknown(leader.terms)
            score = leader.bare + float(value) + more
            if key not in wanted:  # from the stronger of the two: evidence that goes by the weaker one is not the same
                wanted[key] = _Wanted(score, (*leader.terms, term), leader, second.excess(each, name))
    return wanted


@dataclass(frozen=True)
class _Columns:
    """Single amplitudes: of which hypothesis, from which template, in which channel (-1: all)."""

    raw: Array
    projected: Array
    information: Array
    templates: list[Template]
    channels: list[int]


def _jointly(scan: Scan, residual: Array) -> dict[tuple[str, ...], _Wanted]:
    """Every two hypotheses at the settings that explain most together."""
    columns = _columns(scan, residual)
    found, amplitudes = _explained(columns, residual)
    names = np.array([t.hypothesis.name for t in columns.templates])
    order = list(dict.fromkeys(names))
    places = {name: np.flatnonzero(names == name) for name in order}
    wanted = {}
    for a, first in enumerate(order):
        for second in order[a + 1 :]:
            block = found[np.ix_(places[first], places[second])]
            top = float(block.max())
            if top < 0:
                continue
            mean = float(evidence.mean(block.ravel()))
            i, j = np.unravel_index(int(block.argmax()), block.shape)
            both = places[first][i], places[second][j]
            terms = tuple(_term(columns, k, float(amplitudes[k, m])) for k, m in (both, both[::-1]))
            wanted[tuple(sorted((first, second)))] = _Wanted(mean, terms, None, top - mean)
    return wanted


def _columns(scan: Scan, residual: Array) -> _Columns:
    """The columns of every hypothesis that the residual likes best, one a channel and one for all channels together."""
    raw, projected, information, templates, channels = [], [], [], [], []
    for template, (mine, left) in zip(scan.templates, scan.by_template()):
        sides = [(mine[:, c], left[:, c], c if mine.shape[1] > 1 else -1) for c in range(mine.shape[1])]
        sides += [(mine.sum(axis=1), left.sum(axis=1), -1)] if mine.shape[1] > 1 else []
        for column, beyond, channel in sides:
            raw.append(column)
            projected.append(beyond)
            information.append(float(column @ beyond) + template.hypothesis.width**-2.0)
            templates.append(template)
            channels.append(channel)
    whole, stacked, sizes = np.stack(raw, axis=1), np.stack(projected, axis=1), np.array(information)
    liked = (residual @ stacked) ** 2 / sizes
    names = np.array([t.hypothesis.name for t in templates])
    mine = [np.flatnonzero(names == name) for name in dict.fromkeys(names)]
    kept = np.concatenate([m[np.argsort(-liked[m], kind="stable")[:_COLUMNS]] for m in mine])
    return _Columns(
        whole[:, kept], stacked[:, kept], sizes[kept], [templates[k] for k in kept], [channels[k] for k in kept]
    )


def _explained(columns: _Columns, residual: Array) -> tuple[Array, Array]:
    """log evidence of every two columns, and the amplitude of the first beside the second."""
    gram = columns.raw.T @ columns.projected
    score, size = columns.projected.T @ residual, columns.information
    room = size[:, None] * size[None] - gram**2
    apart = gram**2 < _ONE**2 * size[:, None] * size[None]
    room = np.where(apart, room, np.inf)
    amplitudes = (size[None] * score[:, None] - gram * score[None]) / room
    gain = amplitudes * score[:, None] + amplitudes.T * score[None]
    one_sided = np.array([not t.hypothesis.signed for t in columns.templates])
    fine = ~one_sided[:, None] | (amplitudes > 0)
    flags = np.array([t.hypothesis.flag for t in columns.templates])
    possible = apart & fine & fine.T & ~flags[:, None] & ~flags[None]
    return np.where(possible, 0.5 * gain - 2.0 * _AMPLITUDE, -np.inf), amplitudes


def _term(columns: _Columns, place: int, amplitude: float) -> Term:
    template, channel = columns.templates[place], columns.channels[place]
    hypothesis: Hypothesis = template.hypothesis
    count = template.columns.shape[1]
    inside = float(np.clip(amplitude, *hypothesis.limits))
    if not hypothesis.by_channel:
        return Term(hypothesis, inside, template.setting)
    local = {s.symbol: np.full(count, template.setting[s.symbol]) for s in hypothesis.shapes if s.by_channel}
    amplitudes = np.full(count, inside) if channel < 0 else np.where(np.arange(count) == channel, inside, 0.0)
    return Term(hypothesis, amplitudes, {**template.setting, **local})
