"""The diagnosis of one data set: is there a gap, where, what causes it, how far it shrinks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis.covariance import Noise
from petkin.diagnosis.design import Visible, foresee
from petkin.diagnosis.detect import CLAIM, AgainstNoise, noise_draws, tails
from petkin.diagnosis.effect import Hypothesis, Simulator
from petkin.diagnosis.estimates import estimates, regions, setting, strengths
from petkin.diagnosis.how_far import closure
from petkin.diagnosis.noise import levels, lowered
from petkin.diagnosis.nominal import Base, base_fit, least_noise
from petkin.diagnosis.nuisance import Projection
from petkin.diagnosis.occam import spared
from petkin.diagnosis.pairs import pairs
from petkin.diagnosis.profile import profiles
from petkin.diagnosis.refit import Fit, begun, refit
from petkin.diagnosis.scan import Scan, Template, starts, templates
from petkin.diagnosis.sets import LAPSE, LAPSE_WITHIN, confusability, probabilities, smallest_set
from petkin.diagnosis.unknown import Elsewhere, Smooth, beside, driven, left_beside
from petkin.diagnosis.verdict import Cause, Diagnosis
from petkin.diagnosis.where import over
from petkin.diagnosis.which import Candidate, again, refitted, singles

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

#: Draws of noise for the test.
DRAWS = 400
#: Log evidence from which on an explanation's own residual tells the noise better than the first floor.
_SURE = 5.0
#: Spreads that differ by less than this are the same.
_SAME_SPREAD = 0.1
#: Causes listed at most, and the probability below which none is.
_LISTED, _NEGLIGIBLE = 8, 0.005


@dataclass(frozen=True)
class Detected:
    """Whether there is a gap; what that takes beyond the simulator's fit is found when it is asked for.

    Args:
        simulator: what predicts.
        hypotheses: effects that may be missing.
        based: the simulator's fit, the noise, and what a flexible fit took and left.
        seed: of the draws of noise.
        draws: how many.
    """

    simulator: Simulator
    hypotheses: Sequence[Hypothesis]
    based: Base
    seed: int
    draws: int

    @cached_property
    def scan(self) -> Scan:
        """Every hypothesis around that fit."""
        return scan_of(self.simulator, self.based[1], self.based[0], self.hypotheses)

    @cached_property
    def drawn(self) -> Array:
        """What the refit leaves of whitened draws of noise (n, C K)."""
        return draws_left(np.random.default_rng(self.seed), self.draws, self.based, self.scan.projection)

    @cached_property
    def against(self) -> AgainstNoise:
        """What every hypothesis has for the data, and for the draws."""
        evidence = self.scan.evidence
        return AgainstNoise(self.scan.names, evidence(self.based[0].residual), evidence(self.drawn))

    @cached_property
    def p_value(self) -> float:
        """Share of the draws that look as much like a gap as the data."""
        return self.against.p_value

    @property
    def present(self) -> bool:
        return self.p_value <= CLAIM

    @property
    def strongest(self) -> float:
        """Log evidence of the likeliest hypothesis before any refit."""
        return float(self.against.found.max())


def silent(_: str, __: float) -> None:
    """Tells nobody."""


@dataclass(frozen=True)
class _Explained:
    """The explanations, best first, and what they are judged against."""

    noise: Noise
    base: Fit
    scan: Scan
    ranked: list[Candidate]

    @property
    def projection(self) -> Projection:
        return Projection.of_fit(self.base)


def diagnose(
    simulator: Simulator,
    data: Array,
    hypotheses: Sequence[Hypothesis],
    *,
    always: frozenset[str] = frozenset(),
    elsewhere: Elsewhere | None = None,
    seed: int = 0,
    draws: int = DRAWS,
    detected: Detected | None = None,
    progress: Progress = silent,
) -> Diagnosis:
    """Compare data with what a simulator can produce.

    Args:
        simulator: what predicts.
        data: (C, K), finite.
        hypotheses: effects that may be missing.
        always: names that get a refit however they look in the scan.
        elsewhere: what was seen beside the channels, in what they are means of.
        seed: of the draws.
        draws: how many.
        detected: what `detect` finds in these data, with this simulator and these hypotheses, where it is known.
        progress: told what is being done, and how far it is.
    """
    if detected is None:
        progress("looking at every effect", 0.05)
        detected = detect(simulator, data, hypotheses, seed=seed, draws=draws)
    base, noise, _, _ = detected.based
    progress("refitting the likely ones", 0.4)
    explained = _explained(simulator, data, _Explained(noise, base, detected.scan, []), always)
    progress("weighing", 0.8)
    return _verdict(simulator, data, explained, hypotheses, elsewhere, detected)


def detect(
    simulator: Simulator,
    data: Array,
    hypotheses: Sequence[Hypothesis],
    *,
    seed: int = 0,
    draws: int = DRAWS,
    based: Base | None = None,
) -> Detected:
    """Whether data hold anything that a simulator cannot produce and noise seldom looks like.

    Args:
        simulator: what predicts.
        data: (C, K), finite.
        hypotheses: effects that may be missing.
        seed: of the draws.
        draws: how many.
        based: what `base_fit` finds, where it is known.
    """
    based = base_fit(simulator, data) if based is None else based
    return Detected(simulator, hypotheses, based, seed, draws)


def draws_left(
    rng: np.random.Generator,
    count: int,
    based: Base,
    projection: Projection | None = None,
) -> Array:
    """What the refit leaves of whitened draws of noise (count, C K).

    Args:
        rng: randomness.
        count: draws.
        based: what `base_fit` found.
        projection: of its fit, where it is known.
    """
    base, noise, bases, loose = based
    projection = Projection.of_fit(base) if projection is None else projection
    drawn = noise_draws(rng, count, noise, tails(loose), bases, levels(base.values, noise.spread))
    return projection.left(drawn, projection.priors(rng, count, base))


def foresee_design(simulator: Simulator, data: Array, hypotheses: Sequence[Hypothesis]) -> tuple[Visible, ...]:
    """What a design could tell, around the simulator's fit and with the noise of some data of it."""
    base, noise, _, _ = base_fit(simulator, data)
    return foresee(simulator, noise, base, scan_of(simulator, noise, base, hypotheses).templates)


