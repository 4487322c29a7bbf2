"""Families of contrasts, and what columns score against them.

    c = E a + N b + noise,    C = cov(N b + noise) = V (x) 1 + N N',    scores E' C^{-1} c

V, the covariance of the rows in every sample, is given: a row's own few samples tell it too roughly.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

Array = NDArray[np.float64]

#: The least whose square is not zero.
_TINY = 1e-150
#: Relative error of a product of two rows.
_ROUNDING = 1e-16
#: Shares of the usual size that are tried.
_SHARES = (0.1, 0.2, 0.4, 0.7, 1.2)


@dataclass(frozen=True)
class Family:
    """Contrasts of one kind.

    Args:
        rows: (J, K).
        white: W of W V W' = 1 (J, J).
        nuisance: whitened columns of what they may hold besides, as large as it may be (n, J K).
        inner: products of these columns (n, n).
    """

    rows: Array
    white: Array
    nuisance: Array
    inner: Array

    @classmethod
    def of(cls, rows: Array, nuisance: Array, noise: Array, least: float) -> Family:
        """A family as it is seen.

        Args:
            rows: (J, K).
            nuisance: columns of what they may hold besides, as large as it may be (n, J, K).
            noise: V, the covariance of their noise (J, J), the same in every sample.
            least: no mixture of rows has noise of a smaller standard deviation.
        """
        size, axes = np.linalg.eigh(noise)
        white = (axes / np.sqrt(np.maximum(size, max(least, _TINY) ** 2))).T
        held = _whitened(white, nuisance)
        return cls(rows, white, held, held @ held.T)

    def with_nuisance(self, times: float) -> Family:
        """The same with so many times as much nuisance."""
        return replace(self, nuisance=times * self.nuisance, inner=times**2 * self.inner)

    def holding(self, further: Array, *, times: float) -> Family:
        """The family holding more besides: so many times as large a share of it as is likeliest.

        Args:
            further: columns of what they may hold besides (n, J, K), of the usual size.
            times: more than 1 where few rows tell the share, or it differs between them.
        """
        rows, more = _whitened(self.white, self.rows[None])[0], _whitened(self.white, further)
        between, inner = self.nuisance @ more.T, more @ more.T
        hidden = _beneath(self._factor, np.column_stack([between, self.nuisance @ rows]))
        beyond = inner - hidden[:, :-1].T @ hidden[:, :-1]
        left = more @ rows - hidden[:, :-1].T @ hidden[:, -1]
        share = times * max(_SHARES, key=lambda share: _gained(share * left, share**2 * beyond))
        both = np.block([[self.inner, share * between], [share * between.T, share**2 * inner]])
        return replace(self, nuisance=np.concatenate([self.nuisance, share * more]), inner=both)

    def scored(self, columns: Array) -> tuple[Array, Array]:
        """E C^{-1} c and E C^{-1} E' of columns E (m, J K)."""
        told = self._told(columns)
        return told[:-1, -1], told[:-1, :-1]

    def scored_over_time(self, places: Array, courses: Array, columns: Array) -> tuple[Array, Array]:
        """The same of places (P, J, K) that follow each of some courses (A, K), place by place, and then of columns.

        V is that of every sample, so that rows of one are multiplied before courses are taken:

            E V^{-1} E' of e_p phi_a and e_q phi_b:   sum_k phi_a(k) phi_b(k) e_p(k)' V^{-1} e_q(k)
        """
        (count, _, samples), each, held = places.shape, len(courses), len(self.nuisance)
        seen, beside = _by_sample(self.white @ places), self._seen(columns)
        gram = (seen @ seen.swapaxes(1, 2)).reshape(samples, count * count)
        both = np.einsum("ak,bk->kab", courses, courses).reshape(samples, each * each)
        inner = (gram.T @ both).reshape(count, count, each, each).swapaxes(1, 2).reshape(count * each, count * each)
        across = np.concatenate([self.nuisance, beside])
        held_by = _by_sample(across.reshape(len(across), -1, samples)) @ seen.swapaxes(1, 2)
        between = np.tensordot(held_by, courses, axes=(0, 1)).reshape(len(across), count * each)
        whole = np.block([[inner, between[held:].T], [between[held:], beside @ beside.T]])
        hidden = np.concatenate([between[:held], self.nuisance @ beside.T], axis=1)
        told = whole - _square(_beneath(self._factor, hidden))
        return told[:-1, -1], told[:-1, :-1]

    def misfit(self, column: Array) -> float:
        """chi2 per degree of freedom that a column (J K) leaves, however large it is.

        (c' C^{-1} c - (e' C^{-1} c)^2 / e' C^{-1} e) / (J K - 1)
        """
        (known, shared), (_, whole) = self._told(column)
        left = whole - shared**2 / known if known > 0 else whole
        return float(left) / max(self.rows.size - 1, 1)

    @cached_property
    def _factor(self) -> Array:
        return _factor(self.inner)

    def _told(self, columns: Array) -> Array:
        """E C^{-1} E' of columns and, after them, of the rows themselves (m + 1, m + 1), by Woodbury's identity:

            E V^{-1} E' - Y' Y,   L Y = N V^{-1} E',   L L' = 1 + N V^{-1} N'

        N has fewer rows than C.

        Reference: Woodbury MA. Inverting modified matrices. Princeton Statistical Research Group memo 42; 1950.
        """
        seen = self._seen(columns)
        return seen @ seen.T - _square(_beneath(self._factor, self.nuisance @ seen.T))

    def _seen(self, columns: Array) -> Array:
        """Columns and, after them, the rows in units in which the noise is white (m + 1, J K)."""
        return _whitened(self.white, np.concatenate([columns.reshape(-1, *self.rows.shape), self.rows[None]]))


def _by_sample(values: Array) -> Array:
    """(n, J, K) as (K, n, J)."""
    return np.ascontiguousarray(values.transpose(2, 0, 1))


def _square(columns: Array) -> Array:
    return np.asarray(columns.T @ columns, np.float64)


def _whitened(white: Array, values: Array) -> Array:
    """Rows (n, J, K) in units in which the noise is white (n, J K)."""
    return np.asarray((white @ values).reshape(len(values), len(white) * values.shape[-1]), np.float64)


def _gained(seen: Array, inner: Array) -> float:
    """Log likelihood of rows that hold M besides, less that of none of it:

        (s' (1 + I)^{-1} s - log |1 + I|) / 2,   s = M C^{-1} c,   I = M C^{-1} M'

    Args:
        seen: s (n,).
        inner: I (n, n).
    """
    factor = _factor(inner)
    square = float((_beneath(factor, seen) ** 2).sum())
    return 0.5 * square - float(np.log(np.diag(factor)).sum())


def _factor(inner: Array) -> Array:
    """L of L L' = 1 + I; so that rounding makes no square negative, 1 is no less than what it rounds I by."""
    least = max(1.0, inner.shape[0] * _ROUNDING * float(np.diag(inner).max(initial=0.0)))
    return np.asarray(np.linalg.cholesky(inner + least * np.eye(len(inner))), np.float64)


def _beneath(factor: Array, columns: Array) -> Array:
    """L^{-1} columns."""
    return np.asarray(solve_triangular(factor, columns, lower=True, check_finite=False), np.float64)


def root(covariance: Array) -> Array:
    """A of A'A = covariance."""
    values, axes = np.linalg.eigh(covariance)
    return np.sqrt(np.maximum(values, 0.0))[:, None] * axes.T
