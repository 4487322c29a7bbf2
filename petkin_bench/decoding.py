"""How predicted states become pictures: by the known drawing, or by a network that sees more or less of them.

* physics: the system's own drawing.
* neural_prior: a network of the positions, which are known to be all that is seen.
* neural: a network of all states.
* adaptive: a network of the positions and c_p.

Reference: arXiv:2403.08194, sections 4.4 and C.6.
"""

from __future__ import annotations

import torch
from torch import Tensor

from petkin.errors import InputError
from petkin.hybrid import Decoder, Task

DECODERS = ("physics", "neural_prior", "neural", "adaptive")


def decoder_of(name: str, task: Task, widths: tuple[int, ...]) -> Decoder | None:
    """The decoder of this name with fresh first weights; None for the system's own drawing.

    Raises:
        InputError: there is none.
    """
    if name not in DECODERS:
        raise InputError(f"There is no decoder {name!r}; choose one of {', '.join(DECODERS)}.")
    if name == "physics":
        return None
    scale = (task.centre.abs() + task.reach).clamp_min(1.0)
    chosen = list(range(len(task.states))) if name == "neural" else _positions(task)
    low, high = torch.tensor(task.parameters.lower), torch.tensor(task.parameters.upper)
    middle, half = (0.5 * (high + low)).float(), (0.5 * (high - low)).float()

    def sees(state: Tensor, forcing: Tensor | None, p: Tensor) -> Tensor:
        look = (state / scale.to(state))[..., chosen]
        return (torch.cat([look, (p - middle.to(p)) / half.to(p)], dim=-1) if name == "adaptive" else look).movedim(
            -1, 0
        )

    inputs = len(chosen) + (len(task.parameters) if name == "adaptive" else 0)
    emission = task.emission
    shape = (emission.channels, emission.size, emission.size)  # type: ignore[attr-defined]
    return Decoder(sees, inputs, shape, widths=widths)


def _positions(task: Task) -> list[int]:
    """States that are not velocities."""
    return [i for i, name in enumerate(task.states) if not (name.endswith("'") or name[0] in "vw")]
