"""Sizes of a cause with their errors, from the curvature of its fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc

from petkin.diagnosis import evidence
from petkin.diagnosis.covariance import Noise
from petkin.diagnosis.effect import Simulator, Term
from petkin.diagnosis.refit import Fit
from petkin.diagnosis.scan import Scan, starts
from petkin.diagnosis.verdict import Estimate, Strength
from petkin.diagnosis.where import Place, benjamini_hochberg
from petkin.diagnosis.which import Candidate, columns_of, informed

Array = NDArray[np.float64]

_Z90 = 1.6448536269514722
#: Standard error of a median over that of a mean, of many normal values: sqrt(pi / 2).
_OF_MEDIAN = float(np.sqrt(np.pi / 2.0))
#: Amplitudes below this share of their range change values by their slope.
_SLIGHT = 0.02


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
        numbers = (symbol for symbol in ("frame", "axis") if symbol in term.setting)
        found += [Estimate(symbol, "1", *(3 * [float(term.setting[symbol])])) for symbol in numbers]
    return tuple(found)


def strengths(candidates: Sequence[Candidate], scan: Scan, simulator: Simulator, base: Fit) -> dict[str, Strength]:
    """Amplitude of every single effect: after its refit, or the linear one of its template that the scan likes best."""
    each = scan.each(base.residual)
    found = {}
    for candidate in (c for c in candidates if len(c.names) == 1):
        if candidate.fit is not None:
            term, one = candidate.terms[0], estimates(candidate, simulator, base)[0]
        else:
            term, one = _from_scan(scan, base.residual, each, candidate.label)
        h = term.hypothesis
        single = not h.flag and (h.alike or not h.by_channel)
        found[candidate.label] = Strength(one.symbol, one.unit, one.value, one.low, one.high, h.signed, single)
    return found


def _from_scan(scan: Scan, residual: Array, each: Array, name: str) -> tuple[Term, Estimate]:
    errors = np.sqrt(np.diag(np.linalg.inv(scan.information(scan.best(each, name)))))
    term = starts(scan, residual, each, name)[0]
    return term, _amplitude(term, errors)


def _amplitude(term: Term, errors: Array) -> Estimate:
    """One number with its 90 % interval: of amplitudes that differ between channels the clearest, or the median of an
    effect that all channels have about alike."""
    hypothesis = term.hypothesis
    if hypothesis.flag:
        return Estimate("amplitude", "flag", 1.0, 1.0, 1.0)
    values = np.atleast_1d(np.asarray(term.amplitude, np.float64))
    errors = np.maximum(errors, 1e-12)
    weight = errors**-2.0 / (errors**-2.0).sum()
    mean, error = float(weight @ values), float((errors**-2.0).sum() ** -0.5)
    if hypothesis.by_channel and np.ptp(values / errors) > 4.0 * _Z90:  # not one amplitude for all
        if hypothesis.alike:
            mean, error = float(np.median(values)), _OF_MEDIAN * float(values.std(ddof=1)) / values.size**0.5
        else:
            clearest = int(np.argmax(np.abs(values) / errors))
            mean, error = float(values[clearest]), float(errors[clearest])
    return Estimate("amplitude", hypothesis.unit, mean, mean - _Z90 * error, mean + _Z90 * error)


def regions(leader: Candidate, found: Place, base: Fit, simulator: Simulator, noise: Noise) -> Place:
    """Of an effect that has an amplitude a channel: each channel by the chance that it alone has one, and by its own
    test if all have.

    An amplitude counts by all that it changes, since the slope at a strong one may be next to none.

    Reference: Efron B. Large-Scale Inference. Cambridge 2010, chapter 2 (a probability of none is a local false
    discovery rate).
    """
    fit, known = leader.fit, len(base.state.terms)
    if fit is None or len(leader.terms) != 1 or not leader.terms[0].hypothesis.by_channel:
        return found
    hypothesis = leader.terms[0].hypothesis
    place = columns_of(fit, len(simulator.channels), known)[0][""]
    columns, amplitude = _secants(fit, known, place, simulator, noise)
    information = informed(fit, place, columns)
    spread, score = evidence.Spread.of(information), information @ amplitude
    each = benjamini_hochberg(erfc(np.abs(spread.apart(score)) / np.sqrt(2.0)))
    if hypothesis.alike:
        return Place(each, found.shares)
    alone = spread.alone(score, hypothesis.signed)
    return Place(1.0 - alone - (1.0 - alone.sum()) * (1.0 - each), found.shares)


def _secants(fit: Fit, known: int, place: slice, simulator: Simulator, noise: Noise) -> tuple[Array, Array]:
    """Whitened change by every channel's amplitude (n, C) over that amplitude, slopes where it is next to nothing; and
    the amplitudes."""
    terms, own = fit.state.terms, fit.state.terms[known]
    amplitude = np.asarray(own.amplitude, np.float64)
    without = (*terms[:known], replace(own, amplitude=np.zeros_like(amplitude)), *terms[known + 1 :])
    change = fit.values - simulator.predict(fit.state.own, fit.state.shared, without)
    strong = np.abs(amplitude) > _SLIGHT * own.hypothesis.width
    size = np.where(strong, amplitude, 1.0)
    secants = noise.whiten(np.eye(len(change))[:, :, None] * (change / size[:, None])[None]).T
    return np.where(strong, secants, fit.jacobian[:, place]), amplitude


def setting(leader: Candidate, symbol: str) -> float | None:
    """Value of a parameter of the leader that has it."""
    return next((float(t.setting[symbol]) for t in leader.terms if symbol in t.setting), None)
