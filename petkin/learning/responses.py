"""What linear tissue answers to known inputs, tabulated over rates once and read in training at the cost of a look-up.

The response of a rate a to an input u_j is y_j(t; a) = int_0^t e^{-a (t - s)} u_j(s) ds. It is smooth in a, also where
a meets a pole of the input, so cubic Hermite pieces over a grid in sqrt(a), with values and slopes from the closed
forms of `petkin.dynamics`, hold it to single precision. A plasma curve is a sum sum_j g_j u_j, for a family of
formulas by its coefficients, for measured curves by which of them it is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from petkin.dynamics import Forcing
from petkin.imaging import FrameObservation

#: Pieces over the rates. Errors stay below 1e-6 of the highest response for scans of hours.
_PIECES = 256


@dataclass(frozen=True)
class Known:
    """An input that is known, and the frames under which it was scanned.

    Args:
        plasma: C_P, kBq/mL.
        blood: whole blood, kBq/mL.
        observation: the frames.
    """

    plasma: Forcing
    blood: Forcing
    observation: FrameObservation


@dataclass(frozen=True)
class Responses:
    """Responses to J inputs at nodes, at frame ends, and over frames.

    Args:
        highest: largest rate, 1/min.
        table: values and slopes in r = sqrt(a) at both ends of every piece [pieces, 4 J, columns].
        parts: how many columns are nodes, frame ends and frames.
        plasma: u_j at the nodes [J, nodes], kBq/mL.
        blood: what the frames report of whole blood [J, frames], kBq/mL.
    """

    highest: float
    table: Float[Tensor, "n four_J c"]
    parts: tuple[int, int, int]
    plasma: Float[Tensor, "J nodes"]
    blood: Float[Tensor, "J frames"]

    @classmethod
    def of(cls, known: Sequence[Known], nodes: Float[Tensor, " nodes"], *, highest: float) -> Responses:
        """Tabulate inputs.

        Args:
            known: u_j, with as many frames each.
            nodes: times, min.
            highest: largest rate that will be asked for, 1/min.
        """
        roots = torch.linspace(0.0, highest**0.5, _PIECES + 1, dtype=torch.float64)
        knots = torch.stack([_with_slopes(_columns(one, nodes), roots) for one in known], dim=2)
        table = torch.cat([knots[:-1], knots[1:]], dim=1).flatten(1, 2)
        frames = len(known[0].observation.frames)
        return cls(
            highest,
            table.float(),
            (len(nodes), frames, frames),
            torch.stack([one.plasma(nodes) for one in known]).float(),
            torch.stack([torch.as_tensor(one.observation.of_forcing(one.blood)) for one in known]).float(),
        )

    def __call__(
        self, rates: Float[Tensor, "*b m"], amounts: Float[Tensor, "*b J"]
    ) -> tuple[Float[Tensor, "*b m nodes"], Float[Tensor, "*b m frames"], Float[Tensor, "*b m frames"]]:
        """Responses at nodes, at frame ends and over frames to sum_j g_j u_j; differentiable in the rates."""
        pieces = len(self.table)
        place = torch.sqrt(rates.clamp_min(1e-12) / self.highest) * pieces
        piece = place.detach().floor().clamp(0, pieces - 1)
        s, width = place - piece, self.highest**0.5 / pieces
        back = 1.0 - s
        cubics = torch.stack(
            [(1 + 2 * s) * back * back, width * s * back * back, s * s * (3 - 2 * s), -width * s * s * back], dim=-1
        )
        weights = (cubics[..., None] * amounts[..., None, None, :]).flatten(-2)
        values = (weights[..., None, :] @ self.table[piece.long()])[..., 0, :]
        return tuple(values.split(self.parts, dim=-1))  # type: ignore[return-value]


def _columns(known: Known, nodes: Tensor) -> Callable[[Tensor], Tensor]:
    times = torch.cat([nodes, torch.tensor(known.observation.frames.end)])
    unique, place = torch.unique(times, return_inverse=True)

    def responses(rates: Tensor) -> Tensor:
        over_frames = known.observation.of_response(known.plasma, rates)
        return torch.cat([known.plasma.response(rates, unique)[..., place], over_frames], dim=-1)

    return responses


def _with_slopes(columns: Callable[[Tensor], Tensor], roots: Tensor) -> Float[Tensor, "n 2 c"]:
    """Values at a = r^2 and their derivatives in r."""
    found = torch.func.jvp(lambda r: columns(r * r), (roots,), (torch.ones_like(roots),))
    return torch.stack(found[:2], dim=1)
