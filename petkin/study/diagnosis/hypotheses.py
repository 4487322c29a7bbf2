"""Effects as hypotheses about regional curves: at which settings each is tried, and how likely those are beforehand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from petkin.diagnosis import Hypothesis, Shape
from petkin.effects import Effect, ForwardModel
from petkin.study.diagnosis.onsets import onset_bounds, onsets
from petkin.study.diagnosis.regional import SCANNER, RegionalSimulator, unset

#: Onsets tried: so many for the scanner, so many for the tissue.
_SCANNER_ONSETS, _TISSUE_ONSETS = 40, 14
#: Regions tried as what lies beside the others, times how many there are (two at least); and at every how many onsets.
_BESIDE, _SPARSE = 25, 2
#: Log odds of a blunder that is there or not: it has no size to be averaged over, and fewer scans have it than have any
#: one effect. Set on training scans, of which it makes the truth likelier taken together.
_BLUNDER = -3.0
#: How often what lies beside is one region, not the others' mean, and how often the next frame lacks what a wrong one
#: has too much.
_OFTEN = {"beside": 0.5, "edge": 0.25}
#: A rate that may be zero is looked for from this share of the end of its range on.
_SLOWEST = 0.001


def hypotheses(
    candidates: Sequence[Effect], simulator: RegionalSimulator, *, without: frozenset[str]
) -> tuple[Hypothesis, ...]:
    """All effects that may be missing: not included, not withheld, and possible for this simulator."""
    model = simulator.model(simulator.starts[0], np.zeros(len(simulator.shared)))
    known = {e.name for e in simulator.includes} | without
    forms = (form_of(e, model) for e in candidates)
    return tuple(hypothesis_of(e, simulator) for e in forms if e.name not in known and e.suits(model))


def form_of(effect: Effect, model: ForwardModel) -> Effect:
    """The form of an effect that suits a forward model: where a picture tells of it, that of pictures."""
    return effect.imaged if effect.imaged is not None and effect.imaged.suits(model) else effect


def hypothesis_of(effect: Effect, simulator: RegionalSimulator) -> Hypothesis:
    """An effect as a hypothesis about this simulator."""
    first, last = onset_bounds(simulator.clock, scanner=effect.stage in SCANNER)
    shapes = [
        Shape(p.symbol, p.lower or _SLOWEST * p.upper, p.upper, p.symbol in effect.regional)
        for p in effect.parameters
        if p.symbol in effect.grid
    ]
    if "onset" in effect.parameters.symbols:
        shapes.append(Shape("onset", first, last, sd=np.inf, kinked=True))
    settings = (*_settings(effect, simulator), *effect.besides(simulator.input))
    return replace(
        unset(effect),
        settings=settings,
        shapes=tuple(shapes),
        trust=effect.trust if effect.name in simulator.measured else 1.0,
        log_odds=_BLUNDER if effect.flag else 0.0,
        told=_told(settings),
    )


def _settings(effect: Effect, simulator: RegionalSimulator) -> tuple[dict[str, float], ...]:
    clock = simulator.clock
    found: list[dict[str, float]] = [{}]
    for parameter in effect.parameters.members[1:]:
        values = effect.grid.get(parameter.symbol, ())
        if parameter.symbol == "onset":
            scanner = effect.stage in SCANNER
            values = onsets(clock, _SCANNER_ONSETS if scanner else _TISSUE_ONSETS, scanner=scanner)
        elif parameter.symbol == "frame":
            values = tuple(float(k) for k in range(len(clock.frames)))
        elif parameter.symbol == "edge":
            values = (0.0, 1.0)
        elif parameter.symbol == "beside":
            chosen = _neighbours(len(simulator.channels))
            near = [{**setting, "beside": region} for setting in found[::_SPARSE] for region in chosen]
            found = [*({**setting, "beside": 0.0} for setting in found), *near]
        elif parameter.symbol == "axis":
            assert simulator.moves is not None
            values = tuple(map(float, simulator.moves.ways))
        if values:
            found = [{**setting, parameter.symbol: float(v)} for setting in found for v in values]
    return tuple(found)


def _neighbours(regions: int) -> list[float]:
    """Numbers of regions that may lie beside others: all of few, fewer of many; none where each has but one other."""
    if regions < 3:
        return []
    return np.unique(np.linspace(1, regions, max(_BESIDE // regions, 2)).round()).tolist()


def _told(settings: Sequence[Mapping[str, float]]) -> tuple[float, ...]:
    """How much likelier each is than an average one, by how often its switches are on."""
    told = np.zeros(len(settings))
    for symbol, often in _OFTEN.items():
        on = np.array([setting.get(symbol, 0.0) > 0 for setting in settings])
        if on.any():
            told += np.log(np.where(on, often / on.mean(), (1.0 - often) / (1.0 - on.mean())))
    return tuple(map(float, told)) if told.any() else ()
