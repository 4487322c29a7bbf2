"""What `petkin fit` loads before it computes: nothing that takes long and is not needed yet."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

import petkin
from petkin_bench.problems import fit_problem
from petkin_bench.whole_image import write_image

#: Each takes a good part of a second to load, or is for other verbs.
_NOT_NEEDED = (
    *("torch", "torchdiffeq", "sympy", "matplotlib", "distributed"),
    *("scipy.special", "scipy.stats", "scipy.interpolate", "scipy.optimize", "scipy.ndimage"),
    *("petkin.effects", "petkin.phantoms", "petkin.hybrid", "petkin.diagnosis"),
)
#: Processor time from the first line of code to the first that fits; 1.5 s on a machine that was busy otherwise.
_AT_MOST_S = 4.0
_FIT = """
import json, sys, time
from pathlib import Path
from petkin.study.fit import fit_study
from petkin.study.request import FitRequest

said = []
def progress(step, done):
    said.append((step.rpartition(": ")[2], time.process_time(), sorted(sys.modules)))

folder = Path(sys.argv[1])
fit_study(
    FitRequest(
        target=folder / "pet.nii.gz", out=folder / "out", level="voxel", blood=(folder / "blood.tsv",),
        frames=folder / "frames.json", mask=folder / "mask.nii.gz", nuclide="F18", units="kBq/mL", delay=0.0,
    ),
    progress,
)
started = next(seconds for step, seconds, _ in said if step == "2TCM by voxel")
loaded = next(names for step, _, names in said if step == "writing")
print(json.dumps([started, loaded]))
"""


def test_a_voxel_fit_loads_no_more_than_it_needs(tmp_path: Path) -> None:
    mask = np.ones((5, 5, 5), np.bool_)
    write_image(tmp_path, fit_problem(voxels=mask.size, percent=5.0), mask)
    done = subprocess.run(
        [sys.executable, "-c", _FIT, str(tmp_path)],
        cwd=Path(petkin.__file__).parents[1],
        capture_output=True,
        text=True,
        check=True,
    )
    started, loaded = json.loads(done.stdout.splitlines()[-1])
    assert not set(_NOT_NEEDED) & set(loaded)
    assert started < _AT_MOST_S
