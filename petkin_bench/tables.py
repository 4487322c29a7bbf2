"""Results as tables for a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich.console import Console
from rich.table import Table

Row = Mapping[str, object]

#: Narrower, the speed table cannot be read.
_WIDTH = 190
_COLUMNS = (
    *("voxels/s", "us", "no errors", "by hand", "ratio", "product"),
    *("best", "by hand: best", "error", "by hand: error", "others, curves/s"),
)
#: Curves a second and thread of other programs on the common benchmark curves (46 frames), as measured on one machine.
PEERS = {
    "1TCM": "KMAP-C 1,230-1,450; PETPAL 280; kinfitr 8",
    "2TCM": "KMAP-C 121-133; PETPAL 100-185; kinfitr 5",
    "2TCM3k": "KMAP-C 410-437; kinfitr 9",
    "Patlak": "nifti_dynamic 1.1-4.2 M; PETPAL 225 k; kinfitr 31",
    "Logan": "PETPAL 216 k; kinfitr 32",
    "MA1": "kinfitr 50",
    "SRTM": "NiftyPAD 2.8 k (basis); dynamicpet 140, 9 k (linear); PETPAL 100; kinfitr 16",
    "MRTM1": "NiftyPAD 1.5 k; kinfitr 35",
    "LoganRef": "dynamicpet 17 k; NiftyPAD 1 k; kinfitr 133",
}


def print_speed(rows: Sequence[Row]) -> None:
    """One line a problem: speed, then quality, by hand beside petkin, then what others were measured to do."""
    console = Console()
    console = Console(width=max(console.width, _WIDTH))
    table = _table(
        "Processor time a voxel with standard errors on one thread, voxels/s by the clock on all; "
        "percent within 0.1 / 1 % of the best; median error +- robust spread, percent"
    )
    for name in _COLUMNS:
        table.add_column(name, justify="right")
    for row in rows:
        if "voxels_per_s" in row:
            table.add_row(_name(row), *_speed(row), *_quality(row), PEERS.get(str(row["fit"]), ""))
    console.print(table)
    for line in _remarks(rows):
        console.print(line)


def print_training(rows: Sequence[Row]) -> None:
    """A step of ours against a naive one, and the time to the published accuracy."""
    table = Table(title="Training, processor time; both forms predict 64 queries a step", title_justify="left")
    names = ("problem", "step, ms", "naive", "ratio", "data, %", "to accuracy, s", "naive, projected", "ratio ")
    for name in names:
        table.add_column(name, justify="left" if name == "problem" else "right")
    console = Console()
    console = Console(width=max(console.width, _WIDTH))
    for row in rows:
        steps = (_number(row, key, ".1f") for key in ("step_cpu_ms", "naive_step_cpu_ms", "ratio_step", "data_percent"))
        keys = ("cpu_s_to_accuracy", "naive_cpu_s_to_accuracy", "ratio_to_accuracy")
        reached = (_number(row, key, ".0f") if row.get(key, "") != "" else "" for key in keys)
        table.add_row(str(row["problem"]), *steps, *reached)
    console.print(table)
    for row in rows:
        if "naive_projected" in row:
            target, best = _number(row, "target_mse_z", ".2g"), row["best_mse_z"]
            Console().print(
                f"{row['problem']}: accuracy is MSE z {target}; best here {best}. {row['naive_projected']}."
            )


def print_accuracy(rows: Sequence[Row]) -> None:
    """Errors on the common curves, beside what others reached."""
    table = Table(title="Common benchmark curves, errors in percent", title_justify="left")
    for name in ("set", "curves", "model", "quantity", "median |error|", "p90", "failed", "others, clean / noisy"):
        table.add_column(name, justify="right" if name in ("median |error|", "p90", "failed") else "left")
    for row in rows:
        errors = (_number(row, "median_error_percent", ".4f"), _number(row, "p90_error_percent", ".4f"))
        names = (str(row[key]) for key in ("set", "curves", "model", "quantity"))
        table.add_row(*names, *errors, str(row["failed"]), str(row["others_clean_noisy"]))
    Console().print(table)


def _table(title: str) -> Table:
    table = Table(title=title, title_justify="left")
    table.add_column("fit", no_wrap=True)
    return table


def _name(row: Row) -> str:
    return f"{row['fit']}, {row['frames']} fr, {_number(row, 'noise_percent', 'g')} %"


def _speed(row: Row) -> list[str]:
    return [
        _number(row, "voxels_per_s", ",.0f"),
        _number(row, "cpu_us_per_voxel", ".2f"),
        _number(row, "cpu_us_without_errors", ".2f"),
        _number(row, "by_hand_cpu_us", ",.0f"),
        _number(row, "ratio_cpu", ",.0f"),
        _number(row, "product_cpu_us", ".3f"),
    ]


def _quality(row: Row) -> list[str]:
    outcome = str(row.get("outcome", ""))
    return [
        _pair(row, "within_0.1_percent", "within_1_percent", "{} / {}"),
        _pair(row, "by_hand_within_0.1_percent", "by_hand_within_1_percent", "{} / {}"),
        _pair(row, "bias_percent", "spread_percent", outcome + " {} +- {}"),
        _pair(row, "by_hand_bias_percent", "by_hand_spread_percent", "{} +- {}"),
    ]


def _remarks(rows: Sequence[Row]) -> list[str]:
    lines = []
    for row in rows:
        if "numpy_cpu_us" in row:
            keys = ("cpu_us_per_voxel", "numpy_cpu_us", "product_cpu_us")
            ours, same, bare = (_number(row, key, ".3f") for key in keys)
            lines.append(
                f"{row['fit']}: {ours} us a voxel; numpy that delivers the same estimates, residuals, errors and "
                f"finite curves takes {same}, the bare product (two unknowns, nothing else) {bare}."
            )
        if "scan_cpu_us" in row:
            lines.append(
                f"{row['fit']}: of its {_number(row, 'cpu_us_per_voxel', '.2f')} us a voxel, "
                f"{_number(row, 'scan_cpu_us', '.2f')} are for what a scan shares, whatever the number of its voxels."
            )
        if "wall_over_files" in row:
            whole, read, fit, write = (_number(row, key, ".2f") for key in ("wall_s", "read_s", "fit_s", "write_s"))
            lines.append(
                f"{row['fit']}: {whole} s for {row['maps']} maps and a report; reading the image takes {read} s, the "
                f"fit {fit} s, writing the maps {write} s: {_number(row, 'wall_over_files', '.1f')} x the files alone."
            )
        if "first_run_s" in row:
            keys = ("computing_after_s", "wall_s", "first_run_s", "help_s")
            computing, wall, first, text = (_number(row, key, ".1f") for key in keys)
            lines.append(
                f"Start: a fresh process computes after {computing} s and has fitted {row['voxels']} voxels and "
                f"written maps after {wall} s, the first time, compiling, after {first} s; --help takes {text} s."
            )
    return lines


def _number(row: Row, key: str, form: str) -> str:
    return format(float(str(row[key])), form) if key in row else ""


def _pair(row: Row, first: str, second: str, form: str) -> str:
    return form.format(_number(row, first, ".1f"), _number(row, second, ".1f")) if first in row else ""
