"""`petkin diagnose`: every scan of a study against what the simulator can produce."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis import (
    Detected,
    Diagnosis,
    Hypothesis,
    Member,
    Progress,
    Visible,
    base_fit,
    detect,
    diagnose,
    foresee_design,
    in_common,
    silent,
)
from petkin.effects import EFFECTS
from petkin.effects.noise import NOISE_VARIANCE
from petkin.io import (
    AtomicFolder,
    RegionalCurves,
    Remark,
    json_text,
    write_bytes,
    write_map,
    write_text,
)
from petkin.io.names import cohort_report_path, map_path, report_path
from petkin.learning import Members, open_members
from petkin.one_core import on_one_core
from petkin.reporting import (
    CohortReport,
    render_cohort_report,
    render_gap_report,
)
from petkin.study.diagnosis.answer import answer
from petkin.study.diagnosis.cohort import cohort_answer
from petkin.study.diagnosis.gap_map import gap_map, gap_map_sidecar
from petkin.study.diagnosis.hypotheses import hypotheses
from petkin.study.diagnosis.imaged import look_at_image, pictured, weighed
from petkin.study.diagnosis.judging import diagnose_curves, law_of_noise, laws_in_common, scattered
from petkin.study.diagnosis.preparing import prepared, sources_of
from petkin.study.diagnosis.regional import RegionalSimulator
from petkin.study.diagnosis.report import Judged, gap_report
from petkin.study.diagnosis.request import DiagnoseRequest
from petkin.study.diagnosis.resting import picture_of
from petkin.study.diagnosis.scatter import as_voxels_scatter
from petkin.study.diagnosis.shared_law import SharedLaw, of_all
from petkin.study.diagnosis.sidecar import Blunder, blunders
from petkin.study.diagnosis.state import read_states
from petkin.study.diagnosis.state_files import write_states
from petkin.study.outputs import require_own_folder, write_study_description
from petkin.study.sources import Source

#: Effects whose weak template says little of what they do at full strength: these always get a refit.
ALWAYS = frozenset({"second_tissue", "blood_volume", "parent_fraction", "arterial_delay", "vascular_trapping"})
#: Share of the work that the noise of several scans is.
_LAWS = 0.2


@dataclass(frozen=True)
class Diagnosed:
    """What came of one scan: its label, the answer, where the report is, and what was odd about the files."""

    label: str
    answer: dict[str, Any]
    report: Path
    remarks: tuple[Remark, ...] = ()


@on_one_core
def diagnose_study(request: DiagnoseRequest, progress: Progress = silent) -> tuple[Diagnosed, ...]:
    """Diagnose every scan of a study and write JSON and HTML, each scan whole or not at all.

    Of several scans, what they share comes last, under the label "group".

    Raises:
        InputError: in one line, what makes a diagnosis impossible.
    """
    progress("reading", 0.0)
    name, out, sources = sources_of(request)
    require_own_folder(out)
    members = _members(request, sources)
    scans = [_remarked(source, *prepared(source, request)) for source in sources]
    started = time.process_time()
    laws = _laws_in_common(scans, request, progress)
    together = time.process_time() - started
    begun = _LAWS if len(scans) > 1 else 0.0
    written: list[Diagnosed] = []
    cohort: list[Member] = []
    for i, (source, curves, simulator) in enumerate(scans):

        def here(step: str, done: float, i: int = i, label: str = source.label) -> None:
            progress(f"{label}: {step}", begun + (1.0 - begun) * (i + done) / len(scans))

        started = time.process_time()
        one = _diagnosed(source, curves, simulator, request, members, laws[i], here)
        seconds = time.process_time() - started
        text = answer(
            one.found,
            one.simulator,
            subject=source.label,
            model=simulator.label,
            seed=request.seed,
            seconds=round(seconds, 2),
            shown=one.shown,
            states=one.states,
        )
        report = gap_report(source, curves, one, text, request.command_line)
        relative = report_path(source.entities, desc="gap")
        with AtomicFolder(out) as folder:
            write_study_description(folder, name, out=out, raw=request.target)
            write_text(folder.path(relative.with_suffix(".json")), json_text(text))
            write_bytes(folder.path(relative), render_gap_report(report).encode())
            if one.gap is not None and source.image is not None:
                path = map_path(source.entities, simulator.label, desc="gapz")
                write_map(folder.path(path), one.gap, source.image.affine, gap_map_sidecar(one.found))
            if one.states is not None:
                write_states(folder, source, one.states, request)
        written.append(Diagnosed(source.label, text, out / relative, source.remarks))
        cohort.append(Member.of(source.label, one.found))
    if len(cohort) > 1:
        written.append(_cohort(cohort, written, out, name, request, laws, together))
    progress("done", 1.0)
    return tuple(written)


def _remarked(
    source: Source, curves: RegionalCurves, simulator: RegionalSimulator
) -> tuple[Source, RegionalCurves, RegionalSimulator]:
    """With what was odd about the means over its regions among what was odd about its files."""
    return replace(source, remarks=tuple(dict.fromkeys((*source.remarks, *curves.remarks)))), curves, simulator


def _members(request: DiagnoseRequest, sources: tuple[Source, ...]) -> Members | None:
    """The ensemble that was asked for, which fits every scan.

    Raises:
        InputError: it cannot be read, or is of another radionuclide.
    """
    if not request.checkpoints:
        return None
    members = open_members(request.checkpoints)
    for source in sources:
        members.require(math.log(2.0) / source.decay)
    return members


def _diagnosed(
    source: Source,
    curves: RegionalCurves,
    simulator: RegionalSimulator,
    request: DiagnoseRequest,
    members: Members | None,
    shared: SharedLaw | None,
    progress: Progress,
) -> Judged:
    """The sidecar first, then the noise, the image and the regions, each with what came before."""
    shown = blunders(source.sidecar)
    progress("looking at every effect", 0.0)
    if source.segmented is not None:
        found, simulator, detected, gap = _in_image(source, curves, simulator, request, shown, shared, progress)
    else:
        candidates, law = _candidates(simulator, request, shown), _law(request, shared)
        found, simulator, detected = diagnose_curves(simulator, curves.values, candidates, progress=progress, **law)
        gap = None
    states = None
    if members is not None:
        states = read_states(
            members,
            simulator,
            curves.values,
            detected.based,
            _candidates(simulator, request, shown),
            seed=request.seed,
            progress=progress,
        )
    return Judged(found, simulator, shown, gap, states, shared)


def _in_image(
    source: Source,
    curves: RegionalCurves,
    simulator: RegionalSimulator,
    request: DiagnoseRequest,
    shown: Sequence[Blunder],
    shared: SharedLaw | None,
    progress: Progress,
) -> tuple[Diagnosis, RegionalSimulator, Detected, NDArray[np.float32]]:
    """What the voxels of an image and the means over its regions say together, the simulator that knows how it has
    moved, what a gap of the regions was claimed from, and where in the image it is."""
    candidates = _candidates(simulator, request, shown)
    scatter, simulator, detected = law_of_noise(simulator, curves.values, candidates, **_law(request, shared))
    progress("looking at the image", 0.1)
    picture = picture_of(source, simulator, detected.based[0])
    if scatter is not None:
        scatter = as_voxels_scatter(scatter, simulator, detected.based[0], picture.grain.by_frame)
    # what voxels say of each region's noise leaves no law of it open
    simulator = replace(simulator, grain=picture.grain.of_means(), law_errors=simulator.law_errors[:0])
    based = base_fit(simulator, curves.values)
    names = frozenset(h.name for h in candidates)
    simulator, based, rest = pictured(source, picture, simulator, curves.values, based, seed=request.seed)
    imaged, moving = look_at_image(source, picture, simulator, based[0], names, rest, seed=request.seed)
    if moving is not simulator:
        simulator, based = moving, base_fit(moving, curves.values)
    seen = tuple(map(imaged.looked.told, _candidates(simulator, request, shown)))
    detected = detect(simulator, curves.values, seen, seed=request.seed, based=based)
    found = diagnose(
        simulator,
        curves.values,
        seen,
        always=ALWAYS,
        elsewhere=imaged.elsewhere,
        seed=request.seed,
        detected=detected,
        progress=progress,
    )
    found = scattered(weighed(found, imaged.looked, seed=request.seed), scatter)
    return found, simulator, detected, gap_map(imaged.voxels, found, simulator)


def _candidates(
    simulator: RegionalSimulator, request: DiagnoseRequest, shown: Sequence[Blunder] = ()
) -> tuple[Hypothesis, ...]:
    """Causes that a request leaves, as likely as what a sidecar shows makes them."""
    told = {b.effect: b.odds for b in shown}
    every = hypotheses(EFFECTS, simulator, without=frozenset(request.without))
    return tuple(replace(h, log_odds=told.get(h.name, h.log_odds)) for h in every)


def _laws_in_common(
    scans: Sequence[tuple[Source, RegionalCurves, RegionalSimulator]],
    request: DiagnoseRequest,
    progress: Progress,
) -> tuple[SharedLaw | None, ...]:
    """How the values of all scans scatter, as they tell it together."""

    def told(looks: int) -> None:
        progress("noise of all scans", _LAWS * looks / (2 * len(scans)))

    asked = [
        (simulator, curves.values, _candidates(simulator, request, blunders(source.sidecar)))
        for source, curves, simulator in scans
    ]
    return laws_in_common(asked, seed=request.seed, always=ALWAYS, told=told)


def _law(request: DiagnoseRequest, shared: SharedLaw | None) -> dict[str, Any]:
    """What `law_of_noise` is asked beside curves, of what a request names and includes."""
    name = NOISE_VARIANCE.name
    return {
        "always": ALWAYS,
        "without": name in request.without,
        "included": name in request.include,
        "shared": shared,
        "seed": request.seed,
    }


def _cohort(
    members: list[Member],
    written: list[Diagnosed],
    out: Path,
    name: str,
    request: DiagnoseRequest,
    laws: Sequence[SharedLaw | None],
    together: float,
) -> Diagnosed:
    """What the scans share, written beside them; `together`, s, is what the law of their noise took."""
    started = time.process_time()
    found = in_common(members)
    seconds = sum(one.answer["provenance"]["seconds"] for one in written) + together + time.process_time() - started
    text = cohort_answer(found, [one.answer for one in written], seed=request.seed, seconds=round(seconds, 2))
    relative = cohort_report_path(desc="gap")
    links = tuple(one.report.relative_to(out).as_posix() for one in written)
    page = CohortReport(f"{name}: what {len(members)} scans share", text, links, of_all(laws), request.command_line)
    with AtomicFolder(out) as folder:
        write_text(folder.path(relative.with_suffix(".json")), json_text(text))
        write_bytes(folder.path(relative), render_cohort_report(page).encode())
    return Diagnosed("group", text, out / relative)


@on_one_core
def foresee_study(request: DiagnoseRequest, progress: Progress = silent) -> tuple[tuple[str, tuple[Visible, ...]], ...]:
    """For every scan, its label and what its frames, regions and blood could ever tell of each effect.

    Noise is that of the scan's own curves, and goes as all scans tell; no effect is judged from them.

    Raises:
        InputError: as `diagnose_study`.
    """
    progress("reading", 0.0)
    _, _, sources = sources_of(request)
    scans = [(source, *prepared(source, request)) for source in sources]
    laws, found = _laws_in_common(scans, request, progress), []
    for i, ((source, curves, simulator), law) in enumerate(zip(scans, laws, strict=True)):
        progress(f"{source.label}: design", _LAWS + (1.0 - _LAWS) * i / len(scans))
        candidates = _candidates(simulator, request)
        _, simulator, _ = law_of_noise(simulator, curves.values, candidates, **_law(request, law))
        found.append((source.label, foresee_design(simulator, curves.values, candidates)))
    progress("done", 1.0)
    return tuple(found)
