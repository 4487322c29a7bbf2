"""Hypotheses: what may be missing in a simulator, and the simulator that they are about."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Standard deviation of an amplitude's prior, in widths of its plausible range.
_PRIOR_WIDTHS = 1.5
#: Plausible ranges within which a fit may go, and where a relative amplitude ends at the latest.
_REACH, _ALMOST_ALL = 3.0, 0.95


@dataclass(frozen=True)
class Shape:
    """A parameter of a hypothesis that is fitted beside its amplitude, on a log scale.

    Args:
        symbol: name.
        lower, upper: where it may lie, > 0.
        by_channel: whether it differs between channels.
        sd: of the prior of its logarithm, about the middle of the bounds; infinite for none.
        kinked: whether values bend where it passes from one sample to the next, as by an onset.
    """

    symbol: str
    lower: float
    upper: float
    by_channel: bool = False
    sd: float = 0.8
    kinked: bool = False


@dataclass(frozen=True)
class Sighting:
    """Where a witness of other data puts an effect and everything else.

    Args:
        own, shared: parameters of the simulator beside it.
        amplitude: of the effect.
        setting: of its other parameters.
    """

    own: Array
    shared: Array
    amplitude: float
    setting: Mapping[str, float]


@dataclass(frozen=True)
class Hypothesis:
    """An effect that may be missing.

    Args:
        name: as in reports.
        stage: part of the observation chain that it belongs to.
        symbol, unit: of the amplitude.
        lower, upper: plausible range of the amplitude; zero is no effect.
        settings: values of the other parameters to try, one mapping a start.
        shapes: which of them are fitted from there.
        by_channel: whether the amplitude differs between channels.
        alike: whether it is then about the same in all of them, and not in some alone.
        flag: whether it is there or not, at amplitude 1.
        folded: whether amplitudes of either sign do much the same, so that a refit begins at both.
        split_by: the measurement that would tell it from what looks like it.
        log_odds: what is known of it before the data, beyond that it may be there.
        told: log of how much likelier each setting is than an average one, as far as that is known; none for alike.
        trust: part of the range that is likely where what it concerns was measured with care; 1 for all of it.
        least: what no amplitude lies below.
        witness: who told `log_odds`; of effects that one witness told, the surest alone counts in a pair.
        sighting: where a refit may begin besides.
    """

    name: str
    stage: str
    symbol: str
    unit: str
    lower: float
    upper: float
    settings: tuple[Mapping[str, float], ...] = ({},)
    shapes: tuple[Shape, ...] = ()
    by_channel: bool = False
    alike: bool = False
    flag: bool = False
    folded: bool = False
    split_by: str = ""
    log_odds: float = 0.0
    told: tuple[float, ...] = ()
    trust: float = 1.0
    least: float = -np.inf
    witness: str = ""
    sighting: Sighting | None = field(default=None, compare=False)

    @property
    def ways(self) -> list[tuple[Mapping[str, float], float]]:
        """Every setting with what is told of it."""
        return list(zip(self.settings, self.told or (0.0,) * len(self.settings), strict=True))

    @property
    def signed(self) -> bool:
        return self.lower < 0

    @property
    def limits(self) -> tuple[float, float]:
        """Where a fit may go: three ranges, but a relative amplitude stays below one where its range does."""
        lower, upper = max(_REACH * self.lower, self.least), _REACH * self.upper
        if self.unit != "1":
            return lower, upper
        return max(lower, min(self.lower, -_ALMOST_ALL)), min(upper, max(self.upper, _ALMOST_ALL))

    @property
    def widths(self) -> tuple[float, float]:
        """Standard deviations of the amplitude's prior, below zero and above, as wide as each side of the range."""
        below, above = (_PRIOR_WIDTHS * self.trust * abs(end) for end in (self.lower, self.upper))
        return below or above, above or below

    @property
    def width(self) -> float:
        """The larger of both."""
        return max(self.widths)

    @property
    def typical(self) -> float:
        """Amplitude at which a template is taken: a tenth of the range, or all of a flag."""
        return 1.0 if self.flag else 0.1 * (self.upper if self.upper > 0 else self.lower)


