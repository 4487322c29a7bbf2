"""The arterial blood of one scan as formulas: total plasma, unmetabolised plasma, whole blood."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch

from petkin.dynamics import ExponentialSum
from petkin.errors import InputError
from petkin.inputs import PLASMA_PRESETS, InputFunction, exponentials
from petkin.phantoms import Population, random_stream

#: Body weight (kg) that a population's plasma curve and dose belong to.
REFERENCE_WEIGHT = 75.0


@dataclass(frozen=True)
class Administration:
    """How one scan began: body weight (kg), injected activity (MBq), and A1 of the plasma curve where it is drawn."""

    weight: float
    dose: float
    rise: float | None


def injected(population: Population, *, seed: int, subject: int, session: int) -> Administration:
    """Draw weight, dose and A1; the weight is the subject's."""
    blood = population.blood
    weight = REFERENCE_WEIGHT * math.exp(blood.weight_sd * random_stream(seed, "weight", subject).standard_normal())
    dose = blood.dose * math.exp(blood.dose_sd * random_stream(seed, "dose", subject, session).standard_normal())
    rise = None if blood.rise is None else random_stream(seed, "rise", subject, session).uniform(*blood.rise)
    return Administration(round(weight, 1), round(dose, 1), rise)


def arterial_input(population: Population, given: Administration) -> InputFunction:
    """The input function of one scan: plasma x parent fraction, and whole blood, all exact formulas.

    Raises:
        InputError: the population names a plasma curve that there is none of.
    """
    blood = population.blood
    preset = PLASMA_PRESETS.get(blood.plasma)
    if preset is None:
        raise InputError(
            f"Population {population.name!r} asks for plasma {blood.plasma!r}; use one of {', '.join(PLASMA_PRESETS)}."
        )
    size = blood.factor * (given.dose / blood.dose) * (REFERENCE_WEIGHT / given.weight)
    rise = {} if given.rise is None else {"A1": given.rise}
    total = preset(**rise, onset=blood.arrival, factor=size)
    whole = total if blood.whole_blood_to_plasma == 1.0 else _scaled(total, blood.whole_blood_to_plasma)
    if blood.parent is None:
        return InputFunction(total, whole, total_plasma=total)
    share = blood.parent.share
    fraction = exponentials([share, 1.0 - share], [-blood.parent.fast, -blood.parent.slow])
    return InputFunction(_product(total, fraction), whole, total_plasma=total, parent_fraction=fraction)


def _scaled(curve: ExponentialSum, factor: float) -> ExponentialSum:
    return ExponentialSum(factor * curve.coefficients, curve.exponents, curve.powers, curve.onset)


def _product(first: ExponentialSum, second: ExponentialSum) -> ExponentialSum:
    """The product of two sums of exponentials is such a sum again; the second starts no later than the first."""
    running = second.coefficients * torch.exp(second.exponents * (first.onset - second.onset))
    coefficients = (first.coefficients[:, None] * running[None, :]).flatten()
    exponents = (first.exponents[:, None] + second.exponents[None, :]).flatten()
    powers = tuple(n + m for n in first.powers for m in second.powers)
    return ExponentialSum(coefficients, exponents, powers, first.onset)
