"""`petkin fit`: every scan of a study, or one image, fitted and written."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from petkin.fitting import FitResult, Need, Status
from petkin.io import AtomicFolder, write_bytes
from petkin.io.names import report_path
from petkin.methods import find_method
from petkin.reporting import render_fit_report
from petkin.study.arterial import arterial_input
from petkin.study.fit_report import build_report
from petkin.study.fit_scan import Progress, ScanFit, fit_scan
from petkin.study.outputs import require_own_folder, write_scan, write_study_description
from petkin.study.reading import read_sources
from petkin.study.request import FitRequest
from petkin.study.truth import known_truth


@dataclass(frozen=True)
class Outcome:
    """One model's result on regions or voxels, in a few numbers.

    Args:
        model: label.
        level: "region" or "voxel".
        curves: how many have a value.
        flagged: how many of them are in doubt.
        symbol: what the model is used for, VT or Ki.
        median: over the curves that are not in doubt; NaN for none.
        percent_se: median percent standard error of the same.
    """

    model: str
    level: str
    curves: int
    flagged: int
    symbol: str
    median: float
    percent_se: float


@dataclass(frozen=True)
class Fitted:
    """What came of one scan.

    Args:
        fit: the fit without its voxels, which lie on disk.
        outcomes: its results in short.
        report: where the report is.
    """

    fit: ScanFit
    outcomes: tuple[Outcome, ...]
    report: Path


def _silent(step: str, done: float) -> None:
    """Tells nobody."""


def fit_study(request: FitRequest, progress: Progress = _silent) -> tuple[Fitted, ...]:
    """Fit everything that the request names and write the results, each scan whole or not at all.

    All sidecars and all blood are read, and the folder for the results is tried, before the first scan is fitted.

    Args:
        request: what to fit and how.
        progress: told what is being done, and how far all of it is.

    Raises:
        InputError: in one line, what makes a right answer impossible.
    """
    progress("reading", 0.0)
    name, out, sources = read_sources(request)
    require_own_folder(out)
    needed = request.needs(Need.INPUT)
    arterial = [arterial_input(source, request) if needed else None for source in sources]
    fitted = []
    for i, source in enumerate(sources):

        def here(step: str, done: float, i: int = i, label: str = source.label) -> None:
            progress(f"{label}: {step}", (i + done) / len(sources))

        fit = fit_scan(source, arterial[i], request, here)
        here("writing", 0.92)
        relative = report_path(source.entities, desc="fit")
        with AtomicFolder(out) as folder:
            write_study_description(folder, name, out=out, raw=request.target)
            write_scan(folder, fit, request)
            here("report", 0.95)
            report = build_report(fit, request, known_truth(request.target, source))
            write_bytes(folder.path(relative), render_fit_report(report).encode())
        fitted.append(Fitted(replace(fit, voxels=None, by_voxel=()), _outcomes(fit), out / relative))
    progress("done", 1.0)
    return tuple(fitted)


def _outcomes(fit: ScanFit) -> tuple[Outcome, ...]:
    levels = (("region", fit.regional), ("voxel", fit.by_voxel))
    return tuple(_outcome(result, level) for level, results in levels for result in results)


def _outcome(result: FitResult, level: str) -> Outcome:
    symbol = find_method(result.model).outcome
    value, percent_se = result[symbol], result.percent_se(symbol)
    fitted = np.isfinite(value)
    sure = fitted & np.isin(result.status, (Status.OK, Status.AT_BOUND))
    errors = percent_se[sure & np.isfinite(percent_se)]
    return Outcome(
        model=result.model,
        level=level,
        curves=int(fitted.sum()),
        flagged=int((fitted & (result.status != Status.OK)).sum()),
        symbol=symbol,
        median=float(np.median(value[sure])) if sure.any() else float("nan"),
        percent_se=float(np.median(errors)) if errors.size else float("nan"),
    )
