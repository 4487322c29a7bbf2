"""Numbers that carry their derivatives through plain arithmetic: exact Jacobians of a model's short formulas.

Forward differentiation, sparse: a value knows the derivatives by the arguments that it depends on and no others, so the
first steps of a formula, which see one or two arguments, cost no more than that.

Reference: Griewank A, Walther A. Evaluating derivatives, 2nd ed. SIAM 2008, chapter 3. doi:10.1137/1.9780898717761
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Slopes = dict[int, Any]


@dataclass(frozen=True, slots=True)
class Dual:
    """A value (N,) and its derivatives by argument number; absent ones are zero."""

    value: Any
    slopes: Slopes

    #: Arrays leave arithmetic with a Dual to the Dual.
    __array_ufunc__ = None

    def __add__(self, other: Any) -> Dual:
        if not isinstance(other, Dual):
            return Dual(self.value + other, self.slopes)
        return Dual(self.value + other.value, _sum(self.slopes, other.slopes))

    def __neg__(self) -> Dual:
        return Dual(-self.value, _scaled(self.slopes, -1.0))

    def __sub__(self, other: Any) -> Dual:
        if not isinstance(other, Dual):
            return Dual(self.value - other, self.slopes)
        slopes = dict(self.slopes)
        for p, slope in other.slopes.items():
            slopes[p] = slopes[p] - slope if p in slopes else -slope
        return Dual(self.value - other.value, slopes)

    def __rsub__(self, other: Any) -> Dual:
        return Dual(other - self.value, _scaled(self.slopes, -1.0))

    def __mul__(self, other: Any) -> Dual:
        if not isinstance(other, Dual):
            return Dual(self.value * other, _scaled(self.slopes, other))
        slopes = _sum(_scaled(self.slopes, other.value), _scaled(other.slopes, self.value))
        return Dual(self.value * other.value, slopes)

    def __truediv__(self, other: Any) -> Dual:
        if not isinstance(other, Dual):
            return self * (1.0 / other)
        inverse = 1.0 / other.value
        value = self.value * inverse
        return Dual(value, _sum(_scaled(self.slopes, inverse), _scaled(other.slopes, -value * inverse)))

    def __rtruediv__(self, other: Any) -> Dual:
        value = other / self.value
        return Dual(value, _scaled(self.slopes, -value / self.value))

    def __pow__(self, power: float) -> Dual:
        value = self.value**power
        return Dual(value, _scaled(self.slopes, power * value / self.value))

    __radd__ = __add__
    __rmul__ = __mul__


def partials(function: Callable[..., Any], arguments: list[Array]) -> tuple[Array, Array]:
    """Values (Q, N) and Jacobian (Q, P, N) of a function of P arrays (N,) with Q results, of + - * / and powers."""
    seeds = [Dual(column, {p: 1.0}) for p, column in enumerate(arguments)]
    results = function(*seeds)
    results = results if isinstance(results, tuple) else (results,)
    count = len(arguments[0])
    values = np.empty((len(results), count))
    jacobian = np.zeros((len(results), len(arguments), count))
    for q, result in enumerate(results):
        values[q] = result.value if isinstance(result, Dual) else result
        for p, slope in result.slopes.items() if isinstance(result, Dual) else ():
            jacobian[q, p] = slope
    return values, jacobian


def _scaled(slopes: Slopes, factor: Any) -> Slopes:
    return {p: factor if isinstance(slope, float) and slope == 1.0 else slope * factor for p, slope in slopes.items()}


def _sum(one: Slopes, other: Slopes) -> Slopes:
    total = dict(one)
    for p, slope in other.items():
        total[p] = total[p] + slope if p in total else slope
    return total
