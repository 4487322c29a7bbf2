"""Choices checked against the methods they are meant for."""

from __future__ import annotations

import numpy as np

from petkin.errors import InputError
from petkin.fitting import Choices, find_device
from petkin.methods.method import Method


def check_choices(methods: tuple[Method, ...], choices: Choices) -> None:
    """Refuse bounds, fixed or shared values that no chosen method has, bounds upside down, a device that is not there.

    Raises:
        InputError: with the symbol and what there is instead.
    """
    known = dict.fromkeys(symbol for method in methods for symbol in method.symbols)
    for symbol in (*choices.bounds, *choices.fixed):
        if symbol not in known:
            labels = ", ".join(method.label for method in methods)
            raise InputError(f"{symbol!r} is no parameter of {labels}; these have {', '.join(known)}.")
    for symbol, (low, high) in choices.bounds.items():
        if not 0 <= low < high:
            raise InputError(f"Bounds of {symbol} are {low:g} to {high:g}; the lower must be >= 0 and below the upper.")
    for symbol, value in choices.fixed.items():
        if not (np.isfinite(value) and value >= 0 and (symbol != "vB" or value < 1)):
            raise InputError(f"{symbol} cannot be fixed at {value:g}; give a value >= 0 (below 1 for vB).")
    shareable = dict.fromkeys(symbol for method in methods for symbol in method.shareable)
    for symbol in choices.share:
        if symbol not in shareable:
            labels = ", ".join(method.label for method in methods)
            raise InputError(
                f"{symbol!r} cannot be shared over regions by {labels}; {', '.join(shareable) or 'nothing'} can."
            )
    if len(choices.share) > 1:
        raise InputError(f"--share is given {' and '.join(choices.share)}; one parameter can be shared at a time.")
    learned = [method.label for method in methods if method.label == "hybrid"]
    if bool(learned) != (choices.checkpoint is not None):
        raise InputError("--model hybrid and --checkpoint FILE (made by petkin train) go together.")
    if choices.checkpoint is not None and not choices.checkpoint.is_file():
        raise InputError(f"{choices.checkpoint}: no such checkpoint; petkin train makes one.")
    slow, fast = choices.rate_bounds
    if not 0 <= slow < fast:
        raise InputError(f"Rates from {slow:g} to {fast:g} per min are no interval; give e.g. 0.001:5.")
    if choices.device is not None:
        find_device(choices.device)
