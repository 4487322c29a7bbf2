"""A model's formulas as compiled code takes them: recorded on a tape, and laid out in lanes for `normal`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from petkin.fitting import lanes
from petkin.fitting.lanes import LANES, OWN
from petkin.fitting.normal import COLUMN, SPEED_1, X0
from petkin.fitting.table import RATE_OFFSET
from petkin.fitting.tape import Tape, record_partials
from petkin.jit import njit
from petkin.kinetics import CompartmentModel
from petkin.kinetics.compartment import Macro

_STRICT = {"contract", "nsz"}


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


@lru_cache
def curve_formulas(model: CompartmentModel, macros: tuple[Macro, ...] = ()) -> Formulas:
    """Of a compartment model: x0 = vB, x_m = (1 - vB) phi_m; macro-parameters as asked for."""

    def curve(*p):
        *rates, vB = p
        return (vB, *(number for phi, a in model.impulse(*rates) for number in ((1.0 - vB) * phi, a)))

    return Formulas.of(curve, tuple(lambda *p, m=m: m.formula(*p[:-1]) for m in macros), len(model.parameters))


@njit()
def lay(memory, register, w, row):
    """A register of the tape into a row."""
    first = np.uint64(row * LANES)  # unsigned indices are known not to count from the end
    for n in range(np.uint64(LANES)):
        w[first + n] = memory[register, n]


@njit(fastmath=_STRICT)
def place(memory, outputs, exponentials, low, spacing, last, position, w):
    """Positions of the exponentials between nodes, and how fast they move with the rate."""
    for m in range(exponentials):
        rate = memory[outputs[2 + 2 * m]]
        for n in range(LANES):
            shifted = rate[n] + RATE_OFFSET
            w[(SPEED_1 + m) * LANES + n] = 1.0 / (shifted * spacing)
            x = min(max((np.log(shifted) - low) / spacing, 0.0), last)
            position[m, n] = x if x > 0.0 else 0.0  # also where a rate is no number


@njit()
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


@njit()
def unpack(memory, outputs, parameters, exponentials, w):
    """Amplitudes, and derivatives of amplitudes and rates by every parameter."""
    atoms = 1 + 2 * exponentials
    for m in range(exponentials + 1):
        lay(memory, outputs[0 if m == 0 else 2 * m - 1], w, X0 + m)
    first = outputs.shape[0] // (parameters + 1)
    for o in range(atoms):
        for q in range(parameters):
            lay(memory, outputs[first + o * parameters + q], w, COLUMN + 5 * q + o)
