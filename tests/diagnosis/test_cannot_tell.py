"""What no curve can tell is said in every answer: exactly unidentifiable effects and pairs, over many designs.

A scale of the input is taken up by K1 (and by the volume of blood); the clock of the frames and the delay of the blood
move the same curves against each other; a wrong half-life and a drift of the scanner both grow slowly in all regions.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from petkin.diagnosis.diagnose import foresee_design
from petkin.effects import EFFECTS, effect_named
from petkin.study.diagnosis.answer import cannot_tell
from petkin.study.diagnosis.hypotheses import hypotheses
from petkin.study.diagnosis.regional import RegionalSimulator

from . import independent_scan as scan
from .test_withheld import simulator_of

SEEDS = range(7)
#: Exactly or nearly the same whatever the scan, by what the simulator has.
TIMED, UNTIMED = ("blood_volume", "arterial_delay"), ("blood_volume",)


@cache
def design(seed: int, includes: tuple[str, ...]) -> tuple[frozenset[frozenset[str]], frozenset[str]]:
    """Pairs and single effects under `cannot_tell` of a scan with noise of 1 to 4 percent."""
    rng = np.random.default_rng(9000 + seed)
    truth = scan.draw(rng)
    simulator: RegionalSimulator = replace(simulator_of(truth), includes=tuple(effect_named(name) for name in includes))
    data = scan.noisy(scan.curves(truth), rng, percent=float(rng.uniform(1.0, 4.0)), share=0.3 * (seed % 3))
    visible = foresee_design(simulator, data, hypotheses(EFFECTS, simulator, without=frozenset()))
    listed = [frozenset(entry["effects"]) for entry in cannot_tell(visible, simulator)]
    return frozenset(n for n in listed if len(n) > 1), frozenset().union(*(n for n in listed if len(n) == 1))


def listed(seed: int, includes: tuple[str, ...], names: tuple[str, ...]) -> bool:
    """Whether the effects are named together, or each as one that cannot be seen."""
    pairs, singles = design(seed, includes)
    return frozenset(names) in pairs or set(names) <= singles


@pytest.mark.parametrize(
    ("includes", "names"),
    [
        (TIMED, ("input_scale",)),
        (UNTIMED, ("input_scale",)),
        (TIMED, ("frame_offset",)),
        (UNTIMED, ("arterial_delay", "frame_offset")),
        (TIMED, ("gain_drift", "half_life_error")),
        (UNTIMED, ("gain_drift", "half_life_error")),
    ],
)
def test_what_nothing_can_split_is_listed(includes: tuple[str, ...], names: tuple[str, ...]) -> None:
    assert np.mean([listed(seed, includes, names) for seed in SEEDS]) >= 0.95
