"""Five systems of the generator's own: many runs at once, by another solver than the product's, in other coordinates.

A kit names what is changed about a system and by how much; what it does not name is as the product's simulator has it.
Smooth motion is solved by Adams and backward differences (LSODA), a ball between walls by short steps and exact hits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from petkin_bench.withheld.bodies.camera import pictured

Array = NDArray[np.float64]
#: What is changed, by name.
Kit = Mapping[str, float]
#: (time, places, speeds, parameters, kit) -> accelerations; all but the first and the last (B, n).
Pull = Callable[[float, Array, Array, Array, Kit], Array]

_RTOL, _ATOL, _SHORT = 1e-8, 1e-9, 2.5e-3
#: Speed at which dry friction has seven tenths of its size.
_SLOW = 0.01


@dataclass(frozen=True)
class Rig:
    """A system.

    Args:
        name: as the product calls it.
        starts: least and most of every coordinate and speed at the start.
        parameters: least and most of every parameter of the law.
        pull: the law.
        picture: places (..., n) -> points (..., P, 2) in units of the picture's half.
        interval: between frames, s.
        frames: how many.
        wall: where a ball turns round; 0 for none.
        turning: whether the last three places are a rotation, which is kept as a quaternion.
    """

    name: str
    starts: tuple[tuple[float, float], ...]
    parameters: tuple[tuple[float, float], ...]
    pull: Pull
    picture: Callable[[Array], Array]
    interval: float
    frames: int
    wall: float = 0.0
    turning: bool = False

    @property
    def half(self) -> int:
        return len(self.starts) // 2

    def drawn(self, rng: np.random.Generator, runs: int) -> tuple[Array, Array]:
        """Starts (runs, n) and the law's parameters (m,)."""
        low, high = np.array(self.starts).T
        least, most = np.array(self.parameters).T
        return rng.uniform(low, high, (runs, len(low))), rng.uniform(least, most)

    def seen(self, starts: Array, parameters: Array, kit: Kit) -> Array:
        """Points (B, T, P, 2) in pictures, of starts (B, n) and parameters (B, m)."""
        return pictured(self, lambda times: self.places(starts, parameters, kit, times), kit)

    def places(self, starts: Array, parameters: Array, kit: Kit, times: Array) -> Array:
        """Places (B, times, n) at ascending times."""
        if self.wall:
            return _between_walls(self, starts, parameters, kit, times)
        half, count = self.half, len(starts)
        q = _as_quaternions(starts[:, :half]) if self.turning else starts[:, :half]
        width = q.shape[1]

        def rate(t: float, flat: Array) -> Array:
            state = flat.reshape(count, -1)
            places, speeds = state[:, :width], state[:, width:]
            faster = self.pull(t, places, speeds, parameters, kit) + more(t, places, speeds, kit, half)
            moved = speeds
            if self.turning:
                moved = np.concatenate([speeds[:, :3], _spun(places[:, 3:], speeds[:, 3:])], axis=1)
            return np.concatenate([moved, faster], axis=1).ravel()

        begin = np.concatenate([q, starts[:, half:]], axis=1).ravel()
        span = (0.0, float(times[-1]) + 1e-6)
        found = solve_ivp(rate, span, begin, "LSODA", times, rtol=_RTOL, atol=_ATOL, max_step=self.interval)
        return np.moveaxis(found.y.reshape(count, -1, len(times))[:, :width], 1, 2)


def more(t: float, q: Array, v: Array, kit: Kit, half: int) -> Array:
    """Accelerations (B, n) that no catalogue has: a kick, a brake that sets in, a place that attracts, a slow push."""
    found = np.zeros_like(v)
    if "kick" in kit:
        since = (t - kit["moment"]) / 0.05
        found[:, 0] += kit["kick"] * np.exp(-0.5 * since**2)
    if "brake" in kit:
        found -= kit["brake"] * v / (1.0 + np.exp((kit["moment"] - t) / 0.02))
    if "well" in kit:
        away = q[:, 0] - kit["place"]
        found[:, 0] -= kit["well"] * away * np.exp(-0.5 * (away / kit["wide"]) ** 2)
    if "ramp" in kit:
        found[:, 0] += kit["ramp"] * t
    return found


