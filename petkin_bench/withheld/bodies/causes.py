"""What is withheld from moving bodies: effects of the catalogues' words, other forms of them, and causes of no name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from petkin_bench.withheld.bodies.rigs import Kit, Rig

#: What is drawn beside a size.
Drawn = Mapping[str, float]


@dataclass(frozen=True)
class Cause:
    """Something that a simulator lacks.

    Args:
        name: in the catalogue's words; "" for none.
        stage: where it acts.
        knob: what of a kit it turns.
        most: the largest size.
        signed: whether it may be negative.
        draw: of everything else that the kit needs.
    """

    name: str
    stage: str
    knob: str
    most: float
    signed: bool = True
    draw: Callable[[np.random.Generator, Rig], Drawn] = lambda rng, rig: {}

    def kit(self, size: float, drawn: Drawn) -> Kit:
        """At a size."""
        return {self.knob: size, **drawn}


def _pitch(rng: np.random.Generator, rig: Rig) -> Drawn:
    fast = 4.0 if rig.turning else 1.0
    return {"pitch": fast * float(np.exp(rng.uniform(np.log(0.8), np.log(5.0))))}


def _late(rng: np.random.Generator, rig: Rig) -> Drawn:
    return {**_pitch(rng, rig), "phase": float(rng.uniform(0.0, 2.0 * np.pi))}


def _square(rng: np.random.Generator, rig: Rig) -> Drawn:
    return {**_pitch(rng, rig), "square": 1.0}


def _moment(rng: np.random.Generator, rig: Rig) -> Drawn:
    return {"moment": float(rng.uniform(0.2, 0.7)) * rig.frames * rig.interval}


def _place(rng: np.random.Generator, rig: Rig) -> Drawn:
    low, high = rig.starts[0]
    wide = 0.15 * (high - low)
    return {"place": float(rng.uniform(low, high)) * 0.4, "wide": wide}


def _always(**what: float) -> Callable[[np.random.Generator, Rig], Drawn]:
    return lambda rng, rig: what


def _moves(name: str, most: float, *, signed: bool = True, **more: Callable[..., Drawn]) -> Cause:
    return Cause(name, "dynamics", name, most, signed, **more)


_CAMERA = (
    Cause("camera_roll", "observation", "camera_roll", 0.3),
    Cause("camera_offset_x", "observation", "camera_offset_x", 0.2),
    Cause("camera_offset_y", "observation", "camera_offset_y", 0.2),
    Cause("camera_scale", "observation", "camera_scale", 0.1),
    Cause("lens_distortion", "observation", "lens_distortion", 0.1),
    Cause("exposure_blur", "observation", "exposure_blur", 1.0, signed=False),
    Cause("frame_rate", "clock", "frame_rate", 0.1),
)
_FRICTION = (
    _moves("damping_linear", 1.0, signed=False),
    _moves("damping_quadratic", 1.0, signed=False),
    _moves("damping_coulomb", 1.0, signed=False),
)
_DRAG = (_moves("drag_linear", 1.0, signed=False), _moves("drag_quadratic", 1.0, signed=False))
#: Effects of the catalogues, by system.
KNOWN: Mapping[str, tuple[Cause, ...]] = {
    "pendulum": (
        *_FRICTION,
        _moves("torque", 1.0),
        _moves("forcing", 1.0, draw=_pitch),
        _moves("gravity_tilt", 0.3),
        _moves("stiffening", 0.2),
        *_CAMERA,
    ),
    "mass_spring": (
        *_FRICTION,
        _moves("spring_cubic", 2.0),
        _moves("rest_length", 0.1),
        _moves("mass_ratio", 0.5),
        _moves("forcing", 2.0, draw=_pitch),
        _moves("gravity_tilt", 0.5),
        *_CAMERA,
    ),
    "bouncing_ball": (
        _moves("gravity_tilt", 0.6),
        _moves("wind", 2.0),
        _moves("drag_linear", 0.5, signed=False),
        _moves("drag_quadratic", 0.2, signed=False),
        _moves("magnus", 0.5),
        _moves("restitution", 0.4, signed=False),
        _moves("wall_friction", 0.4, signed=False),
        *_CAMERA,
    ),
    "double_pendulum": (
        _moves("mass_ratio", 0.5),
        _moves("length_ratio", 0.2),
        *_FRICTION,
        _moves("forcing", 2.0, draw=_pitch),
        _moves("gravity_tilt", 0.3),
        *_CAMERA,
    ),
    "rigid_body": (
        _moves("force_elevation", 10.0),
        _moves("mass_ratio", 0.3),
        _moves("inertia", 0.3),
        _moves("lever", 0.3),
        _moves("gravity", 2.0),
        *_DRAG,
        _moves("spin_damping", 2.0, signed=False),
        _moves("forcing", 1.0, draw=_pitch),
        *_CAMERA,
    ),
}


def _other(name: str, knob: str, most: float, **what: float) -> Cause:
    stage = "observation" if name.startswith(("camera", "lens")) else "dynamics"
    return Cause(name, stage, knob, most, signed=name.startswith("lens"), draw=_always(**what))


_SWINGING = ("pendulum", "mass_spring", "double_pendulum")
_LENSES = {
    "training": _other("lens_distortion", "lens_distortion", 0.1, divided=1.0),
    "scored": _other("lens_distortion", "lens_distortion", 0.1, steeper=1.0),
}
_FRICTIONS = {
    "training": (
        _other("damping_quadratic", "damping_power", 1.0, power=1.8),
        _other("damping_coulomb", "damping_coulomb", 0.8, stiction=0.5),
    ),
    "scored": (
        _other("damping_quadratic", "damping_power", 1.0, power=2.25),
        _other("damping_linear", "damping_power", 1.0, power=1.12),
        _other("damping_coulomb", "damping_coulomb", 1.0, soft=0.08),
    ),
}
_DRAGS = {
    "training": (_other("drag_quadratic", "drag_power", 0.3, power=1.8),),
    "scored": (
        _other("drag_quadratic", "drag_power", 0.3, power=2.25),
        _other("drag_linear", "drag_power", 0.5, power=1.12),
    ),
}
_FORCED = {
    "training": Cause("forcing", "dynamics", "forcing", 1.0, draw=_square),
    "scored": Cause("forcing", "dynamics", "forcing", 1.0, draw=_late),
}
_HARD = {
    "training": _other("restitution", "restitution", 0.4, hard=0.3),
    "scored": _other("restitution", "restitution", 0.4, hard=0.5),
}


def other_forms(split: str, system: str) -> tuple[Cause, ...]:
    """The same effects in another mathematical form."""
    if system == "bouncing_ball":
        return (_LENSES[split], *_DRAGS[split], _HARD[split])
    if system == "rigid_body":
        return (_LENSES[split], *_DRAGS[split], _FORCED[split])
    return (_LENSES[split], *_FRICTIONS[split], _FORCED[split])


_ALIEN = {
    "training": (
        Cause("", "dynamics", "kick", 8.0, draw=_moment),
        Cause("", "dynamics", "swell", 0.6, draw=_pitch),
        Cause("", "observation", "drift", 0.2),
        Cause("", "observation", "keystone", 0.3),
        Cause("", "observation", "slipping", 0.3),
    ),
    "scored": (
        Cause("", "dynamics", "brake", 1.5, signed=False, draw=_moment),
        Cause("", "dynamics", "well", 12.0, draw=_place),
        Cause("", "dynamics", "ramp", 0.8),
        Cause("", "observation", "jump", 0.2, draw=_moment),
        Cause("", "observation", "zoom", 0.2),
        Cause("", "observation", "rolling", 1.0),
    ),
}


#: What a system does not show: nothing of a cube's law swells but its push, which its catalogue has; and masses on a
#: track stay on one line of the picture.
_HIDDEN = {"rigid_body": ("swell", "kick"), "mass_spring": ("keystone", "rolling")}


def unknown(split: str, system: str) -> tuple[Cause, ...]:
    """What no catalogue has."""
    return tuple(c for c in _ALIEN[split] if c.knob not in _HIDDEN.get(system, ()))
