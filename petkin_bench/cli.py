"""`petkin-bench`: measure, print, and keep what was measured."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from petkin.errors import PetkinError

app = typer.Typer(
    name="petkin-bench",
    help="Benchmarks of petkin against named baselines, measured in one run.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)
speed = typer.Typer(help="How fast, against what, and how good.", no_args_is_help=True)
app.add_typer(speed, name="speed")


@speed.callback()
def _speed() -> None:
    """How fast, against what, and how good."""


@speed.command("fit")
def speed_fit(
    voxels: Annotated[int, typer.Option(help="Curves that petkin fits, a problem.", min=1000)] = 100_000,
    by_hand: Annotated[int, typer.Option(help="Curves fitted by hand, a problem.", min=10)] = 200,
    threads: Annotated[int, typer.Option(help="Threads; 0 for all cores.", min=0)] = 0,
    quick: Annotated[bool, typer.Option("--quick", help="A small run that keeps nothing.")] = False,
) -> None:
    """Voxel fits with standard errors against scipy's curve_fit, in the same run, with the quality of both.

    A ratio is processor time by hand over processor time of petkin, a voxel. Rows are appended to
    petkin_bench/results/speed_fit.csv.
    """
    import tempfile

    import numba

    from petkin_bench.provenance import append_rows
    from petkin_bench.speed import measure_graphical, measure_model
    from petkin_bench.whole_image import SHAPE, measure_image

    if threads:
        numba.set_num_threads(min(threads, numba.get_num_threads()))
    if quick:
        voxels, by_hand = min(voxels, 20_000), min(by_hand, 30)
    problems = [("2TCM", 26, 15.0), ("2TCM", 26, 5.0), ("2TCM", 80, 15.0), ("2TCM3k", 26, 5.0), ("1TCM", 26, 5.0)]
    rows: list[dict[str, object]] = []
    for model, frames, percent in problems[:1] if quick else problems:
        row = measure_model(
            model, frames=frames, percent=percent, voxels=voxels, by_hand=by_hand, judged=min(by_hand, 200)
        )
        rows.append(row)
        typer.echo(_line(row))
    for label in ("Patlak", "Logan"):
        rows.append(measure_graphical(label, voxels=voxels))
        typer.echo(_line(rows[-1]))
    with tempfile.TemporaryDirectory() as folder:
        shape = (32, 32, 16) if quick else SHAPE
        rows.append(measure_image(Path(folder), by_hand_cpu_us=float(str(rows[0]["by_hand_cpu_us"])), shape=shape))
        typer.echo(_line(rows[-1]))
    if not quick:
        typer.echo(
            f"Appended to {append_rows('speed_fit', [row | {'threads': numba.get_num_threads()} for row in rows])}"
        )


@app.command()
def accuracy(
    data: Annotated[Path, typer.Option(help="Folder of the benchmark curves.", envvar="PETKIN_BENCH_DATA")],
) -> None:
    """Errors on the common benchmark curves, clean and noisy, beside what other programs reached on them.

    Rows are appended to petkin_bench/results/accuracy.csv.
    """
    from petkin_bench.accuracy import measure_accuracy
    from petkin_bench.provenance import append_rows

    rows = measure_accuracy(data)
    for row in rows:
        typer.echo(
            f"{row['set']:8} {row['curves']:6} {row['model']:7} {row['quantity']:4} median |error| "
            f"{row['median_error_percent']:9.4f} %  p90 {row['p90_error_percent']:9.4f} %  failed {row['failed']}"
            + (f"   others, clean / noisy: {row['others_clean_noisy']}" if row["others_clean_noisy"] else "")
        )
    typer.echo(f"Appended to {append_rows('accuracy', rows)}")


def _line(row: dict[str, object]) -> str:
    text = (
        f"{row['fit']:20} {row['frames']:3} frames {row['noise_percent']:4g} %  {row['voxels_per_s']:12,.0f} voxels/s  "
        f"{row['cpu_us_per_voxel']:8.2f} us CPU/voxel  {row['ratio_cpu']:8,.4g} x {row['baseline']}"
    )
    if "within_0.1_percent" in row:
        text += (
            f"  within 0.1 / 1 % of best: {row['within_0.1_percent']:.1f} / {row['within_1_percent']:.1f} % (by hand "
            f"{row['by_hand_within_0.1_percent']:.1f} / {row['by_hand_within_1_percent']:.1f} %)  "
            f"{row['outcome']} {row['bias_percent']:+.1f} +- {row['spread_percent']:.1f} %"
        )
    return text


def main() -> None:
    """Run the command line; a `PetkinError` becomes one line on standard error and exit status 2."""
    try:
        app()
    except PetkinError as error:
        print(f"petkin-bench: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(2)
