"""The basis table: everything a fit needs to know of the input function and the frames.

With the input fixed, a model curve is linear in its amplitudes, and each exponential enters through its rate alone:

    model = vB C_B + (1 - vB) sum_i phi_i B(a_i),    B_k(a) = frame k's report of e^{-a t} * C_P(t).

So B is computed once, in float64 and exactly, at nodes in u = log(a + c), and read by cubic interpolation afterwards.
The cost of a fit no longer depends on the input function. Weighted curves are then compressed onto the few directions
that B and the blood span.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petkin.imaging import FrameObservation
from petkin.inputs.input_function import InputFunction
from petkin.jit import njit

#: c in u = log(a + c), 1/min: nodes crowd where curves over an hour or two still tell rates apart.
RATE_OFFSET = 1e-3

#: Weights of f(x), f(x + h), ... f(x + 5 h) in h f'(x), to h^6 f^(6) / 6, and the step in u that they are used with.
_ONE_SIDED = np.array([-137.0 / 60.0, 5.0, -5.0, 10.0 / 3.0, -5.0 / 4.0, 1.0 / 5.0])
_STEP = 0.01

#: Share of a spacing below which two positions are the same.
_ROUNDING = 1e-9

Array = NDArray[np.float64]


@dataclass(frozen=True)
class BasisTable:
    """B(a) and dB/du at equally spaced nodes u, and the blood, as frames report them (kBq/mL).

    Args:
        u: nodes, log(1/min).
        basis: B at the nodes (nodes, K), min kBq/mL.
        slope: dB/du at the nodes (nodes, K).
        blood: frame values of C_B (K,).
    """

    u: Array
    basis: Array
    slope: Array
    blood: Array

    @property
    def rates(self) -> Array:
        """Rates at the nodes, 1/min."""
        return np.exp(self.u) - RATE_OFFSET

    @property
    def spacing(self) -> float:
        return float(self.u[1] - self.u[0])


def log_rate(rate: float | Array) -> float | Array:
    """u = log(a + c)."""
    return np.log(np.asarray(rate) + RATE_OFFSET)


@dataclass(frozen=True, eq=False)
class Itself:
    """Something that equals itself alone, as a key."""

    thing: Any

    def __hash__(self) -> int:
        return id(self.thing)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Itself) and self.thing is other.thing


def build_table(
    arterial: InputFunction, observation: FrameObservation, *, rate_bounds: tuple[float, float], nodes: int
) -> BasisTable:
    """Tabulate B(a) between two rates; the last few tables are kept, since a scan's voxels may come in many blocks.

    B is exact at the nodes. Its slopes there are those of the cubic spline whose end slopes are exact to a part in 1e8,
    and read between the nodes as well as exact ones do, at a fraction of their cost.

    Args:
        arterial: input function, kBq/mL over min.
        observation: what frames report.
        rate_bounds: lowest and highest rate, 1/min; the lowest may be 0.
        nodes: number of nodes; 64 give 1e-6 of a curve's norm, 160 give 3e-8.
    """
    return _built(Itself(arterial), Itself(observation), rate_bounds, nodes)


@lru_cache(maxsize=4)
def _built(arterial: Itself, observation: Itself, rate_bounds: tuple[float, float], nodes: int) -> BasisTable:
    u = np.linspace(float(log_rate(rate_bounds[0])), float(log_rate(rate_bounds[1])), nodes)
    beside = _STEP * np.arange(1, len(_ONE_SIDED))
    every = np.concatenate([u, u[0] + beside, u[-1] - beside])
    rates = np.maximum(np.exp(every) - RATE_OFFSET, 0.0)
    values = np.asarray(observation.thing.of_response(arterial.thing.plasma, rates))
    blood = np.asarray(observation.thing.of_forcing(arterial.thing.whole_blood))
    basis, above, below = np.split(values, [nodes, nodes + len(beside)])
    lowest = np.tensordot(_ONE_SIDED, np.concatenate([basis[:1], above]), 1) / _STEP
    highest = -np.tensordot(_ONE_SIDED, np.concatenate([basis[-1:], below]), 1) / _STEP
    return BasisTable(u, basis, _spline_slopes(basis, float(u[1] - u[0]), lowest, highest), blood)


def _spline_slopes(values: Array, spacing: float, first: Array, last: Array) -> Array:
    """Slopes s of the cubic spline through equally spaced rows whose end slopes are given:

    s_(i-1) + 4 s_i + s_(i+1) = 3 (y_(i+1) - y_(i-1)) / h, from above downwards and back (Thomas).
    """
    slopes, ahead = np.empty_like(values), np.zeros(len(values))
    slopes[0], slopes[-1] = first, last
    for i in range(1, len(values) - 1):
        ahead[i] = 1.0 / (4.0 - ahead[i - 1])
        slopes[i] = ahead[i] * (3.0 * (values[i + 1] - values[i - 1]) / spacing - slopes[i - 1])
    for i in range(len(values) - 2, 0, -1):
        slopes[i] -= ahead[i] * slopes[i + 1]
    return slopes


@dataclass(frozen=True)
class InnerProducts:
    """All that a fit needs of a compressed table: b at a position x between nodes is four rows, weighted.

    Args:
        blood: length of the weighted blood curve along axis 0.
        low, spacing: u = low + spacing x.
        rows: b and db/dx of every node, as columns (R, 2 nodes).
        gram: rows^T rows (2 nodes, 2 nodes).
        own: of every interval, the upper triangle of its 4 x 4 block of `gram`, then its four entries of rows[0];
            (nodes - 1, 14).
    """

    blood: float
    low: float
    spacing: float
    rows: Array
    gram: Array
    own: Array


@dataclass(frozen=True)
class Compression:
    """The table seen through shared frame weights: coordinates in an orthonormal basis Q whose first axis is the blood.

    Args:
        project: (R, K); z = project @ curve holds all that a fit can use of a curve.
        root_weights: sqrt(w) (K,).
        basis: B in these coordinates (nodes, R).
        slope: dB/du (nodes, R).
        blood: length of the weighted blood curve along axis 0.
        u: nodes.
    """

    project: Array
    root_weights: Array
    basis: Array
    slope: Array
    blood: float
    u: Array

    @property
    def size(self) -> int:
        return self.basis.shape[1]

    @property
    def rates(self) -> Array:
        """Rates at the nodes, 1/min."""
        return np.exp(self.u) - RATE_OFFSET

    def positions(self, rates: tuple[float, float]) -> tuple[float, float]:
        """The ends of an interval of rates (1/min) inside the table, counted in nodes."""
        low, spacing, last = float(self.u[0]), float(self.u[1] - self.u[0]), len(self.u) - 1.0
        first, final = ((float(log_rate(rate)) - low) / spacing for rate in rates)
        # An end that is a node but for rounding is that node.
        return max(first, 0.0) if first > _ROUNDING else 0.0, final if final < last - _ROUNDING else last

    @cached_property
    def products(self) -> InnerProducts:
        """Inner products of all nodes, for readings between them."""
        spacing = float(self.u[1] - self.u[0])
        rows = np.stack([self.basis, self.slope * spacing], axis=1).reshape(-1, self.size)
        gram = rows @ rows.T
        first = 2 * np.arange(len(self.u) - 1)
        upper = [gram[first + a, first + b] for a in range(4) for b in range(a, 4)]
        own = np.stack([*upper, *(rows[first + a, 0] for a in range(4))], axis=1)
        return InnerProducts(self.blood, float(self.u[0]), spacing, np.ascontiguousarray(rows.T), gram, own)


def compress(table: BasisTable, weights: Array, *, tolerance: float = 0.0, size: int | None = None) -> Compression:
    """Compress a table for curves that share their frame weights.

    Args:
        table: basis table.
        weights: frame weights (K,), relative.
        tolerance: directions below this singular value (relative to the largest) are dropped.
        size: keep exactly this many directions (padded with zeros where there are fewer).
    """
    root = np.sqrt(weights)
    blood = root * table.blood
    length = float(np.linalg.norm(blood))
    first = blood / length if length > 0 else np.zeros_like(blood)
    weighted = table.basis * root
    across = weighted - np.outer(weighted @ first, first)
    # Rates are weighted alike: a slow exponential has a larger curve, not a more important one.
    across = across / np.maximum(np.linalg.norm(weighted, axis=1, keepdims=True), 1e-300)
    _, singular, rows = np.linalg.svd(across, full_matrices=False)
    kept = int(np.count_nonzero(singular > max(tolerance, 1e-15) * singular[0]))
    if size is not None:
        kept = min(kept, size - 1)
    # Directions of tiny singular value come out of the decomposition leaning on the blood: QR sets them upright.
    axes = np.linalg.qr(np.vstack([first, rows[:kept]]).T)[0].T
    axes[0] = first
    if size is not None and len(axes) < size:
        axes = np.vstack([axes, np.zeros((size - len(axes), axes.shape[1]))])
    return Compression(axes * root, root, weighted @ axes.T, (table.slope * root) @ axes.T, length, table.u)


@njit(nogil=True, fastmath={"reassoc", "contract", "nsz", "arcp"})
def project_rows(axes: Array, rows: Array) -> Array:
    """axes @ rows.T, to the bit the same for a row whatever stands beside it (a library's product is not)."""
    answer = np.empty((axes.shape[0], rows.shape[0]))
    for n in range(rows.shape[0]):
        for r in range(axes.shape[0]):
            total = 0.0
            for k in range(axes.shape[1]):
                total += axes[r, k] * rows[n, k]
            answer[r, n] = total
    return answer
