"""Small values on the command line, taken apart with one clear line where they are wrong."""

from __future__ import annotations

import math
import shlex
import sys
from collections.abc import Collection

from petkin.errors import InputError


def numbers_by_symbol(entries: list[str], *, option: str) -> dict[str, float]:
    """`vB=0.05` entries as {symbol: number}; files' VB is vB."""
    return {_symbol(e, option): _number(e.partition("=")[2], e, option) for e in entries}


def bounds_by_symbol(entries: list[str], *, option: str) -> dict[str, tuple[float, float]]:
    """`K1=0:2` entries as {symbol: (lower, upper)}."""
    found = {}
    for entry in entries:
        low, colon, high = entry.partition("=")[2].partition(":")
        if not colon:
            raise InputError(f"{option} {entry!r}: give SYMBOL=LOWER:UPPER, e.g. K1=0:2.")
        found[_symbol(entry, option)] = (_number(low, entry, option), _number(high, entry, option))
    return found


def interval(text: str, *, option: str) -> tuple[float, float]:
    """`0.001:5` as two numbers."""
    low, colon, high = text.partition(":")
    if not colon:
        raise InputError(f"{option} {text!r}: give LOWER:UPPER, e.g. 0.001:5.")
    return _number(low, text, option), _number(high, text, option)


def delay_in_minutes(text: str) -> str | float:
    """`estimate`, or seconds as minutes."""
    return text if text == "estimate" else _number(text, text, "--delay") / 60.0


def dose_in_mbq(text: str) -> str | float:
    """`stated` or `total`, or a number of MBq."""
    return text if text in ("stated", "total") else _number(text, text, "--dose")


def seconds(text: str, *, option: str) -> float:
    """A number of seconds."""
    return _number(text, text, option)


def minutes_or_auto(text: str, *, option: str) -> float | None:
    """A number of minutes, or None for `auto`."""
    return None if text == "auto" else _number(text, text, option)


def labels(given: list[str] | None, entity: str) -> tuple[str, ...]:
    """Labels of subjects or sessions, each once, with or without the `sub-` or `ses-` that files write before them."""
    return tuple(dict.fromkeys(label.removeprefix(entity) for label in given or ()))


def regions_and_symbols(entries: list[str]) -> tuple[tuple[str, str], ...]:
    """`putamen:VT` entries as (region, symbol); without a symbol, ""."""
    pairs = []
    for entry in entries:
        region, colon, symbol = entry.rpartition(":") if ":" in entry else (entry, "", "")
        if not region or (colon and not symbol):
            raise InputError(f"--profile {entry!r}: give REGION or REGION:SYMBOL, e.g. putamen:VT.")
        pairs.append((region, "vB" if symbol == "VB" else symbol))
    return tuple(dict.fromkeys(pairs))


def typed_command(*, without: Collection[str] = (), flags: Collection[str] = ()) -> str:
    """The command as typed, without the program's folder, and without options that change no result.

    Args:
        without: such options that take a value.
        flags: such options that take none.
    """
    kept, words = ["petkin"], iter(sys.argv[1:])
    for word in words:
        if word in without:
            next(words, None)
        elif word not in flags and word.partition("=")[0] not in without:
            kept.append(word)
    return shlex.join(kept)


def memory_size(text: str) -> int:
    """`4G` as bytes; units are powers of 1024, and a number alone is bytes."""
    number, unit = text.strip().upper().removesuffix("B").removesuffix("I"), 1
    for power, letter in enumerate("KMGT", start=1):
        if number.endswith(letter):
            number, unit = number.removesuffix(letter), 1024**power
    size = _number(number, text, "--memory") * unit
    if not size > 0:
        raise InputError(f"--memory {text!r}: give what petkin may hold, e.g. 4G.")
    return int(size)


def _symbol(entry: str, option: str) -> str:
    symbol, equals, _ = entry.partition("=")
    if not equals or not symbol:
        raise InputError(f"{option} {entry!r}: give SYMBOL=VALUE, e.g. vB=0.05.")
    return "vB" if symbol == "VB" else symbol


def _number(text: str, entry: str, option: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{option} {entry!r}: {text!r} is not a finite number.")
    return value