def friction(v: Array, kit: Kit) -> Array:
    """Deceleration by friction of every form."""
    found = kit.get("damping_linear", 0.0) * v + kit.get("damping_quadratic", 0.0) * np.abs(v) * v
    dry = kit.get("damping_coulomb", 0.0)
    if dry:
        soft = kit.get("soft", _SLOW)
        found = found + dry * v / np.sqrt(v**2 + soft**2) * (1.0 + kit.get("stiction", 0.0) * np.exp(-np.abs(v) / 0.3))
    if "damping_power" in kit:
        found = found + kit["damping_power"] * np.sign(v) * np.abs(v) ** kit["power"]
    return found


def beat(t: float, kit: Kit) -> float:
    """A periodic push of unit size: a sine, or a wave with corners."""
    phase = kit.get("pitch", 1.0) * t + kit.get("phase", 0.0)
    wave = np.sin(phase)
    return float(np.tanh(6.0 * wave) if kit.get("square", 0.0) else wave)


def _pendulum(t: float, q: Array, v: Array, p: Array, kit: Kit) -> Array:
    swell = 1.0 + kit.get("swell", 0.0) * np.sin(kit.get("pitch", 1.0) * t)
    back = swell * p[:, :1] / 2.0 * np.sin(q - kit.get("gravity_tilt", 0.0))
    back = back * (1.0 + kit.get("stiffening", 0.0) * q**2)
    return kit.get("torque", 0.0) + kit.get("forcing", 0.0) * beat(t, kit) - back - friction(v, kit)


def _hanging(q: Array) -> Array:
    return 0.66 * np.stack([np.sin(q), np.cos(q)], axis=-1)


def _spring(t: float, q: Array, v: Array, p: Array, kit: Kit) -> Array:
    """Two masses, the first place is where their middle is, the second how far they are apart."""
    apart = np.abs(q[:, 1])
    longer = apart - 6.0 * (1.0 + kit.get("rest_length", 0.0))
    swell = 1.0 + kit.get("swell", 0.0) * np.sin(kit.get("pitch", 1.0) * t)
    tension = swell * p[:, 0] * longer + kit.get("spring_cubic", 0.0) * longer**3
    on_first = -np.sign(q[:, 1]) * tension - friction(v[:, 1], kit)
    on_second = -on_first / (1.0 + kit.get("mass_ratio", 0.0))
    on_first = on_first + kit.get("forcing", 0.0) * beat(t, kit)
    tilt = kit.get("gravity_tilt", 0.0)
    return np.stack([0.5 * (on_first + on_second) + tilt, on_first - on_second], axis=1)


def _on_track(q: Array) -> Array:
    middle, apart = q[..., 0], q[..., 1]
    first, second = (middle + 0.5 * apart) / 6.0, (middle - 0.5 * apart) / 6.0
    return np.stack([np.stack([x, np.zeros_like(x)], axis=-1) for x in (first, second)], axis=-2)


def _two_arms(t: float, q: Array, v: Array, p: Array, kit: Kit) -> Array:
    """Lagrange's equations with the mass matrix as it stands."""
    heavy, lower = 1.0 + kit.get("mass_ratio", 0.0), 1.0 + kit.get("length_ratio", 0.0)
    swell = 1.0 + kit.get("swell", 0.0) * np.sin(kit.get("pitch", 1.0) * t)
    g = swell * p[:, 0] / 1.5
    tilt, between = kit.get("gravity_tilt", 0.0), q[:, 0] - q[:, 1]
    at_joint, at_top = friction(v[:, 1] - v[:, 0], kit), friction(v[:, 0], kit)
    mass = np.empty((len(q), 2, 2))
    mass[:, 0, 0], mass[:, 1, 1] = heavy + 1.0, lower**2
    mass[:, 0, 1] = mass[:, 1, 0] = lower * np.cos(between)
    force = np.stack(
        [
            -lower * np.sin(between) * v[:, 1] ** 2 - (heavy + 1.0) * g * np.sin(q[:, 0] - tilt) - at_top + at_joint,
            lower * (np.sin(between) * v[:, 0] ** 2 - g * np.sin(q[:, 1] - tilt) - at_joint),
        ],
        axis=1,
    )
    force[:, 0] += kit.get("forcing", 0.0) * beat(t, kit)
    return np.asarray(np.linalg.solve(mass, force[..., None])[..., 0], np.float64)


