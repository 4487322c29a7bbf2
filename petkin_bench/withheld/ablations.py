"""The engine with a part taken out, which must score worse."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from importlib import import_module
from typing import Any
from unittest.mock import patch

import numpy as np

from petkin.diagnosis.nuisance import Projection


def _no_axes(jacobian: Any, penalty: Any) -> Projection:
    return Projection(np.zeros((len(jacobian) + len(penalty), 0)), len(jacobian))


def _no_share(residuals: Any) -> Any:
    return np.zeros(residuals.shape[:-2])


def _no_factor(residuals: Any, freedom: float, _: Any) -> Any:
    return np.sqrt((residuals**2).sum(axis=(-2, -1)) / residuals.shape[-2] / freedom), _no_share(residuals)


def _no_pairs(*_: Any) -> list[Any]:
    return []


#: Part -> module of the engine, class in it or "", name, and what stands in for it.
_STAND_INS: dict[str, tuple[tuple[str, str, str, Any], ...]] = {
    "projection": (("nuisance", "Projection", "of", _no_axes),),
    "priors": (("effect", "", "_PRIOR_WIDTHS", 1e3), ("effect", "", "_REACH", 1e3)),
    "common_noise": (("noise", "", "common_share", _no_share), ("noise", "", "with_factor", _no_factor)),
    "pairs": (("diagnose", "", "pairs", _no_pairs),),
}
PARTS = tuple(_STAND_INS)
#: All of it: a network alone judges.
ENGINE = "engine"


@contextmanager
def without(part: str) -> Iterator[None]:
    """The engine without a part, or whole where it is "".

    `projection`: templates and residuals are compared as they are, though refits are kept; `priors`: strengths have no
    plausible range; `common_noise`: no share of the noise is common to a frame; `pairs`: one cause at a time.
    """
    with ExitStack() as stack:
        for module, owner, name, value in _STAND_INS.get(part, ()):
            found = import_module(f"petkin.diagnosis.{module}")
            stack.enter_context(patch.object(getattr(found, owner) if owner else found, name, value))
        yield
