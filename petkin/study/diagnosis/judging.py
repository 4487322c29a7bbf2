"""What regional curves say, under the law by which they scatter.

A law other than that of counts is there to explain a gap: where counts leave none, theirs stays. Where they leave one,
its p-value is the mean over both laws, each as likely as the scatter makes it, and if that claims nothing the other law
stands in place of the gap, unless the likeliest cause has twice the evidence that any law could have. If it does claim
something, the other must also be the law of what the likely causes leave to be taken,
since the gap of a missing delay makes early frames uneven. A law that is flatter than that of counts has a name,
`noise_variance`; it is beside other causes where there is a gap as well.

Where several scans tell their law together (`laws_in_common`), that is the law of each, gap or none.

Reference: Meng XL. Ann Stat 1994;22:1142-1160 (p-values averaged over what is not known).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis import (
    CLAIM,
    DRAWS,
    Z90,
    Cause,
    Detected,
    Diagnosis,
    Hypothesis,
    Progress,
    Strength,
    base_fit,
    detect,
    diagnose,
    silent,
)
from petkin.effects.noise import NOISE_VARIANCE
from petkin.study.diagnosis.regional import RegionalSimulator
from petkin.study.diagnosis.scatter import Scatter, evidence_without_gap, look_at_scatter
from petkin.study.diagnosis.shared_law import SharedLaw, shared_law

Array = NDArray[np.float64]

#: Log evidence of a gap that is strong, and how much more than a law's it must be for no law to stand in its place. Of
#: 183 training scans of noise alone, of five other laws, whose gap a law explains, none has such a gap; of 8 with one
#: region and a gap of d' 6 to 19 six.
_STRONG, _BEYOND = 5.0, 3.0
#: Causes beside which the law is asked: those with so much of the likeliest one's probability, at most so many.
_LIKELY, _ASKED = 0.1, 4
#: Prior odds that nothing scatters otherwise, and how often no explanation is right; as of the other effects.
_PRIOR_LOG_ODDS, _LAPSE = -3.0, 0.05


@dataclass(frozen=True)
class _Asked:
    """Curves and their possible causes, to be asked under one law of noise or another.

    Args:
        values: curves (R, K).
        candidates: causes.
        always: those that get a refit however they look.
        seed, draws: of noise.
        progress: told what is being done, and how far it is.
    """

    values: Array
    candidates: Sequence[Hypothesis]
    always: frozenset[str]
    seed: int
    draws: int = DRAWS
    progress: Progress = silent

    def detected(self, under: RegionalSimulator) -> Detected:
        return detect(under, self.values, self.candidates, seed=self.seed, draws=self.draws)

    def diagnosed(self, under: RegionalSimulator, detected: Detected) -> Diagnosis:
        return diagnose(
            under,
            self.values,
            self.candidates,
            always=self.always,
            seed=self.seed,
            detected=detected,
            progress=self.progress,
        )


def diagnose_curves(
    simulator: RegionalSimulator,
    values: Array,
    candidates: Sequence[Hypothesis],
    *,
    always: frozenset[str] = frozenset(),
    without: bool = False,
    included: bool = False,
    shared: SharedLaw | None = None,
    seed: int = 0,
    draws: int = DRAWS,
    progress: Progress = silent,
) -> tuple[Diagnosis, RegionalSimulator, Detected]:
    """What regional curves alone say under the law by which they scatter; the simulator under that law, and what claims
    a gap there.

    Args:
        simulator, values, candidates, always, without, included, shared, seed, draws: as of `law_of_noise`.
        progress: told what is being done, and how far it is.
    """
    asked = _Asked(values, candidates, always, seed, draws, progress)
    scatter, simulator, detected, found = _judged(asked, simulator, without, included, shared, strong_first=True)
    return scattered(asked.diagnosed(simulator, detected) if found is None else found, scatter), simulator, detected


def law_of_noise(
    simulator: RegionalSimulator,
    values: Array,
    candidates: Sequence[Hypothesis],
    *,
    always: frozenset[str] = frozenset(),
    without: bool = False,
    included: bool = False,
    shared: SharedLaw | None = None,
    seed: int,
    draws: int = DRAWS,
) -> tuple[Scatter | None, RegionalSimulator, Detected]:
    """What the scatter of regional curves says of its law, the simulator under the law that is taken, and whether that
    leaves a gap.

    Args:
        simulator: how counts scatter.
        values: curves (R, K).
        candidates: causes.
        always: causes that get a refit however they look.
        without: a more even scatter has no name: it stays a gap, and nothing is told of it.
        included: it is no gap: the likeliest law is taken, and nothing is told of it.
        shared: what it is as other scans tell it too.
        seed, draws: of noise, behind p-values.
    """
    asked = _Asked(values, candidates, always, seed, draws)
    return _judged(asked, simulator, without, included, shared, strong_first=False)[:3]


def _judged(
    asked: _Asked,
    simulator: RegionalSimulator,
    without: bool,
    included: bool,
    shared: SharedLaw | None,
    *,
    strong_first: bool,
) -> tuple[Scatter | None, RegionalSimulator, Detected, Diagnosis | None]:
    """As `law_of_noise`, and the diagnosis where it was needed for that.

    A gap that no law explains needs no other law's p-value: `strong_first` asks for the diagnosis before it, which
    costs more unless it is wanted anyway.
    """
    values, seed = asked.values, asked.seed
    if shared is not None:
        if without and shared.flatter:
            return None, simulator, asked.detected(simulator), None
        named = shared.flatter and not included
        told = look_at_scatter(simulator, base_fit(simulator, values), seed=seed) if named else None
        other = replace(simulator, law=shared.law, law_errors=shared.errors)
        return told, other, asked.detected(other), None
    counted = asked.detected(simulator)
    found = look_at_scatter(simulator, counted.based, seed=seed)
    told = None if without or included else found
    if not included:
        if not counted.present or (without and found.claimed):
            return told, simulator, counted, None
        likeliest = asked.diagnosed(simulator, counted) if strong_first else None
        if likeliest is None or not _beyond_noise(simulator, likeliest):
            other = replace(simulator, law=found.law, law_errors=found.errors)
            otherwise = asked.detected(other)
            denied = found.odds * otherwise.p_value + (1.0 - found.odds) * counted.p_value > CLAIM
            if not denied and not found.otherwise:
                return told, simulator, counted, likeliest
            likeliest = asked.diagnosed(simulator, counted) if likeliest is None else likeliest
            if denied and not _beyond_noise(simulator, likeliest):
                return told, other, otherwise, None
        if found.otherwise:
            found = _beside_causes(simulator, values, counted, likeliest, found, seed=seed)
            told = None if without else found
        if not found.otherwise or (without and found.claimed):
            return told, simulator, counted, likeliest
    other = replace(simulator, law=found.law)
    return told, other, asked.detected(other), None


def laws_in_common(
    scans: Sequence[tuple[RegionalSimulator, Array, Sequence[Hypothesis]]],
    *,
    seed: int,
    always: frozenset[str] = frozenset(),
    told: Callable[[int], None] = lambda _: None,
) -> tuple[SharedLaw | None, ...]:
    """The law of every scan as all tell it together, beside the likely causes of a gap as well as without any; None
    of one scan, and where they do not tell the law of counts from others.

    Args:
        scans: how counts scatter, curves (R, K), and causes, of each.
        seed: of draws of noise.
        always: causes that get a refit however they look.
        told: the scans that have been asked, of both times together.
    """
    alone = (None,) * len(scans)
    if len(scans) < 2:
        return alone
    looks, bases = [], []
    for simulator, values, _ in scans:
        bases.append(base_fit(simulator, values))
        looks.append(look_at_scatter(simulator, bases[-1], seed=seed))
        told(len(looks))
    found = shared_law(looks)
    if found is None or not any(len(one.errors) for one in found):
        return found or alone
    for i, (simulator, values, candidates) in enumerate(scans):
        detected = detect(simulator, values, candidates, seed=seed, based=bases[i])
        if detected.present:
            likeliest = diagnose(simulator, values, candidates, always=always, seed=seed, detected=detected)
            looks[i] = _beside_causes(simulator, values, detected, likeliest, looks[i], seed=seed)
        told(len(scans) + i + 1)
    return shared_law(looks) or alone


def _beyond_noise(simulator: RegionalSimulator, likeliest: Diagnosis) -> bool:
    """Whether a gap explains more than any law in its place: a missing delay makes early frames uneven, not noisy.

    A law is in place of noise of single channels as well, so that both are held against a simulator of sure noise.
    """
    spared = likeliest.noise.spared(likeliest.base.residual, likeliest.base.freedom)
    explained = max(likeliest.unknown_evidence, likeliest.causes[0].log_evidence) + spared
    return explained >= max(_STRONG, evidence_without_gap(simulator, likeliest.base) + _BEYOND)


def _beside_causes(
    simulator: RegionalSimulator, values: Array, detected: Detected, likeliest: Diagnosis, found: Scatter, *, seed: int
) -> Scatter:
    """What is left beside the likely causes says of the law, each as sure as the cause is likely; what was found where
    none has a fit.

    Beside the likeliest alone, scans whose causes are as likely as others would change their law at a breath, and of
    scans that tell it together all would. What a cause adds is told from the fit that showed the gap: noise weighed by
    the cause moves a fit without it.
    """
    base, least = detected.based[0], _LIKELY * likeliest.likely[0].probability
    likely = [(c.probability, c.fit) for c in likeliest.likely if c.fit is not None and c.probability >= least]
    looks = [
        look_at_scatter(simulator, base_fit(simulator, values - (fit.values - base.values)), seed=seed)
        for _, fit in likely[:_ASKED]
    ]
    if len(looks) < 2:
        return looks[0] if looks else found
    shares = np.array([probability for probability, _ in likely[:_ASKED]])
    first, *rest = (float(s) * look.exponents for s, look in zip(shares / shares.sum(), looks, strict=True))
    return Scatter.of(sum(rest, first))


def scattered(found: Diagnosis, scatter: Scatter | None) -> Diagnosis:
    """A diagnosis together with what residuals say of the variance law; as it is where they are not asked.

    Where the law is wrong, that is a cause of its own if there is no other gap, and stands beside every single cause
    if there is one; the diagnosis must then have been made under the law that was found.
    """
    if scatter is None:
        return found
    name, stage = NOISE_VARIANCE.name, NOISE_VARIANCE.stage
    size = _strength(scatter)
    found = replace(
        found,
        evidence=found.evidence | {name: (stage, scatter.log_evidence)},
        strengths=found.strengths | {name: size},
    )
    if not scatter.claimed:
        return found
    p = min(found.p_value, 2.0 * scatter.p_value)
    sure = (1.0 - _LAPSE) / (1.0 + float(np.exp(-_PRIOR_LOG_ODDS - scatter.log_evidence)))
    alone = Cause((name,), (stage,), sure, scatter.log_evidence, (size,))
    if not found.present:
        return replace(
            found,
            present=True,
            p_value=min(p, CLAIM),
            causes=(alone,),
            likely=(alone, *found.likely),
            chosen=(name,),
            set_probability=sure,
            unknown=1.0 - sure,
            onset=None,
            frame=None,
        )
    likely = tuple(_beside(cause, alone) for cause in found.likely)
    alike = {frozenset(_with(label) for label in pair): c for pair, c in found.alike.items()}
    chosen = tuple(_with(label) for label in found.chosen)
    return replace(found, p_value=p, causes=likely, likely=likely, alike=alike, chosen=chosen)


def _strength(scatter: Scatter) -> Strength:
    low, high = (scatter.flatness + sign * Z90 * scatter.error for sign in (-1.0, 1.0))
    value, low, high = (float(np.clip(f, 0.0, 1.0)) for f in (scatter.flatness, low, high))
    return Strength("amplitude", "1", value, low, high, signed=False, single=False, effect=NOISE_VARIANCE.name)


def _with(label: str) -> str:
    """A label with the noise beside it; a pair stays as it is: a third cause has no place."""
    return label if "+" in label else "+".join(sorted((label, NOISE_VARIANCE.name)))


def _beside(cause: Cause, alone: Cause) -> Cause:
    if len(cause.effects) > 1:
        return cause
    one, two = sorted((cause, alone), key=lambda c: c.label)
    return replace(
        cause,
        effects=(*one.effects, *two.effects),
        stages=(*one.stages, *two.stages),
        log_evidence=cause.log_evidence + alone.log_evidence,
        estimates=(*one.estimates, *two.estimates),
    )
