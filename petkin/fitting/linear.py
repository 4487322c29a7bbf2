"""Weighted linear least squares a curve, where columns of the design may be made from the curve itself.

Every graphical and multilinear method is one equation that is linear in its unknowns,

    R y = sum_i theta_i X_i + sum_j theta_j O_j y,    frames of weight > 0,

y the curve, X_i columns that all curves have in common (integrals of the input, a reference region), O_j and R linear
operators on the frames (the curve itself, its integrals). Each curve's columns are orthogonalised by modified
Gram-Schmidt, those in common once beforehand and the response last: as stable as a QR decomposition, sums of squares
without cancellation, and no array of the size of a curve outside the cache.

Noise n of the frames enters response and columns alike: what is left of the equation is L n with
L = R - sum_j theta_j O_j, correlated over frames wherever an integral takes part. To first order

    cov(theta) = s^2 G X^T W L N L^T W X G,  G = (X^T W X)^-1,    s^2 = WRSS / tr(P W L N L^T),

N the frames' relative variances and P the projection off the weighted columns. For L = 1 this is the usual covariance.

References: Bjorck A. Solving linear least squares problems by Gram-Schmidt orthogonalization. BIT 1967;7:1-21,
doi:10.1007/BF01934122. White H. Econometrica 1980;48:817-838, doi:10.2307/1912934 (a covariance that is not that of the
weights).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.fitting.gram_schmidt import INDEPENDENT, scratch, solve_curves
from petkin.fitting.shared_columns import Answer, regress_curves

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LinearDesign:
    """One equation of the module; the unknowns are those of `shared`, then those of `own`.

    Args:
        shared: columns X that all curves have in common (S, K).
        own: operators O that make a curve's own columns, (J, K, K): column j of a curve y is own[j] @ y.
        response: operator R (K, K).
        weights: of the equations (K,), >= 0; where zero, a frame is left out.
        noise: variances of frame values (K,) up to a factor that all share; also of frames that only integrals use.
        offset: taken off every curve first (K,), kBq/mL, such as the blood in it.
        scale: multiplies what is left.
    """

    shared: Array
    own: Array
    response: Array
    weights: Array
    noise: Array
    offset: Array
    scale: float = 1.0

    @property
    def used(self) -> NDArray[np.intp]:
        """Frames that take part."""
        return np.flatnonzero(self.weights > 0)

    @property
    def unknowns(self) -> int:
        return len(self.shared) + len(self.own)


@dataclass(frozen=True)
class LinearSolutions:
    """What came of n curves.

    Args:
        theta: unknowns (p, n); not finite where the columns of a curve depend on each other.
        covariance: of the unknowns at unit noise (p, p, n); the noise is wrss / freedom.
        wrss: weighted residual sum of squares (n,).
        freedom: what `wrss` is at unit noise, on average (n,): frames less unknowns for L = 1.
        total: sum of a curve's values over all frames (n,).
        finite: whether all values of a curve are numbers (n,).
    """

    theta: Array
    covariance: Array
    wrss: Array
    freedom: Array
    total: Array
    finite: NDArray[np.bool_]


@dataclass(frozen=True)
class LinearSolver:
    """A design made ready: `prepare` it once, solve for as many curves as there are.

    Args:
        operators: own columns and last the response, over used frames, times root weights (J + 1, U, K).
        spans: first and one past the last frame that a row of them reads (J + 1, U, 2).
        axes: orthonormal axes of the shared columns (S, U).
        inverse: what makes the shared unknowns from components along the axes (S, S).
        offset, scale: as in `LinearDesign`.
        spread: how the noise of every frame enters the used ones through each operator, operators transposed times
            root variances (J + 1, K, U), their spans (J + 1, K, 2), the same along the axes (J + 1, S, K), and
            traces of products of two operators' spreads (J + 1, J + 1).
    """

    operators: Array
    spans: NDArray[np.intp]
    axes: Array
    inverse: Array
    offset: Array
    scale: float
    spread: tuple[Array, NDArray[np.intp], Array, Array]

    @classmethod
    def prepare(cls, design: LinearDesign, label: str) -> LinearSolver:
        """What all curves have in common.

        Raises:
            InputError: too few frames, or columns in common that depend on each other.
        """
        used = design.used
        if len(used) <= design.unknowns:
            raise InputError(
                f"{label} has {design.unknowns} unknowns but only {len(used)} frames to tell them from; "
                "an error needs one more: use more frames."
            )
        root = np.sqrt(design.weights[used])
        operators = np.concatenate([design.own, design.response[None]])[:, used] * root[:, None]
        axes, upper = np.linalg.qr((design.shared[:, used] * root).T)
        diagonal, lengths = np.abs(np.diag(upper)), np.sqrt((upper**2).sum(axis=0))
        if not (diagonal > INDEPENDENT * lengths).all():
            raise InputError(
                f"{label}: the input says nothing in the {len(used)} frames used (it is zero there, or not finite, or "
                "its integrals are multiples of each other); check the input function and its times."
            )
        inverse = np.linalg.inv(upper) if len(upper) else np.empty((0, 0))
        noisy = np.ascontiguousarray((operators * np.sqrt(design.noise)).transpose(0, 2, 1))
        spread = (
            noisy,
            _spans(noisy),
            np.ascontiguousarray(np.einsum("vku,us->vsk", noisy, axes)),
            np.einsum("vku,wku->vw", noisy, noisy),
        )
        return cls(
            np.ascontiguousarray(operators),
            _spans(operators),
            np.ascontiguousarray(axes.T),
            inverse,
            design.offset,
            design.scale,
            spread,
        )

    @cached_property
    def in_common(self) -> bool:
        """Whether no column is a curve's own and the curve itself is the response."""
        return len(self.operators) == 1 and bool((np.diff(self.spans[0]) == 1).all())

    def regress(
        self,
        frames: NDArray[np.floating],
        part: slice,
        outcome: int,
        answer: Answer,
    ) -> None:
        """Values, percent errors, chi-square and status where all columns are in common: see `regress_curves`."""
        used = self.spans[0, :, 0]
        factor = self.operators[0, np.arange(len(used)), used] * self.scale
        each, freedom = self._unit
        tissue, unit = (self.offset[used], factor, used), (np.sqrt(np.diag(each)), freedom)
        regress_curves(frames, part, tissue, self.axes, self.inverse, unit, outcome, answer)

    def solve(self, frames: NDArray[np.floating], rows: slice) -> LinearSolutions:
        """Unknowns of some of the curves (K, N), float32 or float64, frames first; `rows` has a start and a stop."""
        n, (vectors, used, count) = rows.stop - rows.start, self.operators.shape
        unknowns = len(self.axes) + vectors - 1
        theta, (wrss, freedom, total), finite = np.empty((unknowns, n)), np.empty((3, n)), np.empty(n, np.bool_)
        same = vectors == 1  # no column is the curve's own: all curves have one covariance
        covariance = np.empty((unknowns, unknowns, 0 if same else n))
        solve_curves(
            np.ascontiguousarray(frames[:, rows], np.float64),  # of one kind, so that one kind is compiled
            self.offset,
            self.scale,
            self.operators,
            self.spans,
            self.axes,
            self.inverse,
            self.spread,
            scratch(count, vectors, used, unknowns),
            (theta, covariance, wrss, freedom, total, finite),
        )
        if same:
            each, all_freedom = self._unit
            covariance = np.broadcast_to(each[:, :, None], (*each.shape, n))
            freedom = np.broadcast_to(all_freedom, n)
        return LinearSolutions(theta, covariance, wrss, freedom, total, finite)

    @cached_property
    def _unit(self) -> tuple[Array, float]:
        """Covariance (S, S) and freedom of curves whose columns are all shared."""
        _, _, along, traces = self.spread
        each = self.inverse @ (along[0] @ along[0].T) @ self.inverse.T
        return each, float(traces[0, 0] - (along[0] ** 2).sum())


def _spans(operators: Array) -> NDArray[np.intp]:
    """First and one past the last entry of every row that is not zero (..., 2)."""
    filled = operators != 0
    return np.stack([np.argmax(filled, axis=-1), filled.shape[-1] - np.argmax(filled[..., ::-1], axis=-1)], axis=-1)
