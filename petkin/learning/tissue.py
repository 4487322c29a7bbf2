"""Tissue as a system known in part: C_T' = K1 C_P - k2 C_T + f_NN, C_P known, frames observed.

The curve of one region under one input is a series; series of the same tissue under other inputs tell its c_p and c_n.
All regions share one encoder and one hypernetwork, and every region has an f_NN of its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor, nn

from petkin.dynamics import Parameter, ParameterSet, VectorField
from petkin.errors import InputError
from petkin.hybrid import Curve, Identifier, Residual, Task, into_rows
from petkin.hybrid.residual import Network
from petkin.imaging import FrameObservation
from petkin.kinetics import ONE_TISSUE, TWO_TISSUE, CompartmentModel
from petkin.learning.flow import TissueFlow
from petkin.learning.grid import Grid
from petkin.learning.responses import Known, Responses

#: Activity (in the unit of the curves) that f_NN's inputs and the encoder's are divided by, and largest f_NN a minute.
SCALE, BOUND = 20.0, 50.0
#: Hidden layers of f_NN, a smooth function of one or two numbers.
_DEPTH = 2
#: Numbers in c_n.
CODE = 4
#: Directions in which an encoder sees curves, and the smallest spread that it magnifies, as a share of the largest.
_DIRECTIONS, _FINEST = 7, 1e-4
#: What is known of the tissue: all, one tissue, nothing, or one tissue with an f_NN of all or of each.
PRIORS: dict[str, CompartmentModel | None] = {
    "full_physics": TWO_TISSUE,
    "purely_physics": ONE_TISSUE,
    "purely_neural": None,
    "global_hylad": ONE_TISSUE,
    "meta_hylad": ONE_TISSUE,
}
_HYBRID = ("purely_neural", "global_hylad", "meta_hylad")
#: Lower and upper by symbol.
Bounds = Mapping[str, tuple[float, float]]


def _tissue(state: Tensor, forcing: Tensor | None, parameters: Tensor) -> Tensor:
    return state[..., 0][None] / SCALE


def _tissue_and_plasma(state: Tensor, forcing: Tensor | None, parameters: Tensor) -> Tensor:
    assert forcing is not None
    return torch.stack(torch.broadcast_tensors(state[..., 0], forcing)) / SCALE


def _tissue_and_hidden(state: Tensor, forcing: Tensor | None, parameters: Tensor) -> Tensor:
    return state.movedim(-1, 0) / SCALE


def _free_and_held(state: Tensor, forcing: Tensor | None, parameters: Tensor) -> Tensor:
    return torch.stack([state[..., 0] - state[..., 1], state[..., 1]]) / SCALE


@dataclass(frozen=True)
class Held(Residual):
    """Tracer that tissue holds back: dC_b/dt = f_NN(C_T - C_b, C_b), and only C_T - C_b washes out.

    C_T' = K1 C_P - k2 (C_T - C_b): k2 C_b is added to the law of one tissue. Tracer is neither made nor lost, and f_NN
    cannot take the place of K1 or k2. Two tissues are f_NN = k3 (C_T - C_b) - k4 C_b.
    """

    @property
    def network(self) -> Network:
        return Network(self.inputs, 1, self.width, self.depth)

    def value(
        self, layers: tuple[tuple[Tensor, Tensor], ...], state: Tensor, forcing: Tensor | None, parameters: Tensor
    ) -> Float[Tensor, "r ..."]:
        """(k2 C_b, f_NN)."""
        return torch.stack(self.rows(layers, state, forcing, parameters))

    def rows(
        self, layers: tuple[tuple[Tensor, Tensor], ...], state: Tensor, forcing: Tensor | None, parameters: Tensor
    ) -> tuple[Tensor, ...]:
        """The same, k2 C_b without the network."""
        (held,) = super().value(layers, state, forcing, parameters)
        return (parameters[..., 1] * state[..., 1]).expand_as(held), held


#: Forms of f_NN: of the tissue, as published; of tissue and plasma, and with a compartment that holds tracer back, both
#: nought where there is no tracer; with a compartment of which nothing is known.
RESIDUALS = {
    "C_T": Residual(_tissue, 1, 1, into_rows(0), BOUND, depth=_DEPTH),
    "C_T,C_P": Residual(_tissue_and_plasma, 2, 1, into_rows(0), BOUND, depth=_DEPTH, rests=True),
    "held": Held(_free_and_held, 2, 2, into_rows(0, 1), BOUND, depth=_DEPTH, rests=True),
    "hidden": Residual(_tissue_and_hidden, 2, 2, into_rows(0, 1), BOUND, depth=_DEPTH),
}


def find_residual(name: str) -> Residual:
    """The form of f_NN of this name.

    Raises:
        InputError: there is none.
    """
    if name not in RESIDUALS:
        raise InputError(f"There is no residual of {name!r}; choose one of {', '.join(RESIDUALS)}.")
    return RESIDUALS[name]


@dataclass(frozen=True)
class Conditions:
    """What all series of a training have in common: known inputs and frames, made ready.

    Args:
        observation: the frames, or those of the first scan.
        responses: of linear tissue to the inputs.
        grid: of the residual.
        told: what an encoder is told of each input [J, q].
    """

    observation: FrameObservation
    responses: Responses
    grid: Grid
    told: Float[Tensor, "J q"]

    @classmethod
    def of(cls, known: Sequence[Known], told: Float[Tensor, "J q"], *, highest: float) -> Conditions:
        """From inputs that share one observation, or that have one each with as many frames.

        Raises:
            InputError: other numbers of frames.
        """
        counts = {len(one.observation.frames) for one in known}
        if len(counts) > 1:
            raise InputError(
                f"Scans of {sorted(counts)} frames cannot be learned together; choose those of one number."
            )
        observations = [one.observation for one in known]
        alike = all(seen is observations[0] for seen in observations)
        grid = Grid.of(observations[:1] if alike else observations)
        return cls(observations[0], Responses.of(known, grid.nodes, highest=highest), grid, told)


@dataclass(frozen=True)
class Frames:
    """What is observed: frame values, beside what is known of the input. A region's share of a picture is left out."""

    def observe(self, states: Float[Tensor, "*b T d"]) -> Float[Tensor, "*b T n"]:
        """Frame values and the inputs' amounts."""
        return states[..., 1:]

    def squared_error(self, predicted: Tensor, actual: Tensor) -> Float[Tensor, "*b T"]:
        """Of frame values."""
        return (predicted[..., 1] - actual[..., 1]) ** 2


