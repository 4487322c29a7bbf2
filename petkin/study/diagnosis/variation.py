"""How much kinetics vary within regions, as far as an image shows it, and what contrasts may hold of that.

The logarithm of every parameter varies over the voxels as a smooth field does, whose correlation falls with distance
as e^{-d^2 / 2 l^2}. Regions that touch share it, and so do their contrasts:

    c_r(k) = sum_p J_rp(k) a_rp,    cov(a_rp, a_sp) = v_p B_rs,    B_rs = sum_(v in r) sum_(u in s) w_v w_u rho(v - u)

v comes from decoys: contrasts of the same weights times smooth waves, made blind to what the weights see.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from petkin.study.diagnosis.picture import Voxels

Array = NDArray[np.float64]

#: Length over which kinetics vary, that of the waves of decoys, and edge of a cell, mm.
_LENGTH_MM, _DECOY_MM, _CELL_MM = 15.0, 20.0, 5.0
#: Waves of which a field is the sum, and decoys.
_WAVES, _DECOYS = 128, 64
#: Usual variance of the logarithm, and of how many contrasts it has the weight; so many independent ones are the decoys
#: of a region.
_USUAL, _TRUST, _INDEPENDENT = 0.01, 4.0, 8.0
_ROUNDS, _TINY, _ROUNDING = 60, 1e-9, 1e-13


@dataclass(frozen=True)
class Weighed:
    """A contrast: weights of the voxels (N,), and the covariance of its noise between the regions (R, R)."""

    weights: Array
    noise: Array

    @property
    def sizes(self) -> Array:
        """Standard deviation of its noise in every region (R,)."""
        return np.sqrt(np.maximum(np.diag(self.noise), 0.0))


@dataclass(frozen=True)
class Variation:
    """Fields of kinetics within the regions of an image.

    Args:
        cells: where they are.
        fields: waves of which smooth fields of unit variance are sums, at the cells (C, Q).
        apart: other such waves, so that fields still have what contrasts without these see (C, Q).
        sensitivity: derivatives of the weighted regional curves by their own parameters (R, K, P).
        variance: v of the logarithm of every parameter (P,).
    """

    cells: _Cells
    fields: Array
    apart: Array
    sensitivity: Array
    variance: Array

    @classmethod
    def of(cls, voxels: Voxels, contrasts: Sequence[Weighed]) -> Variation:
        """As far as such contrasts show it."""
        rng, cells = np.random.default_rng(0), _Cells.of(voxels)
        fields, waves = cells.waves(rng, _WAVES, _LENGTH_MM), cells.waves(rng, _DECOYS, _DECOY_MM)
        decoys = [decoy for each in contrasts for decoy in _decoys(voxels, each, cells, waves, fields)]
        apart = cells.waves(rng, _WAVES, _LENGTH_MM)
        return cls(cells, fields, apart, voxels.sensitivity, _variances(decoys, voxels.sensitivity.shape[2]))

    def joint(self, weights: Array, regions: NDArray[np.intp]) -> Array:
        """What several contrasts of each of some regions may hold of it, by weights (F, N): (n, F R, K)."""
        held, sensitivity = self.cells.over(weights), self.sensitivity[regions]
        seen = np.stack([(held * (self.cells.region == r)) @ self.fields for r in regions], axis=1)
        seen = seen.reshape(-1, seen.shape[-1])
        size, axes = np.linalg.eigh(seen @ seen.T)
        there = size > _TINY * size[-1]
        root = (axes[:, there] * np.sqrt(size[there])).reshape(-1, len(regions), int(there.sum()))
        columns = np.einsum("frs,rkp,p->spfrk", root, sensitivity, np.sqrt(self.variance))
        return columns.reshape(-1, len(seen), sensitivity.shape[1])

    def parted(self, voxels: Voxels, contrast: Weighed) -> Array:
        """Weights (2, N) that see no smooth field, and those that see what these do not, each of unit length.

        (1 + q F F')^-1 w = w - F (1 / q + F' F)^-1 F' w,   of waves F at the voxels: what has a variance of one and
        fields of variance q in it is whitened so. q is that of kinetics over that of noise, of the usual parameter and
        frame.

        Reference: Woodbury MA. Inverting modified matrices. Princeton Statistical Research Group memo 42; 1950.
        """
        left = contrast.weights.copy()
        for r, noise in enumerate(np.diag(contrast.noise)):
            mine = voxels.place == r
            waves = self.apart[self.cells.index[mine]]
            q = float((self.sensitivity[r] ** 2 * self.variance).mean() / max(noise, _TINY))
            inner = waves.T @ waves + np.eye(waves.shape[1]) / max(q, _TINY)
            left[mine] -= waves @ np.linalg.solve(inner, waves.T @ left[mine])
        return np.stack([voxels.centred(left), voxels.centred(contrast.weights - left)])


@dataclass(frozen=True)
class _Cells:
    """Neighbouring voxels of a region together, so that what is smooth is drawn for few places.

    Args:
        index: cell of every voxel (N,).
        middle: of every cell, mm (C, 3).
        region: of every cell (C,).
    """

    index: NDArray[np.intp]
    middle: Array
    region: NDArray[np.intp]

    @classmethod
    def of(cls, voxels: Voxels) -> _Cells:
        at = np.stack(np.nonzero(voxels.inside)) * np.array(voxels.picture.size)[:, None]
        keys = np.concatenate([voxels.place[None], np.floor(at / _CELL_MM).astype(np.intp)])
        cells, index = np.unique(keys, axis=1, return_inverse=True)
        index = index.ravel()
        middle = np.stack([np.bincount(index, x) for x in at], axis=1) / np.bincount(index)[:, None]
        return cls(index, middle, cells[0])

    def waves(self, rng: np.random.Generator, count: int, length: float) -> Array:
        """Waves (C, count), whose products sum to e^{-d^2 / 2 length^2} on average.

        Reference: Rahimi A, Recht B. Adv Neural Inf Process Syst 2007;20:1177-1184 (random Fourier features).
        """
        ways, phases = rng.standard_normal((3, count)) / length, rng.uniform(0.0, 2.0 * np.pi, count)
        return np.asarray(np.cos(self.middle @ ways + phases) * np.sqrt(2.0 / count), np.float64)

    def over(self, rows: Array, among: NDArray[np.bool_] | slice = slice(None)) -> Array:
        """Sums over every cell (n, C) of rows of weights of the voxels, or of some of them (n, N)."""
        index = self.index[among]
        return np.asarray(np.stack([np.bincount(index, row, len(self.region)) for row in rows]), np.float64)


@dataclass(frozen=True)
class _Decoys:
    """Decoys of one region.

    Args:
        moments: mean of their products (K, K).
        noise: their variance by noise and by edges that run within voxels (K, K).
        varied: what kinetics of unit variance give them (K, P).
    """

    moments: Array
    noise: Array
    varied: Array


def _decoys(voxels: Voxels, contrast: Weighed, cells: _Cells, waves: Array, fields: Array) -> list[_Decoys]:
    """Decoys of one contrast, region by region; none of a region that it does not weigh, as of one voxel."""
    found = []
    for r, size in enumerate(contrast.sizes):
        mine = voxels.place == r
        own = contrast.weights[mine]
        if not own.any():
            continue
        seen = np.stack([np.full(own.size, own.size**-0.5), own], axis=1)
        waved = own[:, None] * waves[cells.index[mine]]
        free = waved - seen @ (seen.T @ waved)
        length = np.linalg.norm(free, axis=0)
        free = (free / np.where(length > _TINY, length, np.inf)).T
        contrasts = voxels.weighed(free, r)
        edges = voxels.mixed(voxels.usual(np.sqrt(((free @ voxels.seen[mine]) ** 2).sum(axis=1).mean())), r)
        held = ((cells.over(free, mine) @ fields) ** 2).sum() / len(free)
        noise = size**2 * np.eye(contrasts.shape[1]) + edges @ edges.T
        found.append(_Decoys(contrasts.T @ contrasts / len(free), noise, np.sqrt(held) * voxels.sensitivity[r]))
    return found


def _variances(decoys: list[_Decoys], parameters: int) -> Array:
    """The likeliest variances (P,) beside the usual ones, of moments S = noise + sum_p v_p g_p g_p'.

    In units of the noise, along Q of g = Q R, all that changes with v is of P by P:

        g' (1 + g v g')^-1 g = R' T,   T = (1 + R v R')^-1 R

    Reference: Zhou H, Hu L, Zhou J, Lange K. J Comput Graph Stat 2019;28:350-361 (each step is never less likely).
    """
    if not decoys:
        return np.full(parameters, _USUAL)
    each = [_along(decoy) for decoy in decoys]
    varied, moments = (np.stack(parts) for parts in zip(*each, strict=True))
    variance, one = np.full(parameters, _USUAL), np.eye(varied.shape[1])
    for _ in range(_ROUNDS):
        told = np.linalg.solve(one + (varied * variance) @ varied.swapaxes(1, 2), varied)
        more = _TRUST * _USUAL / variance**2 + _INDEPENDENT * (told * (moments @ told)).sum(axis=(0, 1))
        less = _TRUST / variance + _INDEPENDENT * (varied * told).sum(axis=(0, 1))
        variance = variance * np.sqrt(more / less)
    return variance


def _along(decoy: _Decoys) -> tuple[Array, Array]:
    """R of what varied, and the moments along its Q, both in units of the noise, which is no less than rounding."""
    least = _ROUNDING * (np.trace(decoy.noise) + (decoy.varied**2).sum())
    factor = np.linalg.cholesky(decoy.noise + least * np.eye(len(decoy.noise)))
    axes, varied = np.linalg.qr(solve_triangular(factor, decoy.varied, lower=True))
    axes = solve_triangular(factor, axes, lower=True, trans=1)
    return varied, axes.T @ decoy.moments @ axes
