"""Voxels fitted block by block, so that what a fit holds at a time has a bound. No value depends on the blocks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petkin.fitting import Choices, FitResult, Given
from petkin.io import Rows
from petkin.methods import Method, find_method
from petkin.study.series import VoxelCurves

_NONE = np.empty(0, np.uint8)
#: Most voxels that something shared by all is estimated from.
_SAMPLE = 10_000


@dataclass(frozen=True)
class _Block:
    """What came of a block: values and errors in turn, chi2 and AICc; status and what else is known; the rest of it."""

    values: NDArray[np.float32]
    codes: list[NDArray[Any]]
    fit: FitResult


def fit_voxels(
    method: Method,
    voxels: VoxelCurves,
    given: Given,
    choices: Choices,
    progress: Callable[[float], None],
) -> FitResult:
    """A method fitted to all voxels; values are float32 and may lie in a file.

    Args:
        method: what to fit.
        voxels: their curves.
        given: what the scan gives besides.
        choices: what the user chose.
        progress: told how far it is, 0 to 1.
    """
    plan, store = voxels.plan, None
    parts = plan.parts(voxels.count)
    shared = _shared(method, voxels, given, choices)
    held = replace(choices, fixed={**choices.fixed, **{symbol: value for symbol, (value, _) in shared.items()}})
    work = partial(_fit_block, method.label, given, held, voxels.rows)
    codes, fits = [], []
    for part, block in zip(parts, plan.resources.spread(work, parts), strict=True):
        if store is None:
            store = plan.rows(f"results of {method.label}", len(block.values), voxels.count)
            codes = [np.empty(voxels.count, values.dtype) for values in block.codes]
        store.array[:, part] = block.values
        for whole, values in zip(codes, block.codes, strict=True):
            whole[part] = values
        store.release()
        fits.append(block.fit)
        progress(part.stop / voxels.count)
    assert store is not None
    joined = _joined(fits, store.array, codes)
    if not shared:
        return joined
    fixed = {symbol: value for symbol, value in joined.settings["fixed"].items() if symbol not in shared}
    return replace(joined, shared=shared, settings={**joined.settings, "fixed": fixed})


def _shared(method: Method, voxels: VoxelCurves, given: Given, choices: Choices) -> dict[str, tuple[float, float]]:
    """What all voxels have in common, from evenly spaced ones, before blocks go separate ways."""
    if method.share is None:
        return {}
    step = max(1, -(-voxels.count // _SAMPLE))
    sample = np.ascontiguousarray(voxels.rows.array[:, ::step])
    voxels.rows.release()
    return method.share(sample.T, given, choices, True)


def _fit_block(label: str, given: Given, choices: Choices, rows: Rows, part: slice) -> _Block:
    fit = find_method(label).fit(rows.array[:, part].T, given, choices, True)
    rows.release()
    numbers = [numbers for e in fit.estimates for numbers in (e.value, e.percent_se)]
    with np.errstate(over="ignore"):  # what float32 cannot hold is infinite
        values = np.stack([*numbers, fit.chi2, fit.aicc], dtype=np.float32, casting="same_kind")
        codes = [fit.status, *(_narrow(column.values) for column in fit.columns)]
    bare = tuple(replace(e, value=_NONE, percent_se=_NONE) for e in fit.estimates)
    columns = tuple(replace(column, values=_NONE) for column in fit.columns)
    return _Block(values, codes, replace(fit, estimates=bare, chi2=_NONE, aicc=_NONE, status=_NONE, columns=columns))


def _narrow(values: NDArray[Any]) -> NDArray[Any]:
    return values.astype(np.float32) if values.dtype.kind == "f" else values


def _joined(fits: list[FitResult], values: NDArray[np.float32], codes: list[NDArray[Any]]) -> FitResult:
    (*numbers, chi2, aicc), (status, *others), first = values, codes, fits[0]
    estimates = (replace(e, value=v, percent_se=se) for e, v, se in zip(first.estimates, numbers[::2], numbers[1::2]))
    return replace(
        first,
        estimates=tuple(estimates),
        chi2=chi2,
        aicc=aicc,
        status=status,
        columns=tuple(replace(column, values=whole) for column, whole in zip(first.columns, others, strict=True)),
        remarks=tuple(dict.fromkeys(remark for fit in fits for remark in fit.remarks)),
    )
