"""What linear reference methods share: columns of the reference region, the equation's frames, one k2'."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petkin.fitting import Choices, FitResult, Given
from petkin.fitting.integrals import curve_integrals
from petkin.fitting.linear import LinearDesign
from petkin.fitting.reference_tissue import fixed_k2prime, share_k2prime
from petkin.fitting.regression import Regression, weights_and_noise
from petkin.methods.late import Array, Axes, LateEquation, fit_late


@dataclass(frozen=True)
class Terms:
    """What an equation is made of, over K frames.

    Args:
        reference: frame values of C_R (K,), kBq/mL.
        area: frame values of int_0^t C_R (K,), kBq min/mL.
        curve: operator that leaves a curve as it is (K, K).
        integral: operator that makes frame values of int_0^t C from those of C (K, K), min.
        k2prime: shared k2', 1/min; NaN where the method has none.
    """

    reference: Array
    area: Array
    curve: Array
    integral: Array
    k2prime: float

    @property
    def delayed_area(self) -> Array:
        """int_0^t C_R + C_R / k2': what the plasma's area is to the reference region, up to K1' / k2'."""
        return self.area + self.reference / self.k2prime


@dataclass(frozen=True)
class Line:
    """A linear reference method.

    Args:
        label: of the method.
        regression: what the unknowns mean, for a k2'.
        shared: columns that all curves have in common.
        own: operators that make columns of the curve itself.
        response: operator of the side that they add up to.
        axes: of the plot in which it is a line, from its terms.
        one_k2prime: whether it needs the k2' of the reference region.
        holds_early: whether an automatic t* is 0: the equation holds from the start for one tissue compartment.
    """

    label: str
    regression: Callable[[float], Regression]
    shared: Callable[[Terms], tuple[Array, ...]]
    own: Callable[[Terms], tuple[Array, ...]]
    response: Callable[[Terms], Array]
    axes: Callable[[Terms], Axes]
    one_k2prime: bool = False
    holds_early: bool = False


def fit_line(line: Line, curves: NDArray[np.floating], given: Given, choices: Choices, voxels: bool) -> FitResult:
    """Every curve's weighted regression over the frames from t* on.

    Raises:
        InputError: no reference region, or not from injection on; weights that differ between curves; too few frames.
    """
    given.reference_input(line.label)
    shared = share_k2prime(curves, given, choices, voxels) if line.one_k2prime else {}
    k2prime = fixed_k2prime(line.label, choices, shared) if line.one_k2prime else float("nan")
    reference = given.reference_curve(line.label)
    integral, _ = curve_integrals(given.observation)
    terms = Terms(reference.values, integral @ reference.values, np.eye(len(integral)), integral, k2prime)
    equation = LateEquation(line.regression(k2prime), lambda *_: _design(line, terms, given), line.axes(terms))
    t_star = 0.0 if line.holds_early and choices.t_star is None else choices.t_star
    result = fit_late(equation, curves, given, replace(choices, fixed={}, t_star=t_star), voxels)
    fixed = {"k2prime": k2prime} if line.one_k2prime and not shared else {}
    settings = {key: value for key, value in result.settings.items() if key != "vB"}
    return replace(result, shared=shared, settings={**settings, "reference": reference.name, "fixed": fixed})


def _design(line: Line, terms: Terms, given: Given) -> LinearDesign:
    own, count = line.own(terms), len(terms.reference)
    operators = np.stack(own) if own else np.empty((0, count, count))
    weights = weights_and_noise(given.weights, line.label)
    return LinearDesign(np.stack(line.shared(terms)), operators, line.response(terms), *weights, np.zeros(count))
