"""Standard errors of every curve: the compiled Gauss-Newton covariance, many curves in step as in `lanes`.

The column of a parameter in the Jacobian is a combination of five vectors, the blood's axis, both atoms and both of
their derivatives, whose inner products are tabulated: J^T W J = C^T G C with G 5 x 5, no vector of frames is touched.
Where that loses digits (two rates nearly the same), the columns are built and orthogonalised one curve at a time.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from petkin.fitting import lanes
from petkin.fitting.dual import partials
from petkin.fitting.lanes import LANES, OWN, VECTORS
from petkin.fitting.normal import invert, normal_equations, orthogonalise
from petkin.fitting.sensitivity import model_jacobian
from petkin.fitting.table import RATE_OFFSET, Compression, InnerProducts
from petkin.kinetics import CompartmentModel

Array = NDArray[np.float64]

_STRICT = {"contract", "nsz"}
#: Eigenvalues of a scaled normal matrix below this are rounding.
_LEAST_EIGENVALUE = 1e-14
#: Relative error of a pivot from which on a curve is done again.
_LOST = 1e-6


def covariances(model: CompartmentModel, packed: Compression, parameters: Array, held: NDArray[np.bool_]) -> Array:
    """(J^T W J)^-1 of every curve, W the frame weights.

    Args:
        model: compartment model.
        packed: compressed table.
        parameters: (N, P).
        held: (N, P), parameters that count as known (fixed, or on a bound).

    Returns:
        (N, P, P): zero rows for held parameters; 1e30 times the scale where the rest cannot be told apart.
    """
    columns = [np.ascontiguousarray(column) for column in parameters.T]
    exponentials, chain = impulse_partials(model, columns[:-1])
    answer = np.empty((parameters.shape[1], parameters.shape[1], len(parameters)))
    none = np.empty((0, len(columns) - 1, len(parameters)))
    _run(packed.products, columns, exponentials, chain, held.T, none, answer, np.empty((0, len(parameters))))
    return np.moveaxis(answer, -1, 0)


def variances(
    products: InnerProducts,
    parameters: Array,
    exponentials: Array,
    chain: Array,
    held: NDArray[np.bool_],
    macro_chain: Array,
) -> Array:
    """Variances of the parameters, then of the macro-parameters, (P + M, N), for weights that are inverse variances.

    Args:
        products: inner products of the compressed table.
        parameters: (P, N).
        exponentials: phi_1, a_1, phi_2, ... (2 m, N).
        chain: their derivatives by the rate constants (2 m, P - 1, N).
        held: (P, N), parameters that count as known.
        macro_chain: derivatives of the macro-parameters by the rate constants (M, P - 1, N).
    """
    count = parameters.shape[1]
    answer = np.empty((len(held) + len(macro_chain), count))
    _run(products, list(parameters), exponentials, chain, held, macro_chain, np.empty((0, 0, count)), answer)
    return answer


def dense_variances(
    model: CompartmentModel, packed: Compression, parameters: Array, held: NDArray[np.bool_], macro_chain: Array
) -> Array:
    """The same for models beyond the five vectors: from every curve's Jacobian itself, by its eigenvalues."""
    _, jacobian = model_jacobian(model, packed, np.ascontiguousarray(parameters.T))
    jacobian = np.where(held.T[:, None, :] | ~np.isfinite(jacobian), 0.0, jacobian)
    length = np.sqrt((jacobian**2).sum(axis=1))
    scale = np.divide(1.0, length, out=np.zeros_like(length), where=length > 0)
    scaled = jacobian * scale[:, None, :]
    values, axes = np.linalg.eigh(np.einsum("nrp,nrq->npq", scaled, scaled))
    felt = np.maximum(values, _LEAST_EIGENVALUE)
    macros = np.einsum(
        "mqn,nq,nqk->nmk", macro_chain, scale[:, : macro_chain.shape[1]], axes[:, : macro_chain.shape[1]]
    )
    rows = np.concatenate([scale[:, :, None] * axes, macros], axis=1)
    return (rows**2 / felt[:, None, :]).sum(axis=2).T


def impulse_partials(model: CompartmentModel, rates: list[Array]) -> tuple[Array, Array]:
    """phi_1, a_1, phi_2, ... (2 m, N) of a model and their derivatives by the rate constants (2 m, P - 1, N)."""
    return partials(lambda *k: tuple(number for pair in model.impulse(*k) for number in pair), rates)


