"""Sizes of a cause with their errors, from the curvature of its fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc

from petkin.diagnosis import evidence
from petkin.diagnosis.covariance import Noise
from petkin.diagnosis.effect import Simulator, Term
from petkin.diagnosis.occam import columns_of, informed
from petkin.diagnosis.refit import Fit, shape_of
from petkin.diagnosis.scan import Scan, starts
from petkin.diagnosis.strength import Z90, Estimate, Strength
from petkin.diagnosis.where import Place, benjamini_hochberg
from petkin.diagnosis.which import Candidate

Array = NDArray[np.float64]

#: Standard error of a median over that of a mean, of many normal values: sqrt(pi / 2).
_OF_MEDIAN = float(np.sqrt(np.pi / 2.0))
#: Onsets asked: how far from the fitted one, in errors of its logarithm, which lie between these; how many over all
#: times; and how finely what lies between is drawn.
_NEAR, _WIDTHS = np.array([0.3, 0.6, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0]), (0.004, 0.3)
_ACROSS, _FINE = 9, 2000
#: An amplitude that is none.
_NOTHING = 1e-9
#: Amplitudes below this share of their range change values by their slope.
_SLIGHT = 0.02


def estimates(candidate: Candidate, simulator: Simulator, base: Fit, noise: Noise) -> tuple[Estimate, ...]:
    """Amplitude, onset and numbers of every effect of a cause, one effect after the other; errors are larger where more
    than noise is left."""
    fit = candidate.fit
    if fit is None:
        return ()
    known, covariance = len(base.state.terms), fit.beyond * fit.covariance
    found: list[Estimate] = []
    placed = zip(fit.state.terms[known:], columns_of(fit, len(simulator.channels), known))
    for term, place in sorted(placed, key=lambda both: both[0].hypothesis.name):
        name = term.hypothesis.name
        found.append(_amplitude(term, _part(covariance, place), simulator.channels))
        if "onset" in place:
            found.append(_onset(term, fit, place, simulator, noise))
        numbers = (symbol for symbol in ("frame", "edge", "axis", "beside") if symbol in term.setting)
        found += [Estimate(symbol, "1", *(3 * [float(term.setting[symbol])]), effect=name) for symbol in numbers]
    return tuple(found)


def _onset(term: Term, fit: Fit, places: Mapping[str, slice], simulator: Simulator, noise: Noise) -> Estimate:
    """With the interval that holds 0.9 of its probability, any time as likely beforehand.

    Values bend where an onset passes from one sample to the next, so that the curvature at the fit says little. What
    they are at another onset t is predicted; amplitudes and all else follow by one linear step:

        ln p(t) = -1/2 min_x { |r - d(t) - J(t) x|^2 + prior } / max(chi2 / dof, 1)
    """
    onset, bounds = float(term.setting["onset"]), shape_of(term, "onset")
    width = float(np.clip(fit.errors[places["onset"]][0], *_WIDTHS))
    near = np.concatenate([-_NEAR[::-1], np.zeros(1), _NEAR])
    times = np.union1d(np.linspace(bounds.lower, bounds.upper, _ACROSS), onset * np.exp(width * near))
    times = times[(times >= bounds.lower) & (times <= bounds.upper)]
    amplitude = np.asarray(term.amplitude, np.float64)
    without = _predicted(simulator, fit, term, replace(term, amplitude=0.0 * amplitude))
    log = np.empty(len(times))
    for i, time in enumerate(times):
        there = _predicted(simulator, fit, term, replace(term, setting={**term.setting, "onset": time}))
        jacobian = fit.jacobian.copy()
        jacobian[:, places["onset"]] = 0.0
        jacobian[:, places[""]] = _per_amplitude(there - without, amplitude, noise, fit.jacobian[:, places[""]])
        left = fit.residual - noise.whiten(there - fit.values)
        slope = jacobian.T @ left + np.sqrt(fit.penalty) * fit.pulled
        normal = jacobian.T @ jacobian + np.diag(fit.penalty)
        normal[places["onset"], places["onset"]] = 1.0
        log[i] = 0.5 * (slope @ np.linalg.solve(normal, slope) - left @ left) / fit.beyond
    fine = np.union1d(times, np.linspace(times[0], times[-1], _FINE))
    density = np.exp(np.interp(fine, times, log - log.max()))
    below = np.concatenate([np.zeros(1), np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(fine))])
    low, high = np.interp([0.05 * below[-1], 0.95 * below[-1]], below, fine)
    return Estimate("onset", "min", onset, min(float(low), onset), max(float(high), onset), effect=term.hypothesis.name)


def _predicted(simulator: Simulator, fit: Fit, term: Term, other: Term) -> Array:
    """What a fit would predict with another term in place of one of its own (C, K)."""
    terms = tuple(other if t is term else t for t in fit.state.terms)
    return simulator.predict(fit.state.own, fit.state.shared, terms)


def _per_amplitude(change: Array, amplitude: Array, noise: Noise, slopes: Array) -> Array:
    """Whitened change (C, K) over the amplitude that makes it, one column or one a channel; slopes of none."""
    local = np.eye(len(change))[:, :, None] * change[None] if amplitude.ndim else change[None]
    some = np.abs(np.atleast_1d(amplitude)) > _NOTHING
    columns = noise.whiten(local / np.where(some, np.atleast_1d(amplitude), 1.0)[:, None, None]).T
    return np.where(some, columns, slopes)


def strengths(candidates: Sequence[Candidate], scan: Scan, simulator: Simulator, base: Fit) -> dict[str, Strength]:
    """Amplitude of every single effect: after its refit, or the linear one of its template that the scan likes best."""
    each = scan.each(base.residual)
    found = {}
    for candidate in (c for c in candidates if len(c.names) == 1):
        if candidate.fit is not None:
            (place,) = columns_of(candidate.fit, len(simulator.channels), len(base.state.terms))
            term = candidate.fit.state.terms[-1]
            one = _amplitude(term, _part(candidate.fit.covariance, place), simulator.channels)
        else:
            term, one = _from_scan(scan, base.residual, each, candidate.label, simulator.channels)
        h = term.hypothesis
        single = not h.flag and (h.alike or not h.by_channel)
        if "axis" in term.setting:  # its sign means another way for every axis
            ends = sorted(map(abs, (one.low, one.high)))
            one = replace(one, value=abs(one.value), low=0.0 if one.low * one.high < 0 else ends[0], high=ends[1])
        found[candidate.label] = Strength(**vars(one), signed=h.signed and "axis" not in term.setting, single=single)
    return found


def _from_scan(scan: Scan, residual: Array, each: Array, name: str, channels: Sequence[str]) -> tuple[Term, Estimate]:
    covariance = np.asarray(np.linalg.inv(scan.information(scan.best(each, name))), np.float64)
    term = starts(scan, residual, each, name)[0]
    return term, _amplitude(term, covariance, channels)


def _part(covariance: Array, places: Mapping[str, slice]) -> Array:
    """That of a term's amplitudes; empty of what has none."""
    place = places.get("", slice(0))
    return covariance[place, place]


