"""Running integrals as frames would report them: exact of an input function, to fourth order of a measured curve."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petkin.dynamics import Forcing
from petkin.fitting.table import Itself
from petkin.imaging import FrameObservation, FrameSchedule

Array = NDArray[np.float64]

#: Points of Gauss and Legendre in a frame: exact for a cubic under the decay of any isotope that is imaged.
_POINTS = 6
#: Edges closer than this (min) are one, written down twice.
_SAME = 1e-3


def curve_integrals(observation: FrameObservation) -> tuple[Array, Array]:
    """Operators I and J that take frame values y of a curve C to those of int_0^t C ds and of its integral.

    The area under a curve is known at frame ends; a cubic spline through these areas, flat at the start, is its running
    integral in between. Where frames weigh by decay, or are read in their middle, the spline is the one that would
    report y. Over a gap the curve is a straight line between its neighbours' means, and so it is from zero at injection
    to the first frame.

    Args:
        observation: what K frames report.

    Returns:
        I (K, K) in min, J (K, K) in min^2; column k is what the value of frame k alone adds. The last few are kept,
        since a scan's voxels may come in many blocks.
    """
    return _curve_integrals(Itself(observation))


@lru_cache(maxsize=4)
def _curve_integrals(key: Itself) -> tuple[Array, Array]:
    from scipy.interpolate import CubicSpline

    observation = key.thing
    edges, areas = _areas(observation.frames)
    ends: Any = (1, np.zeros(len(observation.frames))), "not-a-knot"
    running = CubicSpline(edges, areas, bc_type=ends)
    reported = _report(running.derivative(), observation)
    once, twice = _report(running, observation), _report(running.antiderivative(), observation)
    means = np.linalg.inv(reported)
    return _for_good(np.asarray(once @ means, np.float64)), _for_good(np.asarray(twice @ means, np.float64))


def input_columns(forcing: Forcing, observation: FrameObservation) -> tuple[Array, Array]:
    """Frame values (K,) of u and of int_0^t u ds, exactly; the last few are kept, like the operators above."""
    return _input_columns(Itself(forcing), Itself(observation))


@lru_cache(maxsize=4)
def _input_columns(forcing: Itself, observation: Itself) -> tuple[Array, Array]:
    area = observation.thing.of_response(forcing.thing, np.zeros(1))[0]
    return _for_good(np.asarray(observation.thing.of_forcing(forcing.thing))), _for_good(np.asarray(area))


def _for_good(array: Array) -> Array:
    """What is kept for others must not be written to."""
    array.setflags(write=False)
    return array


def input_integrals(forcing: Forcing, observation: FrameObservation) -> tuple[Array, Array]:
    """Frame values (K,) of int_0^t u ds and of its integral, exactly.

    int_0^t (t - s) u(s) ds is what the response e^{-a t} * u loses per unit of rate at a = 0.
    """
    import torch

    rate = torch.zeros(1, dtype=torch.float64, requires_grad=True)
    values = observation.of_response(forcing, rate)[0]
    # The derivative of all values by one number, from two passes backwards: the first is linear in `seed`.
    seed = torch.zeros_like(values, requires_grad=True)
    (along,) = torch.autograd.grad(values, rate, seed, create_graph=True)
    (slope,) = torch.autograd.grad(along.sum(), seed)
    return values.detach().numpy(), -slope.numpy()


def _areas(frames: FrameSchedule) -> tuple[Array, Array]:
    """Edges of frames and gaps (E,), ascending, and the area up to each, a column a frame of unit value (E, K)."""
    each = np.eye(len(frames))
    edges, areas = [0.0], [np.zeros(len(frames))]
    for k in range(len(frames)):
        gap = frames.start[k] - edges[-1]
        if gap > _SAME:
            mean = 0.5 * (each[k - 1] + each[k] if k else each[k])
            edges.append(frames.start[k])
            areas.append(areas[-1] + gap * mean)
        edges.append(frames.end[k])
        areas.append(areas[-1] + frames.duration[k] * each[k])
    return np.array(edges), np.array(areas)


def _report(curve: Callable[[Array], Array], observation: FrameObservation) -> Array:
    """Frame values (K, ...) of a piecewise polynomial."""
    frames = observation.frames
    if observation.mid_frame:
        return curve(frames.mid)
    nodes, shares = np.polynomial.legendre.leggauss(_POINTS)
    lag = 0.5 * frames.duration[:, None] * (1.0 + nodes)
    weight = 0.5 * shares * np.exp(-observation.decay * lag)
    if observation.corrected:
        weight = weight / weight.sum(axis=1, keepdims=True)
    else:
        weight = weight * np.exp(-observation.decay * frames.start)[:, None]
    return np.einsum("kp,kp...->k...", weight, curve(frames.start[:, None] + lag))
