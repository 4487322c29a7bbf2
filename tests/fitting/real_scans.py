"""Twelve human [11C]PBR28 scans with the input curves, weights and best fits of another program (kinfitr 0.9.1)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from petkin.dynamics import PiecewiseLinear
from petkin.imaging import FrameSchedule
from petkin.inputs.input_function import InputFunction

from .regridded_input import as_the_reference_reads

#: Samples kept of the 6000 equal steps where the exact response is asked for: all to 12 min, every eighth after.
_DENSE_UNTIL, _EVERY = 800, 8


@dataclass(frozen=True)
class Scan:
    """One scan.

    Args:
        name: subject and session, as the tables have it.
        frames: schedule.
        curves: regional curves, one column a region, kBq/mL.
        weights: the reference's frame weights, zero in empty frames.
        blood: its input curves: time (min), AIF and whole_blood_radioactivity (kBq/mL).
        best: its best fit a region over several starts, with `inpshift` (min).
    """

    name: str
    frames: FrameSchedule
    curves: pd.DataFrame
    weights: np.ndarray
    blood: pd.DataFrame
    best: pd.DataFrame

    @property
    def shift(self) -> float:
        return float(self.best.inpshift.iloc[0])

    def arterial(self) -> InputFunction:
        """The input curves as straight lines, not shifted."""
        last = len(self.blood) - 1
        keep = np.unique(np.r_[np.arange(_DENSE_UNTIL), np.arange(_DENSE_UNTIL, last, _EVERY), last])
        columns = (torch.tensor(self.blood[c].to_numpy()[keep]) for c in ("time", "AIF", "whole_blood_radioactivity"))
        time, plasma, blood = columns
        return InputFunction(PiecewiseLinear(time, plasma), PiecewiseLinear(time, blood))

    def arterial_as_the_reference_reads(self) -> InputFunction:
        time, plasma, blood = (self.blood[c].to_numpy() for c in ("time", "AIF", "whole_blood_radioactivity"))
        return as_the_reference_reads(time, plasma, blood, self.shift, float(self.frames.mid[-1]))

    def wrss(self, region_curves: np.ndarray, predicted: np.ndarray) -> np.ndarray:
        return np.nansum(self.weights * (region_curves - predicted) ** 2, axis=1)


def read_scans(folder: Path) -> list[Scan]:
    """All scans of the folder."""
    kinfitr, rois = folder / "derivatives" / "kinfitr", folder / "derivatives" / "rois"
    table = pd.read_csv(kinfitr / "multistart_2tcm_same_bounds.tsv", sep="\t")
    scans = []
    for name, best in table.groupby("PET"):
        subject, session = str(name).split("_")
        stem = f"sub-{subject}/ses-{session}/pet/sub-{subject}_ses-{session}_"
        curves = pd.read_csv(rois / f"{stem}seg-rois_tacs.tsv", sep="\t")
        blood = pd.read_csv(kinfitr / f"{stem}inputfunction.tsv", sep="\t")
        blood["time"] /= 60.0
        weights = pd.read_csv(kinfitr / f"{stem}desc-weights_tacs.tsv", sep="\t").weight.to_numpy()
        frames = FrameSchedule(curves.frame_start.to_numpy() / 60.0, curves.frame_end.to_numpy() / 60.0)
        scans.append(Scan(str(name), frames, curves, weights, blood, best))
    return scans
