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
    by_hand: Annotated[int, typer.Option(help="Curves fitted by hand, a problem.", min=10)] = 400,
    threads: Annotated[int, typer.Option(help="Threads; 0 for all cores.", min=0)] = 0,
    quick: Annotated[bool, typer.Option("--quick", help="A small run that keeps nothing.")] = False,
    data: Annotated[
        Path | None,
        typer.Option(help="Folder of the common benchmark curves, for their errors too.", envvar="PETKIN_BENCH_DATA"),
    ] = None,
) -> None:
    """Voxel fits with standard errors against scipy's curve_fit, in the same run, with the quality of both.

    A ratio is processor time by hand over processor time of petkin, a voxel. Quality is judged on the curves that are
    fitted by hand. Rows are appended to petkin_bench/results/speed_fit.csv, and with --data to accuracy.csv.
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


@speed.command("train")
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


@app.command()
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


@app.command()
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

    if table == "pet":
        _run_pet(preset, seeds, dynamics, work, results)
        return

    from petkin.cli.progress import progress_bar
    from petkin.errors import NumericalError
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
                    rows = run_job(job, chosen, work=work, results=folder, progress=told, episodes=shared)
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


@app.command()
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


@app.command()
def diagnose(
    system: Annotated[str, typer.Option(help="pendulum, mass_spring or bouncing_ball.")],
    effect: Annotated[str | None, typer.Option(help="NAME or NAME=SHARE of its range; default: the catalogue.")] = None,
    trials: Annotated[int, typer.Option(help="Runs from starts of their own.", min=1)] = 3,
    noise: Annotated[float, typer.Option(help="Of a place, in units of the picture's half.", min=1e-6)] = 0.01,
    seed: Annotated[int, typer.Option(help="Of starts, parameters and noise.", min=0)] = 0,
    single_flight: Annotated[bool, typer.Option("--single-flight", help="Watch briefly, without walls.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for the answer about one effect.")] = None,
) -> None:
    """Put one effect into runs of a physics system and ask the engine of `petkin diagnose` what is missing.

    With --effect, one case whose answer is printed (and written); without, every effect of the catalogue at half of its
    range and as many runs without any, appended to petkin_bench/results/moving_bodies.csv.
    """
    from petkin_bench.gaps import find_body, withheld
    from petkin_bench.provenance import append_rows

    body = withheld.single_flight(find_body(system)) if single_flight else find_body(system)
    if effect is None:
        rows = withheld.measure_body(body, share=0.5, trials=trials, noise=noise, seed=seed)
        for row in rows:
            typer.echo(f"{row['effect'] or 'nothing':20} d' {row['d_prime']:8}  {row['kind']:10} {row['set']}")
        typer.echo(f"Appended to {append_rows('moving_bodies', [row | {'seed': seed} for row in rows])}")
        return
    answer = withheld.one_case(body, effect, trials=trials, noise=noise, seed=seed)
    typer.echo(answer["verdict"]["sentence"])
    if out is not None:
        from petkin.io import json_text, write_text

        out.mkdir(parents=True, exist_ok=True)
        write_text(out / f"{answer['subject']}_desc-gap_report.json", json_text(answer))


@app.command("real-scans")
def real_scans(
    data: Annotated[Path, typer.Option(help="PET-BIDS study with regional curves and blood.")],
    subject: Annotated[list[str] | None, typer.Option(help="Only this subject; repeatable.")] = None,
    seg: Annotated[str | None, typer.Option(help="Which table of curves, by its seg- label.")] = None,
    seed: Annotated[int, typer.Option(help="Of blunders, twins and draws.", min=0)] = 0,
) -> None:
    """Withhold effects from the simulator, and put blunders into the curves, of real scans; ask what is missing.

    Rows are appended to petkin_bench/results/real_scans.csv.
    """
    import pandas as pd

    from petkin_bench.provenance import append_rows
    from petkin_bench.real_scans import measure_real, summary

    rows = measure_real(data, subjects=tuple(subject or ()), seg=seg, seed=seed)
    typer.echo(pd.DataFrame(summary(rows)).to_string(index=False))
    typer.echo(f"Appended to {append_rows('real_scans', [row | {'seed': seed} for row in rows])}")


@app.command()
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


@app.command()
def withheld(
    cases: Annotated[int, typer.Option(help="Scans; those with a verdict are not judged again.", min=1)] = 150,
    seed: Annotated[int, typer.Option(help="Of the scans; splits never share one.", min=0)] = 0,
    split: Annotated[str, typer.Option(help="scored, or training for calibration.")] = "scored",
    regions: Annotated[int, typer.Option(help="A scan.", min=2)] = 5,
    draws: Annotated[int, typer.Option(help="Noise draws of each diagnosis.", min=20)] = 400,
    workers: Annotated[int, typer.Option(help="Processes.", min=1)] = 1,
    work: Annotated[Path, typer.Option(help="Folder of verdicts and answers.")] = Path("bench-withheld"),
    results: Annotated[
        Path | None, typer.Option(help="Folder for the metrics, as withheld.csv; default: none.")
    ] = None,
) -> None:
    """Blind check of `petkin diagnose`: effects withheld from the simulator, made by a generator of its own.

    Verdicts are appended as they come, each with the digest of its answer; answers lie in a file of their own. They
    are scored when all verdicts are there.
    """
    from petkin_bench.provenance import append_rows
    from petkin_bench.withheld.run import Plan, run
    from petkin_bench.withheld.score import joined, metrics, text_of

    plan = Plan(split, seed, cases, regions, draws)
    found = metrics(joined(*run(plan, work, workers=workers, told=lambda n: typer.echo(f"{n} judged", err=True))))
    typer.echo(text_of(found))
    if results is not None:
        settings = {"split": split, "seed": seed, "scans": cases, "regions": regions, "draws": draws}
        rows = [settings | {"metric": m.name, "value": m.value, "cases": m.cases, "bar": m.bar} for m in found]
        typer.echo(f"Appended to {append_rows('withheld', rows, results)}")


def main() -> None:
    """Run the command line; a `PetkinError` becomes one line on standard error and exit status 2."""
    try:
        app()
    except PetkinError as error:
        print(f"petkin-bench: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(2)
