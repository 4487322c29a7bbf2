"""Metrics of moving bodies, each beside its bar: those of scans that apply, sizes, and how each system does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from petkin_bench.withheld.bodies.rigs import RIGS
from petkin_bench.withheld.score import Judged, Metric, holds, share_of, strong_ones, verdict_metrics

#: How near a size must be; strength beyond the catalogue from which a gap must be called unknown; closure that is next
#: to nothing.
_NEAR, _BEYOND, _SLIGHT = 0.2, 5.0, 0.01


def body_metrics(cases: Sequence[Judged]) -> list[Metric]:
    """Every metric of a run that any case has a part in; of several systems, of each besides."""
    systems = [name for name in RIGS if any(c.cells["system"] == name for c in cases)]
    found = [*verdict_metrics(cases, _sizes(cases)), _held_nearly(cases)]
    if len(systems) > 1:
        for system in systems:
            found += _of_system(system, [c for c in cases if c.cells["system"] == system])
    whose = systems[0] if len(systems) == 1 else "bodies"
    return [replace(m, name=f"{whose}: {m.name}") for m in found if m.cases]


def _sizes(cases: Sequence[Judged]) -> list[Metric]:
    """Of strong causes that lead with their very name."""
    named = [c for c in strong_ones(cases) if c.kind == "known" and c.cells["leader"] == c.cells["names"]]
    told = [c for c in named if c.claimed and c.cells["amplitude"]]
    near = (abs(abs(c.number("amplitude")) / abs(c.number("size")) - 1.0) <= _NEAR for c in told)
    held = (holds(c.number("amplitude_low"), c.number("amplitude_high"), c.number("size")) for c in told)
    return [share_of("size within 0.20", near), share_of("size's interval holds it", held)]


def _held_nearly(cases: Sequence[Judged]) -> Metric:
    """Names here have the very form of what is missing and leave nothing, of which an interval cannot be sure."""
    told = [c for c in strong_ones(cases) if c.claimed and c.cells["closure"]]
    low = (c.number("closure_low") - _SLIGHT <= c.number("closed") for c in told)
    high = (c.number("closed") <= c.number("closure_high") + _SLIGHT for c in told)
    return share_of("closure interval covers but for 0.01", (a and b for a, b in zip(low, high, strict=True)))


def _of_system(system: str, cases: Sequence[Judged]) -> list[Metric]:
    return [
        share_of(f"{system}: false alarms", (c.claimed for c in cases if c.kind == "none")),
        share_of(f"{system}: class first, d' >= 6", (c.right for c in strong_ones(cases))),
        share_of(f"{system}: pairs, both named", (c.right for c in cases if c.kind == "pair")),
        share_of(f"{system}: no name called unknown", (c.cells["verdict"] == "unknown" for c in cases if _alien(c))),
    ]


def _alien(case: Judged) -> bool:
    return case.kind == "unknown" and case.number("perpendicular") >= _BEYOND
