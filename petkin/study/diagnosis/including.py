"""Effects that a simulator includes: what they are set to, and how large the refit makes them.

Settings, such as onsets and frames, are found once a scan, as the engine fits them as hypotheses, and then stand;
amplitudes are refitted with the kinetics in every comparison.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis import Z90, Base, Estimate, Fit, Hypothesis, Term, base_fit
from petkin.diagnosis.diagnose import scan_of
from petkin.diagnosis.scan import templates
from petkin.diagnosis.which import singles
from petkin.effects import Effect
from petkin.study.diagnosis.hypotheses import form_of, hypothesis_of
from petkin.study.diagnosis.regional import RegionalSimulator, width

Array = NDArray[np.float64]

#: A hypothesis with what is known of its settings beside the curves.
Told = Callable[[Hypothesis], Hypothesis]

_SIDES = np.array([-1.0, 0.0, 1.0])


def included(simulator: RegionalSimulator, fit: Fit) -> tuple[Estimate, ...]:
    """What the simulator's own refit makes of the effects that it includes, in their order, and what an image shows of
    them where it does; a setting, which is not refitted, has no width.

    Args:
        simulator: with its included effects.
        fit: of the simulator alone.
    """
    errors = fit.widened[: fit.nuisance]
    own, shared = errors[: fit.state.own.size].reshape(fit.state.own.shape), errors[fit.state.own.size :]
    found: list[Estimate] = []
    for effect in simulator.includes:
        symbol = effect.amplitude.symbol
        name = symbol if effect.name in simulator.logarithmic else effect.name
        sizes = _sizes(simulator, effect)
        if effect.name in simulator.seen:
            found.append(replace(simulator.seen[effect.name], symbol=symbol))
        elif name in simulator.shared.symbols:
            i = simulator.shared.symbols.index(name)
            found.append(_of(effect, sizes(fit.state.shared[i] + Z90 * shared[i] * _SIDES)))
        elif name in simulator.own.symbols:
            i = simulator.own.symbols.index(name)
            ends = fit.state.own[:, i, None] + Z90 * own[:, i, None] * _SIDES
            found += [_of(effect, sizes(row), region) for region, row in zip(simulator.channels, ends, strict=True)]
        for symbol, value in simulator.settings.get(effect.name, {}).items():
            unit = effect.parameters[symbol].unit
            regions = simulator.channels if np.ndim(value) else ("",)
            each = zip(regions, map(float, np.atleast_1d(value)), strict=True)
            found += [
                Estimate(symbol, unit, *(3 * [float(one)]), effect=effect.name, channel=region) for region, one in each
            ]
    return tuple(found)


def _sizes(simulator: RegionalSimulator, effect: Effect) -> Callable[[Array], Array]:
    """From coordinates of the refit to amplitudes."""
    if effect.name in simulator.logarithmic:
        return np.exp
    return lambda widths: np.clip(widths * width(effect), *simulator.limits[effect.name])


def _of(effect: Effect, ends: Array, region: str = "") -> Estimate:
    low, value, high = map(float, ends)
    symbol, unit = effect.amplitude.symbol, effect.amplitude.unit
    return Estimate(symbol, unit, value, low, high, effect=effect.name, channel=region)


def _untold(hypothesis: Hypothesis) -> Hypothesis:
    return hypothesis


def without(simulator: RegionalSimulator, names: frozenset[str]) -> RegionalSimulator:
    """The simulator that does not include some effects."""
    if not names & {effect.name for effect in simulator.includes}:
        return simulator
    return replace(
        simulator,
        includes=tuple(effect for effect in simulator.includes if effect.name not in names),
        settings={name: each for name, each in simulator.settings.items() if name not in names},
    )


def settled(simulator: RegionalSimulator, values: Array, told: Told = _untold) -> RegionalSimulator:
    """The simulator with the likeliest settings of the effects that it includes, and how large they begin.

    One effect after another, each beside all that have no setting and those found before; of several once more, since
    the first was found without the others.

    Args:
        simulator: with its included effects.
        values: curves (R, K).
        told: a hypothesis with what else is known of its settings.
    """
    unsettled = [effect for effect in simulator.sized if any(hypothesis_of(effect, simulator).settings)]
    names = {effect.name for effect in unsettled}
    found: dict[str, tuple[Term, ...]] = {}
    for effect in unsettled * min(len(unsettled), 2):
        found.pop(effect.name, None)
        beside = tuple(e for e in simulator.includes if e.name in found or e.name not in names)
        found[effect.name] = _found(_with(replace(simulator, includes=beside), found), values, effect, told)
    return _with(simulator, found)


def _with(simulator: RegionalSimulator, found: Mapping[str, Sequence[Term]]) -> RegionalSimulator:
    """A simulator that includes effects as they were found."""
    terms = {name: term for name, each in found.items() for term in each}
    sizes = {name: float(term.amplitude) for name, term in terms.items() if np.ndim(term.amplitude) == 0}
    settings = {name: terms[name].setting if name in terms else {} for name in found}
    return replace(simulator, settings=settings, begun=sizes) if found else simulator


def in_picture(
    simulator: RegionalSimulator,
    values: Array,
    based: Base,
    told: Told | None = None,
    seen: Mapping[str, Estimate] | None = None,
) -> tuple[RegionalSimulator, Base]:
    """The simulator with the effects that it includes as a picture tells of them, and its fit; both as they were where
    none is told otherwise.

    Args:
        simulator: which knows what motion adds to regions.
        values: curves (R, K).
        based: what `base_fit` finds without the picture.
        told: a hypothesis with what the picture says of its settings; None where it says nothing.
        seen: how large it shows effects to be, by name.
    """
    model = simulator.model(simulator.starts[0], np.zeros(len(simulator.shared)))
    forms = tuple(form_of(effect, model) for effect in simulator.includes)
    if forms == simulator.includes and told is None:
        return simulator, based
    simulator = replace(simulator, includes=forms, settings={}, begun={}, seen=seen or {})
    simulator = settled(simulator, values, told or _untold)
    return simulator, base_fit(simulator, values)


def _found(simulator: RegionalSimulator, values: Array, effect: Effect, told: Told) -> tuple[Term, ...]:
    """Of an effect that the simulator lacks, after its refit; none where it could not be seen."""
    based = base_fit(simulator, values)
    base, noise, *_ = based
    hypothesis = told(hypothesis_of(effect, simulator))
    if not _seen(simulator, based, hypothesis):
        return ()
    (best, *_) = singles(simulator, values, noise, base, scan_of(simulator, noise, base, [hypothesis]))
    return best.terms


def _seen(simulator: RegionalSimulator, based: Base, hypothesis: Hypothesis) -> bool:
    """Whether a hypothesis changes any value at any of its settings."""
    base, noise, *_ = based
    each = (replace(hypothesis, settings=(setting,), told=()) for setting in hypothesis.settings)
    return any(np.any(t.columns) for one in each for t in templates(simulator, noise, base, [one]))
