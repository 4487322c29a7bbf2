"""Every way of fitting that petkin offers, by the label that users and files know it by; `METHODS` is the list."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.fitting.graphical import GraphicalSettings, fit_logan, fit_patlak
from petkin.fitting.nonlinear import FASTEST_RATE, SLOWEST_RATE, NonlinearSettings, fit_curves
from petkin.fitting.results import FitResult
from petkin.fitting.search import REGIONS, VOXELS
from petkin.imaging import FrameObservation
from petkin.inputs.input_function import InputFunction
from petkin.kinetics import MODELS, CompartmentModel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Choices:
    """What a user may choose, whatever the method; a method takes what concerns it.

    Args:
        bounds: lowest and highest value by symbol.
        fixed: values held, by symbol.
        rate_bounds: interval of the exponentials' rates, 1/min.
        t_star: start of the linear part of a graphical method, min.
    """

    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    fixed: Mapping[str, float] = field(default_factory=dict)
    rate_bounds: tuple[float, float] = (SLOWEST_RATE, FASTEST_RATE)
    t_star: float = 30.0


@dataclass(frozen=True)
class Method:
    """One method.

    Args:
        label: BEP023 model label.
        fit: curves (N, K), input, observation, weights, choices, whether they are voxels -> result.
        symbols: parameters that `Choices` may bound or fix.
        outcome: the quantity it is used for, VT or Ki.
        equation: its equation as text.
        reference: where it comes from.
        comparable: whether its AICc is over frame values and may be compared with another's.
    """

    label: str
    fit: Callable[[NDArray[np.floating], InputFunction, FrameObservation, Array, Choices, bool], FitResult]
    symbols: tuple[str, ...]
    outcome: str
    equation: str
    reference: str
    comparable: bool


def _compartments(model: CompartmentModel) -> Method:
    def fit(
        curves: NDArray[np.floating],
        arterial: InputFunction,
        observation: FrameObservation,
        weights: Array,
        choices: Choices,
        voxels: bool,
    ) -> FitResult:
        mine = model.parameters.symbols
        box = model.parameters.with_bounds({s: b for s, b in choices.bounds.items() if s in mine})
        box = box.with_fixed({s: v for s, v in choices.fixed.items() if s in mine})
        settings = NonlinearSettings(
            model,
            parameters=box,
            rate_bounds=choices.rate_bounds,
            effort=VOXELS if voxels else REGIONS,
            keep_predicted=not voxels,
        )
        return fit_curves(curves, arterial, observation, weights, settings)

    outcome = model.macros[0].symbol
    return Method(model.label, fit, model.parameters.symbols, outcome, model.equation, model.reference, True)


def _graphical(label: str, plot: Callable[..., FitResult], outcome: str, equation: str, reference: str) -> Method:
    def fit(
        curves: NDArray[np.floating],
        arterial: InputFunction,
        observation: FrameObservation,
        weights: Array,
        choices: Choices,
        voxels: bool,
    ) -> FitResult:
        settings = GraphicalSettings(choices.t_star, choices.fixed.get("vB", 0.0), keep_predicted=not voxels)
        return plot(curves, arterial, observation, weights, settings)

    return Method(label, fit, ("vB",), outcome, equation, reference, False)


METHODS = (
    *(_compartments(model) for model in MODELS),
    _graphical(
        "Patlak",
        fit_patlak,
        "Ki",
        "C_T(t) = Ki int_0^t C_P ds + V0 C_P(t), t > t*",
        "Patlak CS et al. J Cereb Blood Flow Metab 1983;3:1-7, doi:10.1038/jcbfm.1983.1",
    ),
    _graphical(
        "Logan",
        fit_logan,
        "VT",
        "int_0^t C_T ds / C_T(t) = VT int_0^t C_P ds / C_T(t) + b, t > t*",
        "Logan J et al. J Cereb Blood Flow Metab 1990;10:740-747, doi:10.1038/jcbfm.1990.127",
    ),
)


def find_method(label: str) -> Method:
    """The method with this label.

    Raises:
        InputError: there is none.
    """
    for method in METHODS:
        if method.label.lower() == label.lower():
            return method
    raise InputError(f"There is no model {label!r}; choose from {', '.join(m.label for m in METHODS)}.")


def check_choices(methods: tuple[Method, ...], choices: Choices) -> None:
    """Refuse bounds or fixed values that no chosen method has, and bounds that are upside down.

    Raises:
        InputError: with the symbol and what there is instead.
    """
    known = dict.fromkeys(symbol for method in methods for symbol in method.symbols)
    for symbol in (*choices.bounds, *choices.fixed):
        if symbol not in known:
            labels = ", ".join(method.label for method in methods)
            raise InputError(f"{symbol!r} is no parameter of {labels}; these have {', '.join(known)}.")
    for symbol, (low, high) in choices.bounds.items():
        if not 0 <= low < high:
            raise InputError(f"Bounds of {symbol} are {low:g} to {high:g}; the lower must be >= 0 and below the upper.")
    for symbol, value in choices.fixed.items():
        if not (np.isfinite(value) and value >= 0 and (symbol != "vB" or value < 1)):
            raise InputError(f"{symbol} cannot be fixed at {value:g}; give a value >= 0 (below 1 for vB).")
    slow, fast = choices.rate_bounds
    if not 0 <= slow < fast:
        raise InputError(f"Rates from {slow:g} to {fast:g} per min are no interval; give e.g. 0.001:5.")


def with_delay(result: FitResult, delay: float, se: float) -> FitResult:
    """The result with the delay that its input was given."""
    return replace(result, delay=delay, delay_se=se)
