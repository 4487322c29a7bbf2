"""Simulated tissue to train on: rates drawn from ranges, a family of inputs, frames, noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from petkin.dynamics import Forcing
from petkin.hybrid import Dataset
from petkin.imaging import CountingNoise, FrameObservation, FrameSchedule
from petkin.inputs import InputFunction, feng, paper_plasma
from petkin.kinetics import TWO_TISSUE, CompartmentModel
from petkin.learning.responses import Known
from petkin.learning.tissue import Conditions

#: The tissue model's rate constants, symbol by symbol, drawn uniformly.
Ranges = Mapping[str, tuple[float, float]]
#: A1 (activity/min) of an input with amount one.
_UNIT_RISE = 100.0


@dataclass(frozen=True)
class Population:
    """Tissues and scans.

    Args:
        observation: frames, and how they average.
        ranges: of the tissue's rate constants; of vB where there is blood.
        rise: A1 of the paper's plasma curve is drawn from here, activity concentration/min.
        model: of the tissue.
        noise: percent, of frame values, see `petkin.imaging.CountingNoise`; the reference is each curve's mean.
        regions: tissues that are scanned together, under the same input.
    """

    observation: FrameObservation
    ranges: Ranges
    rise: tuple[float, float]
    model: CompartmentModel = TWO_TISSUE
    noise: float = 0.0
    regions: int = 5

    @property
    def conditions(self) -> Conditions:
        """Inputs and frames, made ready; rates up to the largest that the bounds leave to any model."""
        known = [Known(u, u, self.observation) for u in self.inputs]
        highest = sum(high for symbol, (_, high) in self.bounds.items() if symbol != "K1")
        return Conditions.of(known, self.told, highest=highest)

    @property
    def bounds(self) -> dict[str, tuple[float, float]]:
        """Of c_p: from a fifth of what is drawn to a third more, so that one tissue can stand for two."""
        return {symbol: (0.2 * low, 4.0 / 3.0 * high) for symbol, (low, high) in self.ranges.items()}

    @property
    def inputs(self) -> tuple[Forcing, Forcing]:
        """Known inputs: C_P is the first, plus A1/100 times the second."""
        rates = tuple(paper_plasma(0.0).exponents[1:].tolist())
        return paper_plasma(0.0), feng(_UNIT_RISE, 0.0, 0.0, rates)

    @property
    def told(self) -> Float[Tensor, "J q"]:
        """What an encoder is told of each known input: where A1 lies in its range, -1 to 1."""
        low, high = (rise / _UNIT_RISE for rise in self.rise)
        return torch.tensor([[-(high + low) / (high - low)], [2.0 / (high - low)]])


#: The paper's: 80 frames of 0.5 min, not decay-corrected with its tau = 110 min, rates and A1 from its appendix.
PAPER = Population(
    FrameObservation(FrameSchedule.uniform(80, 0.5), 1.0 / 110.0, corrected=False),
    {"K1": (0.1, 0.3), "k2": (0.01, 0.3), "k3": (0.01, 0.1), "k4": (0.01, 0.05)},
    (100.0, 200.0),
)


def draw(population: Population, subjects: int, scans: int, seed: int) -> tuple[Dataset, Dataset]:
    """Tissues that were each scanned several times, with other inputs: as they are, and as they were measured.

    The regions of one subject follow each other, each a tissue of its own.

    States are C_T at the frames' ends, frame values, and the amounts of the known inputs.

    Args:
        population: what to draw from.
        subjects: how many; M is as many times the regions.
        scans: S of every subject.
        seed: of rates, inputs and noise.
    """
    rng = np.random.default_rng(seed)
    model, observation = population.model, population.observation
    low, high = np.array([population.ranges[symbol] for symbol in model.parameters.symbols[: model.rates]]).T
    truth = torch.tensor(low + (high - low) * rng.random((subjects * population.regions, model.rates)))
    rises = population.rise[0] + (population.rise[1] - population.rise[0]) * rng.random((subjects, scans))
    rise = torch.tensor(rises).repeat_interleave(population.regions, dim=0) / _UNIT_RISE
    amounts = torch.stack([torch.ones_like(rise), rise], dim=-1)
    blood = population.ranges.get("vB", (0.0, 0.0))
    vB = torch.tensor(rng.uniform(*blood, (len(truth), 1)) if blood[1] > 0 else np.zeros((len(truth), 1)))
    rates = torch.cat([torch.nn.functional.pad(truth, (0, len(model.parameters) - model.rates - 1)), vB], dim=-1)
    ends = torch.tensor(observation.frames.end)
    parts = [
        torch.stack([model.tissue(rates, u, ends), model.frame_values(rates, InputFunction(u, u), observation)], -1)
        for u in population.inputs
    ]
    curves = torch.einsum("msj,jmtc->mstc", amounts, torch.stack(parts))
    told = amounts[:, :, None, :].expand(-1, -1, len(ends), -1)
    clean = Dataset(torch.cat([curves, told], dim=-1).float(), truth.float())
    return clean, _measured(clean, population, rng)


def _measured(clean: Dataset, population: Population, rng: np.random.Generator) -> Dataset:
    if population.noise == 0.0:
        return clean
    values = clean.states[..., 1].double().numpy()
    noise = CountingNoise(population.noise)
    noisy = [
        replace(noise, reference=float(curve.mean())).sample(curve, population.observation, rng)
        for curve in values.reshape(-1, values.shape[-1])
    ]
    states = clean.states.clone()
    states[..., 1] = torch.tensor(np.stack(noisy)).reshape(values.shape)
    return Dataset(states, clean.truth)
