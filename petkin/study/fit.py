"""`petkin fit`: every scan of a study, or one image, fitted and written."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from petkin.io import AtomicFolder, write_bytes
from petkin.io.names import report_path
from petkin.reporting import render_fit_report
from petkin.study.fit_report import build_report
from petkin.study.fit_scan import Progress, ScanFit, fit_scan
from petkin.study.outputs import write_scan, write_study_description
from petkin.study.request import FitRequest
from petkin.study.sources import read_sources
from petkin.study.truth import known_truth


@dataclass(frozen=True)
class Fitted:
    """What came of one scan: its fit and where its report is."""

    fit: ScanFit
    report: Path


def _silent(step: str, done: float) -> None:
    """Tells nobody."""


def fit_study(request: FitRequest, progress: Progress = _silent) -> tuple[Fitted, ...]:
    """Fit everything that the request names and write the results, each scan whole or not at all.

    Args:
        request: what to fit and how.
        progress: told what is being done, and how far all of it is.

    Raises:
        InputError: in one line, what makes a right answer impossible.
    """
    name, out, sources = read_sources(request)
    fitted = []
    for i, source in enumerate(sources):

        def here(step: str, done: float, i: int = i, label: str = source.label) -> None:
            progress(f"{label}: {step}", (i + done) / len(sources))

        fit = fit_scan(source, request, here)
        here("writing", 0.92)
        relative = report_path(source.entities, desc="fit")
        with AtomicFolder(out) as folder:
            write_study_description(folder, name)
            write_scan(folder, fit, request)
            here("report", 0.95)
            report = build_report(fit, request, known_truth(request.target, source))
            write_bytes(folder.path(relative), render_fit_report(report).encode())
        fitted.append(Fitted(fit, out / relative))
    progress("done", 1.0)
    return tuple(fitted)
