"""Tissue learned from a population: one compartment, and what others' scans taught that it lacks."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.fitting import Choices, Estimate, FitResult, Given, Plot, Status
from petkin.kinetics import ONE_TISSUE, Macro
from petkin.methods.method import Method

if TYPE_CHECKING:
    from torch import Tensor

    from petkin.learning import Identified, Mapped

_VOLUME = Macro("VT", "mL cm^-3", lambda K1, k2: K1 / k2, "C_T/C_P at rest, with the learned correction")
#: Symbol, unit and meaning of what is told, in the order of `petkin.learning.quantities`.
_TOLD = (
    *((q.symbol, q.unit, q.meaning) for q in (*ONE_TISSUE.parameters, _VOLUME)),
    ("fNN", "kBq mL^-1 min^-1", "mean over the scan of what is added to K1 C_P - k2 C_T, as learned"),
)
_VT = 3
#: Percent standard error from which on VT counts as not known.
_UNKNOWN = 100.0
#: What all voxels of a scan share.
_LEVEL = "level"
#: Curves in a picture.
_SHOWN = 6


def _fit(curves: NDArray[np.floating], given: Given, choices: Choices, voxels: bool) -> FitResult:
    import torch

    from petkin.learning import Identified, Known, Measured, identify_scan, identify_voxels

    arterial = given.input("hybrid")
    if choices.checkpoint is None:
        raise InputError("--model hybrid needs --checkpoint FILE, made by petkin train.")
    decay = given.observation.decay
    if decay <= 0:
        raise InputError("--model hybrid needs decay-weighted frame means: leave --observation at frame.")
    weights = torch.tensor(np.asarray(given.weights, np.float64))
    known = Known(arterial.plasma, arterial.whole_blood, given.observation)
    values = np.asarray(curves, np.float64)
    finite: NDArray[np.bool_] = np.isfinite(values).all(axis=1)  # type: ignore[assignment]
    usable = finite & (values.sum(axis=1) > 0)
    half_life, path = math.log(2.0) / decay, choices.checkpoint
    found: Identified | Mapped
    if voxels:
        scan = Measured(torch.tensor(np.where(usable[:, None], values, 0.0)), weights, known)
        found = identify_voxels(path, scan, half_life=half_life, level=choices.fixed[_LEVEL])
        told, errors, misfit = (part.double().numpy() for part in (found.quantities, found.percent_se, found.misfit))
        for part in (told, errors, misfit):
            part[~usable] = np.nan
    else:
        found = identify_scan(path, Measured(torch.tensor(values[usable]), weights, known), half_life=half_life)
        told, errors, misfit = (_spread(part, usable) for part in (found.quantities, found.percent_se, found.misfit))
    result = FitResult(
        model="hybrid",
        estimates=tuple(Estimate(*q[:2], told[:, i], errors[:, i], q[2]) for i, q in enumerate(_TOLD)),
        chi2=misfit,
        aicc=np.full(len(values), np.nan),
        status=_status(finite, usable, errors[:, _VT]),
        weights=np.asarray(given.weights),
        settings={"fixed": {}},
        remarks=found.remarks,
    )
    if not isinstance(found, Identified):
        return result
    return replace(result, predicted=_spread(found.predicted, usable), plots=_plots(np.flatnonzero(usable), found))


def _spread(part: Tensor, usable: NDArray[np.bool_]) -> NDArray[np.float64]:
    whole = np.full((len(usable), *part.shape[1:]), np.nan)
    whole[usable] = part.double().numpy()
    return whole


def _status(finite: NDArray[np.bool_], usable: NDArray[np.bool_], percent: NDArray) -> NDArray[np.uint8]:
    status = np.where(usable, Status.OK, Status.NO_SIGNAL).astype(np.uint8)
    status[usable & ~(percent <= _UNKNOWN)] = Status.NOT_IDENTIFIABLE
    status[~finite] = Status.NOT_FINITE
    return status


def _level(
    curves: NDArray[np.floating], given: Given, choices: Choices, voxels: bool
) -> dict[str, tuple[float, float]]:
    """Mean of the voxels, to whose scale f_NN was learned: one for all blocks of them."""
    usable = np.isfinite(curves).all(axis=1)
    level = float(np.asarray(curves)[usable].mean(dtype=np.float64)) if usable.any() else 0.0
    if not level > 0:
        raise InputError("--model hybrid: the mean of all voxels is not above zero; is there tracer in the mask?")
    return {_LEVEL: (level, 0.0)}


def _plots(places: NDArray[np.intp], found: Identified) -> tuple[Plot, ...]:
    shown = np.unique(np.linspace(0, len(places) - 1, min(_SHOWN, len(places))).round().astype(int))
    times, tissue, learned = (part.double().numpy() for part in (found.nodes, found.tissue, found.learned))
    label = "f_NN (kBq/mL/min)"
    by_state = tuple((str(places[n] + 1), tissue[n], learned[n]) for n in shown)
    by_time = tuple((str(places[n] + 1), times, learned[n]) for n in shown)
    text = "What is added to K1 C_P - k2 C_T, as learned from the population of the checkpoint."
    return (
        Plot("Learned correction against tissue", "C_T (kBq/mL)", label, by_state, text=text),
        Plot("Learned correction against time", "time (min)", label, by_time, text=text),
    )


HYBRID = Method(
    label="hybrid",
    name="one tissue compartment and a learned correction",
    fit=_fit,
    symbols=(),
    outcome="VT",
    equation="dC_T/dt = K1 C_P - k2 C_T + f_NN, f_NN of what the checkpoint says it sees, and of c_n",
    how=(
        "K1, k2, vB and c_n of every curve by gradient descent on the weighted misfit and how strange they are beside "
        "the population of the checkpoint. Standard errors: Gauss-Newton curvature of both together, "
        "or what the checkpoint missed the truth of its own population by, where that is more."
    ),
    reference="Ye Y et al. arXiv:2403.08194; Sheiner LB, Beal SL. J Pharm Sci 1982;71:1344-1348",
    share=_level,
)
