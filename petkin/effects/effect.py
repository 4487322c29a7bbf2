"""An effect: one named change of one stage of the forward model, with its parameters and their plausible range."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from petkin.dynamics import Parameter, ParameterSet
from petkin.effects.forward_model import STAGES, ForwardModel
from petkin.errors import InputError
from petkin.inputs import InputFunction

Change = Callable[[ForwardModel, Mapping[str, Any]], ForwardModel]

#: Parameter that says where an effect acts: 0 everywhere, n in region n.
REGION = Parameter("region", "1", 1.0, 0.0, 999.0, meaning="number of the region that it acts in; 0 is all of them")


def _always(_: ForwardModel) -> bool:
    return True


def _none(_: InputFunction) -> tuple[Mapping[str, float], ...]:
    return ()


@dataclass(frozen=True)
class Effect:
    """A change of one stage.

    Args:
        name: as in reports, e.g. "arterial_delay".
        stage: field of `ForwardModel` that it changes, and the only one.
        parameters: the amplitude first; bounds are the plausible range, not what is possible.
        meaning: one sentence, with the sign.
        source: where the form and range come from.
        change: the change itself, given a value for every parameter.
        split_by: the measurement that tells it from what looks like it.
        regional: parameters that may differ between regions, the amplitude first.
        alike: whether all regions then have about the same amplitude; else it may act in some of them alone.
        flag: whether it is there or not, with no strength of its own.
        folded: whether amplitudes of either sign do much the same.
        grid: values at which a diagnosis starts, by symbol, of parameters other than the amplitude; those that are not
            named here and not "onset", "frame" or "region" stay at their start.
        besides: more such starts that blood of a kind has, each with all values that it needs.
        suits: whether a forward model can have it.
        trust: part of the range that is likely where the files say that what it concerns was measured with care.
        least: what no amplitude of a diagnosis lies below, where that is known; else a fit may go beyond the range.
        imaged: its form where there is a picture, of which regions have their share.
    """

    name: str
    stage: str
    parameters: ParameterSet
    meaning: str
    source: str
    change: Change
    split_by: str = ""
    regional: tuple[str, ...] = ()
    alike: bool = False
    flag: bool = False
    folded: bool = False
    grid: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    besides: Callable[[InputFunction], tuple[Mapping[str, float], ...]] = _none
    suits: Callable[[ForwardModel], bool] = _always
    trust: float = 1.0
    least: float = -math.inf
    imaged: Effect | None = None

    def __post_init__(self) -> None:
        if self.stage not in STAGES:
            raise InputError(f"Effect {self.name!r} names stage {self.stage!r}; the stages are {', '.join(STAGES)}.")

    @property
    def amplitude(self) -> Parameter:
        """The parameter that says how strong the effect is."""
        return self.parameters.members[0]

    def form(self, symbol: str) -> Effect:
        """The effect in the form whose amplitude has this symbol."""
        other = self.imaged
        return other if other is not None and other.amplitude.symbol == symbol != self.amplitude.symbol else self

    def values(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """A value for every parameter: the given ones, and starts for the rest. An amplitude may be one a region.

        Raises:
            InputError: an unknown symbol, or a value that is not finite.
        """
        for symbol, value in given.items():
            _ = self.parameters[symbol]
            if not (math.isfinite(value) if isinstance(value, float) else np.all(np.isfinite(value))):
                raise InputError(f"Effect {self.name}: {symbol} is {value:g}; give a finite number.")
        return {p.symbol: given.get(p.symbol, p.start) for p in self.parameters}

    def inject(self, model: ForwardModel, given: Mapping[str, Any] | None = None) -> ForwardModel:
        """The forward model with the effect in it; every stage but `stage` is the same object as before.

        Raises:
            InputError: a value that cannot be, or a model that the effect cannot change.
        """
        return self.change(model, self.values(given or {}))


@dataclass(frozen=True)
class Injection:
    """An effect with its values, as asked for."""

    effect: Effect
    values: Mapping[str, Any]

    def into(self, model: ForwardModel) -> ForwardModel:
        """The forward model with the effect in it."""
        return self.effect.inject(model, self.values)

    @property
    def remarks(self) -> tuple[str, ...]:
        """A line for every value beyond its plausible range: what it means, and what is plausible."""
        beyond = [p for p in self.effect.parameters if not p.lower <= self.values[p.symbol] <= p.upper]
        return tuple(
            f"{self.effect.name}: {p.symbol}={self.values[p.symbol]:g} is simulated as asked, but lies beyond what is "
            f"plausible, {p.lower:g} to {p.upper:g}{'' if p.unit == '1' else ' ' + p.unit} ({p.meaning})."
            for p in beyond
        )


def placed(model: ForwardModel, values: Mapping[str, Any], symbol: str) -> Any:
    """The amplitude by region: as given where it is one a region, else in the region that is named.

    Raises:
        InputError: there is no such region.
    """
    amplitude, region = values[symbol], values["region"]
    if np.ndim(amplitude) > 0:
        return amplitude
    count = len(model.regions)
    if not (region == math.floor(region) and 0 <= region <= count):
        raise InputError(f"region={region:g}: there are regions 1 to {count}; 0 is all of them.")
    return np.array([amplitude if region in (0, r + 1) else 0.0 for r in range(count)])
