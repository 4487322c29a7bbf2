"""What came of a scan, in a few numbers: for the terminal, and to be told again when the scan is not fitted again."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from petkin.fitting import FitResult, Status
from petkin.io import Remark
from petkin.methods import find_method
from petkin.study.fit_scan import ScanFit


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
        label: start of its file names.
        delay: delay of the input that the fits used, min; None where no model needs an input.
        outcomes: its results in short.
        remarks: warnings.
        report: where the report is.
        fit: the fit without its voxels, which lie on disk; None where it was made before, or in another process.
        before: whether it was made by an earlier run of the same request.
    """

    label: str
    delay: float | None
    outcomes: tuple[Outcome, ...]
    remarks: tuple[Remark, ...]
    report: Path
    fit: ScanFit | None = None
    before: bool = False


def outcomes(fit: ScanFit) -> tuple[Outcome, ...]:
    """Every model by region, then every model by voxel."""
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
