"""How visible a cause is once the simulator is refitted, by a least-squares fit of the generator's own.

d'^2 = min_theta |f_true - f_base(theta)|^2 in units of the noise,   c = |g' P h| / (|P g| |P h|)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from petkin_bench.withheld.noise import NoiseLaw
from petkin_bench.withheld.observe import Change, observe
from petkin_bench.withheld.subject import Subject

Array = NDArray[np.float64]

_STEPS, _QUOTIENT = 60, 1e-4
#: What keeps directions that no data hold from running away, 1 / sd^2 of logarithms.
_RIDGE = 1e-4
#: Change of the whitened values per unit of a logarithm below which a refit does nothing: a rate that went to zero
#: would else explain, on its straight line, what only a negative one could.
_FELT = 0.3


@dataclass(frozen=True)
class Simulator:
    """What is refitted: two tissues or one, blood volume and delay where they are in it."""

    second_tissue: bool = True
    blood_volume: bool = True
    delay: bool = True

    @property
    def _rates(self) -> int:
        return 4 if self.second_tissue else 2

    def start(self, subject: Subject) -> Subject:
        """The subject as this simulator would have it."""
        rates = subject.rates.copy()
        if not self.second_tissue:
            rates[:, 1] /= 1.0 + rates[:, 2] / rates[:, 3]
            rates[:, 2] = 0.0
        vB = subject.vB if self.blood_volume else 0.0 * subject.vB
        return replace(subject, rates=rates, vB=vB, delay=subject.delay if self.delay else 0.0)

    def own(self) -> int:
        return self._rates + self.blood_volume

    def moved(self, subject: Subject, step: Array) -> Subject:
        """Logarithms of rates and vB moved by (R, own), and the delay by the last (min)."""
        regions, own = len(subject.rates), self.own()
        by = np.clip(step[: regions * own].reshape(regions, own), -1.0, 1.0)
        rates = subject.rates.copy()
        rates[:, : self._rates] *= np.exp(by[:, : self._rates])
        vB = np.minimum(subject.vB * np.exp(by[:, -1]), 0.8) if self.blood_volume else subject.vB
        delay = subject.delay + (float(np.clip(step[-1], -0.2, 0.2)) if self.delay else 0.0)
        return replace(subject, rates=rates, vB=vB, delay=delay)

    def jacobian(self, subject: Subject, law: NoiseLaw, here: Array, changes: tuple[Change, ...] = ()) -> Array:
        """Whitened derivatives by every coordinate of the values here (R, K); regions are moved together."""
        regions, own = len(subject.rates), self.own()
        columns = np.zeros((regions * own + self.delay, *here.shape))
        for p in range(own):
            step = np.zeros((regions, own))
            step[:, p] = _QUOTIENT
            change = (observe(self.moved(subject, np.append(step.ravel(), 0.0)), changes) - here) / _QUOTIENT
            for r in range(regions):
                columns[r * own + p, r] = change[r]
        if self.delay:
            step = np.zeros(regions * own + 1)
            step[-1] = _QUOTIENT
            columns[-1] = (observe(self.moved(subject, step), changes) - here) / _QUOTIENT
        return law.whiten(columns).T


class Guess(Protocol):
    """A cause that is refitted beside the simulator."""

    @property
    def coordinates(self) -> int: ...

    def change(self) -> Change: ...

    def slopes(self, subject: Subject, before: tuple[Change, ...], after: tuple[Change, ...], here: Array) -> Array:
        """Derivatives of the values (n, R, K) by every coordinate, between other changes."""
        ...

    def moved(self, step: Array) -> Guess:
        """Somewhat else (n,), within its limits."""
        ...


@dataclass(frozen=True)
class Seen:
    """Values (R, K) as the simulator is refitted to them.

    Args:
        left: whitened, what the refit leaves (n,).
        axes: orthonormal columns of what it can do (n, p).
        fitted: the simulator's subject.
        chi2: of the refit, before the last linear step.
        guesses: what was refitted beside it.
    """

    left: Array
    axes: Array
    fitted: Subject
    chi2: float
    guesses: tuple[Guess, ...]

    @property
    def detectability(self) -> float:
        return float(np.linalg.norm(self.left))

    def project(self, columns: Array) -> Array:
        """What a refit leaves of whitened columns (n, m)."""
        return columns - self.axes @ (self.axes.T @ columns)


def seen(values: Array, simulator: Simulator, subject: Subject, law: NoiseLaw, guesses: tuple[Guess, ...] = ()) -> Seen:
    """The refit, from the subject's own kinetics, by damped Gauss-Newton steps; of guessed causes too.

    Guesses at which curves explode explain nothing: their chi2 is infinite.
    """
    target, damping = law.whiten(values), 1e-4
    start = simulator.start(subject)
    here = _point(simulator, start, law, guesses, observe(start, _changes(guesses)))
    if not here.is_finite:
        return Seen(target, np.zeros((target.size, 0)), here.subject, float("inf"), guesses)
    for _ in range(_STEPS):
        there, gained = _stepped(simulator, law, target, here, damping)
        if there is None:
            damping *= 30
            continue
        here, damping = there, damping / 10
        if gained < 1e-3:
            break
    left, felt, _ = np.linalg.svd(here.jacobian, full_matrices=False)
    axes = left[:, felt > _FELT]
    residual = target - here.values
    over = residual - axes @ (axes.T @ residual)
    return Seen(over, axes, here.subject, float(residual @ residual), here.guesses)


@dataclass(frozen=True)
class _Point:
    """Where a refit is: whitened values, and their derivatives by every coordinate of the simulator and of guesses."""

    subject: Subject
    guesses: tuple[Guess, ...]
    values: Array
    jacobian: Array

    @property
    def is_finite(self) -> bool:
        return bool(np.isfinite(self.jacobian).all())


def _point(simulator: Simulator, subject: Subject, law: NoiseLaw, guesses: tuple[Guess, ...], values: Array) -> _Point:
    """A point with such values (R, K)."""
    changes = _changes(guesses)
    own = simulator.jacobian(subject, law, values, changes)
    if any(g.coordinates for g in guesses):
        slopes = [g.slopes(subject, changes[:i], changes[i + 1 :], values) for i, g in enumerate(guesses)]
        own = np.concatenate([own, law.whiten(np.concatenate(slopes)).T], axis=1)
    return _Point(subject, guesses, law.whiten(values), own)


def _changes(guesses: tuple[Guess, ...]) -> tuple[Change, ...]:
    return tuple(g.change() for g in guesses)


def _stepped(
    simulator: Simulator, law: NoiseLaw, target: Array, here: _Point, damping: float
) -> tuple[_Point | None, float]:
    """A lower point by one step, and how much lower."""
    residual, normal = target - here.values, here.jacobian.T @ here.jacobian
    scale = damping * np.diag(normal) + _RIDGE
    step = np.asarray(np.linalg.solve(normal + np.diag(scale), here.jacobian.T @ residual), np.float64)
    own = len(step) - sum(g.coordinates for g in here.guesses)
    moved, other = simulator.moved(here.subject, step[:own]), _moved(here.guesses, step[own:])
    values = observe(moved, _changes(other))
    after = target - law.whiten(values)
    with np.errstate(over="ignore"):  # rates may go where curves explode, and come back
        gained = float(residual @ residual - after @ after)
    there = _point(simulator, moved, law, other, values) if gained > 0 else None
    return (there if there is not None and there.is_finite else None), gained


def _moved(guesses: tuple[Guess, ...], step: Array) -> tuple[Guess, ...]:
    found, place = [], 0
    for guess in guesses:
        found.append(guess.moved(step[place : place + guess.coordinates]))
        place += guess.coordinates
    return tuple(found)


def cosines(columns: Array) -> Array:
    """|c| between projected columns (n, m)."""
    unit = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    return np.abs(unit.T @ unit)


def perpendicular(left: Array, others: Sequence[Array]) -> float:
    """Length of what no one and no two of the other columns explain of it."""
    if not others:
        return float(np.linalg.norm(left))
    unit = np.stack([o / max(float(np.linalg.norm(o)), 1e-300) for o in others], axis=1)
    along = unit.T @ left
    gram = unit.T @ unit
    i, j = np.triu_indices(len(others), 1)
    c = np.clip(gram[i, j], -0.9999, 0.9999)
    two = (along[i] ** 2 + along[j] ** 2 - 2.0 * c * along[i] * along[j]) / (1.0 - c**2)
    best = max(float((along**2).max()), float(two.max(initial=0.0)))
    return float(np.sqrt(max(left @ left - best, 0.0)))
