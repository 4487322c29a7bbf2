"""Dynamics: what drives a system, how it moves, and exact solutions where there are any."""

from petkin.dynamics.exponential import exp_divided_difference
from petkin.dynamics.forcing import ExponentialSum, Forcing, PiecewiseLinear, Shifted
from petkin.dynamics.jumps import Hits, Jump
from petkin.dynamics.linear import integrate_linear, solve_linear
from petkin.dynamics.parameters import Parameter, ParameterSet
from petkin.dynamics.solve import Adaptive, FixedStep, Trajectory, solve
from petkin.dynamics.system import System, VectorField

__all__ = [
    "Adaptive",
    "ExponentialSum",
    "FixedStep",
    "Forcing",
    "Hits",
    "Jump",
    "Parameter",
    "ParameterSet",
    "PiecewiseLinear",
    "Shifted",
    "System",
    "Trajectory",
    "VectorField",
    "exp_divided_difference",
    "integrate_linear",
    "solve",
    "solve_linear",
]
