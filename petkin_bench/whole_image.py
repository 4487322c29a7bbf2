"""`petkin fit` on a whole image, from compressed file to maps on disk."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray

from petkin.io import write_map, write_series, write_table
from petkin.study.fit import fit_study
from petkin.study.request import FitRequest
from petkin_bench.problems import FitProblem, fit_problem

#: The series of the speed goal: 26 frames of int16, about a third of the voxels in the mask.
SHAPE = (128, 128, 64)
_SLOPE = 0.01


def measure_image(folder: Path, *, by_hand_cpu_us: float, shape: tuple[int, int, int] = SHAPE) -> dict[str, object]:
    """One row: read, fit 2TCM with standard errors in every voxel of the mask, write all maps and the report.

    Args:
        folder: where to write the image and the results.
        by_hand_cpu_us: processor time of the named baseline a voxel, measured in the same run.
        shape: voxels along x, y, z.
    """
    mask = _ellipsoid(shape)
    request = _write_image(folder, fit_problem(voxels=int(mask.sum()), percent=15.0), mask)
    wall, cpu = time.perf_counter(), time.process_time()
    fit_study(request)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    voxels = int(mask.sum())
    return {
        "fit": "2TCM, file to maps",
        "frames": 26,
        "noise_percent": 15.0,
        "voxels": voxels,
        "voxels_per_s": voxels / wall,
        "cpu_us_per_voxel": 1e6 * cpu / voxels,
        "by_hand_cpu_us": by_hand_cpu_us,
        "ratio_cpu": by_hand_cpu_us * voxels / (1e6 * cpu),
        "baseline": "scipy curve_fit, closed form, one process, nothing read or written",
    }


def _ellipsoid(shape: tuple[int, int, int]) -> NDArray[np.bool_]:
    axes = np.meshgrid(*[np.linspace(-1, 1, n) for n in shape], indexing="ij")
    return np.sum([axis**2 for axis in axes], axis=0) < 0.87**2


def _write_image(folder: Path, problem: FitProblem, mask: NDArray[np.bool_]) -> FitRequest:
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
