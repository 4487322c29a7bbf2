"""Evidence of a refit: half of what it gains, less what its freedom costs.

    log E = max_x log P(data | x) - log of how much wider the prior is than what the data leave of it

averaged over amplitudes (see `evidence`), over what each channel's own shapes may be, and over the simulator's own
parameters, whose volume a term changes.

Reference: MacKay DJC. Neural Comput 1992;4:415-447 (Occam factors by Laplace's approximation).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis import evidence
from petkin.diagnosis.covariance import Noise
from petkin.diagnosis.effect import Term
from petkin.diagnosis.nuisance import Projection
from petkin.diagnosis.refit import Fit, parts

Array = NDArray[np.float64]

#: The most that a change of the simulator's own volume counts.
_MOST = 4.0


def columns_of(fit: Fit, channels: int, known: int) -> list[dict[str, slice]]:
    """Where the parts of the terms after the first `known` stand in the Jacobian, the amplitude under ""."""
    place, found = fit.nuisance, []
    for i, term in enumerate(fit.state.terms):
        mine = {}
        for part, width in parts(term, channels):
            mine[part] = slice(place, place + width)
            place += width
        if i >= known:
            found.append(mine)
    return found


def after_refit(base: Fit, fit: Fit, channels: int, known: int) -> float:
    """Half the gain, less what averaging over amplitudes and over each channel's own shapes costs, less the change of
    the nuisance's volume."""
    gain = base.objective - fit.objective
    size = base.jacobian.shape[1]
    total = 0.5 * gain if all(t.hypothesis.flag for t in fit.state.terms[known:]) else 0.0
    places = columns_of(fit, channels, known)
    moving = [(t, p[""]) for t, p in zip(fit.state.terms[known:], places) if not t.hypothesis.flag]
    for term, place in moving:
        total += _averaging(term, fit, place, max(gain, 0.0) / len(moving))
    total = min(total, 0.5 * gain)  # an average is no larger than the best, however far the refit is from a minimum
    total -= sum(_apart(term, fit, mine) for term, mine in zip(fit.state.terms[known:], places))
    volume = _log_volume(fit.jacobian[:, :size], fit.penalty[:size]) - _log_volume(base.jacobian, base.penalty)
    return total - float(np.clip(0.5 * volume, -_MOST, _MOST))


def spared(noise: Noise, fit: Fit) -> float:
    """What a fit leaves that the noise of single channels may be."""
    return noise.spared(fit.residual, fit.freedom)


def _averaging(term: Term, fit: Fit, place: slice, gain: float) -> float:
    hypothesis = term.hypothesis
    if not hypothesis.by_channel:
        t = np.sqrt(gain)
        return float(evidence.two_sided(t) if hypothesis.signed else evidence.one_sided(t))
    information = informed(fit, place, fit.jacobian[:, place])
    amplitude = np.asarray(term.amplitude, np.float64)
    score, linear = information @ amplitude, float(amplitude @ information @ amplitude)
    spread = evidence.Spread.of(information)
    if hypothesis.alike:  # how far they differ counts by what that gains: where amplitudes are strong it is not linear
        return float(spread.about(np.sqrt(gain / max(linear, 1e-300)) * score, hypothesis.signed))
    return float(spread.by_channel(score, False, hypothesis.signed)) + 0.5 * (gain - linear)


def _apart(term: Term, fit: Fit, places: dict[str, slice]) -> float:
    """What shapes cost that every channel has for itself, beside one that all have: ln of the prior's width over the
    error, a channel but for one."""
    cost = 0.0
    for shape in term.hypothesis.shapes:
        if shape.by_channel:
            place = places[shape.symbol]
            count = place.stop - place.start
            told = informed(fit, place, fit.jacobian[:, place]) * shape.sd**2
            cost += 0.5 * float(np.linalg.slogdet(told)[1]) * (count - 1) / count
    return cost


def informed(fit: Fit, place: slice, columns: Array) -> Array:
    """G'PG with its prior, of columns G (n, C) in place of those of a term's amplitudes, all else of the fit free."""
    others = np.ones(fit.jacobian.shape[1], bool)
    others[place] = False
    nuisance = Projection.of(fit.jacobian[:, others], fit.penalty[others])
    return nuisance.inner(columns, columns) + np.diag(fit.penalty[place])


def _log_volume(jacobian: Array, penalty: Array) -> float:
    return float(np.linalg.slogdet(jacobian.T @ jacobian + np.diag(penalty))[1])
