"""Blind checks of the diagnosis."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def diagnose(
    system: Annotated[str, typer.Option(help="pendulum, mass_spring, bouncing_ball, double_pendulum or rigid_body.")],
    effect: Annotated[str | None, typer.Option(help="NAME or NAME=SHARE of its range; default: the catalogue.")] = None,
    runs: Annotated[
        Path | None,
        typer.Option(help="Runs of your own: a CSV with trial, frame, point, x, y (x, y in halves of the picture)."),
    ] = None,
    trials: Annotated[int, typer.Option(help="Runs from starts of their own.", min=1)] = 3,
    noise: Annotated[float, typer.Option(help="Of a place, in units of the picture's half.", min=1e-6)] = 0.01,
    seed: Annotated[int, typer.Option(help="Of starts, parameters and noise.", min=0)] = 0,
    single_flight: Annotated[bool, typer.Option("--single-flight", help="Watch briefly, without walls.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for the answer about one effect, and for its runs.")] = None,
) -> None:
    """Ask the engine of `petkin diagnose` what is missing in the law, the camera or the clock of a physics system.

    With --runs, of places that you give; with --effect, of runs with one effect in them: the answer is printed (and
    written, as JSON and a page, with the runs as --runs reads them). Without either, every effect of the catalogue at
    half of its range and as many runs without any, appended to petkin_bench/results/moving_bodies.csv.
    """
    from petkin.cli.progress import progress_bar
    from petkin.errors import InputError
    from petkin.io import json_text, write_text
    from petkin_bench.gaps import MovingBodies, find_body
    from petkin_bench.gaps import runs as moving
    from petkin_bench.provenance import append_rows

    body = moving.single_flight(find_body(system)) if single_flight else find_body(system)
    if runs is not None and effect is not None:
        raise InputError("--runs and --effect: give one of them.")
    if runs is None and effect is None:
        with progress_bar() as bar:
            rows = moving.measure_body(body, share=0.5, trials=trials, noise=noise, seed=seed, progress=bar)
        for row in rows:
            typer.echo(f"{row['effect'] or 'nothing':20} d' {row['d_prime']:8}  {row['kind']:10} {row['set']}")
        typer.echo(f"Appended to {append_rows('moving_bodies', [row | {'seed': seed} for row in rows])}")
        return
    if runs is not None:
        body, data = moving.read_runs(runs, body)
    else:
        data = moving.one_effect(body, str(effect), trials=trials, noise=noise, seed=seed)
    with progress_bar() as bar:
        found, answer = moving.answer_about(body, data, seed=seed, progress=bar)
    typer.echo(answer["verdict"]["sentence"])
    if out is not None:
        from petkin_bench.gaps.page import render_body_page

        report = out / f"{answer['subject']}_desc-gap_report.json"
        write_text(report, json_text(answer))
        write_text(report.with_suffix(".html"), render_body_page(MovingBodies(body, data), found, answer))
        if runs is None:
            write_text(out / f"{answer['subject']}_runs.csv", moving.written_runs(body, data))


def real_scans(
    data: Annotated[Path, typer.Option(help="PET-BIDS study with regional curves and blood.")],
    subject: Annotated[list[str] | None, typer.Option(help="Only this subject; repeatable.")] = None,
    seg: Annotated[str | None, typer.Option(help="Which table of curves, by its seg- label.")] = None,
    case: Annotated[
        list[str] | None, typer.Option(help="Only this case, e.g. vascular_trapping or delay+10s; repeatable.")
    ] = None,
    rival: Annotated[
        list[str] | None,
        typer.Option(help="Only this effect competes with the answer; repeatable; default: the whole catalogue."),
    ] = None,
    read_blood: Annotated[str, typer.Option(help="recorded or fitted: see petkin diagnose.")] = "recorded",
    without: Annotated[str, typer.Option(help="Take a part of the engine out: see petkin-bench withheld.")] = "",
    seed: Annotated[int, typer.Option(help="Of blunders, twins and draws.", min=0)] = 0,
) -> None:
    """Withhold effects from the simulator, and put blunders into the curves, of real scans; ask what is missing.

    Rows are appended to petkin_bench/results/real_scans.csv, case by case as they come.
    """
    import pandas as pd

    from petkin_bench.provenance import append_rows
    from petkin_bench.real_scans import measure_real, summary

    subjects, only, rivals = (tuple(values or ()) for values in (subject, case, rival))
    settings = {"seed": seed, "blood": read_blood, "without": without}
    rows: list[dict[str, object]] = []
    for found in measure_real(
        data, subjects=subjects, seg=seg, only=only, rivals=rivals, blood=read_blood, lacking=without, seed=seed
    ):
        path = append_rows("real_scans", [row | settings for row in found])
        typer.echo(f"{found[0]['case']} ({found[0]['simulator']}): appended to {path}", err=True)
        rows += found
    typer.echo(pd.DataFrame(summary(rows)).to_string(index=False))


def survey(
    work: Annotated[Path, typer.Option(help="Folder of the studies; those there are not made again.")] = Path(
        "bench-survey"
    ),
    brain: Annotated[list[str] | None, typer.Option(help="Only brains whose name holds this; repeatable.")] = None,
    seeds: Annotated[int, typer.Option(help="Brains of each kind.", min=1)] = 1,
    keep: Annotated[bool, typer.Option(help="Append the rows to petkin_bench/results/survey.csv.")] = True,
) -> None:
    """Simulate whole brains of 16 regions with one effect in each, and diagnose them as a user would.

    One forward model makes and judges them: this is no blind check, but all that lies between two commands is in it.
    """
    from petkin_bench.provenance import append_rows
    from petkin_bench.survey import measure_survey, text_of

    rows = measure_survey(work, only=tuple(brain or ()), seeds=seeds, told=lambda line: typer.echo(line, err=True))
    typer.echo(text_of(rows))
    if keep:
        typer.echo(f"Appended to {append_rows('survey', rows)}")


def withheld(
    cases: Annotated[
        int, typer.Option(help="Scans or cohorts; those with a verdict are not judged again.", min=1)
    ] = 150,
    seed: Annotated[int, typer.Option(help="Of the scans; splits never share one.", min=0)] = 0,
    split: Annotated[str, typer.Option(help="scored, or training for calibration.")] = "scored",
    regions: Annotated[int, typer.Option(help="A scan.", min=1)] = 5,
    frames: Annotated[str, typer.Option(help="clinical, or short: 80 of half a minute.")] = "clinical",
    draws: Annotated[int, typer.Option(help="Noise draws of each diagnosis.", min=20)] = 400,
    without: Annotated[
        str,
        typer.Option(help="Take a part out, which must score worse: projection, priors, common_noise, pairs; engine."),
    ] = "",
    images: Annotated[bool, typer.Option("--images", help="Image cases: small 4-D scans with a segmentation.")] = False,
    scans: Annotated[
        int, typer.Option(help="Of one study, which share a cause or not: 3 to 10 for cohorts.", min=1)
    ] = 1,
    system: Annotated[
        str,
        typer.Option(help="Moving bodies in place of scans: one system of petkin-bench diagnose, or bodies for all."),
    ] = "",
    examples: Annotated[int, typer.Option(help="Training cases of the network alone (--without engine).")] = 800,
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
    from petkin_bench.withheld.bodies.score import body_metrics
    from petkin_bench.withheld.cohorts.score import cohort_metrics
    from petkin_bench.withheld.images.score import image_metrics
    from petkin_bench.withheld.run import LEARNED_SEED, Plan, run
    from petkin_bench.withheld.score import joined, metrics, text_of

    network = work / f"network_seed{LEARNED_SEED}_regions{regions}_{examples}.safetensors"
    plan = Plan(split, seed, cases, regions, draws, without, images, network, frames, scans, system)
    if without == "engine" and not network.is_file():
        from petkin_bench.withheld.network import train_network

        work.mkdir(parents=True, exist_ok=True)
        typer.echo(f"{examples} training cases are made", err=True)
        train_network(network, seed=LEARNED_SEED, count=examples, regions=regions)
    judged = joined(*run(plan, work, workers=workers, told=lambda n: typer.echo(f"{n} judged", err=True)))
    scored = image_metrics if images else cohort_metrics if scans > 1 else body_metrics if system else metrics
    found = scored(judged)
    typer.echo(text_of(found))
    if results is not None:
        settings = {
            "split": split,
            "seed": seed,
            "scans": cases,
            "regions": "" if system else regions,
            "frames": "" if system else frames,
            "draws": draws,
            "without": without,
        }
        rows = [settings | {"metric": m.name, "value": m.value, "cases": m.cases, "bar": m.bar} for m in found]
        typer.echo(f"Appended to {append_rows('withheld', rows, results)}")


def speed_diagnose(
    keep: Annotated[bool, typer.Option(help="Append the rows to petkin_bench/results/speed_diagnose.csv.")] = True,
) -> None:
    """Processor time of a diagnosis over regions and frames, with more draws of noise, and of a cohort."""
    from petkin_bench.provenance import append_rows
    from petkin_bench.speed_diagnose import measure_cohort, measure_sizes, text_of

    def told(what: str) -> None:
        typer.echo(what, err=True)

    rows = [*measure_sizes(told), measure_cohort(told)]
    typer.echo(text_of(rows))
    if keep:
        typer.echo(f"Appended to {append_rows('speed_diagnose', rows)}")
