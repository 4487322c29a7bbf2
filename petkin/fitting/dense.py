"""Standard errors of models beyond the five vectors of `normal`: from every curve's Jacobian itself, by eigenvalues."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin.fitting.covariance import Limits
from petkin.fitting.dual import partials
from petkin.fitting.sensitivity import model_jacobian
from petkin.fitting.table import Compression
from petkin.kinetics import CompartmentModel

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Eigenvalues of a scaled normal matrix below this are rounding.
_LEAST_EIGENVALUE = 1e-14


def dense_errors(
    model: CompartmentModel,
    packed: Compression,
    limits: Limits,
    values: Array,
    percent: Array,
    chi2: Array,
    *,
    wanted: bool,
) -> NDArray[np.int16]:
    """Fill in macro-parameters and percent standard errors, and say which bounds are reached: see `percent_errors`."""
    count = len(model.parameters)
    theta, rates = values[:count], list(values[: model.rates])
    free = ~limits.fixed[:, None]
    low, high = free & (theta <= limits.lowest[:, None]), free & (theta >= limits.highest[:, None])
    with np.errstate(all="ignore"):
        values[count:], macro_chain = partials(lambda *k: tuple(m.formula(*k) for m in model.macros), rates)
        percent[:] = np.nan
        if wanted:
            errors = _errors(model, packed, theta, chi2, low | high, ~free, macro_chain)
            percent[:] = np.where(np.isfinite(values), 100.0 * errors / np.abs(values), np.abs(values))
        return _reached(model, limits, rates, low, high)


def _errors(
    model: CompartmentModel, packed: Compression, theta: Array, chi2: Array, touching: Flags, fixed: Flags, chain: Array
) -> Array:
    """Standard errors (P + M, N); infinite for what the curve does not feel, NaN for parameters on a bound."""
    # A rate that is no longer defined (k4 where k3 = 0) must not spoil macros that do not depend on it.
    chain = np.where(np.isfinite(chain), chain, 0.0)
    held = touching | fixed
    variance = _variances(model, packed, theta, held, chain)
    errors = np.sqrt(np.maximum(variance * chi2, 0.0))
    unfelt = (variance[: len(theta)] == 0.0) & ~held
    spoilt = ((chain != 0.0) & unfelt[None, : model.rates]).any(axis=1)
    errors[np.concatenate([unfelt, spoilt])] = np.inf
    errors[: len(theta)][touching] = np.nan
    return errors


def _variances(model: CompartmentModel, packed: Compression, theta: Array, held: Flags, chain: Array) -> Array:
    """Of the parameters, then of the macro-parameters (P + M, N), for weights that are inverse variances."""
    _, jacobian = model_jacobian(model, packed, np.ascontiguousarray(theta.T))
    jacobian = np.where(held.T[:, None, :] | ~np.isfinite(jacobian), 0.0, jacobian)
    length = np.sqrt((jacobian**2).sum(axis=1))
    scale = np.divide(1.0, length, out=np.zeros_like(length), where=length > 0)
    scaled = jacobian * scale[:, None, :]
    values, axes = np.linalg.eigh(np.einsum("nrp,nrq->npq", scaled, scaled))
    felt = np.maximum(values, _LEAST_EIGENVALUE)
    macros = np.einsum("mqn,nq,nqk->nmk", chain, scale[:, : chain.shape[1]], axes[:, : chain.shape[1]])
    rows = np.concatenate([scale[:, :, None] * axes, macros], axis=1)
    return (rows**2 / felt[:, None, :]).sum(axis=2).T


def _reached(model: CompartmentModel, limits: Limits, rates: list[Array], low: Flags, high: Flags) -> NDArray[np.int16]:
    """Two bits a parameter, lower and upper bound, then the slowest and the fastest rate of an exponential."""
    reached = np.zeros(low.shape[1], np.int16)
    for i in range(len(low)):
        reached |= low[i].astype(np.int16) << np.int16(2 * i)
        reached |= high[i].astype(np.int16) << np.int16(2 * i + 1)
    for phi, rate in model.impulse(*rates):
        reached |= ((phi != 0) & (rate <= limits.slowest)).astype(np.int16) << np.int16(2 * len(low))
        reached |= ((phi != 0) & (rate >= limits.fastest)).astype(np.int16) << np.int16(2 * len(low) + 1)
    return reached
