"""Refits: the simulator's own parameters, and what a hypothesis adds, by damped Gauss-Newton with priors.

    minimise |W (y - f(x))|^2 + |(x - m) / sd|^2

Channels are perturbed together, so that a Jacobian costs as many predictions as one channel has parameters.

Reference: Levenberg K. Quart Appl Math 1944;2:164-168; Marquardt DW. SIAM J Appl Math 1963;11:431-441; Bertsekas DP.
SIAM J Control Optim 1982;20:221-246 (steps that stay within bounds).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from petkin.diagnosis.covariance import Noise
from petkin.diagnosis.effect import Array, Hypothesis, Shape, Simulator, Term

#: Iterations, the fall of the objective at which they end, and how many more while it falls by more than this.
_MOST, _SETTLED = 12, 0.01
_LONGEST, _FALLING = 40, 0.3
#: More falls like the last that are hoped for before a refit that lies far behind is given up.
_HOPED = 5
#: The furthest that a step moves the logarithm of a kinetic parameter or of a shape; rounds in which a step is kept in.
_FURTHEST, _FURTHEST_SHAPE, _ROUNDS = 2.0, 1.0, 6
#: Shares of a linear amplitude at which a refit may begin.
_SHARES = (1.0, 0.3, 0.1)
#: Damping at which no step is left to take.
_STUCK = 1e6
#: Difference quotients take this share of an amplitude's range, and this much of the log of a shape.
_AMPLITUDE_STEP, _SHAPE_STEP = 1e-3, 1e-3


@dataclass(frozen=True)
class State:
    """A point: own (C, Po), shared (S,), terms."""

    own: Array
    shared: Array
    terms: tuple[Term, ...] = ()


@dataclass(frozen=True)
class Point:
    """A state and what is seen there.

    Args:
        state: where.
        values: predicted (C, K).
        residual: whitened (C K,).
        penalty: 1 / sd^2 of every coordinate (n,).
        pulled: (m - x) / sd of every coordinate (n,), the residual of the prior.
        objective: chi-square and prior together.
    """

    state: State
    values: Array
    residual: Array
    penalty: Array
    pulled: Array
    objective: float

    @property
    def chi2(self) -> float:
        return float(self.residual @ self.residual)


@dataclass(frozen=True)
class Fit(Point):
    """A fitted point.

    Args:
        jacobian: whitened columns, own (C Po), shared (S), then those of the terms (C K, n).
        nuisance: how many columns are the simulator's own, before those of the terms.
    """

    jacobian: Array
    nuisance: int

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the residual."""
        return max(self.residual.size - self.jacobian.shape[1], 1)

    @property
    def beyond(self) -> float:
        """Chi-square a degree of freedom, at least 1."""
        return max(self.chi2 / self.freedom, 1.0)

    @property
    def covariance(self) -> Array:
        """Of all coordinates by the curvature (n, n), in the noise that is taken."""
        return np.asarray(np.linalg.pinv(self.jacobian.T @ self.jacobian + np.diag(self.penalty)), np.float64)

    @property
    def errors(self) -> Array:
        """Standard errors of all coordinates (n,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def widened(self) -> Array:
        """The errors, larger where more than noise is left, by the root of chi-square a degree of freedom.

        Reference: Birge RT. Phys Rev 1932;40:207-227.
        """
        return self.errors * self.beyond**0.5


def refit(
    simulator: Simulator,
    data: Array,
    noise: Noise,
    start: State,
    *,
    iterations: int = _MOST,
    renewed: int = 1,
    behind: float = np.inf,
) -> Fit:
    """The nearest minimum from a start.

    Args:
        simulator: what predicts.
        data: (C, K).
        noise: its covariance.
        start: where to begin; its terms say what is fitted besides.
        iterations: at most so many, unless the objective still falls by what evidence would feel.
        renewed: after how many steps the simulator's own derivatives are taken again; those of terms always are. They
            are at the end, and where a step fails.
        behind: objective from which on only the first iterations are done, unless it falls fast.
    """
    target, damping, stale = noise.whiten(data), 1e-3, 0
    here = _at(simulator, noise, _point(simulator, noise, target, start))
    for i in range(_LONGEST):
        lower, damping = _lower(simulator, noise, target, here, damping, patient=not stale)
        fell = 0.0 if lower is None else here.objective - lower.objective
        here, stale = (here, stale) if lower is None else (lower, stale + 1)
        lost = here.objective - _HOPED * fell > behind
        settled = fell < _SETTLED or (i + 1 >= iterations and (fell < _FALLING or lost))
        if settled and not stale:
            break
        if settled or stale >= renewed:
            here, stale = _renewed(simulator, noise, here), 0
            if settled and lower is not None:
                break
    return here if not stale else _renewed(simulator, noise, here)


def begun(simulator: Simulator, data: Array, noise: Noise, origin: Fit, added: tuple[Term, ...]) -> State:
    """Where a refit with more terms should begin: weaker where all of them fits worse than none, and with room made.

    A linear amplitude may lie far beyond what a curved effect needs; and a strong effect fits badly until everything
    else has moved to where it would be beside it, which one linear step tells.
    """
    target, normal = noise.whiten(data), origin.jacobian.T @ origin.jacobian + np.diag(origin.penalty)
    room, pull = _room(simulator, origin.state), np.sqrt(origin.penalty) * origin.pulled
    best, least = None, np.inf
    for share in _SHARES:
        terms = tuple(t if t.hypothesis.flag else replace(t, amplitude=share * t.amplitude) for t in added)
        here = replace(origin.state, terms=(*origin.state.terms, *terms))
        values = simulator.predict(here.own, here.shared, here.terms)
        slope = origin.jacobian.T @ (target - noise.whiten(values)) + pull
        moved = _moved(simulator, origin.state, _within(normal, slope, *room))
        there = replace(moved, terms=(*moved.terms, *terms))
        after = simulator.predict(there.own, there.shared, there.terms)
        for state, predicted in ((here, values), (there, after)):
            reached = _point(simulator, noise, target, state, predicted).objective
            if best is None or reached < least:
                best, least = state, reached
        if least < origin.objective or all(t.hypothesis.flag for t in added):
            break
    assert best is not None
    return best


def _lower(
    simulator: Simulator, noise: Noise, target: Array, here: Fit, damping: float, *, patient: bool
) -> tuple[Fit | None, float]:
    """A lower point by a damped step, with the simulator's own derivatives as they are here, and the next damping.

    Where a step does not lead down, one with kinked shapes as they are may, by more than would end the refit: the slope
    to one side of a kink says nothing of the other side, and would hold up all else.
    """
    normal = here.jacobian.T @ here.jacobian + np.diag(here.penalty)
    slope = here.jacobian.T @ here.residual + np.sqrt(here.penalty) * here.pulled
    rooms = [(_room(simulator, here.state), 0.0)]
    if any(shape.kinked for term in here.state.terms for shape in term.hypothesis.shapes):
        rooms.append((_room(simulator, here.state, still=True), _SETTLED))
    while damping < _STUCK:
        scale = damping * np.diag(normal) + 1e-12
        for room, least in rooms:
            step = _within(normal + np.diag(scale), slope, *room)
            there = _point(simulator, noise, target, _moved(simulator, here.state, step))
            if there.objective < here.objective - least:
                return _at(simulator, noise, there, here), max(damping / 10.0, 1e-9)
        if not patient:
            break
        damping *= 8.0
    return None, damping


def _within(normal: Array, slope: Array, lower: Array, upper: Array) -> Array:
    """The step that solves normal s = slope, but for what would leave the room: that stops there, the rest makes up."""
    step, free = np.asarray(np.linalg.solve(normal, slope), np.float64), np.ones(len(slope), bool)
    for _ in range(_ROUNDS - 1):
        beyond = free & ((step < lower) | (step > upper))
        if not beyond.any():
            break
        step, free = np.clip(step, lower, upper), free & ~beyond
        left = slope[free] - normal[np.ix_(free, ~free)] @ step[~free]
        step[free] = np.linalg.solve(normal[np.ix_(free, free)], left)
    return np.clip(step, lower, upper)


def _room(simulator: Simulator, state: State, *, still: bool = False) -> tuple[Array, Array]:
    """How far every coordinate may move in one step, down and up; kinked shapes not at all if they are to be still."""
    count = len(simulator.channels)
    far = [np.full(state.own.size, _FURTHEST), np.full(state.shared.size, np.inf)]
    lower, upper = [-f for f in far], list(far)
    for term in state.terms:
        for part, width in parts(term, count):
            if part:
                shape, value = shape_of(term, part), term.setting[part]
                ends = np.log(shape.lower / value), np.log(shape.upper / value)
                furthest = 0.0 if still and shape.kinked else _FURTHEST_SHAPE
                ends = np.maximum(ends[0], -furthest), np.minimum(ends[1], furthest)
            else:
                low, high = term.hypothesis.limits
                ends = low - term.amplitude, high - term.amplitude
            lower.append(np.broadcast_to(np.minimum(ends[0], 0.0), (width,)))
            upper.append(np.broadcast_to(np.maximum(ends[1], 0.0), (width,)))
    return np.concatenate(lower), np.concatenate(upper)


def _point(simulator: Simulator, noise: Noise, target: Array, state: State, values: Array | None = None) -> Point:
    """A point; its values where they are known."""
    if values is None:
        values = simulator.predict(state.own, state.shared, state.terms)
    residual = target - noise.whiten(values)
    penalty, offset = _prior(simulator, state)
    pulled = -np.sqrt(penalty) * offset
    return Point(state, values, residual, penalty, pulled, float(residual @ residual + pulled @ pulled))


def _at(simulator: Simulator, noise: Noise, point: Point, known: Fit | None = None) -> Fit:
    """A point with its derivatives; the fit nearby whose own ones still hold."""
    state, values = point.state, point.values
    nuisance = state.own.size + state.shared.size
    own = noise.whiten(of_nuisance(simulator, state, values)).T if known is None else known.jacobian[:, :nuisance]
    jacobian = np.concatenate([own, noise.whiten(of_terms(simulator, state, values)).T], axis=1)
    return Fit(state, values, point.residual, point.penalty, point.pulled, point.objective, jacobian, nuisance)


def _renewed(simulator: Simulator, noise: Noise, fit: Fit) -> Fit:
    """The same point with the simulator's own derivatives as they are here."""
    own = noise.whiten(of_nuisance(simulator, fit.state, fit.values)).T
    return replace(fit, jacobian=np.concatenate([own, fit.jacobian[:, fit.nuisance :]], axis=1))


