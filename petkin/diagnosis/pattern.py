"""One pattern over the channels whose course may be anything: what no smooth discrepancy is, and noise is not either.

    r_ck = a_k p_c + e_ck,   a_k ~ N(0, tau s^2),  e_ck ~ N(0, s^2),  p of length 1, any direction as likely

Across the direction that noise has in common, each channel in units of its own size. With S = r r' its evidence, at the
likeliest s, is

    B = mean over tau of (1 + tau)^{-K/2} (s_0 / s)^n e^{(n - tr S / s^2) / 2} E_p exp(b p'Sp)
    b = tau / (2 s^2 (1 + tau))

where s_0 is the size without it. The mean over directions is Bingham's constant, by saddle point.

Reference: Kume A, Wood ATA. Biometrika 2005;92:465-476 (saddle point of the Bingham constant).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis import evidence
from petkin.diagnosis.covariance import Noise, common_axis
from petkin.diagnosis.noise import without_jumps
from petkin.jit import njit

Array = NDArray[np.float64]

#: Fewer channels than this have no pattern beside what noise has in common.
FEWEST = 3
#: Variance along the pattern, in units of that beside it; halvings that find a saddle point.
_EXCESS, _HALVINGS = np.geomspace(0.25, 40.0, 9), 40
#: Whitened values of no channel are smaller than this.
_QUIET = 0.3


def apart(residuals: Array, noise: Noise) -> Array:
    """Whitened residuals (..., C K) across what noise has in common, jumps cut, each channel in units of its size:
    (..., C, K)."""
    each = without_jumps(residuals.reshape(*residuals.shape[:-1], *noise.spread.shape))
    axis = common_axis(len(noise.size), noise.load)
    each = each - axis * (axis * each).sum(axis=-2, keepdims=True)
    return each / np.maximum(np.sqrt((each**2).mean(axis=-1, keepdims=True)), _QUIET)


def log_evidence(each: Array) -> Array:
    """log B of a pattern in values (..., C, K) as `apart` leaves them."""
    channels, samples = each.shape[-2:]
    size = np.linalg.eigvalsh(each @ each.swapaxes(-1, -2))[..., 1:]
    total, count = size.sum(axis=-1), (channels - 1) * samples
    even = np.maximum(total / count, _QUIET**2)
    found = []
    for excess in _EXCESS:
        along = excess / (1.0 + excess)
        variance = np.maximum((total - along * size[..., -1]) / count, _QUIET**2)
        value = 0.5 * count * np.log(even / variance) + 0.5 * total * (1.0 / even - 1.0 / variance)
        value = value - 0.5 * samples * np.log1p(excess)
        sized = size * (0.5 * along / variance)[..., None]
        found.append(value + _over_directions(sized.reshape(-1, sized.shape[-1])).reshape(value.shape))
    return evidence.mean(np.stack(found, axis=-1))


@njit()
def _over_directions(size):
    """ln of the mean of exp(p'Ap) over directions p, from the eigenvalues of A (n, channels), ascending."""
    count = size.shape[1]
    even = 0.5 * count
    found = np.empty(len(size))
    for i in range(len(size)):
        low, high = size[i, -1] + 0.5, size[i, -1] + even
        for _ in range(_HALVINGS):
            middle, slope = 0.5 * (low + high), 0.0
            for each in size[i]:
                slope += 0.5 / (middle - each)
            low, high = (middle, high) if slope > 1.0 else (low, middle)
        t, logs, bend = 0.5 * (low + high), 0.0, 0.0
        for each in size[i]:
            logs += np.log(t - each)
            bend += 0.5 / (t - each) ** 2
        found[i] = t - 0.5 * logs - 0.5 * np.log(bend) - (even - even * np.log(even) - 0.5 * np.log(1.0 / even))
    return found
