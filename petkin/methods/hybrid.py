"""Tissue learned from a population: one compartment, and what others' scans taught that it lacks."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.fitting import Choices, Estimate, FitResult, Given, Plot, Status
from petkin.kinetics import ONE_TISSUE, Macro
from petkin.methods.method import Method

if TYPE_CHECKING:
    from torch import Tensor

    from petkin.learning import Identified

_VOLUME = Macro("VT", "mL cm^-3", lambda K1, k2: K1 / k2, "C_T/C_P at rest, with the learned correction")
#: Curves in a picture.
_SHOWN = 6


def _fit(curves: NDArray[np.floating], given: Given, choices: Choices, voxels: bool) -> FitResult:
    import torch

    from petkin.learning import Known, Measured, identify_scan

    arterial = given.input("hybrid")
    if choices.checkpoint is None:
        raise InputError("--model hybrid needs --checkpoint FILE, made by petkin train.")
    decay = given.observation.decay
    if decay <= 0:
        raise InputError("--model hybrid needs decay-weighted frame means: leave --observation at frame.")
    weights = torch.tensor(np.asarray(given.weights, np.float64))
    known = Known(arterial.plasma, arterial.whole_blood, given.observation)
    values = np.asarray(curves, np.float64)
    usable = np.isfinite(values).all(axis=1) & (values.sum(axis=1) > 0)
    scan = Measured(torch.tensor(values[usable]), weights, known)
    found = identify_scan(choices.checkpoint, scan, half_life=math.log(2.0) / decay)
    return _result(values, usable, found, np.asarray(given.weights))


def _result(values: NDArray, usable: NDArray[np.bool_], found: Identified, weights: NDArray) -> FitResult:
    def spread(part: Tensor) -> NDArray[np.float64]:
        whole = np.full((len(values), *part.shape[1:]), np.nan)
        whole[usable] = part.double().numpy()
        return whole

    physics, errors, misfit = spread(found.physics), spread(found.percent_se), spread(found.misfit)
    estimates = tuple(
        Estimate(q.symbol, q.unit, physics[:, i], errors[:, i], q.meaning)
        for i, q in enumerate((*ONE_TISSUE.parameters, _VOLUME))
    )
    status = np.where(usable, Status.OK, Status.NO_SIGNAL).astype(np.uint8)
    status[~np.isfinite(values).all(axis=1)] = Status.NOT_FINITE
    return FitResult(
        model="hybrid",
        estimates=estimates,
        chi2=misfit,
        aicc=np.full(len(values), np.nan),
        status=status,
        weights=weights,
        predicted=spread(found.predicted),
        remarks=found.remarks,
        plots=_plots(np.flatnonzero(usable), found),
    )


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
    regions_only=True,
)