def of_nuisance(simulator: Simulator, state: State, values: Array) -> Array:
    """Derivatives by the simulator's own coordinates and the shared ones (n, C, K), at known values (C, K).

    Of one that can go no further, of an effect at its limit, the derivative is that of the way back.
    """
    steps, count = simulator.own.step, len(simulator.channels)
    change = _either_way(
        lambda sign: (
            (simulator.predict(state.own + sign * np.diag(steps)[:, None, :], state.shared, state.terms) - values)
            / (sign * steps[:, None, None])
        )
    )
    mine = np.zeros((count, len(steps), *values.shape))
    for c in range(count):
        mine[c, :, c] = change[:, c]

    def by_shared(which: Array, step: float) -> Array:
        return _either_way(
            lambda sign: (
                (simulator.predict(state.own, state.shared + sign * step * which, state.terms) - values) / (sign * step)
            )
        )

    rest = [by_shared(*each)[None] for each in zip(np.eye(len(simulator.shared)), simulator.shared.step, strict=True)]
    return np.concatenate([mine.reshape(-1, *values.shape), *rest])


def _either_way(quotient: Callable[[float], Array]) -> Array:
    """Difference quotients (..., K) forwards; backwards where nothing changes forwards."""
    forwards = quotient(1.0)
    still = ~forwards.any(axis=-1, keepdims=True)
    return np.where(still, quotient(-1.0), forwards) if still.any() else forwards