@dataclass(frozen=True)
class Term:
    """A hypothesis at some strength.

    Args:
        hypothesis: which.
        amplitude: a number, or one a channel.
        setting: values of its other parameters, each a number or one a channel.
    """

    hypothesis: Hypothesis
    amplitude: Any
    setting: Mapping[str, Any]


def foreknown(terms: Sequence[Term]) -> float:
    """Log odds of terms together before the data: what one witness said of several is the same evidence."""
    told: dict[str, float] = {}
    for hypothesis in (term.hypothesis for term in terms):
        by = hypothesis.witness or hypothesis.name
        told[by] = max(told.get(by, -np.inf), hypothesis.log_odds)
    return float(sum(told.values()))


@dataclass(frozen=True)
class Coordinates:
    """Parameters that every comparison refits, in coordinates where their prior is normal.

    Args:
        symbols: names.
        mean, sd: of the prior; an infinite sd is none.
        step: for difference quotients.
        begun: where a fit begins; None where that is the mean.
    """

    symbols: tuple[str, ...]
    mean: Array
    sd: Array
    step: Array
    begun: Array | None = None

    @property
    def start(self) -> Array:
        return self.mean if self.begun is None else self.begun

    @cached_property
    def precision(self) -> Array:
        """1 / sd^2."""
        return np.asarray(self.sd**-2.0, np.float64)

    def __len__(self) -> int:
        return len(self.symbols)


@dataclass(frozen=True)
class Profiles:
    """What channels may depart along at once, each on a smooth course of its own.

    Args:
        together, alone: where all channels depart alike, and where each does for itself (profiles, C, K).
    """

    together: Array
    alone: Array

    @classmethod
    def of_values(cls, values: Array) -> Profiles:
        """In proportion to the values (C, K); a channel for itself half in proportion to its level."""
        level = values.mean(axis=1, keepdims=True)
        return cls(values[None], (0.5 * values + 0.5 * level)[None])


class Simulator(Protocol):
    """What predicts all channels at all samples."""

    @property
    def channels(self) -> tuple[str, ...]: ...

    @property
    def times(self) -> Array:
        """Of the samples (K,), > 0."""
        ...

    @property
    def own(self) -> Coordinates:
        """What every channel has for itself."""
        ...

    @property
    def shared(self) -> Coordinates:
        """What all channels have in common."""
        ...

    @property
    def starts(self) -> tuple[Array, ...]:
        """Values of `own` to start from."""
        ...

    @property
    def accuracy(self) -> float:
        """Relative error of its predictions."""
        ...

    @property
    def common_factor(self) -> bool:
        """Whether noise that a whole sample has in common is a factor of its values; else as large as each's own."""
        ...

    def predict(self, own: Array, shared: Array, terms: tuple[Term, ...] = ()) -> Array:
        """Values (..., channels, samples) for `own` (..., channels, parameters) and `shared` (parameters,)."""
        ...

    def driven(self, own: Array, shared: Array, courses: Callable[[Array], Array]) -> Array:
        """What channels gain (n, C, K) where what drives them all departs from what is known of it.

        Args:
            own, shared: where.
            courses: of the departure, in units of the drive's level: times (T,) -> (n, T).

        Returns:
            no rows where nothing drives the channels, or where it is known for sure.
        """
        ...

    def departing(self, values: Array) -> Sequence[Profiles]:
        """Along what channels with such values (C, K) may depart where no named effect is why."""
        ...

    def unsure(self, own: Array, shared: Array) -> Array:
        """What channels gain (n, C, K) by one standard deviation of every error of what drives them, as far as it is
        known to have any."""
        ...

    def spread(self, values: Array) -> Array:
        """Relative standard deviation of noise (channels, samples) for expected values."""
        ...

    def uneven(self, values: Array) -> Array:
        """What its logarithm gains (n, C, K) by one standard deviation of every error of its law, as far as that is
        known to have any."""
        ...

    def flexible(self, shared: Array) -> Array:
        """Non-negative curves (curves, samples) whose mixtures hold any channel without a gap."""
        ...
