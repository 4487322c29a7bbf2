"""Every curve's best exponentials, free but for signs and the interval of rates: drives the compiled kernel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin.fitting import kernel
from petkin.fitting.device_tables import DeviceTables, device_tables
from petkin.fitting.lanes import MAX_STEPS
from petkin.fitting.one_rate import OneRateTables, one_rate_tables, search_one_rate
from petkin.fitting.scan import SINGLE, TRAPPED
from petkin.fitting.table import RATE_OFFSET, Compression
from petkin.kinetics import CompartmentModel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Effort:
    """How hard to search.

    Args:
        nodes: table nodes.
        coarse: nodes of the exhaustive look-up.
        size: compressed directions; None keeps all that carry signal.
        tolerance: a polish ends when its expected relative gain in cost falls below this.
        again: second start where the residual promises more than this share of the cost.
        starts: grid points that a bounded fit starts from besides the free optimum.
        refine: finish on explicit residuals, past the rounding of the projected cost.
    """

    nodes: int
    coarse: int
    size: int | None
    tolerance: float
    again: float
    starts: int
    refine: bool


#: For images: 1 microsecond a voxel, within 0.1 % of the best cost in 98 of 100 voxels.
VOXELS = Effort(nodes=80, coarse=24, size=16, tolerance=1e-4, again=1e-3, starts=2, refine=False)
#: For regional curves: to the rounding of the table.
REGIONS = Effort(nodes=160, coarse=64, size=None, tolerance=1e-12, again=1e-6, starts=5, refine=True)


@dataclass(frozen=True)
class Exponentials:
    """Signed-off exponentials of N curves, fastest first: amplitudes already divided by 1 - vB; Kb where walls trap."""

    phi: Array
    rate: Array
    vB: Array
    cost: Array
    converged: NDArray[np.bool_]
    Kb: Array | None = None


def search_exponentials(
    model: CompartmentModel, packed: Compression, z: Array, sizes: Array, effort: Effort, *, blood: bool
) -> Exponentials:
    """Best exponentials of every curve.

    Args:
        model: compartment model; says how many rates are free and whether one is zero.
        packed: compressed table.
        z: compressed curves (R, N).
        sizes: weighted sum of squares of every curve (N,).
        effort: how hard to search.
        blood: whether blood may take part; without it vB = 0.
    """
    return search_among(model, search_tables(model, packed, effort, blood=blood), z, sizes, effort)


def search_among(
    model: CompartmentModel,
    tables: kernel.Tables | OneRateTables | DeviceTables,
    z: Array,
    sizes: Array,
    effort: Effort,
) -> Exponentials:
    """The same with tables made beforehand, for curves that come in parts."""
    z, sizes = np.ascontiguousarray(z), np.ascontiguousarray(sizes)
    if isinstance(tables, OneRateTables):
        found = search_one_rate(tables, z, sizes)
    elif isinstance(tables, DeviceTables):
        from petkin.fitting.on_device import search_on_device

        found = search_on_device(z, sizes, tables, effort.tolerance, effort.again)
    else:
        found = kernel.search(z, sizes, tables, effort.tolerance, effort.again)
    return exponentials(model, found)


def exponentials(model: CompartmentModel, found: Array) -> Exponentials:
    """What a compiled search found (7, N), as the model has it."""
    vB = np.minimum(found[kernel.X0], 1.0)
    held = np.where(vB < 1.0, 1.0 - vB, np.nan)
    atoms = model.free_rates + model.trapping
    phi = found[kernel.X1 : kernel.X1 + atoms] / held
    rate = np.maximum(np.exp(found[kernel.U1 : kernel.U1 + atoms]) - RATE_OFFSET, 0.0)
    return Exponentials(phi.T, rate.T, vB, found[kernel.COST], found[kernel.STEPS] < MAX_STEPS)


def search_tables(
    model: CompartmentModel,
    packed: Compression,
    effort: Effort,
    *,
    blood: bool,
    rates: tuple[float, float] = (0.0, np.inf),
    device: str | None = None,
) -> kernel.Tables | OneRateTables | DeviceTables:
    """What the search reads of a compressed table; free rates keep between `rates` (1/min); no device: compiled."""
    one = model.free_rates == 1
    rates = (0.0 if one and model.trapping else rates[0], rates[1])
    if one and device is None:
        return one_rate_tables(packed, TRAPPED if model.trapping else SINGLE, axis=blood, rates=rates)
    products = packed.products
    first, last = packed.positions(rates)
    count = int(last - np.ceil(first)) // 2 + 1 if one else effort.coarse
    coarse = np.unique(np.linspace(np.ceil(first), np.floor(last), count).round().astype(np.int64))
    lengths = np.linalg.norm(packed.basis[coarse], axis=1)
    # The look-up only says where to start: single precision does.
    atoms, lead = _off_blood(packed.basis[coarse], blood=blood)
    if device is not None:
        return device_tables(model, packed, coarse, (atoms, lead), (first, last), device, blood=blood)
    return kernel.Tables(
        blood=packed.blood if blood else 0.0,
        low=products.low,
        spacing=products.spacing,
        first=first,
        last=last,
        rows=products.rows,
        gram=products.gram,
        own=products.own,
        coarse=coarse,
        atoms=atoms.astype(np.float32),
        lead=lead.astype(np.float32),
        near=(atoms @ atoms.T).astype(np.float32),
        units=packed.basis[coarse] / lengths[:, None],
        lean=packed.basis[coarse, 0] / lengths,
        toward=(products.gram[:, 2 * coarse] / lengths).ravel(),
    )


def _off_blood(chosen: Array, *, blood: bool) -> tuple[Array, Array]:
    """Unit atoms for the look-up, off the blood axis where blood takes part, and their lean on it."""
    atoms = chosen.copy()
    if blood:
        atoms[:, 0] = 0.0
    length = np.linalg.norm(atoms, axis=1)
    return atoms / length[:, None], chosen[:, 0] / length
