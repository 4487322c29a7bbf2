"""Dispersion of a blood curve in tubing and vessels: a first-order smear, there and back.

    measured(t) = int_0^t (1/tau) e^{-(t - s)/tau} true(s) ds    <=>    true = measured + tau d measured/dt

Reference: Iida H et al. J Cereb Blood Flow Metab 1986;6:536-545, doi:10.1038/jcbfm.1986.99;
Meyer E. J Nucl Med 1989;30:1069-1078.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin.dynamics import Forcing, PiecewiseLinear
from petkin.errors import InputError
from petkin.inputs.linearise import piecewise_linear


def dispersed(forcing: Forcing, tau: float, *, end: float, tolerance: float = 1e-4) -> PiecewiseLinear:
    """What is measured behind a dispersion `tau` when `forcing` enters it: response(1/tau)/tau, as straight pieces.

    Args:
        forcing: the true curve, one (no batch).
        tau: time constant, min.
        end: last time wanted, min; it must lie after the start of the curve.
        tolerance: largest relative departure of the straight pieces from the exact response.

    Returns:
        The dispersed curve from the first knot of `forcing` to `end`, held constant after.

    Raises:
        InputError: tau is not positive, or `end` lies before the start.
    """
    _check(tau)
    knots = np.asarray(forcing.knots, np.float64)
    if end <= knots[0]:
        raise InputError(f"The dispersed curve is wanted up to {end:g} min but starts at {knots[0]:g} min: extend it.")

    def curve(t: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(forcing.response(np.array(1.0 / tau), t)) / tau

    # A piece that halving would skip over (a short peak between two far knots) is caught by this first division.
    first = np.linspace(knots[0], end, 64)
    return piecewise_linear(curve, np.concatenate([knots[knots < end], first]), tolerance=tolerance)


def undispersed(
    times: NDArray[np.float64], values: NDArray[np.float64], tau: float, *, half_window: float = 0.0
) -> NDArray[np.float64]:
    """Samples freed from dispersion: g = c + tau dc/dt, at the same times.

    The slope is that of a parabola: through each sample and its two neighbours, or least squares over all samples
    within `half_window`. The values themselves are not smoothed, so the area is kept: it grows by tau (c_last - c_0)
    alone. Neighbours a time d away multiply the noise by sqrt(1 + tau^2 / (2 d^2)), 2.1 for tau = 2.6 s and d = 1 s. A
    fit of tissue curves integrates that noise away, while smoothing blunts the peak (Wollenweber et al. 1997 advise
    against it); hence the default.

    Args:
        times: sampling times, ascending, even or not, min, (samples,).
        values: measured activity, kBq/mL, (samples,).
        tau: time constant, min.
        half_window: half width of the window for the slope, min; 0 takes the neighbours.

    Returns:
        Corrected activity, kBq/mL, (samples,).

    Raises:
        InputError: tau or the window are out of range, or there are fewer than three samples.

    Reference: see the module; Wollenweber SD, Hichwa RD, Ponto LLB. IEEE Trans Nucl Sci 1997;44:1613-1617.
    """
    _check(tau)
    if times.size < 3:
        raise InputError(f"Dispersion correction needs at least three samples; got {times.size}.")
    if half_window < 0:
        raise InputError(f"The window of a dispersion correction cannot be negative; got {half_window:g} min.")
    slopes = np.gradient(values, times, edge_order=2)
    if half_window > 0:
        slopes = np.array([_local_slope(times, values, t, half_window, s) for t, s in zip(times, slopes, strict=True)])
    return values + tau * slopes


def _local_slope(
    times: NDArray[np.float64], values: NDArray[np.float64], t: float, half_window: float, fallback: float
) -> float:
    near = np.abs(times - t) <= half_window * (1 + 1e-9)
    if near.sum() < 4:
        return fallback
    offsets = (times[near] - t) / half_window
    powers = np.stack([np.ones_like(offsets), offsets, offsets**2], axis=1)
    return float(np.linalg.lstsq(powers, values[near], rcond=None)[0][1] / half_window)


def _check(tau: float) -> None:
    if not 0 < tau <= 1.0:
        raise InputError(
            f"A dispersion constant of {tau:g} min is out of range (0 to 1 min): give minutes, e.g. 2.6 s as 2.6 / 60."
        )
