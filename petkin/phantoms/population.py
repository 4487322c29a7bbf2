"""Populations: which kinetics the tissues of a phantom have, and how subjects, sessions and voxels differ.

A number x in the file is a median, and subject n has in region r at session j

    x exp(s_subject (sqrt(c) a_n + sqrt(1 - c) b_nr) + s_session e_nrj),

a, b, e standard normal, c = `shared` the share of the between-subject variance that all regions of a subject have in
common. A pair [low, high] is drawn uniformly for every subject and region instead.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from petkin.errors import InputError
from petkin.phantoms.definition import Region
from petkin.phantoms.reading import catalogue_folder, read_described
from petkin.phantoms.streams import random_stream

#: Rate constants and blood volume, in the order of every array here; units as in `petkin.kinetics`.
SYMBOLS = ("K1", "k2", "k3", "k4", "vB")
#: Tissue whose kinetics stand in where a population does not name a region's own.
ANY_TISSUE = "any"

Symbol = Literal["K1", "k2", "k3", "k4", "vB"]
NonNegative = Annotated[float, Field(ge=0)]
Range = tuple[NonNegative, NonNegative]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class ParentFraction(_Strict):
    """f(t) = share e^{-fast t} + (1 - share) e^{-slow t}, t from injection, min; rates in 1/min."""

    share: Annotated[float, Field(ge=0, le=1)]
    fast: NonNegative
    slow: NonNegative


class Blood(_Strict):
    """The blood that goes with a tracer.

    Attributes:
        plasma: preset of `petkin.inputs.PLASMA_PRESETS`.
        rise: A1 drawn uniformly from this range, or the preset's own.
        factor: multiplies the curve; 37 takes uCi/mL to kBq/mL.
        arrival: min after injection.
        whole_blood_to_plasma: C_B over total plasma.
        parent: share of the plasma activity that is unchanged tracer; all of it where not given.
        dose: median injected activity, MBq, that the curve belongs to in a subject of 75 kg.
        dose_sd: sd of the log of the dose between scans; the curve grows with the dose.
        weight_sd: sd of the log of the body weight between subjects; the curve shrinks with it.
    """

    plasma: str
    rise: Range | None = None
    factor: Annotated[float, Field(gt=0)] = 1.0
    arrival: NonNegative = 0.0
    whole_blood_to_plasma: Annotated[float, Field(gt=0)] = 1.0
    parent: ParentFraction | None = None
    dose: Annotated[float, Field(gt=0)]
    dose_sd: NonNegative = 0.0
    weight_sd: NonNegative = 0.0


class Spread(_Strict):
    """sd of the logs by symbol, between subjects, sessions of a subject, and voxels of a region."""

    subject: Mapping[Symbol, NonNegative] = Field(default_factory=dict)
    session: Mapping[Symbol, NonNegative] = Field(default_factory=dict)
    voxel: Mapping[Symbol, NonNegative] = Field(default_factory=dict)
    shared: Annotated[float, Field(ge=0, le=1)] = 0.5

    def of(self, level: Mapping[Symbol, float]) -> Float[NDArray, " symbols"]:
        return np.array([level.get(s, 0.0) for s in SYMBOLS])  # type: ignore[call-overload]


class Population(_Strict):
    """A tracer in a population: kinetics by tissue, their spread, and the blood.

    Attributes:
        model: label of the compartment model that the kinetics belong to.
        radionuclide: as BIDS spells it.
        frames: schedule that suits the tracer, as `petkin.imaging.frame_schedule` reads it.
    """

    name: str
    title: str
    source: str
    model: str
    tracer: str
    radionuclide: str
    frames: str
    blood: Blood
    spread: Spread = Spread()
    kinetics: Annotated[Mapping[str, Mapping[Symbol, NonNegative | Range]], Field(min_length=1)]

    @model_validator(mode="after")
    def _complete(self) -> Population:
        for tissue, values in self.kinetics.items():
            missing = [s for s in SYMBOLS if s not in values]
            if missing:
                raise ValueError(f"tissue {tissue!r} lacks {', '.join(missing)}")
            for symbol, value in values.items():
                if isinstance(value, tuple) and value[0] > value[1]:
                    raise ValueError(f"tissue {tissue!r}: {symbol} runs from {value[0]:g} down to {value[1]:g}")
        return self

    def of_tissue(self, tissue: str) -> Mapping[Symbol, float | tuple[float, float]]:
        """Kinetics of one tissue.

        Raises:
            InputError: neither the tissue nor "any" is in the population.
        """
        found = self.kinetics.get(tissue, self.kinetics.get(ANY_TISSUE))
        if found is None:
            known = ", ".join(self.kinetics)
            raise InputError(
                f"Population {self.name!r} has neither tissue {tissue!r} nor {ANY_TISSUE!r}; it has {known}."
            )
        return found


def population_names() -> tuple[str, ...]:
    """Names of the shipped populations."""
    return tuple(sorted(p.stem for p in (catalogue_folder() / "populations").glob("*.toml")))


def read_population(name: str | Path) -> Population:
    """A population by its name, or from a .toml file of one's own.

    Raises:
        InputError: no such population, or a file that does not describe one.
    """
    return read_described(str(name), catalogue_folder() / "populations", Population, "population", population_names())


def draw_kinetics(
    population: Population, regions: Sequence[Region], *, seed: int, subject: int, session: int
) -> Float[NDArray, "regions symbols"]:
    """Rate constants of one scan, columns as `SYMBOLS`; depends on nothing but the arguments."""
    spread = population.spread
    first = random_stream(seed, "kinetics", subject)
    uniform = first.random((len(regions), len(SYMBOLS)))
    common, own = first.standard_normal(len(SYMBOLS)), first.standard_normal(uniform.shape)
    again = random_stream(seed, "kinetics", subject, session).standard_normal(uniform.shape)
    between = math.sqrt(spread.shared) * common + math.sqrt(1.0 - spread.shared) * own
    logs = spread.of(spread.subject) * between + spread.of(spread.session) * again
    low, high = _ranges(population, regions)
    return np.where(high > low, low + (high - low) * uniform, low * np.exp(logs))


def draw_voxels(
    population: Population, kinetics: Float[NDArray, "voxels symbols"], rng: np.random.Generator
) -> Float[NDArray, "voxels symbols"]:
    """Kinetics of single voxels about those of their regions: log-normal, independent of each other."""
    spread = population.spread
    return kinetics * np.exp(spread.of(spread.voxel) * rng.standard_normal(kinetics.shape))


def _ranges(population: Population, regions: Sequence[Region]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    rows = [population.of_tissue(r.tissue) for r in regions]
    pairs = [[v if isinstance(v := row[s], tuple) else (v, v) for s in SYMBOLS] for row in rows]  # type: ignore[index]
    both = np.array(pairs, dtype=float)
    return both[..., 0], both[..., 1]