def scan_of(simulator: Simulator, noise: Noise, base: Fit, hypotheses: Sequence[Hypothesis]) -> Scan:
    """All hypotheses that can be seen at all around a fit."""
    found = [t for t in templates(simulator, noise, base, hypotheses) if np.any(t.columns)]
    return _scan(found, simulator, noise, base)


def _scan(found: Sequence[Template], simulator: Simulator, noise: Noise, base: Fit) -> Scan:
    projection = Projection.of_fit(base)
    profiles = simulator.departing(base.values)
    smooth = Smooth.around(profiles, simulator.times, noise, projection, driven(simulator, base))
    return Scan(found, projection, smooth)


def _explained(simulator: Simulator, data: Array, first: _Explained, always: frozenset[str]) -> _Explained:
    """Single causes and pairs; where one is sure, noise is first estimated again from its residual."""
    noise, base, scan = first.noise, first.base, first.scan
    found = singles(simulator, data, noise, base, scan, always)
    leader = found[0]
    if leader.log_evidence > _SURE and leader.fit is not None:
        quieter = _quieter(simulator, data, noise, base, leader.fit)
        if quieter is not noise:
            noise = quieter
            base = refit(simulator, data, noise, base.state)
            scan = _scan([t.under(noise) for t in scan.templates], simulator, noise, base)
            found = again(simulator, data, noise, base, scan, found)
    double = pairs(simulator, data, noise, base, scan, found) if found[0].log_evidence > 1.0 else []
    return _Explained(noise, base, scan, sorted((*found, *double), key=lambda c: -c.log_evidence))


def _quieter(simulator: Simulator, data: Array, noise: Noise, base: Fit, fit: Fit) -> Noise:
    """Noise weighed by what an explanation predicts, and no larger than it leaves; as it was where that is the same."""
    before, after = (simulator.spread(np.maximum(f.values, 0.0)) for f in (base, fit))
    weighed = replace(noise, spread=noise.spread * after / before)
    least = least_noise(simulator, fit.values, weighed.spread)
    level = levels(fit.values, weighed.spread)
    found = lowered(weighed, weighed.without_errors(data - fit.values), fit.jacobian.shape[1], level, least)
    same = np.abs(after / before - 1.0).max() < _SAME_SPREAD and (found.size > 0.97 * noise.size).all()
    return noise if same and found.share > noise.share - 0.05 else found


