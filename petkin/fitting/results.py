"""What a fit returns, whatever the model: estimates, how sure they are, and why one is missing or doubtful."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray


class Status(IntEnum):
    """Why a curve has no value, or a doubtful one. Written into maps and tables; the order is the code."""

    OK = 0
    OUTSIDE = 1
    NOT_FINITE = 2
    NO_SIGNAL = 3
    AT_BOUND = 4
    NOT_IDENTIFIABLE = 5
    NOT_CONVERGED = 6
    SECOND_MINIMUM = 7

    @property
    def meaning(self) -> str:
        """One sentence for sidecars and reports."""
        return _MEANINGS[self]


_MEANINGS = {
    Status.OK: "fitted, inside all bounds",
    Status.OUTSIDE: "outside the mask, not fitted",
    Status.NOT_FINITE: "the curve holds NaN or infinite values, not fitted",
    Status.NO_SIGNAL: "the curve holds no signal above zero, not fitted",
    Status.AT_BOUND: "fitted, but a parameter ended on a bound: its standard error does not apply",
    Status.NOT_IDENTIFIABLE: "fitted, but the data do not determine what the model is used for (VT, Ki, BPND): "
    "its standard error exceeds 100 percent",
    Status.NOT_CONVERGED: "the fit ended before its tolerance was met",
    Status.SECOND_MINIMUM: "fitted, but another set of parameters fits the curve as well within its noise and gives an "
    "outcome (VT, Ki, BPND) more than 2 standard errors away",
}


@dataclass(frozen=True)
class Estimate:
    """One fitted or derived quantity over N curves, and what it is in words."""

    symbol: str
    unit: str
    value: NDArray[np.floating]
    percent_se: NDArray[np.floating]
    meaning: str = ""


@dataclass(frozen=True)
class Column:
    """Something else that is known of N curves: a column of a table, or a map.

    Args:
        name: of the column, and `desc-<name>` of the map.
        values: (N,); whole numbers where `levels` says what they stand for.
        meaning: what it is in words.
        unit: "1" for none.
        levels: meaning by code, written as words in tables; None for plain numbers.
        bits: whether codes are powers of two that add up; 0 is then none of them.
        mapped: whether voxels get a map of it.
    """

    name: str
    values: NDArray[Any]
    meaning: str
    unit: str = "1"
    levels: dict[int, str] | None = None
    bits: bool = False
    mapped: bool = True

    @property
    def cells(self) -> NDArray[Any]:
        """Values as a table shows them: codes in words, missing where there is nothing to say."""
        if self.levels is None:
            return self.values
        return np.array([self._words(int(code)) for code in self.values], dtype=object)

    def _words(self, code: int) -> str | float:
        levels = self.levels or {}
        found = [text for bit, text in levels.items() if code & bit] if self.bits else [levels.get(code, "")]
        return "; ".join(text for text in found if text) or float("nan")


@dataclass(frozen=True)
class Plot:
    """A picture that a method adds to its report.

    Args:
        title, x_label, y_label: as shown, with units.
        points: measured (name, x, y); a curve's name is its number from 1, which reports replace by the region's.
        lines: fitted (name, x, y).
        mark: where a vertical line stands on the x axis, or None.
        text: a sentence below.
    """

    title: str
    x_label: str
    y_label: str
    points: tuple[tuple[str, NDArray[np.floating], NDArray[np.floating]], ...]
    lines: tuple[tuple[str, NDArray[np.floating], NDArray[np.floating]], ...] = ()
    mark: float | None = None
    text: str = ""


@dataclass(frozen=True)
class FitResult:
    """A model fitted to N curves of K frames.

    Args:
        model: model label as BEP023 has it, e.g. "2TCM".
        estimates: parameters, then macro-parameters; NaN where there is none. percent_se is 100 |se / value|.
        chi2: weighted residual sum of squares over its degrees of freedom (weights as in `weights`).
        aicc: small-sample Akaike criterion, n ln(WRSS/n) + 2p + 2p(p+1)/(n-p-1), p counting the variance.
        status: `Status` codes, uint8.
        predicted: fitted frame values (N, K) or None where not kept (voxels).
        weights: frame weights (K,) or (N, K).
        delay: input delay used, min, and its standard error (NaN when given or not estimated).
        settings: what was chosen (bounds, fixed values, t_star, ...), for sidecars.
        remarks: what the data cannot tell, in words.
        shared: value and percent standard error, by symbol, of what all curves have in common.
        plots: pictures for the report.
        columns: what else is known of every curve.
    """

    model: str
    estimates: tuple[Estimate, ...]
    chi2: NDArray[np.floating]
    aicc: NDArray[np.floating]
    status: NDArray[np.uint8]
    weights: NDArray[np.floating]
    predicted: NDArray[np.floating] | None = None
    delay: float = 0.0
    delay_se: float = float("nan")
    settings: dict[str, Any] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    shared: dict[str, tuple[float, float]] = field(default_factory=dict)
    plots: tuple[Plot, ...] = ()
    columns: tuple[Column, ...] = ()

    def __getitem__(self, symbol: str) -> NDArray[np.floating]:
        """Estimates of one quantity over the N curves."""
        for estimate in self.estimates:
            if estimate.symbol == symbol:
                return estimate.value
        raise KeyError(symbol)

    def percent_se(self, symbol: str) -> NDArray[np.floating]:
        """Percent standard errors of one quantity over the N curves."""
        return next(e.percent_se for e in self.estimates if e.symbol == symbol)

    def column(self, name: str) -> NDArray[Any]:
        """Values of one further column over the N curves."""
        return next(c.values for c in self.columns if c.name == name)

    def count(self, status: Status) -> int:
        """How many curves ended with a status."""
        return int(np.count_nonzero(self.status == status))


def undetermined(result: FitResult) -> tuple[str, ...]:
    """What the curves do not tell, a sentence each: standard errors above 100 percent, values on a bound."""
    fitted = np.isin(result.status, (Status.OK, Status.AT_BOUND, Status.NOT_IDENTIFIABLE, Status.NOT_CONVERGED))
    total = int(fitted.sum())
    sentences = []
    for estimate in result.estimates:
        loose = int(np.count_nonzero(estimate.percent_se[fitted] > 100.0))
        if loose:
            sentences.append(
                f"{result.model}: {estimate.symbol} cannot be told from these data in {loose} of {total} curves "
                "(standard error above 100 %)."
            )
    bound = result.count(Status.AT_BOUND)
    if bound:
        sentences.append(
            f"{result.model}: in {bound} of {total} curves a parameter ended on a bound; it has no error there."
        )
    return tuple(sentences)
