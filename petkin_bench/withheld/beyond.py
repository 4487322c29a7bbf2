"""What the catalogue leaves of a cause when everything of one or two of its effects is refitted.

Kinetics, blood volume and delay, and of every effect its size (of a local one a size a region), its onset and its
length: only what is left then is beyond names. A linear look at one region at a time says more, since effects that are
strong, or in all regions at once, do what their weak templates cannot.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from petkin_bench.withheld.causes import KNOWN, Cause
from petkin_bench.withheld.changes import Draw
from petkin_bench.withheld.making import Made
from petkin_bench.withheld.noise import NoiseLaw
from petkin_bench.withheld.observe import Change, observe
from petkin_bench.withheld.subject import Subject
from petkin_bench.withheld.visibility import Seen, seen

Array = NDArray[np.float64]

#: Effects that have but one sign in the catalogue's words; and one whose range there is narrower than what is drawn.
_ONE_SIDED = frozenset(
    (
        *("dispersion", "vascular_trapping", "tissue_metabolite", "tissue_heterogeneity", "saturable_binding"),
        *("partial_volume", "motion_step", "motion_drift", "dead_time", "nonnegativity_bias"),
    )
)
_PLAUSIBLE = {"time_varying_kinetics": (-0.5, 2.0)}
#: Effects whose length is free, and its limits, min.
_LONG, _SHORTEST, _LONGEST = frozenset(("parent_fraction", "time_varying_kinetics")), 1.0, 60.0
#: Onsets and lengths at which a refit may begin.
_ONSETS, _LENGTHS = np.linspace(0.08, 0.88, 17), (4.0, 10.0, 25.0)
#: Single effects that are refitted, how many of those with a second, and how many seconds of each.
_SINGLES, _FIRST, _SECONDS = 6, 3, 2
#: Another start sets in this share of the scan earlier or later.
_APART = 0.12
#: Size of a weak effect, the furthest that an onset moves in a step, min, and steps of difference quotients, that of an
#: onset in units of its furthest.
_WEAK, _FURTHEST, _QUOTIENT, _LATER = 0.1, 5.0, 1e-4, 0.1
#: Of a linear size, at which a refit may begin too.
_SHARE = 0.3
#: Cosine of a weak effect below which no refit asks whether a strong one is the same.
_NEAR = 0.7


@dataclass(frozen=True)
class Catalogued:
    """A catalogued effect as a refit has it: coordinates are sizes in units of the most, onset in units of its furthest
    step, logarithm of the length."""

    cause: Cause
    drawn: Draw
    sizes: Array
    end: float

    @property
    def coordinates(self) -> int:
        return (0 if self.cause.flag else self.sizes.size) + self.cause.onset + (self.cause.name in _LONG)

    def change(self) -> Change:
        if self.cause.local:
            return self.cause.build(1.0, replace(self.drawn, sizes=self.sizes))
        return self.cause.build(float(self.sizes[0]), self.drawn)

    def slopes(self, subject: Subject, before: tuple[Change, ...], after: tuple[Change, ...], here: Array) -> Array:
        found = []
        for which, size, each in self._steps():
            there = observe(subject, (*before, self._with(size * which).change(), *after))
            slope = (there - here) / size
            found.append(np.eye(len(slope))[:, :, None] * slope[None] if each else slope[None])
        return np.concatenate(found) if found else np.zeros((0, *here.shape))

    def _steps(self) -> Iterator[tuple[Array, float, bool]]:
        """Coordinates to move together, how far, and whether each is a region's; an onset by more than a step of the
        generator's clock, between which nothing changes."""
        place, every = 0, np.arange(self.coordinates, dtype=np.float64)
        if not self.cause.flag:
            yield np.where(every < self.sizes.size, 1.0, 0.0), _QUOTIENT, self.cause.local
            place = self.sizes.size
        if self.cause.onset:
            yield np.where(every == place, 1.0, 0.0), _LATER, False
            place += 1
        if self.cause.name in _LONG:
            yield np.where(every == place, 1.0, 0.0), _QUOTIENT, False

    def weaker(self) -> Catalogued:
        """Where a size that is linear's is too much."""
        return self if self.cause.flag else replace(self, sizes=_SHARE * self.sizes)

    def moved(self, step: Array) -> Catalogued:
        return self._with(np.clip(step, -1.0, 1.0))

    def _with(self, step: Array) -> Catalogued:
        most, place = self.cause.most, 0 if self.cause.flag else self.sizes.size
        low, high = _PLAUSIBLE.get(self.cause.name, (0.0 if self.cause.name in _ONE_SIDED else -most, most))
        sizes = np.clip(self.sizes + most * step[:place], low, high) if place else self.sizes
        drawn = self.drawn
        if self.cause.onset:
            onset = float(np.clip(drawn.onset + _FURTHEST * step[place], 0.05 * self.end, 0.95 * self.end))
            drawn, place = replace(drawn, onset=onset), place + 1
        if self.cause.name in _LONG:
            drawn = replace(drawn, length=float(np.clip(drawn.length * np.exp(step[place]), _SHORTEST, _LONGEST)))
        return replace(self, drawn=drawn, sizes=sizes)