def _verdict(
    simulator: Simulator,
    data: Array,
    explained: _Explained,
    hypotheses: Sequence[Hypothesis],
    elsewhere: Elsewhere | None,
    detected: Detected,
) -> Diagnosis:
    shape = (data.shape[0], data.shape[1])
    noise, base, ranked, projection = explained.noise, explained.base, explained.ranked, explained.projection
    present, drawn = detected.present, detected.drawn
    unnamed = float(explained.scan.unknown(base.residual)) - spared(noise, base)
    place = explained.scan.unnamed(base.residual)
    lapse = LAPSE
    if elsewhere is not None:
        unnamed, place, lapse = elsewhere.joined(unnamed), elsewhere.place(unnamed, place), LAPSE_WITHIN
    left_by = {c.label: left for c, left in zip(ranked, left_beside(simulator, noise, ranked, elsewhere), strict=True)}
    named = {
        c.label: beside(c.log_evidence, left_by[c.label], 0.0 if c.fit is None else spared(noise, c.fit))
        for c in ranked
    }
    probability, unknown = probabilities(named, unnamed, lapse=lapse)
    listed = [c for c in ranked if probability[c.label] > _NEGLIGIBLE][:_LISTED] or ranked[:1]
    listed = sorted(listed, key=lambda c: -probability[c.label])
    listed = [c if c.fit is not None else _with_fit(simulator, data, explained, c) for c in listed]
    gaps = {c.label: noise.whiten(c.fit.values - base.values) for c in listed if c.fit is not None}
    alike = _alike(gaps, projection)
    beyond = {a: [(probability[b], gap - own) for b, gap in gaps.items()] for a, own in gaps.items()}
    chosen: tuple[str, ...] = ()
    if present and unknown < 0.5:
        chosen = smallest_set({c.label: probability[c.label] for c in listed}, alike)
    leader = listed[0]
    stage = {h.name: h.stage for h in hypotheses}
    alone = (drawn**2).sum(axis=1) / base.freedom
    causes = tuple(
        Cause(
            c.names,
            tuple(stage[n] for n in c.names),
            probability[c.label],
            c.log_evidence,
            estimates(c, simulator, base, noise),
            closure(base, c.fit, shape, beyond[c.label], alone) if c.fit is not None else None,
            c.fit,
            left_by[c.label],
        )
        for c in listed
    )
    axes = projection.axes[: projection.rows]
    left = drawn.reshape(-1, *shape)
    gap = gaps.get(leader.label, base.residual)
    gap = (gap - axes @ (axes.T @ gap)).reshape(shape)
    residual = base.residual.reshape(shape)
    places = over(residual, left, gap, 0)
    return Diagnosis(
        channels=tuple(simulator.channels),
        present=present,
        p_value=detected.p_value,
        chi2_per_dof=base.chi2 / base.freedom,
        noise=noise,
        base=base,
        causes=causes if present else (),
        unknown=unknown,
        chosen=chosen,
        set_probability=sum(probability[name] for name in chosen),
        regions=regions(leader, places, base, simulator, noise) if present else places,
        frames=over(residual, left, gap, 1),
        onset=setting(leader, "onset") if present else None,
        frame=None if not present or (frame := setting(leader, "frame")) is None else int(frame),
        evidence={c.label: (stage[c.label], c.log_evidence) for c in ranked if len(c.names) == 1},
        strengths=strengths(ranked, explained.scan, simulator, base),
        unknown_evidence=unnamed,
        unknown_place=place,
        visible=foresee(simulator, noise, base, explained.scan.templates),
        alike=alike,
        likely=causes,
        against=detected.against,
        profiles=profiles(explained.scan, base.residual),
    )


def _with_fit(simulator: Simulator, data: Array, explained: _Explained, candidate: Candidate) -> Candidate:
    """A candidate that only the scan has judged, with a refit for its estimates; its evidence stays."""
    scan, base = explained.scan, explained.base
    each = scan.each(base.residual)
    terms = tuple(starts(scan, base.residual, each, name)[0] for name in candidate.names)
    start = begun(simulator, data, explained.noise, base, terms)
    fitted = refitted(simulator, data, explained.noise, base, start)
    return replace(candidate, fit=fitted.fit, terms=fitted.terms, gain=fitted.gain)


def _alike(gaps: dict[str, Array], projection: Projection) -> dict[frozenset[str], float]:
    names = list(gaps)
    if len(names) < 2:
        return {}
    cosine = confusability([gaps[n] for n in names], projection)
    return {frozenset((a, b)): float(cosine[i, j]) for i, a in enumerate(names) for j, b in enumerate(names) if i < j}
