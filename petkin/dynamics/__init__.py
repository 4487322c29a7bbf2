"""Dynamics: what drives a system, how it moves, and exact solutions where there are any."""

from petkin.dynamics.exponential import exp_divided_difference
from petkin.dynamics.forcing import ExponentialSum, Forcing, PiecewiseLinear, Shifted
from petkin.dynamics.parameters import Parameter, ParameterSet

__all__ = [
    "ExponentialSum",
    "Forcing",
    "Parameter",
    "ParameterSet",
    "PiecewiseLinear",
    "Shifted",
    "exp_divided_difference",
]
