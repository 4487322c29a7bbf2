"""Simultaneous estimation of the non-displaceable distribution volume (SIMEVND): one VND for all regions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.fitting import Choices, FitResult, Given, fit_shared
from petkin.kinetics import TWO_TISSUE, with_ratio
from petkin.methods.compartments import nonlinear_settings
from petkin.methods.method import Method

_MODEL = replace(with_ratio(TWO_TISSUE), label="SIMEVND")


def _fit(curves: NDArray[np.floating], given: Given, choices: Choices, voxels: bool) -> FitResult:
    if voxels:
        raise InputError("SIMEVND looks for the VND that all regions of a scan have in common; use --level region.")
    settings = nonlinear_settings(_MODEL, choices, voxels)
    return fit_shared("VND", curves, given.input("SIMEVND"), given.observation, given.weights, settings)


SIMEVND = Method(
    label="SIMEVND",
    name="simultaneous estimation of VND",
    fit=_fit,
    symbols=_MODEL.parameters.symbols,
    outcome="VT",
    equation=TWO_TISSUE.equation + ";  K1/k2 = VND in every region",
    how="The two-tissue model in all regions at once with one VND: their summed weighted squares over their noise "
    "variances, least over a profile in VND. Its standard error is where that sum has risen by 1, and the errors of "
    "all else hold it. Regions must differ in binding, and none may lack it, for VND to be told.",
    reference="Ogden RT, Zanderigo F, Parsey RV. NeuroImage 2015;108:234-242; symbols: Innis RB et al. 2007, "
    "doi:10.1038/sj.jcbfm.9600493",
    regions_only=True,
)
