"""Standard errors of every curve: the compiled Gauss-Newton covariance, many curves in step as in `lanes`.

What a model is enters as a tape of its formulas (`tape`); see `normal` for the normal equations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from petkin.fitting import lanes
from petkin.fitting.lanes import LANES, OWN
from petkin.fitting.normal import (
    ALL_ROWS,
    COLUMN,
    FREE,
    INVERSE,
    LOST,
    PARAMETERS,
    SCALE,
    SPEED_1,
    VALUE,
    VECTORS,
    X0,
    invert,
    invert_again,
)
from petkin.fitting.table import RATE_OFFSET, Compression, InnerProducts
from petkin.fitting.tape import Tape, record_partials, run
from petkin.kinetics import CompartmentModel
from petkin.kinetics.compartment import Macro

Array = NDArray[np.float64]

_STRICT = {"contract", "nsz"}
#: Relative error of a pivot from which on a curve is done again.
_TOO_MUCH = 1e-6


@dataclass(frozen=True)
class Formulas:
    """What follows from P parameters, on tape.

    Args:
        tape: x0, then x and rate (1/min) of every exponential, then the macro-parameters, and their derivatives; the
            curve is x0 axis + sum_m x_m b(a_m).
        parameters: P, at most 5.
        exponentials: how many, 1 or 2.
        macros: how many.
    """

    tape: Tape
    parameters: int
    exponentials: int
    macros: int

    @classmethod
    def of(cls, curve: Callable[..., tuple[Any, ...]], macros: tuple[Callable[..., Any], ...], parameters: int):
        """From functions of the parameters: `curve` -> (x0, x1, a1) or (x0, x1, a1, x2, a2), and each macro."""
        tape = record_partials(lambda *p: (*curve(*p), *(m(*p) for m in macros)), parameters)
        values = len(tape.outputs) // (parameters + 1)
        return cls(tape, parameters, (values - len(macros) - 1) // 2, len(macros))


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


@lru_cache
def curve_formulas(model: CompartmentModel, macros: tuple[Macro, ...] = ()) -> Formulas:
    """Of a compartment model: x0 = vB, x_m = (1 - vB) phi_m; macro-parameters as asked for."""

    def curve(*p):
        *rates, vB = p
        return (vB, *(number for phi, a in model.impulse(*rates) for number in ((1.0 - vB) * phi, a)))

    return Formulas.of(curve, tuple(lambda *p, m=m: m.formula(*p[:-1]) for m in macros), len(model.parameters))


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
        percent: room for 100 |se / value| (P + M, N). Infinite for what the curve does not feel, NaN for parameters on
            a bound and for values that are not finite.
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
        np.zeros(ALL_ROWS * LANES),
        np.zeros((2, LANES)),
        np.empty((VECTORS, size)),
        np.empty((PARAMETERS, size)),
        np.empty((2, PARAMETERS, PARAMETERS)),
    )
    tape = (formulas.tape.steps, formulas.tape.outputs, formulas.exponentials)
    tables = (products.rows, products.gram, products.own, products.blood, products.low, products.spacing)
    ends = (limits.fixed, limits.lowest, limits.highest, limits.slowest, limits.fastest)
    _all(tables, tape, ends, values, percent, chi2, wanted, reached, scratch)
    return reached


@njit(cache=True, nogil=True, error_model="numpy")
def _all(tables, tape, ends, values, percent, chi2, wanted, reached, scratch):
    rows, gram, own, axis, low, spacing = tables
    steps, outputs, exponentials = tape
    fixed = ends[0]
    memory, w, position, vectors, axes, work = scratch
    parameters, atoms = len(fixed), 1 + 2 * exponentials
    macros = values.shape[0] - parameters
    for start in range(0, values.shape[1], LANES):
        count = min(LANES, values.shape[1] - start)
        for q in range(parameters):
            for n in range(LANES):
                memory[q, n] = values[q, start + n] if n < count else 1.0
        run(steps, memory)
        for m in range(macros):
            macro = memory[outputs[atoms + m]]
            for n in range(count):
                values[parameters + m, start + n] = macro[n]
        _touch(memory, outputs, exponentials, ends, values, start, count, w, reached)
        if not wanted:
            percent[:, start : start + count] = np.nan
            continue
        place(memory, outputs, exponentials, low, spacing, float(len(own)), position, w)
        gather(w, gram, own, position)
        unpack(memory, outputs, parameters, exponentials, w)
        invert(w, axis)
        for n in range(count):
            if w[LOST * LANES + n] > _TOO_MUCH:
                invert_again(w, n, axis, rows, position[0, n], position[1, n], vectors, axes, work[0], work[1])
        _parameter_errors(w, values, percent, chi2, fixed, start, count)
        for m in range(macros):
            partials = outputs[atoms + macros + (atoms + m) * parameters :]
            _macro_errors(w, memory, partials, values, percent, chi2, m, parameters, start, count)


@njit(cache=True, error_model="numpy")
def _touch(memory, outputs, exponentials, ends, values, start, count, w, reached):
    """Which parameters are free and off their bounds, and which curves touch one."""
    fixed, lowest, highest, slowest, fastest = ends
    for n in range(count):
        reached[start + n] = 0
    for q in range(len(fixed)):
        low, high = np.int16(1 << (2 * q)), np.int16(2 << (2 * q))
        for n in range(count):
            value = values[q, start + n]
            below, above = (not fixed[q]) & (value <= lowest[q]), (not fixed[q]) & (value >= highest[q])
            reached[start + n] |= (low if below else np.int16(0)) | (high if above else np.int16(0))
            w[(VALUE + q) * LANES + n] = value
            w[(FREE + q) * LANES + n] = 0.0 if fixed[q] | below | above else 1.0
    low, high = np.int16(1 << (2 * len(fixed))), np.int16(2 << (2 * len(fixed)))
    for m in range(exponentials):
        amplitude, rate = memory[outputs[1 + 2 * m]], memory[outputs[2 + 2 * m]]
        for n in range(count):
            takes_part = amplitude[n] != 0.0
            reached[start + n] |= low if takes_part & (rate[n] <= slowest) else np.int16(0)
            reached[start + n] |= high if takes_part & (rate[n] >= fastest) else np.int16(0)


@njit(cache=True, fastmath=_STRICT, error_model="numpy")
def place(memory, outputs, exponentials, low, spacing, last, position, w):
    """Positions of the exponentials between nodes, and how fast they move with the rate."""
    for m in range(exponentials):
        rate = memory[outputs[2 + 2 * m]]
        for n in range(LANES):
            shifted = rate[n] + RATE_OFFSET
            w[(SPEED_1 + m) * LANES + n] = 1.0 / (shifted * spacing)
            x = min(max((np.log(shifted) - low) / spacing, 0.0), last)
            position[m, n] = x if x > 0.0 else 0.0  # also where a rate is no number


@njit(cache=True, error_model="numpy")
def gather(w, gram, own, position):
    """What the inner products need at every curve's rates; an absent second atom sits at the first node."""
    last, two = np.uint64(own.shape[0] - 1), np.uint64(2)
    for n in range(LANES):
        x, y = position[0, n], position[1, n]
        i, j = min(np.uint64(x), last), min(np.uint64(y), last)
        w[lanes.FRACTION_1 * LANES + n], w[lanes.FRACTION_2 * LANES + n] = x - i, y - j
        for k in range(OWN):
            w[(lanes.OWN_1 + k) * LANES + n] = own[i, np.uint64(k)]
            w[(lanes.OWN_2 + k) * LANES + n] = own[j, np.uint64(k)]
        for k in range(4):
            for m in range(4):
                w[(lanes.CROSS + 4 * k + m) * LANES + n] = gram[two * j + np.uint64(k), two * i + np.uint64(m)]


