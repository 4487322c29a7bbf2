"""How sure a scan's regional results are, as far as it was asked: profile likelihoods, bootstrap, choice of a model."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.fitting import FitResult, Given, compare_models, tabulate
from petkin.fitting.bootstrap import bootstrap
from petkin.fitting.profile import profile, with_profiles
from petkin.io import RegionalCurves
from petkin.methods import Method
from petkin.study.request import FitRequest


def check_regions(request: FitRequest, curves: RegionalCurves | None) -> None:
    """Whether the regions that profiles are asked for are there.

    Raises:
        InputError: one is not, or there are no regions.
    """
    for region, _ in request.profiles:
        if curves is None:
            raise InputError(f"--profile {region!r}: there are no regional curves; give --dseg or --tacs.")
        if region not in curves.names:
            some = ", ".join(curves.names[:8]) + (", ..." if len(curves.names) > 8 else "")
            raise InputError(f"--profile {region!r}: there is no such region in {curves.where}; it has {some}.")


def more_certain(
    result: FitResult,
    method: Method,
    curves: RegionalCurves,
    given: Given,
    request: FitRequest,
    progress: Callable[[float], None],
) -> FitResult:
    """The regional result with the profiles and the bootstrap that were asked for.

    Args:
        result: the method's fit of the regional curves.
        method: the method.
        curves: the regional curves.
        given: what the scan gives besides.
        request: what was asked.
        progress: told how far it is, 0 to 1.
    """
    if request.bootstrap is not None:

        def refit(made: NDArray[np.float64], voxels: bool) -> FitResult:
            return method.fit(made, given, request.choices, voxels)

        result = bootstrap(refit, result, curves.values, request.bootstrap, progress)
    if method.nonlinear is None or not request.profiles:
        return result
    settings = method.nonlinear(request.choices, False)
    table = tabulate(given.input(method.label), given.observation, settings)
    found = {}
    for i, region in enumerate(dict.fromkeys(region for region, _ in request.profiles)):
        row = curves.names.index(region)
        symbols = [symbol for name, symbol in request.profiles if name == region]
        wanted = [] if "" in symbols else [s for s in symbols if s in [e.symbol for e in result.estimates]]
        if wanted or "" in symbols:
            found[row] = profile(curves.values[row], result, row, table, settings, wanted)
        progress((i + 1) / len(request.profiles))
    return with_profiles(result, curves.names, found)


def chosen_model(methods: tuple[Method, ...], results: tuple[FitResult, ...]) -> tuple[FitResult, ...]:
    """The models compared by AICc, where it is over the same frames and weights; empty for fewer than two."""
    comparable = [result for method, result in zip(methods, results) if method.comparable]
    same = tuple(result for result in comparable if np.array_equal(result.weights, comparable[0].weights))
    return (compare_models(same),) if len(same) > 1 else ()
