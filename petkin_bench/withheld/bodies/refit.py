"""How visible a cause is once starts and parameters are refitted, by a least-squares fit of the generator's own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin_bench.withheld.bodies.rigs import Kit, Rig

Array = NDArray[np.float64]

_STEPS, _QUOTIENT, _ENOUGH = 25, 1e-4, 1e-3


@dataclass(frozen=True)
class Law:
    """Noise of points (..., runs, T, P, 2): of one size, with a share of its variance in common to a picture."""

    sd: float
    share: float

    def whiten(self, points: Array) -> Array:
        """In units of the noise, flattened to (..., n)."""
        middle = points.mean(axis=-2, keepdims=True)
        count = points.shape[-2]
        apart = (points - middle) / np.sqrt(1.0 - self.share if count > 1 else 1.0)
        white = (apart + middle / np.sqrt(1.0 + (count - 1) * self.share)) / self.sd
        return np.asarray(white.reshape(*points.shape[:-4], -1), np.float64)


@dataclass(frozen=True)
class Watched:
    """Points as the simulator is refitted to them.

    Args:
        rig, law: whose.
        values: points without noise as the product has them (runs, P 2 T).
        starts, parameters: of the refit.
        left: whitened, what the refit leaves (n,).
        axes: orthonormal columns of what it can do (n, p).
    """

    rig: Rig
    law: Law
    values: Array
    starts: Array
    parameters: Array
    left: Array
    axes: Array

    @property
    def detectability(self) -> float:
        return float(np.linalg.norm(self.left))

    def project(self, column: Array) -> Array:
        """What a refit leaves of a whitened column (n,)."""
        return np.asarray(column - self.axes @ (self.axes.T @ column), np.float64)

    def change(self, kit: Kit) -> Array:
        """Of the refit by a kit, whitened."""
        every = np.tile(self.parameters, (len(self.starts), 1))
        there, here = (self.rig.seen(self.starts, every, k) for k in (kit, {}))
        return self.law.whiten(there - here)


def watched(rig: Rig, starts: Array, parameters: Array, sd: float, share: float, kit: Kit) -> Watched:
    """Runs with a kit, and what is left of them when starts and parameters are fitted without it.

    Damped Gauss-Newton steps from the truth; derivatives of all runs are taken in one go.
    """
    law = Law(sd, share)
    points = rig.seen(starts, np.tile(parameters, (len(starts), 1)), kit)
    target = law.whiten(points)
    values = np.moveaxis(points, 1, -1).reshape(len(points), -1)
    damping, (fitted, jacobian) = 1e-4, _jacobian(rig, law, starts, parameters)
    for _ in range(_STEPS):
        residual = target - fitted
        normal = jacobian.T @ jacobian
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-9), jacobian.T @ residual)
        begun = starts + step[: starts.size].reshape(starts.shape)
        there = parameters + step[starts.size :]
        after = _jacobian(rig, law, begun, there)
        gained = float(residual @ residual - (target - after[0]) @ (target - after[0]))
        if not gained > 0:
            damping *= 10.0
            if damping > 1e6:
                break
            continue
        starts, parameters, (fitted, jacobian) = begun, there, after
        damping /= 10.0
        if gained < _ENOUGH:
            break
    axes, size, _ = np.linalg.svd(jacobian, full_matrices=False)
    axes = axes[:, size > 1e-6 * size[0]]
    residual = target - fitted
    return Watched(rig, law, values, starts, parameters, residual - axes @ (axes.T @ residual), axes)


def _jacobian(rig: Rig, law: Law, starts: Array, parameters: Array) -> tuple[Array, Array]:
    """Whitened values (n,) and their derivatives (n, runs states + parameters)."""
    runs, states = starts.shape
    moved = [starts] + [starts + _QUOTIENT * row for row in np.eye(states)] + [starts] * len(parameters)
    laws = [parameters] * (1 + states) + [parameters + _QUOTIENT * row for row in np.eye(len(parameters))]
    every = np.concatenate([np.tile(p, (runs, 1)) for p in laws])
    points = rig.seen(np.concatenate(moved), every, {}).reshape(len(laws), runs, rig.frames, -1, 2)
    change = (points[1:] - points[0]) / _QUOTIENT
    columns = np.zeros((runs * states + len(parameters), *points.shape[1:]))
    for run in range(runs):
        columns[run * states : (run + 1) * states, run] = change[:states, run]
    columns[runs * states :] = change[states:]
    return law.whiten(points[0]), law.whiten(columns).T
