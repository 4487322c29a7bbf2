"""Standard errors of every curve: the compiled Gauss-Newton covariance, many curves in step as in `lanes`.

What a model is enters as a tape of its `formulas`; see `normal` for the normal equations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin.fitting import normal_one
from petkin.fitting.formulas import Formulas, curve_formulas, gather, lay, place, unpack
from petkin.fitting.lanes import LANES
from petkin.fitting.normal import (
    ALL_ROWS,
    COLUMN,
    FREE,
    INVERSE,
    LOST,
    PARAMETERS,
    SCALE,
    VALUE,
    VECTORS,
    invert,
    invert_again,
)
from petkin.fitting.normal_one import gather_one, invert_one
from petkin.fitting.table import Compression, InnerProducts
from petkin.fitting.tape import run
from petkin.jit import njit
from petkin.kinetics import CompartmentModel

Array = NDArray[np.float64]

# Rows after those of `normal`: what variances are scaled by, bounds reached in powers of two, a macro-parameter,
# amplitudes and rates, percent errors.
_CHI2, _REACHED, _MACRO, _AMPLITUDE, _RATE, _ERROR = (ALL_ROWS + row for row in (0, 1, 2, 3, 5, 7))
_ROWS = ALL_ROWS + 12

_STRICT = {"contract", "nsz"}
#: Relative error of a pivot from which on a curve is done again.
_TOO_MUCH = 1e-6


@dataclass(frozen=True)
class Limits:
    """Where values count as lying on a bound.

    Args:
        fixed: parameters that are known (P,).
        lowest, highest: values at or beyond these touch a bound (P,).
        slowest, fastest: rates at or beyond these lie at an end of their interval, 1/min.
    """

    fixed: NDArray[np.bool_]
    lowest: Array
    highest: Array
    slowest: float
    fastest: float

    @property
    def padded(self) -> Array:
        """Where free parameters touch a bound, and which are free, for as many as there is room (3, PARAMETERS)."""
        rows = np.zeros((3, PARAMETERS))
        rows[0], rows[1] = -np.inf, np.inf
        free = np.flatnonzero(~self.fixed)
        rows[0, free], rows[1, free], rows[2, free] = self.lowest[free], self.highest[free], 1.0
        return rows


def model_errors(
    model: CompartmentModel,
    packed: Compression,
    limits: Limits,
    values: Array,
    percent: Array,
    chi2: Array,
    *,
    wanted: bool,
) -> NDArray[np.int16]:
    """`percent_errors` of a compartment model."""
    return percent_errors(
        packed.products, curve_formulas(model, model.macros), limits, values, percent, chi2, wanted=wanted
    )


def percent_errors(
    products: InnerProducts,
    formulas: Formulas,
    limits: Limits,
    values: Array,
    percent: Array,
    chi2: Array,
    *,
    wanted: bool,
) -> NDArray[np.int16]:
    """Fill in macro-parameters and percent standard errors.

    Args:
        products: inner products of the compressed table.
        formulas: of the model.
        limits: parameters on a bound count as known, and have no error.
        values: parameters, then room for macro-parameters (P + M, N).
        percent: room for 100 |se / value| (P + M, N). Infinite for what the curve does not feel and for infinite values
            (VND where k2 = 0), NaN for parameters on a bound and for values that are no numbers.
        chi2: what variances are scaled by (N,).
        wanted: whether errors are wanted; NaN without.

    Returns:
        bounds reached, a bit each (N,): lower and upper of every free parameter in turn, then the slowest and the
        fastest rate of an exponential that takes part.
    """
    size = products.rows.shape[0]
    reached = np.empty(values.shape[1], np.int16)
    scratch = (
        formulas.tape.memory(),
        np.zeros(_ROWS * LANES),
        np.zeros((2, LANES)),
        np.empty((VECTORS, size)),
        np.empty((PARAMETERS, size)),
        np.empty((2, PARAMETERS, PARAMETERS)),
    )
    tape = (formulas.tape.steps, formulas.tape.outputs, formulas.exponentials, formulas.macros)
    tables = (products.rows, products.gram, products.own, products.blood, products.low, products.spacing)
    ends = (*limits.padded, limits.slowest, limits.fastest, 4.0**formulas.parameters)
    _all(tables, tape, ends, values, percent, chi2, wanted, reached, scratch)
    return reached


@njit(nogil=True)
def _all(tables, tape, ends, values, percent, chi2, wanted, reached, scratch):
    rows, gram, own, axis, low, spacing = tables
    steps, outputs, exponentials, macros = tape
    memory, w, position, vectors, axes, work = scratch
    parameters, atoms = len(values) - macros, 1 + 2 * exponentials
    for start in range(0, values.shape[1], LANES):
        count = min(LANES, values.shape[1] - start)
        _enter(memory, values, chi2, parameters, start, count, w)
        run(steps, memory)
        for m in range(macros):
            _copy(memory[outputs[atoms + m]], values[parameters + m], start, count)
        for m in range(exponentials):
            lay(memory, outputs[1 + 2 * m], w, _AMPLITUDE + m)
            lay(memory, outputs[2 + 2 * m], w, _RATE + m)
        _touch(w, ends)
        for n in range(count):
            reached[start + n] = np.int16(w[_REACHED * LANES + n])
        if not wanted:
            for m in range(len(percent)):
                for n in range(count):
                    percent[m, start + n] = np.nan
            continue
        place(memory, outputs, exponentials, low, spacing, float(len(own)), position, w)
        alone = exponentials == 1 and parameters <= normal_one.PARAMETERS
        if alone:
            gather_one(w, own, position)
        else:
            gather(w, gram, own, position)
        unpack(memory, outputs, parameters, exponentials, w)
        if alone:
            invert_one(w, axis)
        else:
            invert(w, axis)
        for n in range(count):
            if w[LOST * LANES + n] > _TOO_MUCH:
                invert_again(w, n, axis, rows, position[0, n], position[1, n], vectors, axes, work[0], work[1])
        _parameter_errors(w, parameters, ends)
        for q in range(parameters):
            _copy(w[(_ERROR + q) * LANES :], percent[q], start, count)
        for m in range(macros):
            lay(memory, outputs[atoms + m], w, _MACRO)
            for q in range(parameters):
                lay(memory, outputs[atoms + macros + (atoms + m) * parameters + q], w, COLUMN + q)
            _macro_error(w)
            _copy(w[_ERROR * LANES :], percent[parameters + m], start, count)


@njit()
def _enter(memory, values, chi2, parameters, start, count, w):
    """Parameters of a block of curves and what their variances are scaled by; ones in lanes without a curve."""
    for q in range(parameters):
        for n in range(count):
            memory[q, n] = values[q, start + n]
        for n in range(count, LANES):
            memory[q, n] = 1.0
        lay(memory, q, w, VALUE + q)
    for n in range(LANES):
        w[_CHI2 * LANES + n] = chi2[start + n] if n < count else 1.0


@njit()
def _copy(numbers, out, start, count):
    for n in range(count):
        out[start + n] = numbers[n]


@njit()
def _touch(w, ends):
    """Which parameters are free and off their bounds, and which bounds every curve touches, in powers of two."""
    lowest, highest, free, slowest, fastest, bit = ends
    for n in range(LANES):
        reached = _end(w, n, 0, lowest, highest, free) + 4.0 * _end(w, n, 1, lowest, highest, free)
        reached += 16.0 * _end(w, n, 2, lowest, highest, free) + 64.0 * _end(w, n, 3, lowest, highest, free)
        reached += 256.0 * _end(w, n, 4, lowest, highest, free)
        on_1, on_2 = w[_AMPLITUDE * LANES + n] != 0.0, w[(_AMPLITUDE + 1) * LANES + n] != 0.0
        rate_1, rate_2 = w[_RATE * LANES + n], w[(_RATE + 1) * LANES + n]
        slow = (on_1 & (rate_1 <= slowest)) | (on_2 & (rate_2 <= slowest))
        fast = (on_1 & (rate_1 >= fastest)) | (on_2 & (rate_2 >= fastest))
        w[_REACHED * LANES + n] = reached + (bit if slow else 0.0) + (2.0 * bit if fast else 0.0)


@njit(forceinline=True)
def _end(w, n, q, lowest, highest, free):
    """Which end a parameter is on (1, 2 or 0), and whether it is free to move."""
    value = w[(VALUE + q) * LANES + n]
    below, above = value <= lowest[q], value >= highest[q]
    w[(FREE + q) * LANES + n] = 0.0 if below | above else free[q]
    return (1.0 if below else 0.0) + (2.0 if above else 0.0)


@njit()
def _parameter_errors(w, parameters, ends):
    """Percent standard errors of the parameters."""
    free = ends[2]
    for n in range(LANES):
        scale = w[_CHI2 * LANES + n]
        _parameter_error(w, n, 0, INVERSE, scale, free)
        _parameter_error(w, n, 1, INVERSE + 5, scale, free)
        _parameter_error(w, n, 2, INVERSE + 9, scale, free)
    if parameters > normal_one.PARAMETERS:
        for n in range(LANES):
            scale = w[_CHI2 * LANES + n]
            _parameter_error(w, n, 3, INVERSE + 12, scale, free)
            _parameter_error(w, n, 4, INVERSE + 14, scale, free)


@njit(forceinline=True)
def _parameter_error(w, n, q, entry, scale, may):
    value, free = abs(w[(VALUE + q) * LANES + n]), w[(FREE + q) * LANES + n] > 0.0
    error = 100.0 * np.sqrt(max(w[entry * LANES + n] * scale, 0.0)) / value
    error = np.inf if free & (w[(SCALE + q) * LANES + n] == 0.0) else error
    w[(_ERROR + q) * LANES + n] = error if (value < np.inf) & (free | (may[q] == 0.0)) else np.nan


@njit(fastmath=_STRICT)
def _macro_error(w):
    """Percent standard error of what stands in MACRO by the delta method; its derivatives stand in rows of COLUMN."""
    for n in range(LANES):
        i = INVERSE * LANES + n
        (d0, s0), (d1, s1), (d2, s2) = _slope(w, n, 0), _slope(w, n, 1), _slope(w, n, 2)
        (d3, s3), (d4, s4) = _slope(w, n, 3), _slope(w, n, 4)
        variance = (
            d0
            * (
                w[i] * d0
                + 2.0 * (w[i + LANES] * d1 + w[i + 2 * LANES] * d2 + w[i + 3 * LANES] * d3 + w[i + 4 * LANES] * d4)
            )
            + d1
            * (w[i + 5 * LANES] * d1 + 2.0 * (w[i + 6 * LANES] * d2 + w[i + 7 * LANES] * d3 + w[i + 8 * LANES] * d4))
            + d2 * (w[i + 9 * LANES] * d2 + 2.0 * (w[i + 10 * LANES] * d3 + w[i + 11 * LANES] * d4))
            + d3 * (w[i + 12 * LANES] * d3 + 2.0 * w[i + 13 * LANES] * d4)
            + d4 * w[i + 14 * LANES] * d4
        )
        value = abs(w[_MACRO * LANES + n])
        error = 100.0 * np.sqrt(max(variance * w[_CHI2 * LANES + n], 0.0)) / value
        error = np.inf if s0 | s1 | s2 | s3 | s4 else error
        w[_ERROR * LANES + n] = error if value < np.inf else value


@njit(fastmath=_STRICT, forceinline=True)
def _slope(w, n, q):
    """A derivative, and whether it makes the error infinite because the curve does not feel the parameter.

    A parameter that is no longer defined (k4 where k3 = 0) spoils only what depends on it.
    """
    slope = w[(COLUMN + q) * LANES + n]
    slope = slope if abs(slope) < np.inf else 0.0
    unfelt = (w[(SCALE + q) * LANES + n] == 0.0) & (w[(FREE + q) * LANES + n] > 0.0)
    return slope, unfelt & (slope != 0.0)