@dataclass(frozen=True)
class _Look:
    """A weak effect around the simulator's fit: whitened columns, as they are (n, 1) or one a region (n, R)."""

    effect: Catalogued
    columns: Array

    def gain(self, fit: Seen) -> tuple[float, Array]:
        """What it would explain of what a refit leaves, and its sizes."""
        mine = fit.project(self.columns)
        ridge = 1e-6 * np.trace(mine.T @ mine) + 1e-12
        sizes: Array = np.linalg.solve(mine.T @ mine + ridge * np.eye(mine.shape[1]), mine.T @ fit.left)
        return float(sizes @ (mine.T @ fit.left)), sizes

    def at(self, sizes: Array) -> Catalogued:
        if self.effect.cause.flag:
            return self.effect
        step = np.zeros(self.effect.coordinates)
        step[: sizes.size] = sizes / self.effect.cause.most
        return replace(self.effect, sizes=np.zeros_like(self.effect.sizes)).moved(step)


def beyond(made: Made, law: NoiseLaw) -> float:
    """d' of what one or two catalogued effects leave of a cause; less than 1 is not looked at more closely."""
    looks = list(_looks(made, law))
    singles: list[Seen] = []
    for starts in _best(looks, made.seen)[:_SINGLES]:
        singles.append(refitted(made, law, starts))
        if singles[-1].chi2 < 1.0:
            return float(np.sqrt(singles[-1].chi2))
    least = min(made.seen.detectability**2, *(found.chi2 for found in singles))
    for first in sorted(singles, key=lambda s: s.chi2)[:_FIRST]:
        for starts in _best(looks, first)[:_SECONDS]:
            least = min(least, refitted(made, law, starts, first).chi2)
        if least < 1.0:
            break
    return float(np.sqrt(least))


def equals(made: Made, law: NoiseLaw, most: float) -> Iterator[str]:
    """Names of effects that have a size and nothing else, and leave at most this share of a cause's d'.

    A delay of a minute is a clock that is off by a minute, which a template of a second is not.
    """
    here, end = observe(made.seen.fitted), float(made.subject.frames.end[-1])
    drawn, whole = replace(made.drawn, sign=1.0), made.seen.detectability**2
    for cause in KNOWN:
        more = cause.flag or cause.local or cause.onset or cause.framed or cause.name in _LONG
        if more or cause.name == made.cause.name:
            continue
        look = _look(made.seen.fitted, here, law, Catalogued(cause, drawn, np.full(1, _WEAK * cause.most), end))
        gain, sizes = look.gain(made.seen)
        start = look.at(sizes)
        if gain < _NEAR**2 * whole or not start.sizes.any():
            continue
        if refitted(made, law, (start, start.weaker())).chi2 <= most**2 * whole:
            yield cause.name


def refitted(made: Made, law: NoiseLaw, starts: Sequence[Catalogued], first: Seen | None = None) -> Seen:
    """The best refit of an effect, from several starts, the first from the subject's own kinetics too; or of one beside
    what a first refit has."""
    here, beside = (made.seen.fitted, ()) if first is None else (first.fitted, first.guesses)
    found = [seen(made.values, made.simulator, here, law, (*beside, start)) for start in starts]
    if first is None:
        found.append(seen(made.values, made.simulator, made.subject, law, (starts[0],)))
    return min(found, key=lambda s: s.chi2)


def _best(looks: Sequence[_Look], fit: Seen) -> list[list[Catalogued]]:
    """Where refits of every effect that is not there yet may begin, its likeliest places first; best effects first."""
    there = {e.cause.name for e in fit.guesses if isinstance(e, Catalogued)}
    found: dict[str, list[tuple[float, Catalogued]]] = {}
    for look in looks:
        if look.effect.cause.name not in there:
            gain, sizes = look.gain(fit)
            found.setdefault(look.effect.cause.name, []).append((gain, look.at(sizes)))
    ranked = sorted((sorted(each, key=lambda e: -e[0]) for each in found.values()), key=lambda each: -each[0][0])
    return [_starts([effect for _, effect in each]) for each in ranked]


def _starts(ranked: Sequence[Catalogued]) -> list[Catalogued]:
    """The likeliest, the same weaker, and the likeliest that sets in elsewhere."""
    first = ranked[0]
    apart = (e for e in ranked if abs(e.drawn.onset - first.drawn.onset) > _APART * e.end)
    return [first, first.weaker(), *islice(apart, 1)]


def _looks(made: Made, law: NoiseLaw) -> Iterator[_Look]:
    """Every effect at a weak size, at several onsets, lengths and frames."""
    subject = made.seen.fitted
    here, end, regions = observe(subject), float(subject.frames.end[-1]), len(subject.rates)
    for cause in KNOWN:
        onsets = _ONSETS * end if cause.onset else (made.drawn.onset,)
        lengths = _LENGTHS if cause.name in _LONG else (made.drawn.length,)
        frames = range(subject.frames.start.size) if cause.framed else (made.drawn.frame,)
        for onset in onsets:
            for length in lengths:
                for frame in frames:
                    drawn = replace(made.drawn, sign=1.0, onset=float(onset), length=float(length), frame=frame)
                    weak = np.full(regions if cause.local else 1, 1.0 if cause.flag else _WEAK * cause.most)
                    yield _look(subject, here, law, Catalogued(cause, drawn, weak, end))


def _look(subject: Subject, here: Array, law: NoiseLaw, effect: Catalogued) -> _Look:
    slope = (observe(subject, (effect.change(),)) - here) / effect.sizes[0]
    local = np.eye(len(slope))[:, :, None] * slope[None] if effect.cause.local else slope[None]
    return _Look(effect, law.whiten(local).T)
