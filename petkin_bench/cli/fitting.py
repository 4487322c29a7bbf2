"""Speed and accuracy of fits."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def speed_fit(
    voxels: Annotated[int, typer.Option(help="Curves that petkin fits, a problem.", min=1000)] = 370_000,
    by_hand: Annotated[int, typer.Option(help="Curves fitted by hand, a problem.", min=10)] = 400,
    threads: Annotated[int, typer.Option(help="Threads; 0 for all cores.", min=0)] = 0,
    quick: Annotated[bool, typer.Option("--quick", help="A small run that keeps nothing.")] = False,
    data: Annotated[
        Path | None,
        typer.Option(help="Folder of the common benchmark curves, for their errors too.", envvar="PETKIN_BENCH_DATA"),
    ] = None,
) -> None:
    """Voxel fits with standard errors against scipy's curve_fit, in the same run, with the quality of both.

    A ratio is processor time by hand over processor time of petkin, a voxel, one thread each. Quality is judged on the
    curves that are fitted by hand. Rows go to petkin_bench/results/speed_fit.csv, and with --data to accuracy.csv.
    """
    import numba

    from petkin_bench.problems import SEED_NOISE, SEED_TRUTH
    from petkin_bench.provenance import append_rows
    from petkin_bench.tables import print_speed

    if threads:
        numba.set_num_threads(min(threads, numba.get_num_threads()))
    if quick:
        voxels, by_hand = min(voxels, 20_000), min(by_hand, 40)
    rows = _speed_rows(voxels, by_hand, quick=quick)
    print_speed(rows)
    if not quick:
        settings = {"threads": numba.get_num_threads(), "seeds": f"{SEED_TRUTH} {SEED_NOISE}", "judged": by_hand}
        typer.echo(f"Appended to {append_rows('speed_fit', [row | settings for row in rows])}")
    if data is not None:
        accuracy(data)


def _speed_rows(voxels: int, by_hand: int, *, quick: bool) -> list[dict[str, object]]:
    import tempfile

    from petkin_bench.graphical import measure_graphical
    from petkin_bench.reference import measure_reference
    from petkin_bench.speed import PROBLEMS, measure_model
    from petkin_bench.start import measure_start
    from petkin_bench.whole_image import SHAPE, measure_image

    rows: list[dict[str, object]] = []
    for model, frames, percent in PROBLEMS[:1] if quick else PROBLEMS:
        typer.echo(f"{model}, {frames} frames, {percent:g} % ...", err=True)
        rows.append(
            measure_model(model, frames=frames, percent=percent, voxels=voxels, by_hand=by_hand, judged=by_hand)
        )
    rows += [measure_graphical(label, voxels=voxels) for label in ("Patlak", "Logan", "MA1")]
    rows += [measure_reference(label, voxels=voxels) for label in ("SRTM", "MRTM1", "LoganRef")]
    typer.echo("a whole image ...", err=True)
    with tempfile.TemporaryDirectory() as folder:
        shape = (32, 32, 16) if quick else SHAPE
        rows.append(measure_image(Path(folder), by_hand_cpu_us=float(str(rows[0]["by_hand_cpu_us"])), shape=shape))
    if not quick:
        typer.echo("start and compilation ...", err=True)
        with tempfile.TemporaryDirectory() as folder:
            rows.append(measure_start(Path(folder)))
    return rows


def accuracy(
    data: Annotated[Path, typer.Option(help="Folder of the benchmark curves.", envvar="PETKIN_BENCH_DATA")],
) -> None:
    """Errors on the common benchmark curves, clean and noisy, beside what other programs reached on them.

    Rows are appended to petkin_bench/results/accuracy.csv.
    """
    from petkin_bench.accuracy import measure_accuracy
    from petkin_bench.provenance import append_rows
    from petkin_bench.tables import print_accuracy

    rows = measure_accuracy(data)
    print_accuracy(rows)
    typer.echo(f"Appended to {append_rows('accuracy', rows)}")