def _amplitude(term: Term, covariance: Array, channels: Sequence[str]) -> Estimate:
    """One number with its 90 % interval: of amplitudes that one channel may have alone the clearest, of those that are
    about alike in all the mean, or the median where they differ. What is common to channels moves them together."""
    hypothesis, channel = term.hypothesis, ""
    if hypothesis.flag:
        return Estimate("amplitude", "flag", 1.0, 1.0, 1.0, effect=hypothesis.name)
    values = np.atleast_1d(np.asarray(term.amplitude, np.float64))
    errors = np.maximum(np.sqrt(np.maximum(np.diag(covariance), 0.0)), 1e-12)
    weight = errors**-2.0 / (errors**-2.0).sum()
    mean, error = float(weight @ values), max(float(weight @ covariance @ weight), 0.0) ** 0.5
    if hypothesis.by_channel and not hypothesis.alike:
        clearest = int(np.argmax(np.abs(values) / errors))
        mean, error, channel = float(values[clearest]), float(errors[clearest]), channels[clearest]
    elif hypothesis.by_channel and np.ptp(values / errors) > 4.0 * Z90:  # not one amplitude for all
        scatter = _OF_MEDIAN * float(values.std(ddof=1)) / values.size**0.5
        mean, error = float(np.median(values)), float(np.hypot(scatter, error))
    low, high = mean - Z90 * error, mean + Z90 * error
    return Estimate("amplitude", hypothesis.unit, mean, low, high, effect=hypothesis.name, channel=channel)


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
