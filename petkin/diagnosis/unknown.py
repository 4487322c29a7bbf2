"""A gap of no name: a smooth discrepancy in every channel, orthogonal to what a refit can do.

    delta_c(t) = sum_p g_pc(t) sum_j w_j phi_j(x) (a_pj + b_pcj)
    x = log(t + 1) or t, rescaled to 0..1,  phi_j = cos(pi j x)

a Gaussian process with a cosine basis, along the profiles g that the simulator names, such as its own values; common to
all channels, in each for itself, both, or in one of them; or in what drives them, u(t) (1 + sum_j w_j phi_j(x) a_j),
as far as they show it. It may also swing: then only three cosines that follow on each other are there, in all channels
alike, at any pace (`Swing`), or in each. Only what the projection leaves of it counts, so that it can never take what
the simulator's own parameters, or a named effect's, explain.

Reference: Plumlee M. Bayesian calibration of inexact computer models. J Am Stat Assoc 2017;112:1274-1285.
doi:10.1080/01621459.2016.1211016
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis import evidence, pattern
from petkin.diagnosis.covariance import Noise
from petkin.diagnosis.effect import Profiles, Simulator
from petkin.diagnosis.nuisance import Projection
from petkin.diagnosis.refit import Fit
from petkin.diagnosis.swing import BAND, Swing

Array = NDArray[np.float64]

#: Where a discrepancy is: in all channels alike, in each for itself, both, in one alone; or in what drives them all.
ALL, EACH, BOTH, ONE, DRIVE = "alike", "each", "both", "one", "drive"
#: The same of what swings: cosines that follow on each other, anywhere among them.
SWINGING = "swings alike"
_SWINGS = {ALL: SWINGING, EACH: "swings each"}
#: Or in some channels up while it is down in others, on any course.
PATTERN = "pattern"
#: Or in what channels are means of, where somebody looked beside them.
WITHIN = "within"
#: Cosines, and the power by which they fade: rougher discrepancies are less likely.
_COUNT, _FADING = 12, 0.5
#: What a gap of no name needs beyond the evidence of channels where somebody looked beside them; chosen on training
#: images by how often sets hold what they say.
_RARER = 1.4
#: Scales of time on which a discrepancy is smooth, and how far beyond the samples it goes on, in shares of their span.
_SCALES: tuple[Callable[[Array], Array], ...] = (lambda t: np.log(t + 1.0), lambda t: t)
_BEYOND = 0.2
#: Beside a name: what it costs in log evidence, as a second cause does, and which share of the name's own it may add;
#: where more is left than that, the name is not what the gap is. Beside how many explanations it is looked for.
_STRANGER, _SMALL, _BESIDE = evidence.SECOND, 0.2, 6


class Explanation(Protocol):
    """A named explanation with its evidence and its fit."""

    @property
    def names(self) -> tuple[str, ...]: ...

    @property
    def fit(self) -> Fit | None: ...

    @property
    def log_evidence(self) -> float: ...


@dataclass(frozen=True)
class Smooth:
    """The discrepancy around a fit, whitened and projected.

    Args:
        columns: P G of every time scale (n, m).
        kinds: by time scale and kind: which columns may be there at once (g, k), and their spread, profiles by
            profiles; any of the g is as likely.
        swing: at any pace, in all channels alike; None where samples are too few.
    """

    columns: tuple[Array, ...]
    kinds: tuple[dict[str, list[tuple[NDArray[np.intp], evidence.Spread]]], ...]
    noise: Noise
    swing: Swing | None

    @classmethod
    def around(
        cls,
        profiles: Sequence[Profiles],
        times: Array,
        noise: Noise,
        projection: Projection,
        driven: Sequence[Array] | None = None,
    ) -> Smooth:
        """Around what is predicted.

        Args:
            profiles: along any of which channels may depart.
            times: of the samples (K,).
            noise: its covariance.
            projection: what is refitted.
            driven: by time scale, what channels show of a departure of what drives them (m, C, K).
        """
        axes = projection.axes[: projection.rows]
        found, kinds = [], []
        for i, scale in enumerate(_SCALES):
            cosines = _cosines(scale, times, times)
            changes, groups = _along(profiles, cosines)
            if driven is not None and len(driven[i]):
                groups[DRIVE] = [np.arange(len(changes), len(changes) + len(driven[i]))[None]]
                changes = np.concatenate([changes, driven[i]])
            columns = noise.whiten(changes).T
            projected = columns - axes @ (axes.T @ columns)
            information = columns.T @ projected
            found.append(projected)
            kinds.append(
                {
                    kind: [(g, evidence.Spread.of(information[g[:, :, None], g[:, None, :]])) for g in each]
                    for kind, each in groups.items()
                }
            )
        together = [each for several in profiles for each in several.together]
        return cls(tuple(found), tuple(kinds), noise, Swing.around(together, times, noise, projection))

    def evidence(self, residuals: Array) -> Array:
        """log evidence of a discrepancy for what a refit left of whitened data (..., n)."""
        return evidence.mean(np.stack([value for _, value in self._each(residuals)]), 0)

    def likeliest(self, residual: Array) -> str:
        """Where the discrepancy is, as far as whitened data (n,) tell."""
        return max(self._each(residual), key=lambda found: float(found[1]))[0]

    def _each(self, residuals: Array) -> list[tuple[str, Array]]:
        """log evidence of every kind, on every scale of time."""
        found = []
        for columns, kinds in zip(self.columns, self.kinds):
            scores = residuals @ columns
            for kind, groups in kinds.items():
                logs = np.concatenate([spread.together(scores[..., g]) for g, spread in groups], axis=-1)
                found.append((kind, evidence.mean(logs)))
        if len(self.noise.size) >= pattern.FEWEST:
            found.append((PATTERN, pattern.log_evidence(pattern.apart(residuals, self.noise))))
        if self.swing is not None:
            found.append((SWINGING, self.swing.log_evidence(residuals)))
        return found


def _along(profiles: Sequence[Profiles], cosines: Array) -> tuple[Array, dict[str, list[NDArray[np.intp]]]]:
    """Columns (m, C, K) of a discrepancy along some profiles, and which may be there at once, by kind (g, k)."""
    found: list[Array] = []
    groups: dict[str, list[NDArray[np.intp]]] = {}
    start = 0
    for several in profiles:
        count, channels = several.together.shape[:2]
        found += [discrepancies(*each, cosines) for each in zip(several.together, several.alone, strict=True)]
        every = start + np.arange(count * _COUNT * (1 + channels)).reshape(count, -1)
        start += every.size
        for kind, which in _groups(every[:, :_COUNT], every[:, _COUNT:].reshape(count, _COUNT, channels)).items():
            groups.setdefault(kind, []).append(which)
    return np.concatenate(found), groups


def _groups(common: NDArray[np.intp], alone: NDArray[np.intp]) -> dict[str, NDArray[np.intp]]:
    """Columns of a discrepancy in all channels alike (profiles, cosines), in each (profiles, cosines, C), both, and in
    one channel alone."""
    bands = np.arange(_COUNT - BAND + 1)[:, None] + np.arange(BAND)
    found = {ALL: common.reshape(1, -1), _SWINGS[ALL]: np.concatenate(common[:, bands], axis=1)}
    channels = alone.shape[2]
    if channels == 1:
        return found
    swinging = np.concatenate(alone[:, bands], axis=1).reshape(len(bands), -1)
    every = np.concatenate([common[..., None], alone], axis=2)
    return found | {
        EACH: alone.reshape(1, -1),
        BOTH: np.sort(every.reshape(1, -1)),
        ONE: np.moveaxis(alone, 2, 0).reshape(channels, -1),
        _SWINGS[EACH]: swinging,
    }


def courses(times: Array) -> tuple[Array, ...]:
    """Smooth courses w_j phi_j (n, K), on every scale of time."""
    return tuple(_cosines(scale, times, times) for scale in _SCALES)


def _cosines(scale: Callable[[Array], Array], samples: Array, times: Array) -> Array:
    """w_j phi_j (n, T) at any times, on a scale of time that the samples span."""
    first, last = scale(samples[0]), scale(samples[-1])
    x = np.clip((scale(times) - first) / (last - first), -_BEYOND, 1.0 + _BEYOND)
    j = np.arange(_COUNT)
    return np.asarray(np.cos(np.pi * j[:, None] * x) * (1.0 + j[:, None]) ** -_FADING, np.float64)


def driven(simulator: Simulator, fit: Fit) -> list[Array]:
    """What the channels show of a smooth departure of what drives them (m, C, K), on every scale of time."""
    state, times = fit.state, simulator.times
    return [simulator.driven(state.own, state.shared, partial(_cosines, scale, times)) for scale in _SCALES]


def discrepancies(together: Array, alone: Array, cosines: Array) -> Array:
    """Columns (m, C, K) of the discrepancy: one block common to all channels, then one a channel.

    Args:
        together, alone: a profile (C, K) of all channels, and of each for itself.
        cosines: w_j phi_j of the samples (n, K).
    """
    common = cosines[:, None, :] * together[None]
    each = np.eye(len(alone))[None, :, :, None] * (cosines[:, None, None, :] * alone[None, None])
    return np.concatenate([common, each.reshape(-1, *alone.shape)])


@dataclass(frozen=True)
class Elsewhere:
    """What was seen beside the channels, in what they are means of.

    Args:
        unnamed: log evidence of a gap of no name there.
        told: what hypotheses were lent from there, in log odds, by name.
    """

    unnamed: float
    told: Mapping[str, float]

    def joined(self, here: float) -> float:
        """log evidence of a gap of no name in the channels, beside them or in both, half of which show nothing there.

        B = (B_here / 2 + B_there (1 + B_here) / 4) e^{-rarer}
        """
        return float(np.logaddexp(here, self._there(here)) - np.log(2.0) - _RARER)

    def place(self, here: float, likeliest: str) -> str:
        """Where it is: as in the channels, unless it is likelier to show beside them."""
        return WITHIN if self._there(here) > here else likeliest

    def _there(self, here: float) -> float:
        return float(self.unnamed + np.logaddexp(0.0, here) - np.log(2.0))

    def beyond(self, names: Sequence[str]) -> float:
        """log evidence there that is left beside such names."""
        return max(self.unnamed - max((self.told.get(name, 0.0) for name in names), default=0.0), 0.0)


def left_beside(
    simulator: Simulator, noise: Noise, ranked: Sequence[Explanation], elsewhere: Elsewhere | None = None
) -> list[float | None]:
    """log evidence of a gap of no name in what each explanation leaves; None where nobody looked.

    Args:
        simulator: what is departed from.
        noise: its covariance.
        ranked: explanations, best first; those far down, or without a fit, are not looked at.
        elsewhere: what was seen beside the channels.
    """
    found: list[float | None] = []
    looked = 0
    for candidate in ranked:
        fit = candidate.fit
        if fit is None or looked == _BESIDE:
            found.append(None)
            continue
        projection = Projection.of_fit(fit)
        smooth = Smooth.around(simulator.departing(fit.values), simulator.times, noise, projection)
        here = float(smooth.evidence(projection.left_of(fit)))
        found.append(here + (0.0 if elsewhere is None else elsewhere.beyond(candidate.names)))
        looked += 1
    return found


def beside(log_evidence: float, left: float | None, spared: float = 0.0) -> float:
    """log evidence of an explanation with what it leaves explained by a gap of no name beside it.

    A name that a smooth discrepancy cannot stand in for keeps its claim, whatever else is in the data.

    Args:
        log_evidence: of the explanation alone.
        left: of a gap of no name in what it leaves, where that is known.
        spared: what of its own is for noise of single channels, which that gap would be in place of.
    """
    if left is None:
        return log_evidence
    more = min(left, _SMALL * max(log_evidence, 0.0)) - spared
    return float(np.logaddexp(log_evidence, log_evidence + more - _STRANGER))
