"""What a physics system of the benchmark owes: its full and its partial law, ranges, starts, pictures, checks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from petkin.dynamics import Parameter, ParameterSet, VectorField
from petkin.errors import InputError
from petkin.hybrid import Dataset, Emission, Flow, Residual, RungeKutta, Task
from petkin.hybrid.residual import Sight

#: Ways of modelling a derivative, in the order of the paper's tables.
DYNAMICS = ("full_physics", "purely_physics", "purely_neural", "global_hylad", "meta_hylad")
#: c_p may leave the range that systems are drawn from by this share of it, on either side.
_MARGIN = 0.3


@dataclass(frozen=True)
class Range:
    """A parameter: symbol, unit, what training and test in distribution draw, what is drawn outside, meaning."""

    symbol: str
    unit: str
    inside: tuple[float, float]
    outside: tuple[float, float]
    meaning: str


@dataclass(frozen=True)
class Physics:
    """A system.

    Args:
        name: as in tables.
        states: names of the components.
        times: of the frames.
        ranges: all that may be a parameter, in the order of the truth.
        draw_truth: (count, outside, generator) -> truth [count, P].
        law, full: what data are made by, and which parameters it takes.
        partial, known: what is known of it, and which parameters that takes.
        kinematics: what even a purely neural derivative knows, without parameters; None for nothing.
        initial: draws n starts [n, d].
        centre, reach: where starts lie, for the encoder.
        emission: pictures.
        residual: what f_NN sees, and where it acts.
        everything: what a purely neural derivative sees, and where it acts.
        missing: (states, truth) -> what f_NN should be.
        energy: (states, truth) -> energy, constant where nothing is lost; None where there is none.
        flow: how models are integrated; data are made much finer.
        sizes: dynamics x starts of the paper.
        seen: states that the pictures show.
        meant: what of c_p acts in the partial law, where not all of it does.
        rough: cheaper pictures of the same scene to train on; None for the pictures themselves.
    """

    name: str
    states: tuple[str, ...]
    times: Float[Tensor, " T"]
    ranges: tuple[Range, ...]
    draw_truth: Callable[[int, bool, torch.Generator], Tensor]
    law: VectorField
    full: tuple[str, ...]
    partial: VectorField
    known: tuple[str, ...]
    kinematics: VectorField | None
    initial: Callable[[int, torch.Generator], Tensor]
    centre: tuple[float, ...]
    reach: tuple[float, ...]
    emission: Emission
    residual: Residual
    everything: Residual
    missing: Callable[[Tensor, Tensor], Tensor]
    energy: Callable[[Tensor, Tensor], Tensor] | None
    flow: Flow
    sizes: tuple[int, int]
    seen: tuple[int, ...] = ()
    meant: Callable[[Tensor], Tensor] | None = None
    rough: Emission | None = None

    def parameters(self, symbols: tuple[str, ...]) -> ParameterSet:
        """c_p: ranges in and out of distribution, a little widened."""
        return ParameterSet(tuple(_parameter(r) for r in self.ranges if r.symbol in symbols))

    def places(self, symbols: tuple[str, ...]) -> tuple[int, ...]:
        """Where these parameters stand in the truth."""
        return tuple(i for i, r in enumerate(self.ranges) if r.symbol in symbols)

    def task(self, dynamics: str) -> Task:
        """The system as it is to be identified.

        Raises:
            InputError: no such way of modelling.
        """
        if dynamics not in DYNAMICS:
            raise InputError(f"There is no dynamics {dynamics!r}; choose one of {', '.join(DYNAMICS)}.")
        full, neural = dynamics == "full_physics", dynamics == "purely_neural"
        hybrid = dynamics in ("global_hylad", "meta_hylad")
        symbols = self.full if full else () if neural else self.known
        return Task(
            name=f"{self.name} {dynamics}",
            states=self.states,
            times=self.times,
            parameters=self.parameters(symbols),
            known=self.law if full else self.kinematics if neural else self.partial,
            residual=self.residual if hybrid else self.everything if neural else None,
            emission=self.emission,
            centre=torch.tensor(self.centre),
            reach=torch.tensor(self.reach),
            flow=self.flow,
            missing=self.missing if hybrid else None,
            seen=self.seen,
            meant=None if full or neural else self.meant,
        )


def _parameter(r: Range) -> Parameter:
    low, high = min(r.inside[0], r.outside[0]), max(r.inside[1], r.outside[1])
    margin = _MARGIN * (high - low)
    lower = max(0.0, low - margin) if low >= 0 else low - margin
    return Parameter(r.symbol, r.unit, 0.5 * (low + high), lower, high + margin, meaning=r.meaning)


def draw(
    physics: Physics,
    dynamics: int,
    starts: int,
    seed: int,
    *,
    outside: bool = False,
) -> Dataset:
    """M dynamics with S starts each, states in single precision from an integration in double, sixteen steps a frame.

    Args:
        physics: the system.
        dynamics, starts: M and S.
        seed: of the draw.
        outside: draw the parameters out of distribution.
    """
    generator = torch.Generator().manual_seed(seed)
    truth = physics.draw_truth(dynamics, outside, generator)
    start = physics.initial(dynamics * starts, generator)
    parameters = truth[:, list(physics.places(physics.full))].repeat_interleave(starts, dim=0)
    states = _fine(physics.flow)(physics.law, start, parameters, physics.times.to(torch.float64))
    return Dataset(states.unflatten(0, (dynamics, starts)).to(torch.float32), truth.to(torch.float32))


def _fine(flow: Flow) -> Flow:
    return RungeKutta(16 * flow.substeps) if isinstance(flow, RungeKutta) else flow


def sees(columns: tuple[int, ...], scales: tuple[float, ...]) -> Sight:
    """Some states over their scales."""

    def look(state: Tensor, forcing: Tensor | None, parameters: Tensor) -> Tensor:
        return torch.stack([state[..., column] / scale for column, scale in zip(columns, scales)])

    return look


def uniform(*bounds: tuple[float, float]) -> Callable[[int, torch.Generator], Tensor]:
    """Starts drawn between bounds, a pair a state."""

    def initial(count: int, generator: torch.Generator) -> Tensor:
        low, high = torch.tensor(bounds, dtype=torch.float64).T
        return low + (high - low) * torch.rand(count, len(bounds), dtype=torch.float64, generator=generator)

    return initial


def uniform_truth(ranges: tuple[Range, ...]) -> Callable[[int, bool, torch.Generator], Tensor]:
    """Parameters drawn from (low, high], each for itself."""

    def draw_truth(count: int, outside: bool, generator: torch.Generator) -> Tensor:
        bounds = [r.outside if outside else r.inside for r in ranges]
        low, high = torch.tensor(bounds, dtype=torch.float64).T
        return high - (high - low) * torch.rand(count, len(ranges), dtype=torch.float64, generator=generator)

    return draw_truth
