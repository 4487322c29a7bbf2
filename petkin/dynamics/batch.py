"""What a solution starts from: the batch of initial states, parameters and forcings, checked before anything moves."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from petkin.dynamics.forcing import Forcing
from petkin.dynamics.system import System
from petkin.errors import InputError


def default_start(forcing: Forcing | None) -> float:
    """Time 0, or the first knot of a forcing that sets in earlier."""
    return 0.0 if forcing is None else min(0.0, float(forcing.knots[0]))


def starting_point(
    system: System, parameters: Tensor | None, initial: Tensor | None, forcing: Forcing | None
) -> tuple[Tensor, Tensor]:
    """Initial state [*b, d] and parameters [*b, p] as given or as the system's own, expanded to the whole batch.

    Raises:
        InputError: a wrong number of states or parameters, batches that do not fit, numbers that are not finite.
    """
    like = torch.zeros((), dtype=torch.float64) if parameters is None else parameters
    state = torch.tensor(system.initial, dtype=like.dtype, device=like.device) if initial is None else initial
    parameters = torch.as_tensor(system.parameters.start) if parameters is None else parameters
    parameters = parameters.to(state)
    for what, value, names in (
        ("initial state", state, system.states),
        ("parameters", parameters, system.parameters.symbols),
    ):
        if value.ndim == 0 or value.shape[-1] != len(names):
            raise InputError(
                f"{system.name}: the {what} must end in an axis of {len(names)} ({', '.join(names)}); its shape is "
                f"{tuple(value.shape)}."
            )
        if not bool(value.isfinite().all()):
            raise InputError(f"{system.name}: the {what} hold a number that is not finite; check what they come from.")
    driven = () if forcing is None else forcing(forcing.knots[:1]).shape[:-1]
    shapes = state.shape[:-1], parameters.shape[:-1], driven
    try:
        batch = np.broadcast_shapes(*shapes)
    except ValueError as failure:
        raise InputError(
            f"{system.name}: the batches of initial state {tuple(shapes[0])}, parameters {tuple(shapes[1])} and "
            f"forcing {tuple(driven)} do not fit; give each one entry an element, or none."
        ) from failure
    return state.expand(*batch, -1), parameters.expand(*batch, -1)


def checked_times(times: Float[Tensor, " times"], start: float) -> Float[Tensor, " times"]:
    """The times in double precision on the CPU.

    Raises:
        InputError: none, not a list, not finite, or before the start.
    """
    if times.ndim != 1 or times.numel() == 0 or not bool(times.isfinite().all()):
        raise InputError(
            f"The times of a solution must be a list of finite numbers; their shape is {tuple(times.shape)}."
        )
    if float(times.min()) < start:
        raise InputError(f"A solution is asked for at t = {float(times.min()):g}, before its start at t = {start:g}.")
    return times.detach().to("cpu", torch.float64)
