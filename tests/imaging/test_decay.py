"""Half-lives against the evaluation of another laboratory (DDEP/LNHB), names as files spell them."""

import math

import pytest

from petkin.errors import InputError
from petkin.imaging import NUCLIDES, decay_constant, half_life

#: Decay Data Evaluation Project, www.lnhb.fr/nuclear-data (minutes); agrees with ENSDF to its own uncertainty.
DDEP_MINUTES = {
    "C11": 20.361,
    "N13": 9.967,
    "O15": 2.041,
    "F18": 109.728,
    "Cu64": 762.024,
    "Ga68": 67.83,
}


@pytest.mark.parametrize(("nuclide", "minutes"), DDEP_MINUTES.items())
def test_half_lives_agree_with_the_other_evaluation(nuclide: str, minutes: float) -> None:
    assert half_life(nuclide) == pytest.approx(minutes, rel=2.5e-3)


@pytest.mark.parametrize("spelling", ["C11", "11C", "C-11", "11-C", " c11 ", "11c"])
def test_spellings_met_in_files(spelling: str) -> None:
    assert half_life(spelling) == 20.364


@pytest.mark.parametrize("name", ["", "C12", "carbon", "C", "11", "F180", "18"])
def test_unknown_nuclide_names_the_known_ones(name: str) -> None:
    with pytest.raises(InputError, match=r"has no half-life here; use one of C11, "):
        half_life(name)


def test_decay_constant_halves_in_one_half_life() -> None:
    for name in NUCLIDES:
        assert math.exp(-decay_constant(name) * half_life(name)) == pytest.approx(0.5, rel=1e-12)


def test_every_half_life_has_a_source_that_states_it() -> None:
    for entry in NUCLIDES.values():
        assert "(" in entry.source
        assert 0 < entry.uncertainty < 0.02 * entry.half_life
