"""`--memory` bounds what the program holds, as the system counts it, and changes no byte of the results."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import petkin
from petkin_bench.problems import fit_problem
from petkin_bench.whole_image import write_image

_SHAPE = (128, 128, 48)
#: A process of its own, because the system counts what the one that starts another holds as that other's.
_MEASURE = """
import resource, subprocess, sys
done = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
sys.exit(done.returncode)
"""


def _fit(folder: Path, *more: str) -> tuple[int, str, float]:
    """Run the command in a process of its own: how it ended, what it said, and the most that it held, GiB."""
    options = {"blood": "blood.tsv", "frames": "frames.json", "mask": "mask.nii.gz", "out": "out"}
    files = [word for option, name in options.items() for word in (f"--{option}", str(folder / name))]
    options_of_image = ("--isotope", "F18", "--units", "kBq/mL", "--delay", "0", "--level", "voxel")
    done = subprocess.run(
        [
            *(sys.executable, "-c", _MEASURE),
            *(sys.executable, "-m", "petkin", "fit", str(folder / "pet.nii.gz"), *files),
            *(*options_of_image, "--model", "Patlak", "--again", *more),
        ],
        cwd=Path(petkin.__file__).parents[1],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    return done.returncode, done.stderr, float(done.stdout) / 2 ** (30 if sys.platform == "darwin" else 20)


def _image(folder: Path, shape: tuple[int, int, int] = _SHAPE) -> None:
    mask = np.ones(shape, np.bool_)
    problem = fit_problem(voxels=2048, percent=5.0)
    write_image(folder, replace(problem, curves=np.tile(problem.curves, (mask.size // 2048, 1))), mask)


def _least(folder: Path, *more: str) -> float:
    """The smallest limit that the command accepts, GiB."""
    status, said, _ = _fit(folder, "--memory", "1M", *more)
    assert status == 2
    least = re.search(r"give at least (\d+\.\d\d)G", said)
    assert least is not None
    return float(least.group(1)) + 0.01


def test_without_a_limit_a_large_image_takes_little_more_than_a_small_one(tmp_path: Path) -> None:
    """At most twice the 16 coefficients and the chi-square of every voxel, which are all that a fit looks at."""
    large, small = tmp_path / "large", tmp_path / "small"
    held = []
    for folder, shape in ((large, _SHAPE), (small, (16, 16, 8))):
        folder.mkdir()
        _image(folder, shape)
        _fit(folder)  # the first run compiles
        held.append(_fit(folder)[2])
    assert held[0] - held[1] <= 2 * 17 * 4 * np.prod(_SHAPE) / 2**30


def test_a_limit_holds_for_denoising_too(tmp_path: Path) -> None:
    _image(tmp_path)
    limit = _least(tmp_path, "--hypr", "6")
    assert limit > _least(tmp_path)
    status, _, held = _fit(tmp_path, "--hypr", "6", "--memory", f"{limit:.3f}G")
    assert status == 0
    assert held <= limit


def test_a_limit_is_kept_and_changes_nothing(tmp_path: Path) -> None:
    """All voxels of a fifth of a gigabyte of curves and maps, within what the program needs for a frame and a block."""
    _image(tmp_path)
    limit = _least(tmp_path)
    results = []
    for more in ((), ("--memory", f"{limit:.3f}G")):
        status, said, held = _fit(tmp_path, *more)
        assert (status, said) == (0, "")
        results.append({path.name: path.read_bytes() for path in (tmp_path / "out").rglob("*.*") if path.is_file()})
    assert held <= limit
    assert results[0] == results[1]
    assert not list(tmp_path.glob(".petkin-*"))
