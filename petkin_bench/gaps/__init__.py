"""Gaps of moving bodies: `BODIES` is the list of systems that `petkin-bench diagnose` knows."""

from petkin.errors import InputError
from petkin_bench.gaps.bouncing_ball import BOUNCING_BALL
from petkin_bench.gaps.double_pendulum import DOUBLE_PENDULUM
from petkin_bench.gaps.mass_spring import MASS_SPRING
from petkin_bench.gaps.moving import Body, MovingBodies
from petkin_bench.gaps.pendulum import PENDULUM
from petkin_bench.gaps.rigid_body import RIGID_BODY

BODIES = (PENDULUM, MASS_SPRING, BOUNCING_BALL, DOUBLE_PENDULUM, RIGID_BODY)


def find_body(name: str) -> Body:
    """The system of this name.

    Raises:
        InputError: there is none.
    """
    for body in BODIES:
        if body.name == name:
            return body
    raise InputError(f"There is no moving body {name!r}; choose one of {', '.join(b.name for b in BODIES)}.")


__all__ = ["BODIES", "Body", "MovingBodies", "find_body"]
