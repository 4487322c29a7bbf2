"""How close fits come to the truth on the common benchmark curves, beside what other programs reached on them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from petkin.dynamics import ExponentialSum
from petkin.errors import InputError
from petkin.fitting import Choices, FitResult, Given, ReferenceCurve, Status, counting_weights
from petkin.imaging import FrameObservation, FrameSchedule
from petkin.inputs import InputFunction
from petkin.methods import find_method

Array = NDArray[np.float64]
_DECAY = np.log(2.0) / 20.364  # carbon-11, 1/min
#: Statuses of curves that came to nothing.
_FAILED = (Status.NOT_FINITE, Status.NO_SIGNAL, Status.NOT_CONVERGED)
#: Where the late part begins, as for the other programs' plots, min.
_T_STAR = 30.0


#: Methods that are tried on the curves of a set; the first is the model that made them.
SETS = {
    "rev2tcm": ("2TCM", "Logan", "MA1", "MA2", "LS2TCM", "SpectralAnalysis"),
    "irr2tcm": ("2TCM3k", "Patlak"),
    "1tcm": ("1TCM", "Logan", "MA1"),
    "srtm": ("SRTM", "SRTM2", "FRTM", "MRTM1", "MRTM2", "LoganRef"),
}
#: The files' name of a quantity where it is not petkin's.
_SPELLED = {"BP": "BPND"}
#: Median |error| % (90th percentile) of others on the outcome of a set, clean / noisy, measured on the same curves.
PEERS = {
    ("rev2tcm", "2TCM"): "kinfitr .09 (5.6) / 7.0 (17); KMAP-C .10 (.19) / 4.2 (23); PETPAL .31 (.47) / 5.4 (17)",
    ("rev2tcm", "Logan"): "PETPAL -7.5, kinfitr -9.3 clean (bias)",
    ("rev2tcm", "MA1"): "kinfitr -8.1 clean (bias)",
    ("irr2tcm", "2TCM3k"): "kinfitr .02 / 1.7; KMAP-C .08 / 1.8",
    ("irr2tcm", "Patlak"): "PETPAL, nifti_dynamic -5.2 clean (bias)",
    ("1tcm", "1TCM"): "kinfitr .14 / .65; KMAP-C .11 / .68; PETPAL .15 / .65",
    ("srtm", "SRTM"): "dynamicpet .10 / 3.0; kinfitr .25 / 2.4; PETPAL .20 / 2.5; NiftyPAD .47 / 2.7",
    ("srtm", "LoganRef"): "dynamicpet .55 (6.6) / 3.5; kinfitr - / 1.5",
    ("srtm", "MRTM1"): "NiftyPAD .08 / 6.0 (43); kinfitr .13 / 2.6",
}


def measure_accuracy(folder: Path) -> list[dict[str, object]]:
    """One row a set, clean or noisy, method and quantity.

    Args:
        folder: `frames.tsv` and, a set, `<set>_true.tsv`, `<set>_clean.tsv`, `<set>_noisy.tsv`.

    Raises:
        InputError: the folder lacks them.
    """
    if not (folder / "frames.tsv").is_file():
        raise InputError(f"{folder}: no frames.tsv; give the folder of the benchmark curves with --data.")
    edges = np.loadtxt(folder / "frames.tsv", skiprows=1)
    frames, reference = FrameSchedule(edges[:, 0], edges[:, 1]), ReferenceCurve("ref", edges[:, 2])
    rows: list[dict[str, object]] = []
    for name, labels in SETS.items():
        header = (folder / f"{name}_true.tsv").read_text().split("\n", 1)[0].split("\t")
        columns = np.loadtxt(folder / f"{name}_true.tsv", skiprows=1).T
        truth = {_SPELLED.get(symbol, symbol): column for symbol, column in zip(header, columns)}
        for what in ("clean", "noisy"):
            curves = np.loadtxt(folder / f"{name}_{what}.tsv")
            weights = counting_weights(curves.mean(axis=0), frames, _DECAY)
            given = Given(FrameObservation(frames, 0.0), weights, _arterial(), reference)
            for label in labels:
                result = find_method(label).fit(curves, given, Choices(t_star=_T_STAR), False)
                rows += [{"set": name, "curves": what, **row} for row in _rows(name, label, result, truth)]
    return rows


def _rows(name: str, label: str, result: FitResult, truth: dict[str, Array]) -> list[dict[str, object]]:
    """One row a quantity that both the method and the truth have."""
    outcome = find_method(label).outcome
    failed = int(np.isin(result.status, _FAILED).sum())
    rows = []
    for symbol in (e.symbol for e in result.estimates if e.symbol in truth):
        error = 100.0 * (result[symbol] / truth[symbol] - 1.0)
        bias = float(np.nanmedian(error))
        rows.append(
            {
                "model": label,
                "quantity": symbol,
                "median_error_percent": float(np.nanmedian(np.abs(error))),
                "p90_error_percent": float(np.nanpercentile(np.abs(error), 90)),
                "bias_percent": bias,
                "spread_percent": 1.4826 * float(np.nanmedian(np.abs(error - bias))),
                "failed": failed,
                "others_clean_noisy": PEERS.get((name, label), "") if symbol == outcome else "",
            }
        )
    return rows


def _arterial() -> InputFunction:
    """The curves' input: Feng's, arriving at 0.735 min, plasma and whole blood alike (kBq/mL over min)."""
    coefficients = torch.tensor([851.1225, -21.8798 - 20.8113, 21.8798, 20.8113], dtype=torch.float64)
    exponents = torch.tensor([-4.133859, -4.133859, -0.1190996, -0.01043449], dtype=torch.float64)
    plasma = ExponentialSum(coefficients, exponents, (1, 0, 0, 0), onset=0.735)
    return InputFunction(plasma, plasma)
