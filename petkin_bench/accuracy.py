"""How close fits come to the truth on the common benchmark curves, beside what other programs reached on them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from petkin.dynamics import ExponentialSum
from petkin.errors import InputError
from petkin.fitting import REGIONS, NonlinearSettings, Status, counting_weights, fit_curves
from petkin.imaging import FrameObservation, FrameSchedule
from petkin.inputs import InputFunction
from petkin.kinetics import compartment_model

#: Set, model, and median |error| % (90th percentile) of others, clean and noisy, as measured on these curves.
SETS = {
    "rev2tcm": (
        "2TCM",
        "VT",
        "kinfitr 0.9.1 .09 (5.6) / 7.0 (17); KMAP-C .10 (.19) / 4.2 (23); PETPAL 0.6.7 .31 (.47) / 5.4 (17)",
    ),
    "irr2tcm": ("2TCM3k", "Ki", "kinfitr .02 / 1.7; KMAP-C .08 / 1.8"),
    "1tcm": ("1TCM", "VT", "kinfitr .14 / .65; KMAP-C .11 / .68; PETPAL .15 / .65"),
}
_DECAY = np.log(2.0) / 20.364  # carbon-11, 1/min


def measure_accuracy(folder: Path) -> list[dict[str, object]]:
    """One row a set, clean or noisy, and quantity.

    Args:
        folder: `frames.tsv` and, a set, `<set>_true.tsv`, `<set>_clean.tsv`, `<set>_noisy.tsv`.

    Raises:
        InputError: the folder lacks them.
    """
    if not (folder / "frames.tsv").is_file():
        raise InputError(f"{folder}: no frames.tsv; give the folder of the benchmark curves with --data.")
    edges = np.loadtxt(folder / "frames.tsv", skiprows=1)
    frames = FrameSchedule(edges[:, 0], edges[:, 1])
    rows: list[dict[str, object]] = []
    for name, (label, outcome, peers) in SETS.items():
        header = (folder / f"{name}_true.tsv").read_text().split("\n", 1)[0].split("\t")
        truth = dict(zip(header, np.loadtxt(folder / f"{name}_true.tsv", skiprows=1).T))
        for what in ("clean", "noisy"):
            curves = np.loadtxt(folder / f"{name}_{what}.tsv")
            settings = NonlinearSettings(compartment_model(label), effort=REGIONS, keep_predicted=False)
            weights = counting_weights(curves.mean(axis=0), frames, _DECAY)
            result = fit_curves(curves, _arterial(), FrameObservation(frames, 0.0), weights, settings)
            failed = int(np.isin(result.status, (Status.NOT_FINITE, Status.NO_SIGNAL, Status.NOT_CONVERGED)).sum())
            for symbol in (s for s in dict.fromkeys((*header, outcome)) if s in truth):
                error = 100.0 * np.abs(result[symbol] / truth[symbol] - 1.0)
                rows.append(
                    {
                        "set": name,
                        "curves": what,
                        "model": label,
                        "quantity": symbol,
                        "median_error_percent": float(np.nanmedian(error)),
                        "p90_error_percent": float(np.nanpercentile(error, 90)),
                        "failed": failed,
                        "others_clean_noisy": peers if symbol == outcome else "",
                    }
                )
    return rows


def _arterial() -> InputFunction:
    """The curves' input: Feng's, arriving at 0.735 min, plasma and whole blood alike (kBq/mL over min)."""
    coefficients = torch.tensor([851.1225, -21.8798 - 20.8113, 21.8798, 20.8113], dtype=torch.float64)
    exponents = torch.tensor([-4.133859, -4.133859, -0.1190996, -0.01043449], dtype=torch.float64)
    plasma = ExponentialSum(coefficients, exponents, (1, 0, 0, 0), onset=0.735)
    return InputFunction(plasma, plasma)
