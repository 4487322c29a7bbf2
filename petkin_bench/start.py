"""What a run costs before it computes: starting the program, and compiling it once."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from petkin_bench.problems import fit_problem
from petkin_bench.whole_image import write_image

_VOXELS = (6, 6, 6)
#: The same study as typed below, saying when the first voxels are fitted.
_TELLING = """
import sys, time
import petkin.cli.app
import petkin.study.fit as study

fit_study = study.fit_study

def told(request, progress, execution):
    def step(name, done):
        if name.endswith(" by voxel"):
            print(time.time(), flush=True)
        progress(name, done)
    return fit_study(request, step, execution)

study.fit_study = told
petkin.cli.app.main()
"""


def measure_start(folder: Path) -> dict[str, object]:
    """One row: `petkin fit` on an image of 216 voxels in a fresh process, without compiled code, with it (to where it
    begins to compute, and to its end), and typed again, when all is read and looked at but nothing is left to fit.

    Args:
        folder: where to write the image, the results and the compiled code.
    """
    mask = np.ones(_VOXELS, np.bool_)
    request = write_image(folder, fit_problem(voxels=mask.size, percent=5.0), mask)
    typed = [
        *("fit", str(request.target), "--blood", str(folder / "blood.tsv")),
        *("--frames", str(request.frames), "--mask", str(request.mask), "--isotope", "F18", "--units", "kBq/mL"),
        *("--delay", "0", "--level", "voxel", "--out", str(folder / "out")),
    ]
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder / "compiled")}
    petkin = [sys.executable, "-m", "petkin"]
    first, second, again = (_wall([*petkin, *typed, *more], environment) for more in ((), ("--again",), ()))
    computing = _until_told([sys.executable, "-c", _TELLING, *typed, "--again"], environment)
    return {
        "fit": "2TCM, start alone",
        "frames": 26,
        "noise_percent": 5.0,
        "voxels": mask.size,
        "wall_s": second,
        "computing_after_s": computing,
        "first_run_s": first,
        "nothing_to_fit_s": again,
        "help_s": _wall([*petkin, "--help"], environment),
        "baseline": "none: a fresh process, compiled code cached",
    }


def _wall(command: list[str], environment: dict[str, str]) -> float:
    start = time.perf_counter()
    subprocess.run(command, env=environment, check=True, capture_output=True)
    return time.perf_counter() - start


def _until_told(command: list[str], environment: dict[str, str]) -> float:
    start = time.time()
    done = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    return float(done.stdout.split()[0]) - start
