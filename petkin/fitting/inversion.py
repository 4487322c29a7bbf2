"""From the exponentials that a search found to a model's parameters: inside the box, and whether they were before.

What a model is enters as a tape of its formulas (`tape`), so that all of it is one compiled pass over the curves.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from petkin.dynamics import ParameterSet
from petkin.fitting.search import Exponentials
from petkin.fitting.tape import WIDTH, Tape, record, run
from petkin.jit import njit
from petkin.kinetics import CompartmentModel

Array = NDArray[np.float64]


def fill_parameters(
    model: CompartmentModel, found: Exponentials, box: ParameterSet, slack: float, theta: Array
) -> NDArray[np.bool_]:
    """Parameters of every curve, clipped to a box.

    Args:
        model: compartment model.
        found: N curves' exponentials.
        box: bounds; where a curve has no exponential at work any rates will do, and its start says which.
        slack: how far outside a bound, relative to 1 + |bound|, still counts as inside.
        theta: room for P parameters (P, N).

    Returns:
        which curves' exponentials belong to parameters inside the box (N,).
    """
    tape = inverse_formulas(model)
    inside = np.empty(theta.shape[1], np.bool_)
    phi, rate = np.ascontiguousarray(found.phi.T), np.ascontiguousarray(found.rate.T)
    blood = np.stack([found.vB] if found.Kb is None else [found.Kb, found.vB])
    room = slack * (1.0 + np.abs(box.upper))
    rests = np.array([0.0, *box.start[1 : model.rates]])
    ends = box.lower, box.upper, box.lower - room, box.upper + room, rests
    _fill(tape.steps, tape.outputs, tape.memory(), phi, rate, blood, ends, theta, inside)
    return inside


@lru_cache
def inverse_formulas(model: CompartmentModel) -> Tape:
    """Amplitudes phi, then rates of the exponentials, fastest first, to the rate constants."""
    atoms = model.free_rates + model.trapping
    return record(lambda *p: model.invert(*zip(p[:atoms], p[atoms:])), 2 * atoms)


@njit(nogil=True)
def _fill(steps, outputs, memory, phi, rate, blood, ends, theta, inside):
    lower, upper, least, most, rests = ends
    rates, atoms = len(outputs), phi.shape[0]
    for start in range(0, len(inside), WIDTH):
        count = min(WIDTH, len(inside) - start)
        for m in range(atoms):
            for n in range(count):
                memory[m, n] = phi[m, start + n]
                memory[atoms + m, n] = rate[m, start + n]
        run(steps, memory)
        for n in range(count):
            inside[start + n] = True
        for q in range(theta.shape[0]):
            low, high, below, above = lower[q], upper[q], least[q], most[q]
            numbers = memory[outputs[q]] if q < rates else blood[q - rates, start : start + count]
            rest = rests[q] if q < rates else np.nan
            for n in range(count):
                alone = (phi[0, start + n] == 0.0) & (phi[atoms - 1, start + n] == 0.0) & (q < rates)
                value = rest if alone else numbers[n]
                inside[start + n] &= (value >= below) & (value <= above)
                value = low if value < low else value
                theta[q, start + n] = high if value > high else value