@njit(cache=True, error_model="numpy")
def unpack(memory, outputs, parameters, exponentials, w):
    """Amplitudes, and derivatives of amplitudes and rates by every parameter."""
    atoms = 1 + 2 * exponentials
    for m in range(exponentials + 1):
        amplitude = memory[outputs[0 if m == 0 else 2 * m - 1]]
        for n in range(LANES):
            w[(X0 + m) * LANES + n] = amplitude[n]
    first = outputs.shape[0] // (parameters + 1)
    for o in range(atoms):
        for q in range(parameters):
            partial = memory[outputs[first + o * parameters + q]]
            for n in range(LANES):
                w[(COLUMN + 5 * q + o) * LANES + n] = partial[n]


@njit(cache=True, error_model="numpy")
def _parameter_errors(w, values, percent, chi2, fixed, start, count):
    entry = INVERSE
    for q in range(len(fixed)):
        for n in range(count):
            value = values[q, start + n]
            error = np.sqrt(max(w[entry * LANES + n] * chi2[start + n], 0.0))
            free = w[(FREE + q) * LANES + n] > 0.0
            error = np.inf if free & (w[(SCALE + q) * LANES + n] == 0.0) else error
            known = (abs(value) < np.inf) & (free | fixed[q])
            percent[q, start + n] = 100.0 * error / abs(value) if known else np.nan
        entry += PARAMETERS - q


@njit(cache=True, fastmath=_STRICT, error_model="numpy")
def _macro_errors(w, memory, partials, values, percent, chi2, m, parameters, start, count):
    """By the delta method; a parameter that is no longer defined (k4 where k3 = 0) spoils only what depends on it."""
    for q in range(parameters):
        partial = memory[partials[q]]
        for n in range(LANES):
            w[(VALUE + q) * LANES + n] = partial[n] if abs(partial[n]) < np.inf else 0.0
    _quadratic_form(w)
    for n in range(count):
        spoilt = False
        for q in range(parameters):
            unfelt = (w[(SCALE + q) * LANES + n] == 0.0) & (w[(FREE + q) * LANES + n] > 0.0)
            spoilt = spoilt | (unfelt & (w[(VALUE + q) * LANES + n] != 0.0))
        value = values[parameters + m, start + n]
        error = np.inf if spoilt else np.sqrt(max(w[LOST * LANES + n] * chi2[start + n], 0.0))
        percent[parameters + m, start + n] = 100.0 * error / abs(value) if abs(value) < np.inf else np.nan


@njit(cache=True, fastmath=_STRICT, error_model="numpy")
def _quadratic_form(w):
    """d^T inverse d for what stands in the rows VALUE, into LOST."""
    for n in range(LANES):
        k, i = VALUE * LANES + n, INVERSE * LANES + n
        d0, d1, d2, d3, d4 = w[k], w[k + LANES], w[k + 2 * LANES], w[k + 3 * LANES], w[k + 4 * LANES]
        w[LOST * LANES + n] = (
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