class CurveEncoder(nn.Module):
    """Features of a frame curve and of its input.

    The curve is seen along the directions in which the curves of a training vary most, each in units of its own
    spread: neighbouring frames say nearly the same, and what tells slow rates apart is a small difference.

    Args:
        mean: of the curves, over the frames that the encoder sees [frames].
        axes: directions over their spreads [frames, directions].
        told: what the encoder is told of each known input [J, q].
    """

    def __init__(self, mean: Tensor, axes: Tensor, told: Tensor) -> None:
        super().__init__()
        self.mean: Tensor
        self.axes: Tensor
        self.told: Tensor
        self.register_buffer("mean", mean)
        self.register_buffer("axes", axes)
        self.register_buffer("told", told)
        self.curve = Curve(axes.shape[1] + told.shape[1])
        self.features = self.curve.features

    def forward(self, series: Float[Tensor, "n T d"]) -> Float[Tensor, "n f"]:
        """Series as observed: frame values, then amounts of the known inputs."""
        seen = (series[:, : len(self.mean), 0] - self.mean) @ self.axes
        return self.curve(torch.cat([seen, series[:, 0, 1:] @ self.told], dim=-1))


def spread_of(curves: Float[Tensor, "*b T"]) -> tuple[Float[Tensor, " T"], Float[Tensor, "T q"]]:
    """Mean of curves, and the directions of most variance over their standard deviations."""
    rows = curves.flatten(0, -2).double()
    mean = rows.mean(dim=0)
    _, sizes, directions = torch.linalg.svd(rows - mean, full_matrices=False)
    spreads = sizes / len(rows) ** 0.5
    kept = min(_DIRECTIONS, len(spreads))
    axes = directions[:kept].T / spreads[:kept].clamp_min(_FINEST * float(spreads[0]))
    return mean.float(), axes.float()


