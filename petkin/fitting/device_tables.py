"""What the search on a device reads of a compressed table, built on the CPU and moved once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.fitting import lanes
from petkin.fitting.table import Compression
from petkin.kinetics import CompartmentModel

if TYPE_CHECKING:
    import torch
    from torch import Tensor

Array = NDArray[np.float64]

#: Curves on the device at a time: 0.15 GB an array of curves x pairs.
CHUNK = 65536


@dataclass(frozen=True)
class DeviceTables:
    """A compressed table on a device; positions x count nodes, u = low + spacing x.

    Args:
        blood: length of the blood atom along axis 0; 0 leaves blood out.
        low, spacing: of the nodes in u.
        first, last: positions that rates keep between.
        cells: b and db/dx at both ends of every interval (nodes - 1, 4, R).
        units: unit vectors along b at the coarse nodes (C, R).
        coarse: their positions (C,).
        atoms, lead: unit atoms off the blood axis there (C, R) and their lean on it (C,).
        pairs: coarse nodes that are looked up together (2, P).
        starts: positions that a polish starts from, of every node alone, then of every pair (2, C + P).
        slow_there, slow_free: whether a second exponential takes part, and whether its rate is free.
    """

    blood: float
    low: float
    spacing: float
    first: float
    last: float
    cells: Tensor
    units: Tensor
    coarse: Tensor
    atoms: Tensor
    lead: Tensor
    pairs: Tensor
    starts: Tensor
    slow_there: bool
    slow_free: bool


def find_device(name: str) -> torch.device:
    """The device that torch knows by this name.

    Raises:
        InputError: there is none.
    """
    import torch

    try:
        device = torch.device(name)
        torch.empty(1, dtype=torch.float64, device=device).sum().item()
    except (RuntimeError, AssertionError, TypeError, NotImplementedError):
        raise InputError(f"--device {name}: torch sees no such device here; leave --device out.") from None
    return device


def device_tables(
    model: CompartmentModel,
    packed: Compression,
    coarse: NDArray[np.int64],
    off_blood: tuple[Array, Array],
    ends: tuple[float, float],
    device: str,
    *,
    blood: bool,
) -> DeviceTables:
    """Tables for `search_on_device`.

    Args:
        model: compartment model; says how many rates are free and whether one is zero.
        packed: compressed table.
        coarse: nodes of the look-up (C,); the first is a = 0 where the model traps.
        off_blood: unit atoms off the blood axis there, and their lean on it.
        ends: positions that rates keep between.
        device: e.g. "cuda".
        blood: whether blood takes part.
    """
    import torch

    there, products, count = find_device(device), packed.products, len(coarse)
    free = model.free_rates == 2
    two = free or model.trapping
    faster, slower = np.tril_indices(count, -1)
    kept = np.full(len(faster), True) if free else (slower == 0) & two
    pairs = np.stack([faster[kept], slower[kept]])
    # Of pairs with one atom at work, the one whose other atom is the slowest.
    alone = np.stack([np.maximum(np.arange(count), int(two)), np.zeros(count, np.int64)])
    starts = np.where([[True], [two]], coarse[np.concatenate([alone, pairs], axis=1)], 0)
    rows = products.rows.T
    cells = np.stack([rows[2 * i : 2 * i + 4] for i in range(len(rows) // 2 - 1)])
    chosen = packed.basis[coarse]

    def move(values: NDArray) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(values)).to(there)

    return DeviceTables(
        packed.blood if blood else 0.0,
        products.low,
        products.spacing,
        *ends,
        cells=move(cells),
        units=move(chosen / np.linalg.norm(chosen, axis=1, keepdims=True)),
        coarse=move(coarse.astype(np.float64)),
        atoms=move(off_blood[0]),
        lead=move(off_blood[1]),
        pairs=move(pairs),
        starts=move(starts.astype(np.float64)),
        slow_there=two,
        slow_free=free,
    )


def read_atoms(t: DeviceTables, x: Tensor) -> tuple[Tensor, Tensor]:
    """b and db/dx at positions x (n,), (n, R) each."""
    import torch

    cell = x.long().clamp(max=len(t.cells) - 1)
    rows, s = t.cells[cell], x - cell
    value, slope = (torch.stack(f.py_func(s), dim=1) for f in (lanes.value_weights, lanes.slope_weights))
    return (value[:, :, None] * rows).sum(1), (slope[:, :, None] * rows).sum(1)
