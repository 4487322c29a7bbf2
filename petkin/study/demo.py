"""`petkin demo`: the whole way from a simulated study to maps, errors and truth, and to what a lesser model misses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from petkin.study.diagnose import Diagnosed, diagnose_study
from petkin.study.diagnosis.request import DiagnoseRequest
from petkin.study.fit import fit_study
from petkin.study.fit_scan import Progress
from petkin.study.outcome import Fitted
from petkin.study.request import FitRequest
from petkin.study.simulate import simulate
from petkin.study.simulation.settings import SimulationSettings

#: A reversible F-18 ligand in a 3-D brain, coarse enough for a laptop's minute.
_VOXEL_MM = 4.0
_NOISE_PERCENT = 5.0


@dataclass(frozen=True)
class Demonstrated:
    """The fits of the study, and what a one-tissue simulator misses in it."""

    fitted: tuple[Fitted, ...]
    diagnosed: tuple[Diagnosed, ...]


def run_demo(out: Path, *, seed: int, command_line: str, progress: Progress) -> Demonstrated:
    """Simulate one subject at `out`, fit 1TCM and 2TCM by region and voxel, and ask what 1TCM lacks.

    Raises:
        InputError: `out` holds something already, or cannot be written.
    """
    progress("simulating", 0.0)
    settings = SimulationSettings(
        out=out, phantom="brain3d", tracer="reversible", noise=_NOISE_PERCENT, voxel_size=_VOXEL_MM, seed=seed
    )
    simulate(settings)
    request = FitRequest(target=out, models=("1TCM", "2TCM"), command_line=command_line)
    fitted = fit_study(request, lambda step, done: progress(step, 0.4 + 0.5 * done))
    return Demonstrated(fitted, ask_one_tissue(out, command_line, lambda step, done: progress(step, 0.9 + 0.1 * done)))


def ask_one_tissue(study: Path, command_line: str, progress: Progress) -> tuple[Diagnosed, ...]:
    """What a simulator of one tissue compartment, blood and its delay misses in a study.

    Raises:
        InputError: the study cannot be diagnosed.
    """
    request = DiagnoseRequest(
        study, model="1TCM", include=("blood_volume", "arterial_delay"), command_line=command_line
    )
    return diagnose_study(request, progress)
