"""Parameters travel as one object: symbol, unit, start, bounds, fixed or not."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError


@dataclass(frozen=True)
class Parameter:
    """One parameter of a system. `fixed` keeps it at `start`."""

    symbol: str
    unit: str
    start: float
    lower: float
    upper: float
    fixed: bool = False
    meaning: str = ""

    def __post_init__(self) -> None:
        if not self.lower <= self.start <= self.upper:
            raise InputError(
                f"{self.symbol}: start {self.start:g} lies outside its bounds [{self.lower:g}, {self.upper:g}]."
            )


@dataclass(frozen=True)
class ParameterSet:
    """An ordered set of parameters."""

    members: tuple[Parameter, ...]

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self.members)

    def __len__(self) -> int:
        return len(self.members)

    def __getitem__(self, symbol: str) -> Parameter:
        for member in self.members:
            if member.symbol == symbol:
                return member
        raise InputError(f"There is no parameter {symbol!r}; this model has {', '.join(self.symbols)}.")

    @cached_property
    def symbols(self) -> tuple[str, ...]:
        return tuple(p.symbol for p in self.members)

    @property
    def start(self) -> NDArray[np.float64]:
        return np.array([p.start for p in self.members])

    @property
    def lower(self) -> NDArray[np.float64]:
        return np.array([p.start if p.fixed else p.lower for p in self.members])

    @property
    def upper(self) -> NDArray[np.float64]:
        return np.array([p.start if p.fixed else p.upper for p in self.members])

    @property
    def free(self) -> tuple[Parameter, ...]:
        return tuple(p for p in self.members if not p.fixed)

    def with_bounds(self, bounds: Mapping[str, tuple[float, float]]) -> ParameterSet:
        """The same set with other bounds; a start outside them moves to the nearer bound."""
        return self._replaced(
            bounds, lambda p, b: replace(p, lower=b[0], upper=b[1], start=float(np.clip(p.start, b[0], b[1])))
        )

    def with_fixed(self, values: Mapping[str, float]) -> ParameterSet:
        """The same set with some parameters held at a value; the bounds widen if the value lies outside them."""
        return self._replaced(
            values, lambda p, v: replace(p, start=v, lower=min(p.lower, v), upper=max(p.upper, v), fixed=True)
        )

    def _replaced(self, changes: Mapping[str, object], change) -> ParameterSet:
        for symbol in changes:
            _ = self[symbol]
        return ParameterSet(tuple(change(p, changes[p.symbol]) if p.symbol in changes else p for p in self.members))
