"""Formulas written once for numpy and torch: what they compute with is what the numbers at hand are.

Both libraries spell alike what is asked of them here (`exp`, `where`, `concatenate`, `cumsum(x, axis=-1)`, ...). So
numbers need no torch, which takes longer to load than a small study takes to fit.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np


def library(*numbers: Any) -> Any:
    """torch where one of these is a tensor, numpy otherwise."""
    torch = sys.modules.get("torch")
    if torch is not None:
        for x in numbers:
            if isinstance(x, torch.Tensor):
                return torch
    return np


def alike(*numbers: Any) -> tuple[Any, ...]:
    """All as arrays of numpy; or, where one is a tensor, as tensors where that one is, plain numbers of its type."""
    xp = library(*numbers)
    if xp is np:
        return tuple(map(np.asarray, numbers))
    first = next(x for x in numbers if isinstance(x, xp.Tensor))

    def tensor(x: Any) -> Any:
        return xp.as_tensor(x, dtype=first.dtype if isinstance(x, float | int) else None, device=first.device)

    return tuple(x if isinstance(x, xp.Tensor) else tensor(x) for x in numbers)
