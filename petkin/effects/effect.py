"""An effect: one named change of one stage of the forward model, with its parameters and their plausible range."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from petkin.dynamics import Parameter, ParameterSet
from petkin.effects.forward_model import STAGES, ForwardModel
from petkin.errors import InputError

Change = Callable[[ForwardModel, Mapping[str, float]], ForwardModel]


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
    """

    name: str
    stage: str
    parameters: ParameterSet
    meaning: str
    source: str
    change: Change

    def __post_init__(self) -> None:
        if self.stage not in STAGES:
            raise InputError(f"Effect {self.name!r} names stage {self.stage!r}; the stages are {', '.join(STAGES)}.")

    @property
    def amplitude(self) -> Parameter:
        """The parameter that says how strong the effect is."""
        return self.parameters.members[0]

    def values(self, given: Mapping[str, float]) -> dict[str, float]:
        """A value for every parameter: the given ones, and starts for the rest.

        Raises:
            InputError: an unknown symbol, or a value that is not finite.
        """
        for symbol, value in given.items():
            _ = self.parameters[symbol]
            if not math.isfinite(value):
                raise InputError(f"Effect {self.name}: {symbol} is {value:g}; give a finite number.")
        return {p.symbol: float(given.get(p.symbol, p.start)) for p in self.parameters}

    def inject(self, model: ForwardModel, given: Mapping[str, float] | None = None) -> ForwardModel:
        """The forward model with the effect in it; every stage but `stage` is the same object as before.

        Raises:
            InputError: a value that cannot be, or a model that the effect cannot change.
        """
        return self.change(model, self.values(given or {}))


@dataclass(frozen=True)
class Injection:
    """An effect with its values, as asked for."""

    effect: Effect
    values: Mapping[str, float]

    def into(self, model: ForwardModel) -> ForwardModel:
        """The forward model with the effect in it."""
        return self.effect.inject(model, self.values)
