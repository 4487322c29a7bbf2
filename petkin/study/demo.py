"""`petkin demo`: the whole way from a simulated study to maps, errors and truth."""

from __future__ import annotations

from pathlib import Path

from petkin.study.fit import fit_study
from petkin.study.fit_scan import Progress
from petkin.study.outcome import Fitted
from petkin.study.request import FitRequest
from petkin.study.simulate import simulate
from petkin.study.simulation.settings import SimulationSettings

#: A reversible F-18 ligand in a 3-D brain, coarse enough for a laptop's minute.
_VOXEL_MM = 4.0
_NOISE_PERCENT = 5.0


def run_demo(out: Path, *, seed: int, command_line: str, progress: Progress) -> tuple[Fitted, ...]:
    """Simulate one subject at `out`, fit 1TCM and 2TCM by region and voxel, and report beside the truth.

    Raises:
        InputError: `out` holds something already, or cannot be written.
    """
    progress("simulating", 0.0)
    settings = SimulationSettings(
        out=out, phantom="brain3d", tracer="reversible", noise=_NOISE_PERCENT, voxel_size=_VOXEL_MM, seed=seed
    )
    simulate(settings)
    request = FitRequest(target=out, models=("1TCM", "2TCM"), command_line=command_line)
    return fit_study(request, lambda step, done: progress(step, 0.4 + 0.6 * done))
