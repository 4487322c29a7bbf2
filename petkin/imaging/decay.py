"""Radioactive decay: half-lives of the nuclides that PET uses, and what follows from them."""

from __future__ import annotations

import re
from dataclasses import dataclass

from petkin import units
from petkin.errors import InputError

_NUCLIDE = re.compile(r"^(?:([A-Za-z]{1,2})-?(\d{1,3})|(\d{1,3})-?([A-Za-z]{1,2}))$")
_ENSDF = "ENSDF, National Nuclear Data Center, www.nndc.bnl.gov"


@dataclass(frozen=True)
class Nuclide:
    """One positron emitter. `half_life` in minutes, its one-sigma uncertainty beside it."""

    symbol: str
    half_life: float
    uncertainty: float
    source: str


#: Half-lives in minutes. A nuclide that is missing here is one more line.
NUCLIDES: dict[str, Nuclide] = {
    n.symbol: n
    for n in (
        Nuclide("C11", 20.364, 0.014, f"{_ENSDF}: 20.364(14) min"),
        Nuclide("N13", 9.965, 0.004, f"{_ENSDF}: 9.965(4) min"),
        Nuclide("O15", 122.24 / 60, 0.16 / 60, f"{_ENSDF}: 122.24(16) s"),
        Nuclide("F18", 109.77, 0.05, f"{_ENSDF}: 109.77(5) min"),
        Nuclide("Cu64", 12.701 * 60, 0.002 * 60, f"{_ENSDF}: 12.701(2) h"),
        Nuclide("Ga68", 67.71, 0.08, f"{_ENSDF}: 67.71(8) min"),
        Nuclide("Rb82", 1.2575, 0.0002, f"{_ENSDF}: 1.2575(2) min"),
        Nuclide("Y86", 14.74 * 60, 0.02 * 60, f"{_ENSDF}: 14.74(2) h"),
        Nuclide("Br76", 16.2 * 60, 0.2 * 60, f"{_ENSDF}: 16.2(2) h"),
        Nuclide("Zr89", 78.41 * 60, 0.12 * 60, f"{_ENSDF}: 78.41(12) h"),
        Nuclide("I124", 4.1760 * 1440, 0.0003 * 1440, f"{_ENSDF}: 4.1760(3) d"),
    )
}


def nuclide(name: str) -> Nuclide:
    """The table's entry for a nuclide as files spell it: "C11" (BIDS), "11C", "C-11", "11c".

    Raises:
        InputError: not a nuclide, or none of `NUCLIDES`.
    """
    match = _NUCLIDE.match(name.strip())
    if match:
        element, mass = match.group(1) or match.group(4), match.group(2) or match.group(3)
        found = NUCLIDES.get(f"{element.capitalize()}{int(mass)}")
        if found is not None:
            return found
    raise InputError(f"Radionuclide {name!r} has no half-life here; use one of {', '.join(NUCLIDES)}.")


def half_life(name: str) -> float:
    """T_1/2 of a nuclide, min.

    Raises:
        InputError: unknown nuclide.
    """
    return nuclide(name).half_life


def decay_constant(name: str) -> float:
    """lambda = ln 2 / T_1/2 of a nuclide, 1/min.

    Raises:
        InputError: unknown nuclide.
    """
    return units.decay_constant(half_life(name))
