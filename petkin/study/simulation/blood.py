"""Blood as a laboratory samples it: an autosampler for the first minutes, and samples drawn by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray

from petkin.dynamics import Forcing
from petkin.inputs import InputFunction, dispersed
from petkin.phantoms import random_stream
from petkin.study.simulation.planning import Plan
from petkin.study.simulation.scene import Scene
from petkin.units import SECONDS_PER_MINUTE

#: The autosampler draws whole blood once a second for ten minutes.
AUTOSAMPLER_END_S = 600
#: Times of samples by hand, min; further ones every 15 min, and one at the end of the scan.
MANUAL_TIMES = (1, 2, 3, 5, 8, 10, 12, 14, 16, 18, 20, 25, 30, 35, 40, 50, 60, 75, 90)
#: Samples whose metabolites are measured.
METABOLITE_TIMES = (2, 5, 8, 12, 20, 30, 40, 60, 90)

_ACTIVITY = {"Units": "kBq/mL"}
_COLUMNS: dict[str, dict[str, str]] = {
    "time": {"Description": "time of the sample from TimeZero", "Units": "s"},
    "whole_blood_radioactivity": {"Description": "activity in whole blood, decay-corrected to TimeZero", **_ACTIVITY},
    "plasma_radioactivity": {"Description": "total activity in plasma, decay-corrected to TimeZero", **_ACTIVITY},
    "metabolite_parent_fraction": {
        "Description": "fraction of the plasma activity that is unchanged tracer",
        "Units": "unitless",
    },
}
Recording = tuple[pd.DataFrame, dict[str, Any]]


def blood_recordings(plan: Plan, scene: Scene) -> dict[str, Recording]:
    """Tables and their JSON by recording label, of the record, not of the truth."""
    rng = random_stream(plan.settings.seed, "blood samples", scene.subject, scene.session)
    end = float(plan.frames.end[-1])
    return {
        "autosampler": _autosampler(plan, scene.record.input, end, rng),
        "manual": _manual(plan, scene.record.input, end, rng),
    }


def manual_times(end: float) -> NDArray[np.float64]:
    """Times of samples by hand in a scan that ends at `end`, min."""
    late = np.arange(MANUAL_TIMES[-1] + 15.0, end, 15.0)
    times = np.concatenate([np.array(MANUAL_TIMES, float), late])
    return np.append(times[times < end - 0.5], end)


def _autosampler(plan: Plan, arterial: InputFunction, end: float, rng: np.random.Generator) -> Recording:
    times = np.arange(min(AUTOSAMPLER_END_S, int(end * SECONDS_PER_MINUTE)) + 1.0)
    tau, curve = plan.settings.sampler_dispersion / SECONDS_PER_MINUTE, arterial.whole_blood
    if tau > 0:
        curve = dispersed(curve, tau, end=times[-1] / SECONDS_PER_MINUTE + 1.0)
    values = _measured(_at(curve, times / SECONDS_PER_MINUTE), plan, rng)
    table = pd.DataFrame({"time": times, "whole_blood_radioactivity": values})
    stated = {"DispersionCorrected": tau == 0}
    if tau > 0:
        stated |= {"DispersionConstant": plan.settings.sampler_dispersion}
    return table, _sidecar(table, plasma=False, metabolites=False) | stated


def _manual(plan: Plan, arterial: InputFunction, end: float, rng: np.random.Generator) -> Recording:
    times = manual_times(end)
    total = arterial.total_plasma or arterial.plasma
    table = pd.DataFrame(
        {
            "time": times * SECONDS_PER_MINUTE,
            "plasma_radioactivity": _measured(_at(total, times), plan, rng),
            "whole_blood_radioactivity": _measured(_at(arterial.whole_blood, times), plan, rng),
        }
    )
    fraction = arterial.parent_fraction
    if fraction is not None:
        measured = np.isin(times, METABOLITE_TIMES) | (times == times[-1])
        values = _measured_share(_at(fraction, times), plan, rng)
        table["metabolite_parent_fraction"] = np.where(measured, values, np.nan)
    return table, _sidecar(table, plasma=True, metabolites=fraction is not None) | {"DispersionCorrected": True}


def _sidecar(table: pd.DataFrame, *, plasma: bool, metabolites: bool) -> dict[str, Any]:
    fields: dict[str, Any] = {"PlasmaAvail": plasma, "WholeBloodAvail": True, "MetaboliteAvail": metabolites}
    if metabolites:
        fields |= {"MetaboliteMethod": "simulated", "MetaboliteRecoveryCorrectionApplied": False}
    return fields | {str(column): _COLUMNS[str(column)] for column in table.columns}


def _at(curve: Forcing, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """A curve at times (min), to 1e-6: a formula leaves 1e-15 of either sign where it starts."""
    return np.asarray(curve(torch.from_numpy(times)).numpy().round(6) + 0.0, np.float64)


def _measured(values: NDArray[np.float64], plan: Plan, rng: np.random.Generator) -> NDArray[np.float64]:
    return values * (1.0 + 0.01 * plan.settings.blood_noise * rng.standard_normal(values.shape))


def _measured_share(values: NDArray[np.float64], plan: Plan, rng: np.random.Generator) -> NDArray[np.float64]:
    """Shares with errors on their log odds, so that none passes 1; the sd of a share is that percent of it."""
    if plan.settings.blood_noise == 0:
        return values
    error = 0.01 * plan.settings.blood_noise * rng.standard_normal(values.shape)
    odds = values / (1.0 - values) * np.exp(error / (1.0 - values))
    return odds / (1.0 + odds)
