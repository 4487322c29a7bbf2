"""Least squares inside a box of rate constants for many voxels: projected Levenberg-Marquardt, 32 fits in step.

As in `normal`, all inner products come from the table, and a model enters as a tape of its formulas. Parameters on a
bound that the gradient pushes outwards are held, the rest take the damped Gauss-Newton step, clipped to the box
(Kanzow, Yamashita & Fukushima 2004, doi:10.1016/j.cam.2004.02.013). The rates of the exponentials are kept in their
interval by a penalty that is quadratic in how far they leave it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin.fitting import lanes
from petkin.fitting.box_step import (
    COST,
    DAMPING,
    DONE,
    MOST_STEPS,
    PLAIN,
    RATE_1,
    ROWS,
    SIZE,
    STEPS,
    THETA,
    TRIAL,
    evaluate,
    propose,
)
from petkin.fitting.formulas import curve_formulas, gather, place, unpack
from petkin.fitting.lanes import LANES
from petkin.fitting.normal import PARAMETERS
from petkin.fitting.table import Compression
from petkin.fitting.tape import run
from petkin.jit import njit
from petkin.kinetics import CompartmentModel
from petkin.levenberg_marquardt import ON_BOUND

Array = NDArray[np.float64]

_STRICT = {"contract", "nsz"}


@dataclass(frozen=True)
class BoxTask:
    """What to fit, and inside what.

    Args:
        model: compartment model.
        packed: compressed table; must cover every rate that the box allows.
        lower, upper: the box (P,).
        rates: interval of the exponentials' rates, 1/min.
        tolerance: a fit ends when its expected relative gain in cost falls below this.
    """

    model: CompartmentModel
    packed: Compression
    lower: Array
    upper: Array
    rates: tuple[float, float]
    tolerance: float


def polish_in_box(
    task: BoxTask, z: Array, sizes: Array, start: Array, penalty: float
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Fit curves from given starts.

    Args:
        task: see `BoxTask`; the model has no wall.
        z: compressed curves (R, N).
        sizes: weighted sums of squares (N,).
        start: parameters inside the box (N, P).
        penalty: of a rate that leaves its interval by its own size, over the curve's sum of squares.

    Returns:
        parameters (N, P), costs without the penalty (N,), converged (N,).
    """
    products, formulas = task.packed.products, curve_formulas(task.model)
    z, start = np.ascontiguousarray(z), np.ascontiguousarray(start.T)
    theta, cost, converged = np.empty_like(start), np.empty(z.shape[1]), np.empty(z.shape[1], np.bool_)
    scratch = (formulas.tape.memory(), np.zeros(ROWS * LANES), np.zeros((2, LANES)), np.empty(LANES, np.int64))
    tables = (products.rows, products.gram, products.own, products.blood, products.low, products.spacing)
    tape = (formulas.tape.steps, formulas.tape.outputs, formulas.exponentials)
    lower, upper = task.lower, task.upper
    span = np.where(np.isfinite(upper - lower), upper - lower, 1.0)
    ends = np.zeros((4, PARAMETERS))
    ends[:, : len(lower)] = lower, upper, lower + ON_BOUND * span, upper - ON_BOUND * span
    interval = (*task.rates, penalty)
    _fit_all(tables, tape, ends, interval, z, sizes, start, task.tolerance, theta, cost, converged, scratch)
    return theta.T, cost, converged


@njit(nogil=True)
def _fit_all(tables, tape, ends, interval, z, sizes, start, tolerance, theta, cost, converged, scratch):
    rows, gram, own, axis, low, spacing = tables
    steps, outputs, exponentials = tape
    memory, w, position, curve = scratch
    parameters, count = start.shape[0], start.shape[1]
    used = fed = 0
    while True:
        while used < LANES and fed < count:
            curve[used] = fed
            _enter(w, used, fed, parameters, z, sizes, start)
            used, fed = used + 1, fed + 1
        if used == 0:
            break
        for q in range(parameters):
            for n in range(LANES):
                memory[q, n] = w[(TRIAL + q) * LANES + n]
        run(steps, memory)
        place(memory, outputs, exponentials, low, spacing, float(len(own)), position, w)
        gather(w, gram, own, position)
        unpack(memory, outputs, parameters, exponentials, w)
        for m in range(exponentials):
            rate = memory[outputs[2 + 2 * m]]
            for n in range(LANES):
                w[(RATE_1 + m) * LANES + n] = rate[n]
        _gather_curves(w, used, curve, z, rows, position, len(own))
        evaluate(w, axis, interval[0], interval[1], interval[2])
        propose(w, ends, tolerance)
        n = 0
        while n < used:
            if w[DONE * LANES + n] == 0.0:
                n += 1
                continue
            v = curve[n]
            for q in range(parameters):
                theta[q, v] = w[(THETA + q) * LANES + n]
            cost[v] = w[PLAIN * LANES + n]
            converged[v] = w[STEPS * LANES + n] < MOST_STEPS
            if fed < count:
                curve[n] = fed
                _enter(w, n, fed, parameters, z, sizes, start)
                fed, n = fed + 1, n + 1
            else:
                used -= 1
                curve[n] = curve[used]
                for row in range(THETA, ROWS):
                    w[row * LANES + n] = w[row * LANES + used]


@njit()
def _enter(w, n, v, parameters, z, sizes, start):
    """Begin a fit in lane n: the first trial counts as a gain."""
    for row in range(THETA, ROWS):
        w[row * LANES + n] = 0.0
    for q in range(parameters):
        w[(TRIAL + q) * LANES + n] = w[(THETA + q) * LANES + n] = start[q, v]
    w[COST * LANES + n] = np.inf
    w[DAMPING * LANES + n] = 1e-2
    w[SIZE * LANES + n] = sizes[v]


@njit(fastmath=_STRICT)
def _gather_curves(w, used, curve, z, rows, position, cells):
    """Four rows of the table on every lane's curve, for both exponentials, and its component on the axis."""
    for n in range(used):
        v = curve[n]
        w[lanes.BLOOD_SEEN * LANES + n] = z[0, v]
        for m in range(2):
            j = np.uint64(2) * np.uint64(min(int(position[m, n]), cells - 1))
            j1, j2, j3 = j + np.uint64(1), j + np.uint64(2), j + np.uint64(3)
            s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
            for r in range(z.shape[0]):
                here = z[r, v]
                s0 += rows[r, j] * here
                s1 += rows[r, j1] * here
                s2 += rows[r, j2] * here
                s3 += rows[r, j3] * here
            k = ((lanes.SEEN_1 if m == 0 else lanes.SEEN_2) * LANES) + n
            w[k], w[k + LANES], w[k + 2 * LANES], w[k + 3 * LANES] = s0, s1, s2, s3
