"""Where a residual is evaluated, and how its curve is read at frame ends and over frames.

Between nodes the residual's part R of a curve is a cubic with the values and slopes at both; its decay-weighted frame
means and its values at frame ends are then linear in those, by matrices that are made once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray
from torch import Tensor

from petkin.imaging import FrameObservation

#: Steps: the first (min), the share of the time that has passed, the longest (min).
_FIRST, _SHARE, _LONGEST = 0.25, 1 / 6, 2.0
_GAUSS = 6


def nodes_until(end: float) -> NDArray[np.float64]:
    """Times from 0 to `end` (min), dense where curves bend."""
    times = [0.0]
    while times[-1] < end:
        times.append(times[-1] + min(max(_SHARE * times[-1], _FIRST), _LONGEST))
    return np.array(times) * (end / times[-1])


@dataclass(frozen=True)
class Grid:
    """Nodes and what frames see between them.

    Args:
        nodes: min (N,).
        at_ends: values at frame ends from values and slopes at the nodes [scans, frames, 2 N]; one for all, or one for
            each known input.
        over_frames: frame values from the same.
    """

    nodes: Float[Tensor, " N"]
    at_ends: Float[Tensor, "scans frames twice"]
    over_frames: Float[Tensor, "scans frames twice"]

    @classmethod
    def of(cls, observations: Sequence[FrameObservation]) -> Grid:
        """For schedules with as many frames each."""
        nodes = nodes_until(max(float(seen.frames.end[-1]) for seen in observations))
        ends = [_hermite(nodes, seen.frames.end) for seen in observations]
        over = [_over_frames(nodes, seen) for seen in observations]
        return cls(torch.tensor(nodes), _single(np.stack(ends)), _single(np.stack(over)))

    @property
    def steps(self) -> Float[Tensor, " steps"]:
        return torch.diff(self.nodes)

    def read(
        self, values: Float[Tensor, "*b N"], slopes: Float[Tensor, "*b N"], amounts: Float[Tensor, "*b J"]
    ) -> tuple[Float[Tensor, "*b frames"], Float[Tensor, "*b frames"]]:
        """At frame ends, and over frames, of the scan whose input a series has."""
        both = torch.cat([values, slopes], dim=-1)
        if len(self.at_ends) == 1:
            return both @ self.at_ends[0].T, both @ self.over_frames[0].T
        scan = amounts.argmax(dim=-1)
        return tuple((matrix[scan] @ both[..., None])[..., 0] for matrix in (self.at_ends, self.over_frames))  # type: ignore[return-value]


def _single(matrix: NDArray[np.float64]) -> Tensor:
    return torch.tensor(matrix, dtype=torch.float32)


def _hermite(nodes: NDArray[np.float64], times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows of a cubic's values at times, over values and slopes at the nodes."""
    count = len(nodes)
    piece = np.clip(np.searchsorted(nodes, times, side="right") - 1, 0, count - 2)
    h = nodes[piece + 1] - nodes[piece]
    s = (times - nodes[piece]) / h
    matrix, row = np.zeros((len(times), 2 * count)), np.arange(len(times))
    matrix[row, piece] = (1 + 2 * s) * (1 - s) ** 2
    matrix[row, piece + 1] = s * s * (3 - 2 * s)
    matrix[row, count + piece] = h * s * (1 - s) ** 2
    matrix[row, count + piece + 1] = h * s * s * (s - 1)
    return matrix


def _over_frames(nodes: NDArray[np.float64], seen: FrameObservation) -> NDArray[np.float64]:
    rows = [_frame_row(nodes, a, b, seen.decay) for a, b in zip(seen.frames.start, seen.frames.end)]
    return np.stack(rows) / seen.divisor[:, None]


def _frame_row(nodes: NDArray[np.float64], start: float, end: float, decay: float) -> NDArray[np.float64]:
    """int_start^end R e^{-decay t} dt as a row over values and slopes, by Gauss points between the nodes inside."""
    edges = np.unique(np.concatenate([[start], nodes[(nodes > start) & (nodes < end)], [end]]))
    points, weights = leggauss(_GAUSS)
    half = 0.5 * np.diff(edges)
    times = (edges[:-1, None] + half[:, None] * (1 + points)).ravel()
    row: NDArray[np.float64] = (half[:, None] * weights).ravel() * np.exp(-decay * times) @ _hermite(nodes, times)
    return row
