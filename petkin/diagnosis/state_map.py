"""Where in its course a system's law lacks a term, as an ensemble of learned residuals reads it, with claims held.

Every member reads the data as a term f_ck that the law lacks, channel by channel and sample by sample, and says how
sure it is: f = f_m + D_m e of standard normal e. The band is simultaneous: of members and their errors together, 95 %
lie in it in all cells at once.

A band may lie off nought because of what the members learned and not because of the data. So a cell is claimed only if
the data ask for it too: what the simulator's own fit leaves, r, is read by the members as they would follow small
departures from that fit, z = G r / sd, and the largest |z| of all cells exceeds that of 95 % of draws of noise.

Reference: Westfall PH, Young SS. Resampling-based multiple testing. Wiley 1993 (largest statistic over all cells).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis.covariance import Noise
from petkin.diagnosis.detect import p_value

Array = NDArray[np.float64]

#: Share that bands and the largest statistic of noise hold; draws of every member for the band.
_HELD, _DRAWS = 0.95, 400
#: A size below this share of the largest is rounding.
_NOTHING = 1e-5


@dataclass(frozen=True)
class Witness:
    """What one member of an ensemble says.

    Args:
        term: f, what the law lacks (C, K).
        root: D, of its errors (C, K, v).
        left: what it leaves of the data (C, K).
        gain: by which its term follows small departures from the simulator's own fit (C, K, K).
        follows: by which its values do (C, K, K).
        beside: by how much it misses that fit (C, K).
    """

    term: Array
    root: Array
    left: Array
    gain: Array
    follows: Array
    beside: Array


@dataclass(frozen=True)
class StateMap:
    """The term that the law lacks.

    Args:
        term: mean of the members (C, K).
        low, high: simultaneous band.
        claimed: cells where the band excludes nought and the data ask for it.
        spread: standard deviation of the term, members and errors together (C, K).
        p_value: of the largest departure that the data ask for.
        evidence: by how much likelier (log) the members have the data than the simulator, the median one, less what
            that is for noise.
    """

    term: Array
    low: Array
    high: Array
    claimed: NDArray[np.bool_]
    spread: Array
    p_value: float
    evidence: float


def map_states(
    members: Sequence[Witness], left: Array, drawn: Array, noise: Noise, rng: np.random.Generator
) -> StateMap:
    """What an ensemble says of data.

    Args:
        members: two or more.
        left: what the simulator's own fit leaves of the data (C, K).
        drawn: what such a fit leaves of noise, in the unit of the data (B, C, K).
        noise: covariance.
        rng: for the band.
    """
    terms = np.stack([m.term for m in members])
    term = terms.mean(axis=0)
    spread, half = _band(members, terms, rng)
    gain = np.mean([m.gain for m in members], axis=0)
    asked, null = (np.einsum("ckl,...cl->...ck", gain, part) for part in (left, drawn))
    size = _above_nothing(null.std(axis=0))
    asked, most = asked / size, np.abs(null / size).max(axis=(1, 2))
    loud = (np.abs(asked) > np.quantile(most, _HELD)) & (np.sign(asked) == np.sign(term))
    return StateMap(
        term=term,
        low=term - half,
        high=term + half,
        claimed=loud & (np.abs(term) > half),
        spread=spread,
        p_value=p_value(float(np.abs(asked).max()), most),
        evidence=float(np.median([_evidence(m, left, drawn, noise) for m in members])),
    )


def _band(members: Sequence[Witness], terms: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Standard deviation of the term, and half the width of its simultaneous band (C, K)."""
    apart = (terms - terms.mean(axis=0)) * np.sqrt(len(terms) / (len(terms) - 1.0))
    parts = []
    for member, off in zip(members, apart):
        drawn = rng.standard_normal((_DRAWS, member.root.shape[0], member.root.shape[2]))
        parts.append(off + np.einsum("ckv,bcv->bck", member.root, drawn))
    own = np.mean([(m.root**2).sum(axis=-1) for m in members], axis=0)
    spread = _above_nothing(np.sqrt(own + (apart**2).mean(axis=0)))
    most = np.abs(np.concatenate(parts) / spread).max(axis=(1, 2))
    return spread, float(np.quantile(most, _HELD)) * spread


def _above_nothing(sizes: Array) -> Array:
    """Sizes that can divide: where the law says that nothing can be, rounding is all there is."""
    return np.maximum(sizes, max(_NOTHING * float(sizes.max()), 1e-300))


def _evidence(member: Witness, left: Array, drawn: Array, noise: Noise) -> float:
    """Half of what a member takes off the simulator's chi-square, less the mean of that over noise alone."""
    gained = _half_square(left, noise) - _half_square(member.left, noise)
    beside = drawn + member.beside - np.einsum("ckl,bcl->bck", member.follows, drawn)
    return float(gained - (_half_square(drawn, noise) - _half_square(beside, noise)).mean())


def _half_square(residual: Array, noise: Noise) -> Array:
    return 0.5 * (noise.whiten(residual) ** 2).sum(axis=-1)
