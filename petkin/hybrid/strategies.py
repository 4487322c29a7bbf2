"""From which series c_p and c_n are taken when a series is predicted.

* reconstruct: all from the series itself.
* meta: both from k other series of the same dynamics: what is identified must serve where it was not seen.
* mixed: c_p, whose meaning the known physics fixes, from the series itself; c_n from k others.

Reference: arXiv:2403.08194, section 3.2 (strategies A, B, C).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import torch
from torch import Tensor

from petkin.errors import InputError
from petkin.hybrid.aggregate import Aggregate, mean
from petkin.hybrid.episodes import of_others
from petkin.hybrid.model import Encoded


class Strategy(Protocol):
    """What every series says by itself [D, S, ...] -> what every series is predicted from."""

    def __call__(self, said: Encoded, k: int, aggregate: Aggregate = mean, /) -> Encoded: ...


def reconstruct(said: Encoded, k: int, aggregate: Aggregate = mean, /) -> Encoded:
    """All from the series itself; k is not used."""
    return said


def meta(said: Encoded, k: int, aggregate: Aggregate = mean, /) -> Encoded:
    """c_p and c_n from k other series."""
    physics, code = _others(said, k, aggregate)
    return replace(said, physics=physics, code=code)


def mixed(said: Encoded, k: int, aggregate: Aggregate = mean, /) -> Encoded:
    """c_p from the series itself, c_n from k others."""
    return replace(said, code=_others(said, k, aggregate)[1])


def _others(said: Encoded, k: int, aggregate: Aggregate) -> tuple[Tensor, Tensor]:
    """What k others say together of c_p and c_n."""
    parts = said.physics.shape[-1], said.code.shape[-1]
    physics, code = of_others(torch.cat([said.physics, said.code], dim=-1), k, aggregate).split(parts, dim=-1)
    return physics, code


STRATEGIES: dict[str, Strategy] = {"reconstruct": reconstruct, "meta": meta, "mixed": mixed}


def find_strategy(name: str) -> Strategy:
    """The strategy of this name.

    Raises:
        InputError: there is none.
    """
    if name not in STRATEGIES:
        raise InputError(f"There is no strategy {name!r}; choose one of {', '.join(STRATEGIES)}.")
    return STRATEGIES[name]
