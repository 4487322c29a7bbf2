"""From which series c_p and c_n are taken when a series is predicted.

* reconstruct: all from the series itself.
* meta: both from k other series of the same dynamics: what is identified must serve where it was not seen.
* mixed: c_p, whose meaning the known physics fixes, from the series itself; c_n from k others.

Reference: arXiv:2403.08194, section 3.2 (strategies A, B, C).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from petkin.errors import InputError
from petkin.hybrid.episodes import of_others
from petkin.hybrid.model import Encoded

#: (what every series says by itself [D, S, ...], k) -> what every series is predicted from.
Strategy = Callable[[Encoded, int], Encoded]


def reconstruct(said: Encoded, k: int) -> Encoded:
    """All from the series itself; k is not used."""
    return said


def meta(said: Encoded, k: int) -> Encoded:
    """c_p and c_n as means over k other series."""
    return replace(said, physics=of_others(said.physics, k), code=of_others(said.code, k))


def mixed(said: Encoded, k: int) -> Encoded:
    """c_p from the series itself, c_n as the mean over k others."""
    return replace(said, code=of_others(said.code, k))


STRATEGIES: dict[str, Strategy] = {"reconstruct": reconstruct, "meta": meta, "mixed": mixed}


def find_strategy(name: str) -> Strategy:
    """The strategy of this name.

    Raises:
        InputError: there is none.
    """
    if name not in STRATEGIES:
        raise InputError(f"There is no strategy {name!r}; choose one of {', '.join(STRATEGIES)}.")
    return STRATEGIES[name]