def _chained(q: Array) -> Array:
    arms = 0.43 * np.stack([np.sin(q), np.cos(q)], axis=-1)
    return np.stack([arms[..., 0, :], arms[..., 0, :] + arms[..., 1, :]], axis=-2)


def _flying(t: float, q: Array, v: Array, p: Array, kit: Kit) -> Array:
    fast = np.hypot(v[:, 0], v[:, 1])[:, None]
    slowed = kit.get("drag_linear", 0.0) + kit.get("drag_quadratic", 0.0) * fast
    if "drag_power" in kit:
        slowed = slowed + kit["drag_power"] * np.maximum(fast, 1e-9) ** (kit["power"] - 1.0)
    spin, tilt = kit.get("magnus", 0.0), kit.get("gravity_tilt", 0.0)
    swell = 1.0 + kit.get("swell", 0.0) * np.sin(kit.get("pitch", 1.0) * t)
    found = -slowed * v + spin * np.stack([-v[:, 1], v[:, 0]], axis=1)
    g = swell * p[:, 0]
    found[:, 0] += g * np.sin(tilt) + kit.get("wind", 0.0)
    found[:, 1] -= g * np.cos(tilt)
    return found


def _between_walls(rig: Rig, starts: Array, parameters: Array, kit: Kit, times: Array) -> Array:
    """Midpoint steps; who passes a wall goes back to the hit, turns round and flies on for the rest."""
    half, found, now = rig.half, [], 0.0
    q, v = starts[:, :half].copy(), starts[:, half:].copy()

    def faster(t: float, q: Array, v: Array) -> Array:
        return rig.pull(t, q, v, parameters, kit) + more(t, q, v, kit, half)

    for goal in map(float, times):
        steps = max(int(np.ceil((goal - now) / _SHORT)), 1) if goal > now else 0
        for left in range(steps, 0, -1):
            h = (goal - now) / left
            q, v = _stepped(faster, rig.wall, kit, now, h, q, v)
            now = now + h
        now = goal
        found.append(q)
    return np.stack(found, axis=1)


def _stepped(
    faster: Callable[[float, Array, Array], Array], wall: float, kit: Kit, now: float, h: float, q: Array, v: Array
) -> tuple[Array, Array]:
    """Places and speeds a step later."""
    a = faster(now, q, v)
    mid = faster(now + h / 2, q + h / 2 * v, v + h / 2 * a)
    q, v = q + h * v + 0.5 * h**2 * a, v + h * mid
    past = np.abs(q) - wall
    hit = (past > 0) & (q * v > 0)
    if not hit.any():
        return q, v
    each = np.where(hit, past / np.maximum(np.abs(v), 1e-9), 0.0)
    since = each.max(axis=1, keepdims=True)
    at, then = q - v * since + 0.5 * a * since**2, v - a * since
    at = np.where(hit, np.sign(q) * wall, at)
    then = np.where(hit, -_kept(np.abs(then), kit) * then, then)
    then = then * np.where(hit[:, ::-1], 1.0 - kit.get("wall_friction", 0.0), 1.0)
    after = faster(now, at, then)
    return at + then * since + 0.5 * after * since**2, then + after * since


def _kept(speed: Array, kit: Kit) -> Array:
    """Share of its speed that a ball keeps at a wall; where `hard` is given, less of a fast one."""
    lost = kit.get("restitution", 0.0)
    return 1.0 - np.minimum(lost * (speed / 3.0) ** kit.get("hard", 0.0), 0.95)