def of_terms(simulator: Simulator, state: State, values: Array) -> Array:
    """Derivatives by what is fitted of the terms (n, C, K), at known values (C, K)."""
    found = [np.zeros((0, *values.shape))]
    for i, term in enumerate(state.terms):
        for part in _parts(term):
            changed = _with_step(term, part, 1.0)
            terms = (*state.terms[:i], changed, *state.terms[i + 1 :])
            change = (simulator.predict(state.own, state.shared, terms) - values) / _size_of_step(term, part)
            found.append(_spread_out(change) if _is_local(term, part) else change[None])
    return np.concatenate(found)


def _spread_out(change: Array) -> Array:
    """A change of all channels (C, K) as one column a channel (C, C, K)."""
    return np.eye(len(change))[:, :, None] * change[None]


def _parts(term: Term) -> tuple[str, ...]:
    """What is fitted of a term: its amplitude unless it is a flag, and its shapes."""
    amplitude = () if term.hypothesis.flag else ("",)
    return (*amplitude, *(shape.symbol for shape in term.hypothesis.shapes))


def _is_local(term: Term, part: str) -> bool:
    """Whether a part differs between channels."""
    return shape_of(term, part).by_channel if part else term.hypothesis.by_channel


def shape_of(term: Term, symbol: str) -> Shape:
    return next(shape for shape in term.hypothesis.shapes if shape.symbol == symbol)


