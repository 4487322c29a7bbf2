"""`petkin fit` on a whole image, from compressed file to maps on disk."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray

from petkin.io import open_series, read_volume, write_map, write_series, write_table
from petkin.study.fit import fit_study
from petkin.study.request import FitRequest
from petkin_bench.problems import FitProblem, fit_problem
from petkin_bench.speed import as_read, petkin_fit
from petkin_bench.timing import measure

#: The series of the speed goal: 26 frames of int16, about a third of the voxels in the mask.
SHAPE = (128, 128, 64)
_SLOPE = 0.01


def measure_image(folder: Path, *, by_hand_cpu_us: float, shape: tuple[int, int, int] = SHAPE) -> dict[str, object]:
    """One row: read, fit 2TCM with standard errors in every voxel of the mask, write all maps and the report.

    Beside it, what the files alone cost: to decompress the image, and to write the same maps again. Compiled code is
    there already; what that takes is `measure_start`.

    Args:
        folder: where to write the image and the results.
        by_hand_cpu_us: processor time of the named baseline a voxel, measured in the same run.
        shape: voxels along x, y, z.
    """
    mask = _ellipsoid(shape)
    voxels = int(mask.sum())
    problem = fit_problem(voxels=voxels, percent=15.0)
    request = write_image(folder, problem, mask)
    curves = as_read(problem)
    fit = measure(lambda: petkin_fit(problem, curves), 3)
    whole = measure(lambda: fit_study(request), 1, warm_up=False)
    read = measure(lambda: _read(folder / "pet.nii.gz"), 3)
    maps = [(path.name, *read_volume(path)) for path in sorted((folder / "out").rglob("*_mimap.nii.gz"))]
    write = measure(lambda: _write_again(folder / "again", maps), 1, warm_up=False)
    return {
        "fit": "2TCM, file to maps",
        "frames": 26,
        "noise_percent": 15.0,
        "voxels": voxels,
        "voxels_per_s": voxels / whole.wall,
        "cpu_us_per_voxel": 1e6 * whole.cpu / voxels,
        "by_hand_cpu_us": by_hand_cpu_us,
        "ratio_cpu": by_hand_cpu_us * voxels / (1e6 * whole.cpu),
        "baseline": "scipy curve_fit, closed form, one process, nothing read or written",
        "maps": len(maps),
        "wall_s": whole.wall,
        "read_s": read.wall,
        "fit_s": fit.wall,
        "write_s": write.wall,
        "wall_over_files": whole.wall / (read.wall + write.wall),
    }


def _read(path: Path) -> None:
    for _ in open_series(path).frames():
        pass


def _write_again(folder: Path, maps: list[tuple[str, NDArray[np.float32], NDArray[np.float64]]]) -> None:
    folder.mkdir(exist_ok=True)
    for name, values, affine in maps:
        write_map(folder / name, values, affine, {})


def _ellipsoid(shape: tuple[int, int, int]) -> NDArray[np.bool_]:
    axes = np.meshgrid(*[np.linspace(-1, 1, n) for n in shape], indexing="ij")
    return np.sum([axis**2 for axis in axes], axis=0) < 0.87**2


def write_image(folder: Path, problem: FitProblem, mask: NDArray[np.bool_]) -> FitRequest:
    """A plain image of the problem's curves with its frames, blood and mask, and the request to fit it."""
    flat = mask.ravel(order="F")

    def frames():
        for values in problem.curves.T:
            frame = np.zeros(mask.size, np.float32)
            frame[flat] = values
            yield frame.reshape(mask.shape, order="F")

    schedule = problem.observation.frames
    write_series(folder / "pet.nii.gz", frames(), np.eye(4) * 2, count=len(schedule), slope=_SLOPE)
    write_map(folder / "mask.nii.gz", mask.astype(np.uint8), np.eye(4) * 2, {})
    times = {"FrameTimesStart": list(schedule.start * 60), "FrameDuration": list(schedule.duration * 60)}
    (folder / "frames.json").write_text(json.dumps(times))
    seconds = np.arange(0.0, 60.0 * schedule.end[-1] + 1)
    plasma = problem.arterial.plasma(torch.tensor(seconds / 60.0)).numpy()
    columns = {"time": seconds, "AIF": plasma, "whole_blood_radioactivity": plasma}
    write_table(folder / "blood.tsv", pd.DataFrame(columns))
    return FitRequest(
        target=folder / "pet.nii.gz",
        out=folder / "out",
        level="voxel",
        blood=(folder / "blood.tsv",),
        frames=folder / "frames.json",
        mask=folder / "mask.nii.gz",
        nuclide="F18",
        units="kBq/mL",
        delay=0.0,
        command_line="petkin-bench speed fit",
    )