def tissue_model(
    dynamics: str,
    conditions: Conditions,
    bounds: Bounds,
    curves: Float[Tensor, "*b T"],
    *,
    residual: str = "C_T,C_P",
    full: CompartmentModel = TWO_TISSUE,
    seed: int = 0,
) -> Identifier:
    """A model with fresh first weights.

    Args:
        dynamics: full_physics (`full`), purely_physics (one tissue), purely_neural, global_hylad or meta_hylad.
        conditions: inputs and frames.
        bounds: of c_p, by symbol; with vB, blood is part of what is observed.
        curves: training curves, whose spread the encoder measures in; their frames are all that it sees.
        residual: what f_NN sees, see `RESIDUALS`.
        full: the tissue's model, where it is known.
        seed: of the weights.

    Raises:
        InputError: no such way of modelling.
    """
    torch.manual_seed(seed)
    task = tissue_task(dynamics, conditions, bounds, residual=residual, full=full)
    encoder = CurveEncoder(*spread_of(curves), conditions.told)
    code = CODE if dynamics in ("purely_neural", "meta_hylad") else 0
    return Identifier(task, encoder, None, code=code, generator=torch.Generator().manual_seed(seed))


def tissue_task(
    dynamics: str,
    conditions: Conditions,
    bounds: Bounds,
    *,
    residual: str = "C_T,C_P",
    full: CompartmentModel = TWO_TISSUE,
) -> Task:
    """Tissue to be identified; arguments as for `tissue_model`."""
    if dynamics not in PRIORS:
        raise InputError(f"There is no dynamics {dynamics!r}; choose one of {', '.join(PRIORS)}.")
    model = full if dynamics == "full_physics" else PRIORS[dynamics]
    symbols = () if model is None else model.parameters.symbols[: model.rates]
    blood = model is not None and "vB" in bounds
    names = (*symbols, "vB") if blood else symbols
    count = 2 + len(conditions.told)
    return Task(
        name=f"tissue {dynamics}" + (f" f_NN({residual})" if dynamics in _HYBRID else ""),
        states=("C_T", "frame", *(f"input {j + 1}" for j in range(count - 2))),
        times=torch.tensor(conditions.observation.frames.end, dtype=torch.float32),
        parameters=ParameterSet(tuple(_parameter(symbol, *bounds[symbol]) for symbol in names)),
        known=None if model is None else _known(model),
        residual=_residual_of(residual, alone=model is None) if dynamics in _HYBRID else None,
        emission=Frames(),
        centre=torch.zeros(count),
        reach=torch.zeros(count),
        flow=TissueFlow(model, conditions.responses, conditions.grid, blood),
        start=_at_rest,
    )


def _residual_of(name: str, *, alone: bool) -> Residual:
    """Where f_NN is all there is, tracer comes from nothing else, and there is no k2."""
    residual = find_residual(name)
    if alone and isinstance(residual, Held):
        raise InputError(f"A residual of {name!r} washes out with k2, which a purely neural tissue has not.")
    return replace(residual, rests=False) if alone else residual


def _parameter(symbol: str, low: float, high: float) -> Parameter:
    unit = "mL cm^-3 min^-1" if symbol == "K1" else "1" if symbol == "vB" else "min^-1"
    return Parameter(symbol, unit, 0.5 * (low + high), low, high)


def _at_rest(series: Float[Tensor, "n T d"]) -> Float[Tensor, "n s"]:
    """No tracer at time zero; amounts of the inputs as observed."""
    return torch.nn.functional.pad(series[:, 0, 1:], (2, 0))


def _known(model: CompartmentModel) -> VectorField:
    def field(t: Tensor, state: Tensor, forcing: Tensor | None, p: Tensor) -> Tensor:
        plasma = state.new_zeros(()) if forcing is None else forcing
        tissue = model.field(state[..., : len(model.states)], plasma, p[..., : model.rates])
        return torch.nn.functional.pad(tissue, (0, state.shape[-1] - tissue.shape[-1]))

    return field
