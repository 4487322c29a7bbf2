"""The verb `simulate`: a PET-BIDS study with images, blood and the truth behind them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pandas as pd
from jaxtyping import Float
from numpy.typing import NDArray

from petkin import __version__
from petkin.errors import InputError
from petkin.io import AtomicFolder, json_text, write_series, write_table, write_text
from petkin.io.descriptions import raw_description
from petkin.io.names import blood_path, image_path, sidecar_path
from petkin.study.simulation import Plan, SimulationSettings, plan
from petkin.study.simulation.blood import blood_recordings
from petkin.study.simulation.images import image_frames
from petkin.study.simulation.scene import Scene, scene
from petkin.study.simulation.sidecars import pet_sidecar
from petkin.study.simulation.truth import truth_description, write_truth
from petkin.study.truth import TRUTH_FOLDER
from petkin.units import KBQ_PER_ML

#: Called after every frame with how many are done, of how many.
Advance = Callable[[int, int], None]


def simulate(settings: SimulationSettings, *, advance: Advance | None = None) -> Path:
    """Write a simulated study; whole or not at all, the same bytes for the same settings and version.

    Args:
        settings: what to simulate.
        advance: told of every frame, for a progress bar.

    Returns:
        The folder of the study.

    Raises:
        InputError: options that cannot be, or a folder that is not empty or cannot be written.
    """
    _refuse_occupied(settings.out)
    planned = plan(settings)
    scans = [(n, j) for n in range(1, settings.subjects + 1) for j in range(1, settings.sessions + 1)]
    with AtomicFolder(settings.out) as folder:
        weights = {}
        for done, (subject, session) in enumerate(scans):
            drawn = scene(planned, subject, session)
            weights[_label(subject, settings.subjects)] = drawn.given.weight
            report = _report(advance, done * len(planned.frames), len(scans) * len(planned.frames))
            _write_scan(folder, planned, drawn, report)
        _write_dataset(folder, planned, weights)
    return settings.out


def _refuse_occupied(out: Path) -> None:
    if out.is_dir() and any(out.iterdir()):
        raise InputError(f"{out} is not empty; give --out a new folder, or empty it.")


def _label(number: int, count: int) -> str:
    return str(number).zfill(max(2, len(str(count))))


def _report(advance: Advance | None, before: int, total: int) -> Callable[[int], None]:
    return (lambda k: None) if advance is None else (lambda k: advance(before + k, total))


def _write_scan(folder: AtomicFolder, planned: Plan, drawn: Scene, report: Callable[[int], None]) -> None:
    settings = planned.settings
    scan = {"sub": _label(drawn.subject, settings.subjects)}
    if settings.sessions > 1:
        scan["ses"] = _label(drawn.session, settings.sessions)
    image = image_path(scan)
    write_series(
        folder.path(image), _stored_frames(planned, drawn, report), planned.painted.affine, count=len(planned.frames)
    )
    write_text(folder.path(sidecar_path(image)), json_text(pet_sidecar(planned, drawn)))
    for recording, (table, fields) in blood_recordings(planned, drawn).items():
        path = blood_path(scan, recording)
        write_table(folder.path(path), table)
        write_text(folder.path(sidecar_path(path)), json_text(fields))
    write_truth(folder, scan, planned, drawn)


def _stored_frames(planned: Plan, drawn: Scene, report: Callable[[int], None]) -> Iterator[Float[NDArray, "x y z"]]:
    factor = 1.0 / KBQ_PER_ML[planned.settings.units]
    for k, frame in enumerate(image_frames(planned, drawn), start=1):
        yield frame * factor
        report(k)


def _write_dataset(folder: AtomicFolder, planned: Plan, weights: dict[str, float]) -> None:
    name = f"simulated {planned.population.tracer} study of phantom {planned.phantom.name}"
    write_text(folder.path("dataset_description.json"), json_text(raw_description(name, __version__)))
    write_text(folder.path(TRUTH_FOLDER / "dataset_description.json"), json_text(truth_description(name)))
    table = pd.DataFrame(
        {"participant_id": [f"sub-{label}" for label in weights], "body_weight": list(weights.values())}
    )
    write_table(folder.path("participants.tsv"), table)
    columns = {"body_weight": {"Description": "body weight of the simulated participant", "Units": "kg"}}
    write_text(folder.path("participants.json"), json_text(columns))
    write_text(folder.path("README"), _readme(planned))


def _readme(planned: Plan) -> str:
    settings, frames = planned.settings, planned.frames
    corrected = "decay-corrected to injection" if planned.observation.corrected else "not corrected for decay"
    return (
        f"Simulated dynamic PET (petkin {__version__}, preset {settings.preset}, seed {settings.seed}).\n\n"
        f"{settings.subjects} subject(s) with {settings.sessions} scan(s) each of phantom {planned.phantom.name} "
        f"({planned.phantom.title}), tracer {planned.population.tracer} [{planned.radionuclide}], "
        f"tissue model {planned.model}.\n"
        f"{len(frames)} frames over {frames.end[-1]:g} min; frame values are means over the frame, {corrected}, with a "
        f"half-life of {planned.half_life_s:.6g} s.\n"
        f"Kinetics: {planned.population.title} ({planned.population.source}).\n\n"
        "No person was scanned. What a fit should find lies in derivatives/phantom.\n"
    )
