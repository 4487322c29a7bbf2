"""`petkin simulate`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

_BRAIN, _TRACER, _SCANNER, _BLOOD = "The brain", "The tracer", "The scanner", "The blood"


def simulate(
    out: Annotated[Path, typer.Option(help="Folder of the study; it must not hold anything yet.")] = Path(
        "petkin-study"
    ),
    preset: Annotated[
        str,
        typer.Option(
            help="physical: decay-corrected frame means with noise; paper: the observation of arXiv 2403.08194 "
            "(40 min, not decay-corrected, tau = 110 min, no noise)."
        ),
    ] = "physical",
    subjects: Annotated[int, typer.Option(help="How many subjects.")] = 1,
    sessions: Annotated[int, typer.Option(help="Scans of each subject, as test and retest.")] = 1,
    seed: Annotated[int, typer.Option(help="Seed of all randomness; the same seed gives the same bytes.")] = 0,
    effect: Annotated[
        list[str] | None,
        typer.Option(
            help="Effect that the image has and the blood record does not, NAME=VALUE[,SYMBOL=VALUE]: "
            "arterial_delay=5 (s), gain_step=0.05,onset=30 (min), second_tissue=0.05 (k3, 1/min; with --model 1TCM), "
            "and all that docs/diagnosing.md lists. Repeatable."
        ),
    ] = None,
    roi: Annotated[
        int | None,
        typer.Option(help="Number of regions: 5 is a slice, 16 a whole brain. Default: 5.", rich_help_panel=_BRAIN),
    ] = None,
    phantom: Annotated[
        str | None, typer.Option(help="brain2d, brain3d, or a .toml file, instead of --roi.", rich_help_panel=_BRAIN)
    ] = None,
    voxel_size: Annotated[
        float | None, typer.Option(help="mm. Default: the phantom's, 3.5 or 4.", rich_help_panel=_BRAIN)
    ] = None,
    subsamples: Annotated[
        int,
        typer.Option(
            help="Points an axis in each voxel: above 1, regions share border voxels.", rich_help_panel=_BRAIN
        ),
    ] = 1,
    voxel_spread: Annotated[
        bool,
        typer.Option("--voxel-spread", help="Let kinetics differ between voxels of a region.", rich_help_panel=_BRAIN),
    ] = False,
    tracer: Annotated[
        str | None,
        typer.Option(
            help="Kinetics and blood: reversible, fdg, paper, or a .toml file. Default: reversible, or the preset's.",
            rich_help_panel=_TRACER,
        ),
    ] = None,
    isotope: Annotated[
        str | None, typer.Option(help="Radionuclide, e.g. C11. Default: the tracer's.", rich_help_panel=_TRACER)
    ] = None,
    model: Annotated[
        str | None, typer.Option(help="1TCM, 2TCM or 2TCM3k (k4 = 0). Default: the tracer's.", rich_help_panel=_TRACER)
    ] = None,
    frames: Annotated[
        str | None,
        typer.Option(
            help='A count over the tracer\'s usual length, "12x10,6x20,gap600,5x300" (count x seconds), paper, fdg, '
            "clinical, interrupted, or a .tsv or .json file. Default: the tracer's.",
            rich_help_panel=_SCANNER,
        ),
    ] = None,
    noise: Annotated[
        float | None,
        typer.Option(
            help="Voxel noise, percent of the brain's mean in the middle of the scan. Default: 5 (paper: 0).",
            rich_help_panel=_SCANNER,
        ),
    ] = None,
    noise_common: Annotated[
        float,
        typer.Option(
            help="Share of a voxel's noise variance that its whole frame has in common. Means over regions have little"
            " noise of their own: 0.005 is a share of 0.6 of one over 300 voxels.",
            rich_help_panel=_SCANNER,
        ),
    ] = 0.0,
    noise_fwhm: Annotated[
        float, typer.Option(help="Spatial correlation of the noise, mm.", rich_help_panel=_SCANNER)
    ] = 0.0,
    psf: Annotated[float, typer.Option(help="Point spread, FWHM in mm.", rich_help_panel=_SCANNER)] = 0.0,
    units: Annotated[str, typer.Option(help="Unit of the image: Bq/mL or kBq/mL.", rich_help_panel=_SCANNER)] = "Bq/mL",
    blood_noise: Annotated[
        float, typer.Option(help="Noise of each blood sample, percent.", rich_help_panel=_BLOOD)
    ] = 0.0,
    sampler_dispersion: Annotated[
        float,
        typer.Option(help="Time constant of the autosampler's line (s), left in its record.", rich_help_panel=_BLOOD),
    ] = 0.0,
    truth_tacs: Annotated[
        bool, typer.Option("--truth-tacs", help="Write the regions' noise-free curves as well.")
    ] = False,
) -> None:
    """Simulate a dynamic PET study: images, blood, and the truth behind them, as a PET-BIDS folder.

    What a fit should find (labels, parameter maps and tables, the effects put in) lies in derivatives/phantom.

    Examples:

      petkin simulate --roi 5 --frames 80 --out study

      petkin simulate --phantom brain3d --tracer fdg --subjects 4 --sessions 2 --psf 5 --effect arterial_delay=5
    """
    from petkin.cli.progress import progress_bar
    from petkin.effects import read_injection
    from petkin.study.simulate import simulate as simulate_study
    from petkin.study.simulation import read_settings, tissue_model

    settings = read_settings(
        out=out,
        preset=preset,
        subjects=subjects,
        sessions=sessions,
        seed=seed,
        effects=tuple(effect or ()),
        roi=roi,
        phantom=phantom,
        voxel_size=voxel_size,
        subsamples=subsamples,
        voxel_spread=voxel_spread,
        tracer=tracer,
        isotope=isotope,
        model=model,
        frames=frames,
        noise=noise,
        noise_common=noise_common,
        noise_fwhm=noise_fwhm,
        psf=psf,
        units=units,
        blood_noise=blood_noise,
        sampler_dispersion=sampler_dispersion,
        truth_tacs=truth_tacs,
    )
    for remark in (remark for text in settings.effects for remark in read_injection(text, imaged=True).remarks):
        print(remark, file=sys.stderr)
    with progress_bar() as step:
        written = simulate_study(settings, advance=lambda done, total: step("simulating", done / total))
    scans = settings.subjects * settings.sessions
    fit = f"petkin fit {written} --model {tissue_model(settings).label}"
    print(f"Wrote {scans} scan{'s' if scans > 1 else ''} to {written}. Next: {fit}")
