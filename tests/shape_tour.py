"""Commands on a study of a few voxels, for the check of shapes in `array_shapes`; `test_shapes` runs it."""

from __future__ import annotations

from pathlib import Path

from .cli.conftest import run_command, study

__all__ = ["study"]


def done(*arguments: object) -> None:
    ran = run_command(*arguments)
    assert ran.status == 0, ran.err


def test_a_study_is_simulated(tmp_path: Path) -> None:
    made = tmp_path / "made"
    flags = ["--voxel-size", 8, "--frames", "6x60,8x300", "--psf", 6, "--voxel-spread"]
    effects = ["--effect", "arterial_delay=5", "--noise-fwhm", 6]
    done("simulate", "--out", made, "--truth-tacs", *flags, *effects)


def test_a_study_is_fitted(study: Path, tmp_path: Path) -> None:
    done(
        "fit",
        study,
        "--model",
        "Logan",
        "--delay",
        0,
        "--level",
        "region",
        "--t-star",
        10,
        "--out",
        tmp_path / "fitted",
    )
