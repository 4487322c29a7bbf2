"""`petkin fit`: every scan of a study, or one image, fitted and written."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from petkin.errors import InputError, PetkinError
from petkin.fitting import Need
from petkin.inputs import InputFunction
from petkin.io import AtomicFolder, Scratch, write_bytes
from petkin.io.atomic import remove_orphans
from petkin.io.names import record_path, report_path
from petkin.one_core import on_one_core
from petkin.study.arterial import arterial_input
from petkin.study.fit_scan import Progress, ScanFit, fit_scan
from petkin.study.outcome import Fitted, outcomes
from petkin.study.outputs import require_own_folder, write_study_description, writing
from petkin.study.reading import read_sources
from petkin.study.request import FitRequest
from petkin.study.resources import Execution, Resources, Spread, free_memory
from petkin.study.resume import finished, write_record
from petkin.study.sources import Source


@dataclass(frozen=True)
class Job:
    """One scan to fit, with all that another process needs for it.

    Args:
        source: the scan.
        arterial: its input function as sampled, or None where no model needs one.
        request: what was asked.
        name: of the study.
        out: folder for the results.
        again: fit it even where it is finished.
        memory: bytes that the process may hold; None for a share of what is free.
    """

    source: Source
    arterial: InputFunction | None
    request: FitRequest
    name: str
    out: Path
    again: bool
    memory: int | None


def _silent(step: str, done: float) -> None:
    """Tells nobody."""


@on_one_core
def fit_study(
    request: FitRequest, progress: Progress = _silent, execution: Execution | None = None
) -> tuple[Fitted, ...]:
    """Fit everything that the request names and write the results, each scan whole or not at all.

    All sidecars and all blood are read, and the folder for the results is tried, before the first scan is fitted. Scans
    that an earlier run of the same request finished are not fitted again.

    Args:
        request: what to fit and how.
        progress: told what is being done, and how far all of it is.
        execution: in which processes, with how much memory.

    Raises:
        InputError: in one line, what makes a right answer impossible; where that is one scan of several, once the
            others are written.
    """
    execution = execution or Execution()
    progress("reading", 0.0)
    name, out, sources = read_sources(request)
    require_own_folder(out)
    for place in (out, out.parent):
        remove_orphans(place)
    needed = request.needs(Need.INPUT)
    memory = execution.memory and execution.memory // max(execution.workers, 1)
    jobs = [
        Job(source, arterial_input(source, request) if needed else None, request, name, out, execution.again, memory)
        for source in sources
    ]
    if execution.workers or execution.scheduler:
        from petkin.study.cohort import fit_on_cluster  # dask takes longer to load than a small study to fit

        answers = fit_on_cluster(fit_job, jobs, execution, progress)
    else:
        answers = _one_by_one(jobs, progress)
    fitted = _without_failures(jobs, answers)
    progress("done", 1.0)
    return fitted


@on_one_core
def fit_job(job: Job, progress: Progress, spread: Spread = map, helpers: int = 1) -> Fitted:
    """Fit one scan and write its results, unless they are there.

    Args:
        job: the scan.
        progress: told what is being done, and how far it is.
        spread: who fits blocks of voxels.
        helpers: in how many processes.

    Raises:
        InputError: something about the scan makes a right answer impossible.
    """
    source, request = job.source, job.request
    before = None if job.again else finished(job.out, source, request)
    if before is not None:
        return before
    with Scratch(job.out) as scratch:
        resources = Resources(job.memory or free_memory(), scratch, spread, helpers)
        fit = fit_scan(source, job.arterial, request, resources, progress)
        progress("writing", 0.92)
        relative = report_path(source.entities, desc="fit")
        delay = None if fit.arterial is None else fit.applied[0]
        fitted = Fitted(source.label, delay, outcomes(fit), fit.remarks, job.out / relative)
        with AtomicFolder(job.out, seal=record_path(source.entities)) as folder:
            write_study_description(folder, job.name, out=job.out, raw=request.target)
            with writing(folder, fit, request):
                progress("report", 0.95)
                write_bytes(folder.path(relative), _report(fit, request).encode())
            write_record(folder, source, request, fitted)
    return replace(fitted, fit=replace(fit, voxels=None, by_voxel=(), voxel_choice=()))


def _report(fit: ScanFit, request: FitRequest) -> str:
    from petkin.reporting import render_fit_report  # the first voxels need not wait for what draws
    from petkin.study.fit_report import build_report
    from petkin.study.truth import known_truth

    return render_fit_report(build_report(fit, request, known_truth(request.target, fit.source)))


def _one_by_one(jobs: list[Job], progress: Progress) -> Iterator[Fitted | PetkinError]:
    for i, job in enumerate(jobs):

        def here(step: str, done: float, i: int = i, label: str = job.source.label) -> None:
            progress(f"{label}: {step}", (i + done) / len(jobs))

        try:
            yield fit_job(job, here)
        except PetkinError as error:
            yield error


def _without_failures(jobs: list[Job], answers: Iterable[Fitted | PetkinError]) -> tuple[Fitted, ...]:
    fitted, errors = [], {}
    for job, answer in zip(jobs, answers, strict=True):
        if isinstance(answer, Fitted):
            fitted.append(answer)
        else:
            errors[job.source.label] = answer
    if len(jobs) == 1 and errors:
        raise next(iter(errors.values()))
    if errors:
        told = " ".join(f"{label}: {error}" for label, error in errors.items())
        raise InputError(f"{len(errors)} of {len(jobs)} scans could not be fitted, the others are written. {told}")
    return tuple(fitted)
