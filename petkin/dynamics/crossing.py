"""Carrying a batch through its jumps, each element at its own times.

Over one short leg of the motion the guards are looked at on a cubic Hermite interpolant; a sign change is placed by a
safeguarded Newton iteration on the flow itself; one more Newton step, recorded by autograd, gives the hit time its
derivative by the implicit function theorem, and the state its own:

    d tau / d theta = -(dg / d theta at fixed tau) / (dg/dt along the flow),    dx = dx at fixed tau + f d tau.

The rest of the leg is then flown from the reset state, further hits included.

Reference: Hairer E, Norsett SP, Wanner G. Solving Ordinary Differential Equations I, II.6. Springer 1993.
Chen RTQ, Amos B, Nickel M. Learning neural event functions for ordinary differential equations. ICLR 2021.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from petkin.dynamics.flight import Flight, Motion, guard_and_slope, guard_of
from petkin.dynamics.jumps import Hits, Jump
from petkin.errors import NumericalError

#: Looks at the guards in one leg: a dip below zero and back that lasts less than a share 1/_LOOKS may be missed.
_LOOKS = 8
_BISECTIONS = 6
_NEWTON_STEPS = 40
#: More hits in one leg than this are taken for endless ones.
_MOST_HITS = 100


def leap(jumps: tuple[Jump, ...], motion: Motion, flight: Flight, end: float) -> tuple[Flight, list[Hits]]:
    """Carry every element from where it stands to time `end`, through all its jumps.

    Args:
        jumps: J of them.
        motion: the motion between jumps.
        flight: where the batch stands, all elements at one time.
        end: end of the leg, no later than `motion.step` from now.

    Returns:
        The flight at `end`, and the hits of this leg in rounds.

    Raises:
        NumericalError: endless hits, an element that comes to rest on its guard, or a hit that cannot be placed.
    """
    hits: list[Hits] = []
    for _ in range(_MOST_HITS):
        remaining = end - flight.time
        arrival = motion.flow(flight.state, flight.time, remaining)
        elapsed, flight = _first_hits(jumps, motion, flight, remaining.detach(), arrival.detach())
        soonest, which = elapsed.min(dim=0)
        which = torch.where(soonest.isfinite(), which, -1)
        if bool((which < 0).all()):
            still = flight.fresh & (remaining.detach() <= _grain(motion, arrival))
            now = torch.tensor(end, dtype=torch.float64, device=arrival.device)
            return replace(flight, time=now, state=arrival, fresh=still), hits
        flight = _land(jumps, motion, flight, arrival, end, soonest, which)
        struck = (which.reshape(-1) >= 0).nonzero()[:, 0]
        hits.append(Hits(flight.time.reshape(-1)[struck], struck, which.reshape(-1)[struck]))
    element = torch.unravel_index(hits[-1].element[0], flight.state.shape[:-1])
    raise NumericalError(_endless(jumps[int(hits[-1].jump[0])], tuple(int(i) for i in element), end))


def _first_hits(
    jumps: tuple[Jump, ...], motion: Motion, flight: Flight, remaining: Tensor, arrival: Tensor
) -> tuple[Float[Tensor, "J ..."], Flight]:
    """Time to the first hit of every jump, infinite where there is none; and the flight with its guards read."""
    with torch.no_grad():
        arc = _arc(motion, flight, remaining, arrival)
        shares = torch.linspace(0.0, 1.0, _LOOKS + 1, dtype=torch.float64, device=arrival.device)
        looks = [arc.at(share) for share in shares]
        guards = torch.stack(
            [torch.stack([guard_of(jump, *look, motion.parameters) for jump in jumps]) for look in looks]
        )
        scale = torch.maximum(flight.scale, guards.abs().amax(dim=0))
        # An armed guard below zero: another jump at the same moment, or a reset, has carried the state through it.
        through = flight.armed & (guards[0] < 0) & ~flight.fresh
        first = _first_crossing(flight.armed, guards)
        elapsed = torch.where(through & (remaining > 0), 0.0, torch.inf).to(torch.float64)
        for j, jump in enumerate(jumps):
            found = first[j].isfinite() & ~through[j] & (remaining > 0)
            if bool(found.any()):
                past = guards[-1, j] <= 0
                elapsed[j] = torch.where(
                    found, _place(jump, motion, arc, (first[j], found, past), scale[j]), elapsed[j]
                )
        flown = torch.minimum(elapsed.amin(dim=0), remaining)
        seen = torch.stack([share * remaining <= flown for share in shares])
        armed = flight.armed | ((guards > 0) & seen[:, None]).any(dim=0)
    _refuse_endless(jumps, elapsed, arc.start + elapsed - flight.last, _grain(motion, arrival), arc.start)
    return elapsed, replace(flight, armed=armed, scale=scale)


def _first_crossing(armed: Tensor, guards: Float[Tensor, "looks J ..."]) -> Float[Tensor, "J ..."]:
    """The look at which an armed guard is first no longer positive, infinite where there is none."""
    first = torch.full(armed.shape, torch.inf, dtype=torch.float64, device=armed.device)
    for k in range(1, guards.shape[0]):
        first = torch.where(armed & (guards[k] <= 0) & first.isinf(), float(k), first)
        armed = armed | (guards[k] > 0)
    return first


@dataclass(frozen=True)
class _Arc:
    """The cubic Hermite interpolant of a leg."""

    start: Tensor
    duration: Tensor
    states: tuple[Tensor, Tensor]
    rates: tuple[Tensor, Tensor]

    def at(self, share: Tensor) -> tuple[Tensor, Tensor]:
        """Time and state after this share of the leg."""
        (x0, x1), (f0, f1) = self.states, self.rates
        s, h = share.to(x0.dtype)[..., None], self.duration.to(x0.dtype)[..., None]
        along = (1 + 2 * s) * (1 - s) ** 2 * x0 + s**2 * (3 - 2 * s) * x1
        return self.start + share * self.duration, along + s * (1 - s) * h * ((1 - s) * f0 - s * f1)


def _arc(motion: Motion, flight: Flight, remaining: Tensor, arrival: Tensor) -> _Arc:
    start, state = flight.time.detach(), flight.state.detach()
    rates = motion.rate(start, state), motion.rate(start + remaining, arrival)
    return _Arc(start, remaining, (state, arrival), rates)


def _place(
    jump: Jump, motion: Motion, arc: _Arc, crossing: tuple[Tensor, Tensor, Tensor], scale: Tensor
) -> Float[Tensor, "*b"]:
    """Time from the arc's start to the guard's fall: bisection on the interpolant, then Newton on the flow.

    `crossing` is the look of the crossing, where there is one, and whether the guard ends below zero. Where it does
    not, and the flow turns out to graze the guard without reaching it, the answer is infinite.
    """
    first, found, past = crossing
    first = torch.where(found, first, 1.0)
    low, high = (first - 1) / _LOOKS, first / _LOOKS
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        above = guard_of(jump, *arc.at(middle), motion.parameters) > 0
        low, high = torch.where(above, middle, low), torch.where(above, high, middle)
    tau = 0.5 * (low + high) * arc.duration
    low, high = (first - 2).clamp(min=0.0) / _LOOKS * arc.duration, arc.duration.expand(first.shape)
    eps = torch.finfo(scale.dtype).eps
    value = torch.zeros_like(scale)
    for _ in range(_NEWTON_STEPS):
        state = motion.flow(arc.states[0], arc.start, tau)
        value, slope = guard_and_slope(jump, motion, arc.start + tau, state)
        low, high = torch.where(value > 0, tau, low), torch.where(value > 0, high, tau)
        newton = tau - value / torch.where(slope == 0, 1.0, slope)
        inside = (newton >= low) & (newton <= high) & (slope < 0)
        moved = torch.where(inside, newton, 0.5 * (low + high))
        done = (value.abs() <= 2 * eps * scale) | ((moved - tau).abs() <= 4 * eps * arc.duration)
        tau = moved
        if bool((done | ~found).all()):
            break
    missed = found & (value.abs() > 1e4 * eps * scale)
    if bool((missed & past).any()):
        element = tuple((missed & past).nonzero()[0].tolist())
        raise NumericalError(
            f"The hit of {jump.name!r} by element {element} near t = {float((arc.start + tau)[element]):g} cannot be "
            "placed; take a smaller step, or a guard that is continuous there."
        )
    return torch.where(missed, torch.inf, tau)


def _land(
    jumps: tuple[Jump, ...],
    motion: Motion,
    flight: Flight,
    arrival: Float[Tensor, "*b d"],
    end: float,
    soonest: Float[Tensor, "*b"],
    which: Int[Tensor, "*b"],
) -> Flight:
    """Fly to the first hit of each element (to the end of the leg where there is none) and reset."""
    struck = which >= 0
    tau = torch.where(struck, soonest, end - flight.time.detach())
    before = torch.where(struck[..., None], motion.flow(flight.state, flight.time, tau), arrival)
    time = torch.where(struck, flight.time + tau, end)
    time, before = _with_hit_gradient(jumps, motion, time, before, which)
    state = before
    for j, jump in enumerate(jumps):
        reset = jump.reset(time.to(before.dtype), before, motion.parameters)
        state = torch.where((which == j)[..., None], reset, state)
    fresh = flight.fresh & (tau <= _grain(motion, state))
    landed = replace(flight, time=time, state=state, fresh=fresh)
    return _rearmed(jumps, motion, landed, which)


def _with_hit_gradient(
    jumps: tuple[Jump, ...], motion: Motion, time: Tensor, state: Tensor, which: Tensor
) -> tuple[Tensor, Tensor]:
    """The same hit times and states, up to one Newton step, with the derivative of the hit time (see the module)."""
    shift = torch.zeros_like(time)
    for j, jump in enumerate(jumps):
        value = guard_of(jump, time, state, motion.parameters)
        _, slope = guard_and_slope(jump, motion, time.detach(), state.detach())
        # A reset that throws the state through this guard gives a large value: its hit is the other jump's, unmoved.
        small = value.detach().abs() <= slope.abs() * _grain(motion, state)
        use = (which == j) & small & (slope < 0)
        shift = torch.where(use, -value / torch.where(use, slope, 1.0), shift)
    with torch.no_grad():
        rate = motion.rate(time, state)
    return time + shift, state + shift.to(state.dtype)[..., None] * rate


@torch.no_grad()
def _rearmed(jumps: tuple[Jump, ...], motion: Motion, flight: Flight, which: Tensor) -> Flight:
    """The flight after its resets: a guard left at zero is armed if it rises, any other if it is positive."""
    armed, fresh, last = flight.armed.clone(), flight.fresh.clone(), flight.last.clone()
    rounding = 1e3 * torch.finfo(flight.state.dtype).eps * flight.scale
    for j, jump in enumerate(jumps):
        mine = which == j
        value, slope = guard_and_slope(jump, motion, flight.time.detach(), flight.state.detach())
        on_guard = value.abs() <= rounding[j]
        resting = mine & on_guard & (slope.abs() * motion.step <= rounding[j])
        if bool(resting.any()):
            element = tuple(resting.nonzero()[0].tolist())
            when = float(flight.time[element])
            raise NumericalError(
                f"Element {element} comes to rest on the guard of {jump.name!r} at t = {when:g}: "
                "no motion follows; stop before, or let the reset move it off."
            )
        fresh[j] = torch.where(mine, on_guard, fresh[j])
        armed[j] = torch.where(mine, torch.where(on_guard, slope > 0, value > 0), armed[j] | (value > 0))
        last[j] = torch.where(mine, flight.time.detach(), last[j])
    return replace(flight, armed=armed, fresh=fresh, last=last)


def _grain(motion: Motion, state: Tensor) -> float:
    """Two hits of one guard that are closer than this are taken for the end of an endless series."""
    return motion.step * torch.finfo(state.dtype).eps ** (1 / 3)


def _refuse_endless(jumps: tuple[Jump, ...], elapsed: Tensor, since: Tensor, grain: float, start: Tensor) -> None:
    too_soon = elapsed.isfinite() & (since < grain)
    if bool(too_soon.any()):
        j, *element = too_soon.nonzero()[0].tolist()
        when = float(torch.broadcast_to(start, too_soon.shape[1:])[tuple(element)])
        raise NumericalError(_endless(jumps[j], tuple(element), when))


def _endless(jump: Jump, element: object, when: float) -> str:
    return (
        f"Element {element} hits {jump.name!r} again and again near t = {when:g}: the hits pile up without end; "
        "stop before, or let the reset give it rest."
    )
