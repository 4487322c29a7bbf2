"""Sizes of a cause with their errors, from the curvature of its fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc

from petkin.diagnosis.effect import Simulator, Term
from petkin.diagnosis.refit import Fit
from petkin.diagnosis.scan import Scan, starts
from petkin.diagnosis.verdict import Estimate
from petkin.diagnosis.where import Place, benjamini_hochberg
from petkin.diagnosis.which import Candidate, columns_of

Array = NDArray[np.float64]

_Z90 = 1.6448536269514722


def estimates(candidate: Candidate, simulator: Simulator, base: Fit) -> tuple[Estimate, ...]:
    fit = candidate.fit
    if fit is None:
        return ()
    known = len(base.state.terms)
    covariance = np.linalg.pinv(fit.jacobian.T @ fit.jacobian + np.diag(fit.penalty))
    error = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    found: list[Estimate] = []
    for term, place in zip(fit.state.terms[known:], columns_of(fit, len(simulator.channels), known)):
        found.append(_amplitude(term, error[place[""]] if "" in place else np.zeros(0)))
        if "onset" in term.setting:
            width = _Z90 * float(error[place["onset"]][0]) if "onset" in place else 0.0
            onset = float(term.setting["onset"])
            found.append(Estimate("onset", "min", onset, max(onset - width, 0.0), onset + width))
        if "frame" in term.setting:
            found.append(Estimate("frame", "1", *(3 * [float(term.setting["frame"])])))
    return tuple(found)


def strengths(candidates: Sequence[Candidate], scan: Scan, simulator: Simulator, base: Fit) -> dict[str, Estimate]:
    """Amplitude of every single effect: after its refit, or the linear one of its template that the scan likes best."""
    each = scan.each(base.residual)
    return {
        c.label: estimates(c, simulator, base)[0]
        if c.fit is not None
        else _from_scan(scan, base.residual, each, c.label)
        for c in candidates
        if len(c.names) == 1
    }


def _from_scan(scan: Scan, residual: Array, each: Array, name: str) -> Estimate:
    errors = np.sqrt(np.diag(np.linalg.inv(scan.information(scan.best(each, name)))))
    return _amplitude(starts(scan, residual, each, name)[0], errors)


def _amplitude(term: Term, errors: Array) -> Estimate:
    hypothesis = term.hypothesis
    if hypothesis.flag:
        return Estimate("amplitude", "flag", 1.0, 1.0, 1.0)
    values = np.atleast_1d(np.asarray(term.amplitude, np.float64))
    errors = np.maximum(errors, 1e-12)
    weight = errors**-2.0 / (errors**-2.0).sum()
    mean, error = float(weight @ values), float((errors**-2.0).sum() ** -0.5)
    if hypothesis.by_channel and np.ptp(values / errors) > 4.0 * _Z90:  # not one amplitude for all: the clearest one
        clearest = int(np.argmax(np.abs(values) / errors))
        mean, error = float(values[clearest]), float(errors[clearest])
    return Estimate("amplitude", hypothesis.unit, mean, mean - _Z90 * error, mean + _Z90 * error)


def regions(leader: Candidate, found: Place, base: Fit, simulator: Simulator) -> Place:
    """Of an effect that has an amplitude a channel, each amplitude's own test."""
    fit = leader.fit
    known = len(base.state.terms)
    if fit is None or len(leader.terms) != 1 or not leader.terms[0].hypothesis.by_channel:
        return found
    place = columns_of(fit, len(simulator.channels), known)[0][""]
    covariance = np.linalg.pinv(fit.jacobian.T @ fit.jacobian + np.diag(fit.penalty))
    error = np.sqrt(np.maximum(np.diag(covariance)[place], 1e-300))
    z = np.abs(np.asarray(leader.terms[0].amplitude)) / error
    return Place(benjamini_hochberg(erfc(z / np.sqrt(2.0))), found.shares)


def setting(leader: Candidate, symbol: str) -> float | None:
    """Value of a parameter of the leader that has it."""
    return next((float(t.setting[symbol]) for t in leader.terms if symbol in t.setting), None)
