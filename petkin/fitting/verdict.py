"""What the numbers of a regression say of every curve: estimates, percent errors, chi-square and status, compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin.fitting.results import Status
from petkin.jit import njit

Array = NDArray[np.float64]

_OK, _UNSURE = int(Status.OK), int(Status.NOT_IDENTIFIABLE)
_SILENT, _BROKEN = int(Status.NO_SIGNAL), int(Status.NOT_FINITE)


@njit(nogil=True, fastmath={"contract", "nsz"})
def delta_variances(slopes, covariance, variances):
    """d' C d of M quantities: slopes (M, p, n), covariance of the unknowns (p, p, n), answer (M, n)."""
    for m in range(slopes.shape[0]):
        for n in range(slopes.shape[2]):
            variances[m, n] = 0.0
        for i in range(slopes.shape[1]):
            for j in range(i + 1):
                times = 1.0 if i == j else 2.0
                for n in range(slopes.shape[2]):
                    variances[m, n] += times * slopes[m, i, n] * slopes[m, j, n] * covariance[i, j, n]


@njit(nogil=True)
def conclude(found, outcome, degrees, answer, first, last):
    """Fill in the answers of some curves; what must not be used is NaN.

    Args:
        found: values (., n) and their standard deviations at unit noise (., n), the quantities first; weighted residual
            sum of squares (n,), which is overwritten, what it is at unit noise on average (n,), sum of the values of a
            curve (n,), whether they are numbers (n,).
        outcome: the quantity that the method is used for.
        degrees: frames less unknowns, a number of the type of the answers.
        answer: room for values and percent errors (M, N), chi-square and status (N,), of which the curves from `first`
            to one before `last` are filled in.
    """
    estimates, deviations, wrss, freedom, total, finite = found
    values, percent = answer[0], answer[1]
    chi2, status = answer[2][first:last], answer[3][first:last]  # cut row by row: the compiler knows them contiguous
    chosen = estimates[outcome]
    hundred, none = chi2.dtype.type(100.0), chi2.dtype.type(np.nan)
    # Short loops over few arrays: with more the compiler gives up showing that they do not overlap.
    for n in range(len(status)):
        chi2[n] = wrss[n] / degrees if (total[n] > 0.0) & (abs(chosen[n]) < np.inf) else none
    for n in range(len(status)):
        chi2[n] = chi2[n] if finite[n] else none
    noise = wrss
    for n in range(len(status)):
        noise[n] = hundred * np.sqrt(wrss[n] / freedom[n])
    for m in range(len(values)):
        estimate, value = estimates[m], values[m][first:last]
        for n in range(len(value)):
            value[n] = estimate[n] if chi2[n] == chi2[n] else none
        deviation, error = deviations[m], percent[m][first:last]
        for n in range(len(error)):
            error[n] = deviation[n] * noise[n] / abs(value[n])
    # Codes are chosen in numbers as wide as what they are chosen by: the compiler takes many at a time.
    told, code, number = percent[outcome][first:last], noise, chi2.dtype.type
    fine, unsure, silent, broken = number(_OK), number(_UNSURE), number(_SILENT), number(_BROKEN)
    for n in range(len(status)):
        code[n] = fine if told[n] <= hundred else unsure
    for n in range(len(status)):
        code[n] = code[n] if total[n] > 0.0 else silent
    for n in range(len(status)):
        code[n] = code[n] if finite[n] else broken
    for n in range(len(status)):
        status[n] = np.uint8(code[n])
