"""Dynamics: what drives a system, how it moves, and exact solutions where there are any."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from petkin.dynamics.exponential import exp_divided_difference
from petkin.dynamics.forcing import ExponentialSum, Forcing, PiecewiseLinear, Shifted
from petkin.dynamics.jumps import Hits, Jump
from petkin.dynamics.parameters import Parameter, ParameterSet
from petkin.dynamics.system import System, VectorField

if TYPE_CHECKING:
    from petkin.dynamics.linear import integrate_linear, solve_linear
    from petkin.dynamics.solver import Adaptive, FixedStep, Trajectory, solve

#: What solves equations of motion loads torch, and is loaded by who asks for it.
_SOLVERS = {
    "Adaptive": "solver",
    "FixedStep": "solver",
    "Trajectory": "solver",
    "integrate_linear": "linear",
    "solve": "solver",
    "solve_linear": "linear",
}


def __getattr__(name: str) -> Any:
    if name not in _SOLVERS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_SOLVERS[name]}"), name)


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
