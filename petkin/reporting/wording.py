"""How numbers, units, symbols and status codes read: one place for typography, in HTML and in figures."""

from __future__ import annotations

import math

from markupsafe import Markup, escape

from petkin.fitting.results import Status

#: Symbols of Innis et al. 2007 (doi:10.1038/sj.jcbfm.9600493) and relatives, as base and index.
_SYMBOLS = {
    "K1": ("K", "1"),
    "k2": ("k", "2"),
    "k3": ("k", "3"),
    "k4": ("k", "4"),
    "k2'": ("k", "2", "′"),
    "Ki": ("K", "i"),
    "vB": ("v", "B"),
    "VB": ("V", "B"),
    "VT": ("V", "T"),
    "VND": ("V", "ND"),
    "VS": ("V", "S"),
    "BPND": ("BP", "ND"),
    "BPP": ("BP", "P"),
    "BPF": ("BP", "F"),
    "R1": ("R", "1"),
    "fP": ("f", "P"),
    "chi2": ("reduced χ²", ""),
}
_SHORT = {
    Status.OK: "fitted",
    Status.OUTSIDE: "outside the mask",
    Status.NOT_FINITE: "NaN or infinite data",
    Status.NO_SIGNAL: "no signal",
    Status.AT_BOUND: "on a bound",
    Status.NOT_IDENTIFIABLE: "not identifiable",
    Status.NOT_CONVERGED: "not converged",
    Status.SECOND_MINIMUM: "second minimum",
}
_UNFITTED = (Status.OUTSIDE, Status.NOT_FINITE, Status.NO_SIGNAL)
_MINUS, _SPACE, MISSING = "\u2212", "\u202f", "n/a"


def number(value: float, digits: int = 3) -> str:
    """A number with `digits` significant digits, a true minus sign, and "n/a" for NaN or infinity."""
    if not math.isfinite(value):
        return MISSING
    if value == 0:
        return "0"
    exponent = math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
    if -4 <= exponent < 6:
        return _signed(f"{value:.{max(digits - 1 - exponent, 0)}f}")
    mantissa, power = f"{value:.{digits - 1}e}".split("e")
    return _signed(f"{mantissa}e{int(power)}")


def percent(value: float, *, signed: bool = False) -> str:
    """A percentage with its sign: two significant digits below 10, whole numbers above; ">1000 %" beyond sense."""
    if not math.isfinite(value):
        return MISSING
    sign = "+" if signed and value > 0 else ""
    if abs(value) > 1000:
        return f"{_MINUS if value < 0 else ''}>{_SPACE}1000{_SPACE}%"
    if 0 < abs(value) < 0.001:
        return f"<{_SPACE}0.001{_SPACE}%"
    text = f"{value:.0f}" if abs(value) >= 9.95 else number(value, 2)
    return f"{sign}{_signed(text)}{_SPACE}%"


def count(value: int) -> str:
    """A whole number with narrow spaces, which do not break, between thousands."""
    return f"{value:,}".replace(",", _SPACE)


def value_with_error(value: float, percent_se: float) -> tuple[str, str]:
    """The value, rounded to two digits of its standard error, and the error: "0.412" and "± 0.011 (2.7 %)"."""
    if not math.isfinite(value):
        return MISSING, ""
    if not math.isfinite(percent_se):
        return number(value, 4), "no SE"
    error = abs(value) * percent_se / 100.0
    if percent_se > 100 or error == 0:
        return number(value, 3), f"± {percent(percent_se)}"
    shown, spread = rounded_to_error(value, error)
    return shown, f"± {spread} ({percent(percent_se)})"


def rounded_to_error(value: float, error: float) -> tuple[str, str]:
    """Both with as many decimals as show two digits of the error (> 0)."""
    decimals = max(1 - math.floor(math.log10(error)), 0)
    if decimals > 6:
        return number(value, 4), number(error, 2)
    return _signed(f"{value:.{decimals}f}"), f"{error:.{decimals}f}"


def _signed(text: str) -> str:
    return text.replace("-", _MINUS)


def unit_text(unit: str) -> str:
    """A unit with real exponents ("mL/cm3/min" becomes "mL/cm³/min"); "" for a pure number."""
    if unit.strip() in ("", "1", "unitless", "arbitrary"):
        return ""
    text = unit.replace("cm3", "cm³").replace("^-1", "⁻¹").replace("^-3", "⁻³")
    return "min⁻¹" if text == "1/min" else text


def symbol_html(symbol: str) -> Markup:
    """A symbol with its index as a subscript; unknown symbols are escaped and left as they are."""
    base, index, *rest = _SYMBOLS.get(symbol, (symbol, ""))
    lowered = Markup("<sub>{}</sub>").format(index) if index else Markup("")
    return escape(base) + lowered + escape("".join(rest))


def symbol_svg(symbol: str, after: str) -> Markup:
    """A symbol with its index lowered, and what follows it, as the content of an SVG text."""
    base, index, *rest = _SYMBOLS.get(symbol, (symbol, ""))
    after = "".join(rest) + after
    if not index:
        return escape(base + after)
    lowered = '{}<tspan dy="0.35em" font-size="70%">{}</tspan><tspan dy="-0.245em">{}</tspan>'
    return Markup(lowered).format(base, index, after)


def round_values(low: float, high: float) -> dict[float, str]:
    """A few round numbers between two, and how they read: all with as many decimals."""
    from matplotlib.ticker import MaxNLocator

    values = [float(v) for v in MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high) if low <= v <= high]
    texts = [f"{value:.10g}" for value in values]
    if not any("e" in text for text in texts):
        decimals = max((len(text.partition(".")[2]) for text in texts), default=0)
        texts = [f"{value:.{decimals}f}" for value in values]
    return dict(zip(values, map(_signed, texts)))


def status_short(status: Status) -> str:
    """A status in two or three words."""
    return _SHORT.get(status, status.name.lower().replace("_", " "))


def status_kind(status: Status) -> str:
    """ "good", "doubtful" (fitted but flagged) or "missing" (not fitted)."""
    if status == Status.OK:
        return "good"
    return "missing" if status in _UNFITTED else "doubtful"


def status_mark(status: Status) -> str:
    """A sign that tells the kinds apart without colour."""
    return {"good": "✓", "doubtful": "▲", "missing": "✗"}[status_kind(status)]


def joined(parts: list[str]) -> str:
    """ "a", "a and b", "a, b and c"."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}" if parts else ""
