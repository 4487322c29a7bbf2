"""The gap voxel by voxel: how much of the leading cause's pattern over the frames each voxel's residual holds.

    z_v = q_r' P_r (x_v - f_r) / (s_r sigma_r),   |q_r| = 1,   q_r in the range of P_r

P_r takes out what refitted kinetics of that voxel could explain; without a gap z is standard normal. Where there is no
leading cause, z is the normal score of chi2 = |P_r (x_v - f_r) / (s_r sigma_r)|^2: any course counts.

Reference: Wilson EB, Hilferty MM. Proc Natl Acad Sci USA 1931;17:684-688 (cube root of chi-square).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis import Diagnosis, second_differences
from petkin.effects.imaging import after
from petkin.imaging import FrameObservation
from petkin.study.diagnosis.picture import Voxels
from petkin.study.diagnosis.regional import RegionalSimulator
from petkin.study.diagnosis.standing import Standing

Array = NDArray[np.float64]

#: A pattern with less than this share of its size left by the projection says nothing.
_LOST = 1e-6


def gap_map(voxels: Voxels, found: Diagnosis, simulator: RegionalSimulator) -> NDArray[np.float32]:
    """z of every voxel [x, y, z]; NaN outside the regions. What it holds of included spatial effects is no gap.

    Args:
        voxels: of the segmentation.
        found: the diagnosis, whose leading cause gives the pattern.
        simulator: with its included effects.
    """
    beside = Standing.of(voxels, simulator).beside(voxels.residual)
    residual = _projected(beside, voxels)
    wanted = _pattern(voxels, found, simulator.clock)
    z = np.empty(len(residual))
    for r in range(len(voxels.fit.values)):
        mine = voxels.place == r
        scores = residual[mine]
        bends = second_differences(beside[mine])
        sigma = max(float(np.sqrt((bends**2).mean())), 1e-300) if bends.size else 1.0
        z[mine] = _scored(scores / sigma, wanted[r], _basis(voxels.sensitivity[r]))
    volume = np.full(voxels.inside.shape, np.nan, np.float32)
    volume[voxels.inside] = z
    return volume


def gap_map_sidecar(found: Diagnosis) -> dict[str, Any]:
    """Fields of the map's JSON."""
    leader = found.causes[0].label if found.causes else None
    return {
        "Description": (
            "z-score of every voxel: its residual after the refit of its kinetics, along the course over the frames of "
            "the leading cause, or the normal score of its chi-square without one; standard normal without a gap"
        ),
        "Cause": leader,
        "Units": "arbitrary",
    }


def _pattern(voxels: Voxels, found: Diagnosis, clock: FrameObservation) -> Array:
    """Course of the leading cause in every region (R, K), weighted as residuals are; zero without a cause."""
    values, spread = voxels.fit.values, voxels.spread
    if found.frame is not None:
        return values * (np.arange(values.shape[1]) == found.frame) / spread
    if found.onset is not None:
        return values * after(clock, found.onset) / spread
    leader = found.causes[0].fit if found.causes else None
    return np.zeros_like(values) if leader is None else (leader.values - values) / spread


def _projected(residual: Array, voxels: Voxels) -> Array:
    """Residuals (N, K) without what their own kinetics could explain."""
    left = residual.copy()
    for r, sensitivity in enumerate(voxels.sensitivity):
        mine = voxels.place == r
        basis = _basis(sensitivity)
        left[mine] -= (residual[mine] @ basis) @ basis.T
    return left


def _basis(sensitivity: Array) -> Array:
    left, size, _ = np.linalg.svd(sensitivity, full_matrices=False)
    return left[:, size > 1e-9 * size[0]]


def _scored(scores: Array, wanted: Array, basis: Array) -> Array:
    """z of projected residuals (N, K) along a pattern; of their chi-square where the projection leaves none of it."""
    left = wanted - basis @ (basis.T @ wanted)
    length = float(np.linalg.norm(left))
    if length > _LOST * max(float(np.linalg.norm(wanted)), 1e-300):
        return scores @ (left / length)
    freedom = max(scores.shape[1] - basis.shape[1], 1)
    spread = 2.0 / (9.0 * freedom)
    return (np.cbrt((scores**2).sum(axis=1) / freedom) - (1.0 - spread)) / np.sqrt(spread)
