"""Fitted quantities of a cause, with their intervals."""

from __future__ import annotations

from dataclasses import dataclass, field

#: Standard errors to either side of a normal 90 % interval.
Z90 = 1.6448536269514722


@dataclass(frozen=True)
class Estimate:
    """A fitted quantity of a cause with its 90 % interval.

    Args:
        effect: whose it is; of a pair one of both.
        channel: the one that it concerns, where it differs between them; else "".
    """

    symbol: str
    unit: str
    value: float
    low: float
    high: float
    effect: str = field(default="", kw_only=True)
    channel: str = field(default="", kw_only=True)


@dataclass(frozen=True)
class Strength(Estimate):
    """The amplitude of an effect.

    Args:
        signed: whether it may be negative.
        single: whether there is one, or about the same in all channels; not of what is only there or not.
        alike: standard deviation, as a share of it, of an error in it that all data sets of a kind have alike.
    """

    signed: bool
    single: bool
    alike: float = 0.0