def _run(
    products: InnerProducts,
    columns: list[Array],
    exponentials: Array,
    chain: Array,
    held: NDArray[np.bool_],
    macro_chain: Array,
    covariance: Array,
    variance: Array,
) -> None:
    count = len(columns[0])
    if count % LANES:
        # A remainder loop might round another way than the rest: fill up, so that there is none.
        spare = LANES - count % LANES
        columns, exponentials, chain = (
            [_fill(c, spare) for c in columns],
            _fill(exponentials, spare),
            _fill(chain, spare),
        )
        held, macro_chain = _fill(held, spare), _fill(macro_chain, spare)
        wide, long = _fill(covariance, spare), _fill(variance, spare)
        _run(products, columns, exponentials, chain, held, macro_chain, wide, long)
        covariance[:], variance[:] = wide[..., :count], long[..., :count]
        return
    speed = 1.0 / ((exponentials[1::2] + RATE_OFFSET) * products.spacing)
    last = float(len(products.own))
    position = np.clip((np.log(exponentials[1::2] + RATE_OFFSET) - products.low) / products.spacing, 0.0, last)
    position = np.where(np.isfinite(position), position, 0.0)
    p, size = len(columns), products.rows.shape[0]
    scratch = (
        np.zeros((lanes.PRODUCTS + VECTORS * VECTORS) * LANES),
        np.zeros((p + 1, VECTORS, LANES)),
        np.empty((p, p, LANES)),
        np.zeros((p, p, LANES)),
        np.zeros((p, LANES)),
        np.empty(LANES),
        np.empty((VECTORS, LANES)),
        np.empty(LANES),
        np.empty((VECTORS, size)),
        np.empty((p, size)),
        np.empty((2, p, p)),
    )
    tables = (products.rows, products.gram, products.own, products.blood)
    held = np.ascontiguousarray(held)
    theta = np.stack(columns)
    _all(tables, position, exponentials[::2], speed, chain, theta, held, macro_chain, covariance, variance, scratch)


def _fill(array: NDArray, spare: int) -> NDArray:
    return np.concatenate([array, np.zeros((*array.shape[:-1], spare), array.dtype)], axis=-1)


@njit(cache=True, nogil=True, error_model="numpy")
def _all(tables, position, phi, speed, chain, theta, held, macro_chain, covariance, variance, scratch):
    rows, gram, own, blood = tables
    work, column, normal, inverse, scale, lost, seen, square, vectors, axes, upper = scratch
    for start in range(0, theta.shape[1], LANES):
        _gather(work, start, gram, own, position)
        lanes.inner_products(work)
        _columns(start, blood, phi, speed, chain, theta, column)
        normal_equations(work, start, column, theta, held, normal, scale, lost, seen, square)
        invert(normal, inverse, scale, lost)
        for n in range(LANES):
            if lost[n] > _LOST:
                orthogonalise(rows, position, start, n, column, scale, normal, vectors, axes, upper)
        _hand_over(start, normal, macro_chain, covariance, variance)


@njit(cache=True, error_model="numpy")
def _gather(work, start, gram, own, position):
    """What the inner products need at every curve's rates; an absent second atom sits at the first node."""
    last, two = np.uint64(own.shape[0] - 1), np.uint64(2)
    for n in range(LANES):
        x = position[0, start + n]
        y = position[1, start + n] if position.shape[0] > 1 else 0.0
        i, j = min(np.uint64(x), last), min(np.uint64(y), last)
        work[lanes.FRACTION_1 * LANES + n], work[lanes.FRACTION_2 * LANES + n] = x - i, y - j
        for k in range(OWN):
            work[(lanes.OWN_1 + k) * LANES + n] = own[i, np.uint64(k)]
            work[(lanes.OWN_2 + k) * LANES + n] = own[j, np.uint64(k)]
        for k in range(4):
            for m in range(4):
                work[(lanes.CROSS + 4 * k + m) * LANES + n] = gram[two * j + np.uint64(k), two * i + np.uint64(m)]


@njit(cache=True, fastmath=_STRICT, error_model="numpy")
def _columns(start, blood, phi, speed, chain, theta, column):
    """Every parameter's column, and last the curve itself, as combinations of the five vectors."""
    rates = chain.shape[1]
    for m in range(phi.shape[0]):
        for q in range(rates):
            for n in range(LANES):
                tissue = 1.0 - theta[rates, start + n]
                column[q, 1 + 2 * m, n] = chain[2 * m, q, start + n] * tissue
                moved = chain[2 * m + 1, q, start + n] * phi[m, start + n] * speed[m, start + n]
                column[q, 2 + 2 * m, n] = moved * tissue
        for n in range(LANES):
            column[rates, 1 + 2 * m, n] = -phi[m, start + n]
            column[rates + 1, 1 + 2 * m, n] = phi[m, start + n] * (1.0 - theta[rates, start + n])
    for n in range(LANES):
        column[rates, 0, n] = blood
        column[rates + 1, 0, n] = blood * theta[rates, start + n]


@njit(cache=True, fastmath=_STRICT, error_model="numpy")
def _hand_over(start, normal, macro_chain, covariance, variance):
    """Covariances, or variances of parameters and of what follows from them, as far as asked for."""
    p = normal.shape[0]
    for i in range(covariance.shape[0]):
        for j in range(covariance.shape[0]):
            for n in range(LANES):
                covariance[i, j, start + n] = normal[max(i, j), min(i, j), n]
    if variance.shape[0] == 0:
        return
    for i in range(p):
        for n in range(LANES):
            variance[i, start + n] = normal[i, i, n]
    for m in range(macro_chain.shape[0]):
        for n in range(LANES):
            variance[p + m, start + n] = 0.0
        for i in range(p - 1):
            for j in range(i + 1):
                twice = 1.0 if i == j else 2.0
                for n in range(LANES):
                    both = macro_chain[m, i, start + n] * macro_chain[m, j, start + n]
                    variance[p + m, start + n] += twice * both * normal[i, j, n]
