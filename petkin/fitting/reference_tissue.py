"""Curves made of a reference region's curve: its table, and the washout rate that all regions share.

With C_R in the place of the plasma, B(a) = e^{-a t} * C_R, and a region with one tissue compartment is

    C_T = R1 C_R + (k2 - R1 k2a) B(k2a),   k2a = k2 / (1 + BPND),

two amplitudes and one rate; with the reference region's own k2' = k2 / R1 known, it has one amplitude less:

    C_T = R1 (C_R + (k2' - k2a) B(k2a)).

References: Lammertsma AA, Hume SP. NeuroImage 1996;4:153-158, doi:10.1006/nimg.1996.0066;
Wu Y, Carson RE. J Cereb Blood Flow Metab 2002;22:1440-1452, doi:10.1097/01.WCB.0000033967.83623.34
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.fitting.choices import Choices
from petkin.fitting.given import Given
from petkin.fitting.one_rate import COST, one_rate_tables, search_one_rate
from petkin.fitting.one_rate_fit import frames_first
from petkin.fitting.parts import in_parts
from petkin.fitting.projection import project_curves
from petkin.fitting.scan import SINGLE
from petkin.fitting.search import REGIONS, VOXELS, Effort
from petkin.fitting.table import RATE_OFFSET, Compression, build_table, compress

Array = NDArray[np.float64]

#: Values of k2' tried before the minimum is polished, on about so many of the curves. Their minimum lies within a few
#: of its own standard errors of that of all curves, to which parabolas lead from there.
_TRIED, _FEW = 24, 1000
#: Step in ln k2' for slope and curvature of the cost, parabolas at most, and what may be missed, in standard errors.
_STEP, _STEPS, _MISSED = 0.005, 6, 0.02


def effort_for(voxels: bool) -> Effort:
    """How hard to search."""
    return VOXELS if voxels else REGIONS


def reference_table(label: str, given: Given, rate_bounds: tuple[float, float], effort: Effort) -> Compression:
    """The compressed table of B between two rates (1/min); its axis is the reference region's frame values."""
    table = build_table(given.reference_input(label), given.observation, rate_bounds=rate_bounds, nodes=effort.nodes)
    return compress(table, given.weights, tolerance=0.0 if effort.size is None else 1e-9, size=effort.size)


def with_known_k2prime(packed: Compression, k2prime: float) -> Compression:
    """The table of C_R + (k2' - a) B(a), what a region looks like whose R1 is 1."""
    away = (k2prime - packed.rates)[:, None]
    basis = away * packed.basis
    basis[:, 0] += packed.blood
    slope = away * packed.slope - (packed.rates + RATE_OFFSET)[:, None] * packed.basis
    return replace(packed, basis=basis, slope=slope)


def share_k2prime(
    curves: NDArray[np.floating], given: Given, choices: Choices, voxels: bool
) -> dict[str, tuple[float, float]]:
    """k2' and its percent standard error as all curves together tell, by its symbol; empty where it is fixed."""
    if "k2prime" in choices.fixed:
        return {}
    effort = effort_for(voxels)
    packed = reference_table("A shared k2'", given, choices.rate_bounds, effort)
    return {"k2prime": shared_k2prime(curves, packed, given.weights, effort)}


def fixed_k2prime(label: str, choices: Choices, shared: dict[str, tuple[float, float]]) -> float:
    """The k2' to use, 1/min: as fixed, else as shared.

    Raises:
        InputError: it is fixed at zero, or bounded.
    """
    if "k2prime" in choices.bounds:
        raise InputError(f"{label}: k2prime is the same for all curves; hold it with --fix k2prime=..., or leave it.")
    value = choices.fixed["k2prime"] if not shared else shared["k2prime"][0]
    if not value > 0:
        raise InputError(f"{label}: k2prime cannot be fixed at {value:g}; it is a rate above 0, 1/min.")
    return value


def shared_k2prime(
    curves: NDArray[np.floating], packed: Compression, weights: Array, effort: Effort
) -> tuple[float, float]:
    """The k2' at which all curves together are fitted best, R1 and BPND being each curve's own.

    Args:
        curves: (N, K), kBq/mL.
        packed: table of B.
        weights: (K,).
        effort: how hard to search.

    Returns:
        k2' in 1/min, and its percent standard error: from the curvature of the total cost at its minimum, with the
        variance that the cost at the minimum tells.
    """
    z, sizes, _, used = project_curves(packed, weights, frames_first(np.asarray(curves)), 0, len(curves))
    every = max(1, np.count_nonzero(used) // _FEW)
    all_curves = np.ascontiguousarray(z[:, used]), sizes[used]
    few = np.ascontiguousarray(all_curves[0][:, ::every]), all_curves[1][::every]
    slowest, fastest = np.log(packed.rates[[0, -1]])
    tried = np.linspace(slowest, fastest, _TRIED)
    best = int(np.argmin([_rough_cost(x, packed, *few) for x in tried]))
    low, high = tried[max(best - 1, 0)], tried[min(best + 1, _TRIED - 1)]
    from scipy.optimize import minimize_scalar

    exact = {"xatol": 1e-7 if every == 1 else _STEP / 4.0}
    near: Any = minimize_scalar(_cost, bounds=(low, high), args=(packed, *few), method="bounded", options=exact)
    found, error = float(near.x), np.inf
    freedom = max(int(np.count_nonzero(weights)) * len(all_curves[1]) - 2 * len(all_curves[1]) - 1, 1)
    for _ in range(_STEPS):
        below, least, above = (_cost(found + shift, packed, *all_curves) for shift in (-_STEP, 0.0, _STEP))
        bend = (below - 2.0 * least + above) / _STEP**2
        error = np.sqrt(2.0 * least / freedom / bend) if bend > 0.0 else np.inf
        if every == 1 or not bend > 0.0:
            break
        before, found = found, float(np.clip(found - (above - below) / (2.0 * _STEP * bend), low, high))
        if (found - before) ** 2 < _MISSED * error:  # about what the parabola misses
            break
    return float(np.exp(found)), 100.0 * float(error)


def _cost(log_k2prime: float, packed: Compression, z: Array, sizes: Array) -> float:
    """The sum of all curves' weighted squared residuals at a k2'."""
    tables = one_rate_tables(with_known_k2prime(packed, float(np.exp(log_k2prime))), SINGLE, axis=False)

    def of(rows: slice) -> float:
        return float(search_one_rate(tables, np.ascontiguousarray(z[:, rows]), sizes[rows])[COST].sum())

    return sum(in_parts(of, len(sizes)))


def _rough_cost(log_k2prime: float, packed: Compression, z: Array, sizes: Array) -> float:
    """The same with the rates of the table's nodes alone."""
    atoms = with_known_k2prime(packed, float(np.exp(log_k2prime))).basis
    length = np.linalg.norm(atoms, axis=1, keepdims=True)
    seen = np.divide(atoms, length, out=np.zeros_like(atoms), where=length > 0.0) @ z
    return float(sizes.sum() - (np.maximum(seen.max(axis=0), 0.0) ** 2).sum())
