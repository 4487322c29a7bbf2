"""One way to solve a system: Runge-Kutta between the kinks, segment by segment. The only file that knows torchdiffeq.

No step crosses a knot of the forcing or a jump: within every step all is smooth and the methods keep their order. Each
element of a batch is carried to its own hit times by flying dx/ds = D f over s in [0, 1] with a duration D of its own.

Reference: Chen RTQ, Rubanova Y, Bettencourt J, Duvenaud D. Neural ordinary differential equations. NeurIPS 2018.
Dormand JR, Prince PJ. A family of embedded Runge-Kutta formulae. J Comput Appl Math 1980;6:19-26.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import cast

import torch
from jaxtyping import Float
from torch import Tensor

from petkin.dynamics.batch import checked_times, default_start, starting_point
from petkin.dynamics.crossing import leap
from petkin.dynamics.flight import take_off
from petkin.dynamics.forcing import Forcing
from petkin.dynamics.jumps import Hits
from petkin.dynamics.system import System
from petkin.errors import InputError, NumericalError

_MOST_STEPS = 100_000
#: How the assertions begin by which torchdiffeq's adaptive method gives up.
_GIVES_UP = ("underflow in dt", "non-finite values in state", "max_num_steps exceeded")


@dataclass(frozen=True)
class FixedStep:
    """Runge-Kutta of fourth order (3/8 rule) in equal steps between the times asked for and the kinks.

    Args:
        step: longest step.
    """

    step: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.step) and self.step > 0):
            raise InputError(f"The step of the fixed-step method is {self.step:g}; it must be positive and finite.")


@dataclass(frozen=True)
class Adaptive:
    """Dormand-Prince 5(4), each component of each element held to rtol |x| + atol a step.

    Args:
        rtol: relative tolerance.
        atol: absolute tolerance, in the unit of the state.
        step: longest step; with jumps it must be given, and the guards are looked at once a step.
    """

    rtol: float = 1e-8
    atol: float = 1e-10
    step: float = math.inf

    def __post_init__(self) -> None:
        if not (self.rtol > 0 and self.atol > 0 and self.step > 0):
            raise InputError(
                f"The adaptive method has rtol {self.rtol:g}, atol {self.atol:g} and step {self.step:g}; "
                "all of them must be positive."
            )


@dataclass(frozen=True)
class Trajectory:
    """What `solve` returns.

    Args:
        times: the times asked for.
        states: x at these times, after any jump at that moment.
        hits: the jumps on the way.
    """

    times: Float[Tensor, " times"]
    states: Float[Tensor, "*b times d"]
    hits: Hits


def solve(
    system: System,
    times: Float[Tensor, " times"],
    *,
    method: FixedStep | Adaptive = Adaptive(),
    parameters: Float[Tensor, "*#b p"] | None = None,
    initial: Float[Tensor, "*#b d"] | None = None,
    forcing: Forcing | None = None,
    start: float | None = None,
) -> Trajectory:
    """x(t) of dx/dt = f(t, x, u(t), p), x(start) = initial, at the times asked for.

    Differentiable in parameters, initial state and values of the forcing, through jumps and their hit times. Computed
    with the number type and on the device of the initial state; times are kept in double precision.

    Args:
        system: field, jumps, and the default parameters and initial state.
        times: where x is wanted, in any order.
        method: `FixedStep(step)` or `Adaptive(rtol, atol)`.
        parameters: p; its batch, the initial state's and the forcing's are broadcast.
        initial: x(start).
        forcing: u; its batch as well.
        start: time of the initial state; by default 0, or the first knot of a forcing that sets in earlier.

    Returns:
        The trajectory.

    Raises:
        InputError: shapes that do not fit, times before the start, numbers that are not finite.
        NumericalError: a state that leaves the numbers, steps that shrink to nothing, endless hits.
    """
    state, parameters = starting_point(system, parameters, initial, forcing)
    start = default_start(forcing) if start is None else start
    marks, order = torch.unique(checked_times(times, start), return_inverse=True)
    motion = _Motion(system, parameters, forcing, method, window=(start, start))
    _check_motion(motion, state)
    states, hits = (_fly if system.jumps else _glide)(motion, state, marks.tolist())
    return Trajectory(times, torch.stack(states, dim=-2)[..., order.to(state.device), :], hits)


@dataclass(frozen=True)
class _Motion:
    """The smooth motion inside a window between two kinks."""

    system: System
    parameters: Tensor
    forcing: Forcing | None
    method: FixedStep | Adaptive
    window: tuple[float, float]

    @property
    def step(self) -> float:
        return self.method.step

    def rate(self, t: Tensor, state: Tensor) -> Tensor:
        return self.system.field(t.to(state.dtype), state, self._input(t, state), self.parameters)

    def flow(self, state: Tensor, start: Tensor, duration: Tensor) -> Tensor:
        return self.along(state, start, duration, [0.0, 1.0])[-1]

    def along(self, state: Tensor, start: Tensor, duration: Tensor, shares: list[float]) -> Tensor:
        """The states after these shares of the duration, of which the first is 0 and the last 1; stacked in front."""
        scale, latest = duration.to(state.dtype)[..., None], {}

        def scaled(share: Tensor, x: Tensor) -> Tensor:
            latest["time"] = start + share.to(torch.float64) * duration
            latest["rate"] = self.rate(latest["time"], x)
            return scale * latest["rate"]

        nodes = torch.tensor(shares, dtype=torch.float64, device=state.device)
        try:
            return _odeint(scaled, state, nodes, self.method, float(duration.detach().max()))
        except AssertionError as failure:
            if not str(failure).startswith(_GIVES_UP):
                raise
            raise NumericalError(_stuck(self.system.name, latest["time"], latest["rate"])) from failure

    def _input(self, t: Tensor, state: Tensor) -> Tensor | None:
        """u(t) inside the window: a knot at its edge belongs to the neighbour, whose one-sided value may be another."""
        if self.forcing is None:
            return None
        knots, (low, high), batch = torch.as_tensor(self.forcing.knots), self.window, state.shape[:-1]
        margin = 16 * torch.finfo(knots.dtype).eps * max(abs(low), abs(high))
        inside = t.clamp(min=low + margin, max=high - margin).to(knots.dtype)
        values = self.forcing(inside.reshape(-1)).to(state.dtype)
        if t.ndim == 0:
            return values[..., 0].expand(batch)
        if values.ndim == 1:
            return values.reshape(batch)
        each = values.expand(*batch, values.shape[-1]).reshape(t.numel(), t.numel())
        return each.diagonal().reshape(batch)


def _odeint(
    rate: Callable[[Tensor, Tensor], Tensor],
    state: Tensor,
    nodes: Float[Tensor, " nodes"],
    method: FixedStep | Adaptive,
    length: float,
) -> Float[Tensor, "nodes *b d"]:
    from torchdiffeq import odeint  # with scipy.integrate behind it, too slow to load for who only reads a forcing

    if isinstance(method, FixedStep):
        grid = _refined(nodes, method.step / length if length > 0 else 1.0)
        options, tolerances = {"grid_constructor": lambda *_: grid}, {}
    else:
        # The worst component decides, so that an element's accuracy does not depend on its company in the batch.
        options = {"norm": lambda error: error.detach().abs().amax(), "max_num_steps": _MOST_STEPS}
        # Steps end on the nodes: the method would else step over the last one, across the kink, and interpolate back.
        options |= {"step_t": nodes[1:], "max_step": method.step / length if length > 0 else math.inf}
        tolerances = {"rtol": method.rtol, "atol": method.atol}
    name = "rk4" if isinstance(method, FixedStep) else "dopri5"
    return cast(Tensor, odeint(rate, state, nodes, method=name, options=options, **tolerances))


def _refined(nodes: Tensor, step: float) -> Tensor:
    """The nodes with equal steps of at most `step` between them."""
    ends = nodes.tolist()
    grid = [ends[0]]
    for low, high in pairwise(ends):
        count = max(1, math.ceil((high - low) / step * (1 - 1e-9)))
        grid += [low + (high - low) * k / count for k in range(1, count)] + [high]
    return torch.tensor(grid, dtype=nodes.dtype, device=nodes.device)


def _segments(motion: _Motion, end: float) -> list[_Motion]:
    """The motion between each two neighbours among the start, the knots after it, and the end."""
    start = motion.window[0]
    knots = [] if motion.forcing is None else [k for k in motion.forcing.knots.tolist() if start < k < end]
    edges = sorted({start, *knots, end})
    return [replace(motion, window=window) for window in pairwise(edges)]


def _glide(motion: _Motion, state: Tensor, marks: list[float]) -> tuple[list[Tensor], Hits]:
    """The states at the marks of a motion without jumps."""
    states = [state] if marks[0] == motion.window[0] else []
    for segment in _segments(motion, marks[-1]):
        low, high = segment.window
        inner = [t for t in marks if low < t < high]
        shares = [0.0, *[(t - low) / (high - low) for t in inner], 1.0]
        clock = torch.tensor([low, high - low], dtype=torch.float64, device=state.device)
        found = segment.along(state, clock[0], clock[1], shares)
        _refuse_wild(found, [low, *inner, high], motion.system.name)
        state = found[-1]
        states += [*found[1:-1], *([state] if high in marks else [])]
    none = torch.zeros(0, dtype=torch.int64, device=state.device)
    return states, Hits(none.to(torch.float64), none, none)


def _fly(motion: _Motion, state: Tensor, marks: list[float]) -> tuple[list[Tensor], Hits]:
    """The states at the marks of a motion with jumps, and its hits."""
    jumps, rounds = motion.system.jumps, []
    flight = take_off(jumps, motion.parameters, motion.window[0], state)
    states = [state] if marks[0] == motion.window[0] else []
    for segment in _segments(motion, marks[-1]):
        low, high = segment.window
        stops = torch.tensor([low, *[t for t in marks if low < t < high], high], dtype=torch.float64)
        for stop in _refined(stops, motion.step).tolist()[1:]:
            flight, hits = leap(jumps, segment, flight, stop)
            _refuse_wild(flight.state[None], [stop], motion.system.name)
            rounds += hits
            states += [flight.state] if stop in marks else []
    none = torch.zeros(0, dtype=torch.int64, device=state.device)
    rounds.append(Hits(none.to(torch.float64), none, none))
    together = (torch.cat([getattr(r, key) for r in rounds]) for key in ("time", "element", "jump"))
    return states, Hits(*together)


def _check_motion(motion: _Motion, state: Tensor) -> None:
    finest = 4 * torch.finfo(state.dtype).eps
    if isinstance(motion.method, Adaptive) and motion.method.rtol < finest:
        raise InputError(
            f"{motion.system.name}: rtol {motion.method.rtol:g} is finer than {state.dtype} can hold; give at least "
            f"{finest:.1g}, or start from a state in double precision."
        )
    if motion.system.jumps and not math.isfinite(motion.step):
        raise InputError(f"{motion.system.name} jumps: give the method a `step`, at which the guards are looked at.")
    start = torch.tensor(motion.window[0], dtype=torch.float64, device=state.device)
    with torch.no_grad():
        rate, values = (
            motion.rate(start, state),
            [j.guard(start, state, motion.parameters) for j in motion.system.jumps],
        )
    if rate.shape != state.shape:
        raise InputError(
            f"{motion.system.name}: the field returns the shape {tuple(rate.shape)} for a state of shape "
            f"{tuple(state.shape)}; they must be equal."
        )
    for jump, value in zip(motion.system.jumps, values):
        if value.shape != state.shape[:-1]:
            raise InputError(
                f"{motion.system.name}: the guard of {jump.name!r} returns the shape {tuple(value.shape)}; it must "
                f"give one number an element, {tuple(state.shape[:-1])}."
            )


def _refuse_wild(states: Float[Tensor, "nodes *b d"], times: list[float], name: str) -> None:
    wild = ~states.isfinite()
    if bool(wild.any()):
        node, *element = wild.any(dim=-1).nonzero()[0].tolist()
        raise NumericalError(
            f"{name}: the state of element {tuple(element)} is no longer finite at t = {times[node]:g}; take a smaller "
            "step, or check the parameters."
        )


def _stuck(name: str, time: Tensor, rate: Tensor) -> str:
    size = rate.detach().abs().amax(dim=-1).nan_to_num(torch.inf, torch.inf)
    element = tuple(int(i) for i in torch.unravel_index(size.argmax(), size.shape))
    when = float(torch.broadcast_to(time, size.shape)[element])
    return (
        f"{name}: the adaptive method makes no more progress at t = {when:g}, where element {element} moves at "
        f"{float(size[element]):g} a unit of time; loosen rtol and atol, or check the parameters."
    )