def parts(term: Term, channels: int) -> list[tuple[str, int]]:
    """What is fitted of a term, "" for its amplitude, and in how many columns."""
    return [(part, channels if _is_local(term, part) else 1) for part in _parts(term)]


def _size_of_step(term: Term, part: str) -> float:
    return _SHAPE_STEP if part else _AMPLITUDE_STEP * _reach(term.hypothesis)


def _reach(hypothesis: Hypothesis) -> float:
    return max(abs(hypothesis.lower), abs(hypothesis.upper))


def _with_step(term: Term, part: str, count: Any) -> Term:
    step = count * _size_of_step(term, part)
    if not part:
        return Term(term.hypothesis, term.amplitude + step, term.setting)
    return Term(term.hypothesis, term.amplitude, {**term.setting, part: term.setting[part] * np.exp(step)})


def _moved(simulator: Simulator, state: State, step: Array) -> State:
    count, size = len(simulator.channels), len(simulator.own)
    own = state.own + step[: count * size].reshape(count, size)
    place = count * size + len(simulator.shared)
    shared = state.shared + step[count * size : place]
    terms = []
    for term in state.terms:
        for part, width in parts(term, count):
            by = step[place : place + width] if _is_local(term, part) else step[place]
            term, place = _advanced(term, part, by), place + width
        terms.append(term)
    return State(own, shared, tuple(terms))


def _advanced(term: Term, part: str, by: Any) -> Term:
    """A term moved within its limits."""
    hypothesis = term.hypothesis
    if not part:
        return Term(hypothesis, np.clip(term.amplitude + by, *hypothesis.limits), term.setting)
    shape = shape_of(term, part)
    value = np.clip(term.setting[part] * np.exp(by), shape.lower, shape.upper)
    return Term(hypothesis, term.amplitude, {**term.setting, part: value})


def _prior(simulator: Simulator, state: State) -> tuple[Array, Array]:
    """1 / sd^2 of every coordinate, and the coordinates less their means."""
    own, shared, count = simulator.own, simulator.shared, len(simulator.channels)
    penalty = [np.broadcast_to(own.precision, state.own.shape).ravel(), shared.precision]
    offset = [(state.own - own.mean).ravel(), state.shared - shared.mean]
    for term in state.terms:
        for part, width in parts(term, count):
            value = np.log(term.setting[part] / _middle(term, part)) if part else term.amplitude
            below, above = (shape_of(term, part).sd,) * 2 if part else term.hypothesis.widths
            sd = np.where(np.asarray(value) < 0, below, above)
            penalty.append(np.broadcast_to(sd**-2.0, (width,)))
            offset.append(np.broadcast_to(value, (width,)))
    return np.concatenate(penalty), np.concatenate(offset)


def _middle(term: Term, part: str) -> float:
    shape = shape_of(term, part)
    return float(np.sqrt(shape.lower * shape.upper))
