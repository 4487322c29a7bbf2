"""Model values and their derivatives in compressed coordinates, for bounded fits and standard errors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petkin.fitting.dual import partials
from petkin.fitting.table import RATE_OFFSET, Compression
from petkin.kinetics import CompartmentModel

Array = NDArray[np.float64]


def derivatives(function: Callable[..., Any], arguments: Array) -> tuple[Array, Array]:
    """Values and Jacobian of an analytic function of P numbers with Q results, over N points.

    Args:
        function: takes P arrays, returns Q arrays (or one).
        arguments: (N, P).

    Returns:
        values (N, Q) and Jacobian (N, Q, P).
    """
    values, jacobian = partials(function, [np.ascontiguousarray(column) for column in arguments.T])
    return values.T, np.moveaxis(jacobian, -1, 0)


def read_basis(packed: Compression, rate: Array) -> tuple[Array, Array]:
    """B(a) and dB/da at rates (N,), each (N, R), read as the kernel does; rates outside the table end at its ends."""
    spacing = float(packed.u[1] - packed.u[0])
    u = np.clip(np.log(rate + RATE_OFFSET), packed.u[0], packed.u[-1])
    x = (u - packed.u[0]) / spacing
    i = np.clip(x.astype(np.int64), 0, len(packed.u) - 2)
    s = (x - i)[:, None]
    lower, upper = packed.basis[i], packed.basis[i + 1]
    rise, fall = packed.slope[i] * spacing, packed.slope[i + 1] * spacing
    value = lower + s * (rise + s * (3 * (upper - lower) - 2 * rise - fall + s * (2 * (lower - upper) + rise + fall)))
    slope = (
        rise + s * (2 * (3 * (upper - lower) - 2 * rise - fall) + s * 3 * (2 * (lower - upper) + rise + fall))
    ) / spacing
    return value, slope / (rate + RATE_OFFSET)[:, None]


def model_values(model: CompartmentModel, packed: Compression, parameters: Array) -> Array:
    """Compressed model curves (N, R) for parameters (N, P)."""
    vB = parameters[:, -1:]
    tissue = np.zeros((len(parameters), packed.size))
    for phi, rate in model.impulse(*parameters[:, : model.rates].T):
        tissue += phi[:, None] * read_basis(packed, rate)[0]
    return (1.0 - vB) * tissue + vB * blood_values(model, packed, parameters)


def blood_values(model: CompartmentModel, packed: Compression, parameters: Array) -> Array:
    """Compressed curves (N, R) of vessels: blood, and what their walls trap (from a table that begins at a = 0)."""
    curves = np.zeros((len(parameters), packed.size))
    curves[:, 0] = packed.blood
    return curves + parameters[:, -2:-1] * packed.basis[0] if model.wall else curves


def model_jacobian(model: CompartmentModel, packed: Compression, parameters: Array) -> tuple[Array, Array]:
    """Compressed model curves (N, R) and their Jacobian (N, R, P)."""
    vB = parameters[:, -1]
    pairs, chain = derivatives(
        lambda *k: tuple(v for pair in model.impulse(*k) for v in pair), parameters[:, : model.rates]
    )
    jacobian = np.zeros((*pairs.shape[:1], packed.size, parameters.shape[1]))
    tissue = np.zeros((len(parameters), packed.size))
    for m in range(pairs.shape[1] // 2):
        phi, rate = pairs[:, 2 * m], pairs[:, 2 * m + 1]
        basis, slope = read_basis(packed, rate)
        tissue += phi[:, None] * basis
        jacobian[:, :, : model.rates] += basis[:, :, None] * chain[:, None, 2 * m, :]
        jacobian[:, :, : model.rates] += (phi[:, None] * slope)[:, :, None] * chain[:, None, 2 * m + 1, :]
    jacobian[:, :, : model.rates] *= (1.0 - vB)[:, None, None]
    blood = blood_values(model, packed, parameters)
    jacobian[:, :, -1] = blood - tissue
    if model.wall:
        jacobian[:, :, -2] = vB[:, None] * packed.basis[0]
    return (1.0 - vB)[:, None] * tissue + vB[:, None] * blood, jacobian