def _tossed(t: float, q: Array, v: Array, p: Array, kit: Kit) -> Array:
    """A cube of mass 8 and side 2, pushed at the corner (1, 1, 1) / sqrt 3 of its body."""
    swell = 1.0 + kit.get("forcing", 0.0) * beat(t, kit)
    force = swell * np.stack([p[:, 0], p[:, 1], np.full(len(p), kit.get("force_elevation", 0.0))], axis=1)
    arm = (1.0 + kit.get("lever", 0.0)) * turned(q[:, 3:], np.full(3, 3.0**-0.5))
    slow, spin = v[:, :3], v[:, 3:]
    speed = np.linalg.norm(slow, axis=1, keepdims=True)
    drag = kit.get("drag_linear", 0.0) + kit.get("drag_quadratic", 0.0) * speed
    if "drag_power" in kit:
        drag = drag + kit["drag_power"] * np.maximum(speed, 1e-9) ** (kit["power"] - 1.0)
    faster = force / (8.0 * (1.0 + kit.get("mass_ratio", 0.0))) - drag * slow
    faster[:, 2] -= kit.get("gravity", 0.0)
    torque = np.cross(arm, force) * 3.0 / 16.0 / (1.0 + kit.get("inertia", 0.0))
    return np.concatenate([faster, torque - kit.get("spin_damping", 0.0) * spin], axis=1)


def turned(u: Array, r: Array) -> Array:
    """A vector r (3,) turned by unit quaternions u (..., 4), the real part first."""
    w, axis = u[..., :1], u[..., 1:]
    once = np.cross(axis, r)
    return r + 2.0 * (w * once + np.cross(axis, once))


def _spun(u: Array, spin: Array) -> Array:
    """Rates of places' quaternions (B, 4) at a spin about the world's axes: u' = (0, spin) u / 2."""
    w, axis = u[:, :1], u[:, 1:]
    return 0.5 * np.concatenate([-(spin * axis).sum(1, keepdims=True), w * spin + np.cross(spin, axis)], axis=1)


def _as_quaternions(places: Array) -> Array:
    """Places with rotation vectors (B, 6) with quaternions in their stead (B, 7)."""
    angle = np.linalg.norm(places[:, 3:], axis=1, keepdims=True)
    axis = places[:, 3:] * 0.5 * np.sinc(angle / (2.0 * np.pi))
    return np.concatenate([places[:, :3], np.cos(angle / 2.0), axis], axis=1)


def _from_above(q: Array) -> Array:
    """Four corners as a camera 8 away sees them that looks down at 30 degrees."""
    signs = ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))
    corners = np.stack([q[..., :3] + turned(q[..., 3:], np.array(s) / np.sqrt(3.0)) for s in signs], axis=-2)
    tip = np.deg2rad(30.0)
    up = np.sin(tip) * corners[..., 1] + np.cos(tip) * corners[..., 2]
    far = 8.0 + np.cos(tip) * corners[..., 1] - np.sin(tip) * corners[..., 2]
    return np.stack([corners[..., 0], up], axis=-1) * (8.0 / far / 2.6)[..., None]


_SWING = (-1.2, 1.2)
RIGS: Mapping[str, Rig] = {
    "pendulum": Rig("pendulum", ((-1.4, 1.4), (-2.0, 2.0)), ((6.0, 14.0),), _pendulum, _hanging, 0.1, 50),
    "mass_spring": Rig(
        "mass_spring",
        ((-0.8, 0.8), (-8.0, -4.5), (-0.4, 0.4), (-1.0, 1.0)),
        ((6.0, 14.0),),
        _spring,
        _on_track,
        0.1,
        50,
    ),
    "bouncing_ball": Rig(
        "bouncing_ball",
        ((-4.0, 4.0), (-2.0, 4.0), (-3.0, 3.0), (-3.0, 3.0)),
        ((1.5, 5.0),),
        _flying,
        lambda q: q[..., None, :] / 6.0,
        0.05,
        50,
        wall=5.0,
    ),
    "double_pendulum": Rig(
        "double_pendulum", (_SWING, _SWING, (-1.0, 1.0), (-1.0, 1.0)), ((6.0, 14.0),), _two_arms, _chained, 0.1, 40
    ),
    "rigid_body": Rig(
        "rigid_body",
        ((-0.8, 0.8), (-0.8, 0.8), (-0.3, 0.3), *[(-0.5, 0.5)] * 6, *[(-1.0, 1.0)] * 3),
        ((-10.0, 10.0), (-10.0, 10.0)),
        _tossed,
        _from_above,
        1.0 / 30.0,
        45,
        turning=True,
    ),
}
