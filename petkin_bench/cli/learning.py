"""Systems known in part: their tables, their speed, forecasts of real curves."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def run(
    table: Annotated[str, typer.Option(help="hybrid, strategy or pet.")] = "hybrid",
    system: Annotated[str | None, typer.Option(help="Only this system; default: all of the table.")] = None,
    preset: Annotated[str, typer.Option(help="tiny, cpu or paper.")] = "cpu",
    seeds: Annotated[int, typer.Option(help="Runs a row, seeds 0, 1, ...", min=1)] = 1,
    dynamics: Annotated[str | None, typer.Option(help="Only this way of modelling, e.g. meta_hylad.")] = None,
    decoder: Annotated[
        str, typer.Option(help="What makes pictures of states: physics, neural_prior, neural or adaptive.")
    ] = "physics",
    episodes: Annotated[
        int, typer.Option(help="Episodes a step, shared by torchrun's processes; 0 for one a process.", min=0)
    ] = 0,
    device: Annotated[str, typer.Option(help="cpu, cuda, cuda:1, ...; default: a GPU where there is one.")] = "",
    work: Annotated[Path, typer.Option(help="Folder of the checkpoints.")] = Path("bench-runs"),
    results: Annotated[Path | None, typer.Option(help="Folder of the result files; default: the package's.")] = None,
) -> None:
    """Train and measure the models of a table; what has its rows is not done again, what was stopped goes on.

    `torchrun --nproc-per-node N -m petkin_bench run ...` trains each model with N processes.

    Rows are appended to learning.csv (learning_pet.csv). `petkin-bench tables` prints them beside the published ones.
    """
    from contextlib import nullcontext
    from functools import partial

    import torch

    from petkin.errors import InputError, NumericalError
    from petkin.fitting import find_device

    if table == "pet":
        if device:
            raise InputError(f"--device {device}: the pet table is trained on the processor; leave --device out.")
        _run_pet(preset, seeds, dynamics, work, results)
        return
    if device:
        find_device(device)

    from petkin.cli.progress import progress_bar
    from petkin.hybrid import device as own_device
    from petkin.hybrid import place, processes
    from petkin_bench.protocol import find_preset, jobs
    from petkin_bench.provenance import RESULTS
    from petkin_bench.training import done, key, run_job

    torch.set_num_threads(1)
    folder, chosen = results or RESULTS, find_preset(preset)
    planned = [job for job in jobs(table, system, seeds, decoder) if dynamics in (None, job.dynamics)]
    finished = done(folder)
    left, died = [job for job in planned if key(job, chosen) not in finished], []
    with processes() as count:
        first = place()[0] == 0
        if first:
            typer.echo(f"{len(planned)} runs, {len(planned) - len(left)} of them done.")
        for job in left:
            with progress_bar() if first else nullcontext(lambda label, share: None) as step:
                told, shared = partial(step, job.label), episodes or count
                try:
                    rows = run_job(
                        job,
                        chosen,
                        work=work,
                        results=folder,
                        progress=told,
                        episodes=shared,
                        device=device or own_device(),
                    )
                except NumericalError as failure:
                    typer.echo(f"{job.label}: {failure}", err=True)
                    rows, died = [], [*died, job.label]
            for row in rows:
                typer.echo(f"{job.label} {row['split']} {row['test']}: MSE x {row['mse_x']:.3g}, z {row['mse_z']:.3g}")
    if died:
        raise NumericalError(f"{len(died)} of {len(left)} runs have no rows: {', '.join(died)}.")


def _run_pet(preset: str, seeds: int, model: str | None, work: Path, results: Path | None) -> None:
    from functools import partial

    import torch

    from petkin.cli.progress import progress_bar
    from petkin_bench.pet import find_preset, finished, pet_jobs, run_pet_job
    from petkin_bench.provenance import RESULTS

    torch.set_num_threads(1)
    folder, chosen = results or RESULTS, find_preset(preset)
    planned, there = pet_jobs(seeds, model), finished(folder)
    left = [job for job in planned if job.key(chosen) not in there]
    typer.echo(f"{len(planned)} runs, {len(planned) - len(left)} of them done.")
    for job in left:
        with progress_bar() as step:
            rows = run_pet_job(job, chosen, work=work, results=folder, progress=partial(step, job.label))
        for row in rows:
            what = f"{row['split']}, noise {row['noise_test']:g} %, told by {row['test']}"
            typer.echo(f"{job.label} {what}: MSE z {row['mse_z']:.3g}, PSNR {row['psnr_x']:.3g}")


def tables(
    results: Annotated[Path | None, typer.Option(help="Folder of the result files; default: the package's.")] = None,
    preset: Annotated[str, typer.Option(help="Rows of this preset.")] = "cpu",
    pictures: Annotated[Path | None, typer.Option(help="Folder for a picture of every run in --work.")] = None,
    work: Annotated[Path, typer.Option(help="Folder of the checkpoints.")] = Path("bench-runs"),
) -> None:
    """Print the learning tables beside the published ones, with the ratio; draw what was learned."""
    from petkin_bench.learning_tables import print_tables
    from petkin_bench.pet_tables import print_pet
    from petkin_bench.provenance import RESULTS

    print_tables(results or RESULTS, preset)
    print_pet(results or RESULTS, preset)
    if pictures is not None:
        from petkin_bench.pictures import write_pictures
        from petkin_bench.protocol import find_preset

        for path in write_pictures(work, pictures, find_preset(preset)):
            typer.echo(path)


def speed_train(
    steps: Annotated[int, typer.Option(help="Steps of preset cpu; 0 for all of them.", min=0)] = 0,
    paper_steps: Annotated[
        int, typer.Option(help="Steps at most to count how many the paper's form needs.", min=3)
    ] = 20_000,
    naive_steps: Annotated[int, typer.Option(help="Steps that a naive step is timed on.", min=3)] = 12,
    quick: Annotated[bool, typer.Option("--quick", help="A few steps of each; keeps nothing.")] = False,
) -> None:
    """Training against the paper's form done naively: processor time of a step, and to the paper's accuracy.

    Rows are appended to petkin_bench/results/speed_train.csv.
    """
    import torch

    from petkin_bench.provenance import append_rows
    from petkin_bench.speed_train import measure_pendulum
    from petkin_bench.speed_train_pet import measure_pet
    from petkin_bench.tables import print_training

    torch.set_num_threads(1)
    if quick:
        steps, paper_steps, naive_steps = 12, 6, 3
    rows = []
    for problem in (measure_pet, measure_pendulum):
        rows += problem(steps=steps, paper_steps=paper_steps, naive_steps=naive_steps)
    print_training(rows)
    if not quick:
        typer.echo(f"Appended to {append_rows('speed_train', rows)}")


def forecast(
    data: Annotated[Path, typer.Option(help="PET-BIDS study with regional curves and blood.")],
    seg: Annotated[str | None, typer.Option(help="Which table of curves, by its seg- label.")] = None,
    session: Annotated[list[str] | None, typer.Option(help="Only this session; repeatable.")] = None,
    results: Annotated[Path | None, typer.Option(help="Folder of the result files; default: the package's.")] = None,
) -> None:
    """Forecast the withheld later half of real curves, each person by what the scans of the others teach.

    Rows are appended to petkin_bench/results/forecast.csv.
    """
    import torch

    from petkin.cli.progress import progress_bar
    from petkin_bench.forecast import measure_forecasts, read_scans, summary
    from petkin_bench.provenance import RESULTS, append_rows

    torch.set_num_threads(1)
    with progress_bar() as step:
        rows = []
        for some in measure_forecasts(read_scans(data, seg, tuple(session or ())), step):
            append_rows("forecast", [row | {"study": data.resolve().name} for row in some], results or RESULTS)
            rows += some
    typer.echo(summary(rows).to_string())
