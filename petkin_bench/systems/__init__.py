"""The physics systems of the benchmark; `SYSTEMS` is the list."""

from petkin.errors import InputError
from petkin_bench.systems.bouncing_ball import BOUNCING_BALL
from petkin_bench.systems.double_pendulum import DOUBLE_PENDULUM
from petkin_bench.systems.mass_spring import MASS_SPRING
from petkin_bench.systems.pendulum import PENDULUM
from petkin_bench.systems.physics import DYNAMICS, Physics, draw
from petkin_bench.systems.rigid_body import RIGID_BODY

SYSTEMS = (PENDULUM, MASS_SPRING, BOUNCING_BALL, RIGID_BODY, DOUBLE_PENDULUM)


def find_system(name: str) -> Physics:
    """The system of this name.

    Raises:
        InputError: there is none.
    """
    for system in SYSTEMS:
        if system.name == name:
            return system
    raise InputError(f"There is no system {name!r}; choose one of {', '.join(s.name for s in SYSTEMS)}.")


__all__ = ["DYNAMICS", "SYSTEMS", "Physics", "draw", "find_system"]
