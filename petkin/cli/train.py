"""`petkin train`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

_FROM, _SIMULATED, _HOW = "Learned from", "A simulated population", "How"


def train(
    out: Annotated[Path, typer.Argument(help="Checkpoint to write (.safetensors); one that was stopped goes on.")],
    study: Annotated[
        list[Path] | None,
        typer.Option(
            "--from",
            help="PET-BIDS study with blood, and curves or an image with regions; repeatable.",
            rich_help_panel=_FROM,
        ),
    ] = None,
    seg: Annotated[
        str | None, typer.Option(help="Which table of curves, by its seg- label.", rich_help_panel=_FROM)
    ] = None,
    subjects: Annotated[int, typer.Option(help="How many.", min=2, rich_help_panel=_SIMULATED)] = 60,
    frames: Annotated[
        str, typer.Option(help="A name, a count over 60 min, or text such as 12x10,6x20.", rich_help_panel=_SIMULATED)
    ] = "clinical",
    isotope: Annotated[str, typer.Option(help="Radionuclide, e.g. F18, C11.", rich_help_panel=_SIMULATED)] = "F18",
    ranges: Annotated[
        list[str] | None,
        typer.Option(
            "--range", help="Of K1, k2, k3, k4 or vB, e.g. K1=0.1:0.3; repeatable.", rich_help_panel=_SIMULATED
        ),
    ] = None,
    rise: Annotated[
        str, typer.Option(help="A1 of the plasma curve (Feng's form), e.g. 400:1000.", rich_help_panel=_SIMULATED)
    ] = "400:1000",
    noise: Annotated[float, typer.Option(help="Counting noise, percent.", min=0.0, rich_help_panel=_SIMULATED)] = 5.0,
    residual: Annotated[
        str, typer.Option(help="What f_NN sees: held (bound tracer); C_T; C_T,C_P; or hidden.", rich_help_panel=_HOW)
    ] = "held",
    steps: Annotated[int, typer.Option(help="Of the training.", min=1, rich_help_panel=_HOW)] = 1000,
    seed: Annotated[int, typer.Option(help="Of draws and first weights.", min=0, rich_help_panel=_HOW)] = 0,
) -> None:
    """Learn what one tissue compartment lacks from many curves, real or simulated, for `petkin fit --model hybrid`.

    Examples:

      petkin train tracer.safetensors --from study

      petkin train simulated.safetensors --frames clinical --range k3=0.01:0.1 --noise 5
    """
    from petkin.cli.loading import loading

    with loading():
        import torch

        from petkin.cli.parsing import bounds_by_symbol, interval
        from petkin.cli.progress import progress_bar
        from petkin.errors import InputError
        from petkin.hybrid import Settings
        from petkin.imaging import FrameObservation, decay_constant, frame_schedule, half_life
        from petkin.learning import PAPER, Population
        from petkin.learning.tissue import find_residual
        from petkin.study.train import TrainRequest, train_population

    torch.set_num_threads(1)
    find_residual(residual)
    chosen = bounds_by_symbol(ranges or [], option="--range")
    known = {**PAPER.ranges, "vB": (0.02, 0.06)}
    if set(chosen) - set(known):
        raise InputError(f"--range {sorted(set(chosen) - set(known))[0]}: choose from {', '.join(known)}.")
    schedule = frame_schedule(frames, length=60.0)
    population = Population(
        FrameObservation(schedule, decay_constant(isotope)),
        {**known, **chosen},
        interval(rise, option="--rise"),
        noise=noise,
    )
    settings = Settings(steps=steps, rate=1e-2, seed=seed, save_every=100)
    request = TrainRequest(out, tuple(study or ()), seg, population, subjects, half_life(isotope), residual, settings)
    with progress_bar() as step:
        train_population(request, step)
    print(out)
