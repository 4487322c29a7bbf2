"""From verdicts and answers to one row a metric, each beside its bar.

A cause is right when it is in the class of what was withheld: itself, or what looks the same after the refit.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from petkin_bench.withheld.causes import KNOWN
from petkin_bench.withheld.making import BINS
from petkin_bench.withheld.noise import KINDS

Array = NDArray[np.float64]

#: Strength from which most bars hold, strength beyond the catalogue from which a gap must be called unknown, and a
#: probability that is sure of a name.
_STRONG, _BEYOND, _SURE = 6.0, 5.0, 0.9
_CALIBRATION_BINS = 5
#: How near a size must be; causes whose size the generator means as the catalogue does: a delay that is withheld from
#: the simulator is a share of three minutes.
_NEAR = 0.2
_SIZED = frozenset(c.name for c in KNOWN if not c.flag) - {"arterial_delay"}


@dataclass(frozen=True)
class Metric:
    """A share or a size with the number of cases behind it, and the bar: at least (`>=`), at most (`<=`) or none."""

    name: str
    value: float
    cases: int
    bar: float | None = None
    side: str = ">="

    @property
    def met(self) -> bool | None:
        """Whether the bar is reached; None without one, or without cases."""
        if self.bar is None or not self.cases:
            return None
        return self.value >= self.bar if self.side == ">=" else self.value <= self.bar


@dataclass(frozen=True)
class Judged:
    """A case with its verdict: the columns of both files."""

    cells: dict[str, str]

    def number(self, name: str) -> float:
        return float(self.cells[name])

    def words(self, name: str) -> list[str]:
        """Entries of a list."""
        return [word for word in self.cells[name].split(";") if word]

    @property
    def kind(self) -> str:
        return self.cells["kind"]

    @property
    def claimed(self) -> bool:
        return self.cells["verdict"] != "none"

    @property
    def strength(self) -> float:
        return self.number("detectability")

    @property
    def classes(self) -> list[list[str]]:
        return [text.split("|") for text in self.words("classes")]

    def hits(self, label: str) -> int:
        """How many of the classes a label names."""
        named = label.split("+")
        return sum(any(n in c for n in named) for c in self.classes)

    def is_right(self, label: str) -> bool:
        """Whether it names every class and nothing else."""
        return self.hits(label) == len(self.classes) == len(label.split("+"))

    @cached_property
    def right(self) -> bool:
        return self.claimed and self.is_right(self.cells["leader"])

    @cached_property
    def covered(self) -> bool:
        return any(self.is_right(label) for label in self.words("set"))


def joined(verdicts: Path, answers: Path) -> list[Judged]:
    """Cases that have both."""
    with verdicts.open(newline="") as first, answers.open(newline="") as second:
        truths = {row["index"]: row for row in csv.DictReader(second)}
        return [Judged(row | truths[row["index"]]) for row in csv.DictReader(first) if row["index"] in truths]


def metrics(cases: Sequence[Judged]) -> list[Metric]:
    """Every metric of a run of scans."""
    strong = strong_ones(cases)
    named = [c for c in strong if c.claimed and c.cells["leader"] == c.cells["names"]]
    return verdict_metrics(cases, [*_places(strong), *_sizes(named)])


def strong_ones(cases: Iterable[Judged]) -> list[Judged]:
    """Single causes of the strength from which most bars hold."""
    return [c for c in cases if c.kind in ("known", "other form") and c.strength >= _STRONG]


def verdict_metrics(cases: Sequence[Judged], more: Iterable[Metric]) -> list[Metric]:
    """What any verdict is judged by, with more about where and how large."""
    strong = strong_ones(cases)
    seconds = [c.number("seconds") for c in cases]
    return [
        *_alarms([c for c in cases if c.kind == "none"]),
        *_by_strength([c for c in cases if c.kind in ("known", "other form")]),
        *_sets(strong),
        share_of("stage first, d' >= 6", (c.cells["stage"] == c.cells["stages"] for c in strong), 0.85),
        *more,
        *_pairs([c for c in cases if c.kind == "pair"]),
        *_unknown([c for c in cases if c.kind == "unknown" and c.number("perpendicular") >= _BEYOND], strong),
        *_by_perpendicular([c for c in cases if c.kind == "unknown"]),
        *_calibration(cases, strong),
        *_closure([c for c in strong if c.claimed and c.cells["closure"]]),
        Metric("CPU s a scan, median", float(np.median(seconds)) if seconds else float("nan"), len(seconds)),
    ]


def share_of(name: str, hits: Iterable[bool], bar: float | None = None, side: str = ">=") -> Metric:
    """Share of the hits."""
    found = list(hits)
    return Metric(name, float(np.mean(found)) if found else float("nan"), len(found), bar, side)


def _alarms(nulls: Sequence[Judged]) -> list[Metric]:
    each = [
        share_of(f"false alarms, {kind}", (c.claimed for c in nulls if c.cells["noise"] == kind), 0.05, "<=")
        for kind in KINDS
    ]
    return [*each, share_of("false alarms, all", (c.claimed for c in nulls), 0.05, "<=")]


def _by_strength(single: Sequence[Judged]) -> list[Metric]:
    edges = [0.9 * low for low, _ in BINS] + [BINS[-1][1], np.inf]
    names = [f"d' {low:g}-{high:g}" for low, high in BINS] + [f"d' > {BINS[-1][1]:g}"]
    found = []
    for name, low, above in zip(names, edges, edges[1:]):
        part = [c for c in single if low <= c.strength < above]
        ceiling = float(np.mean([c.number("ceiling") for c in part])) if part else float("nan")
        allowed = 0.15 if low < BINS[0][1] else 0.05
        found += [
            share_of(f"gap claimed, {name}", (c.claimed for c in part)),
            Metric(f"matched filter, {name}", ceiling, len(part)),
            of_reader(f"must find settings, {name}", part, "ideal"),
            of_reader(f"must find settings and claim, {name}", part, "ideal_claimed"),
            share_of(f"class first, {name}", (c.right for c in part), ceiling - allowed),
        ]
    return found


def of_reader(name: str, part: Sequence[Judged], cell: str) -> Metric:
    """Mean of what a reader told all but the settings would name, where one was asked."""
    told = [float(c.cells[cell]) for c in part if c.cells.get(cell)]
    return Metric(name, float(np.mean(told)) if told else float("nan"), len(told))


def _sets(strong: Sequence[Judged]) -> list[Metric]:
    told = [c for c in strong if c.words("set")]
    sizes = [len(c.words("set")) for c in told]
    return [
        share_of("set covers, d' >= 6, at least", (c.covered for c in strong), 0.87),
        share_of("set covers, d' >= 6, at most", (c.covered for c in strong), 0.93, "<="),
        Metric("set size, median", float(np.median(sizes)) if sizes else float("nan"), len(sizes), 2.0, "<="),
        share_of("set size <= class + 1", (n <= len(c.classes[0]) + 1 for n, c in zip(sizes, told)), 0.9),
    ]


def _places(strong: Sequence[Judged]) -> list[Metric]:
    timed = [c for c in strong if c.number("frame") >= 0 and c.right]
    local = [c for c in strong if c.number("region") >= 0 and c.claimed]
    inside = [c.cells["region"] in c.words("regions") for c in local]
    told = sum(len(c.words("regions")) for c in local)
    return [
        share_of("onset within a frame", (abs(c.number("onset_frame") - c.number("frame")) <= 1 for c in timed), 0.9),
        Metric("regions: precision", sum(inside) / max(told, 1), told, 0.9),
        share_of("regions: recall", inside, 0.9),
    ]


def _sizes(named: Sequence[Judged]) -> list[Metric]:
    """Of causes of a known form that lead with their very name: how far off sizes are, and what intervals hold."""
    known = [c for c in named if c.kind == "known"]
    sized = [c for c in known if c.cells["leader"] in _SIZED and c.cells["amplitude"]]
    timed = [c for c in known if c.number("sets_in") >= 0 and c.cells["onset_low"]]
    near = (abs(abs(c.number("amplitude")) / c.number("size") - 1.0) <= _NEAR for c in sized)
    return [
        share_of("amplitude within 0.20", near),
        share_of("amplitude interval holds it", (_holds_size(c) for c in sized)),
        share_of("onset interval holds it", (_holds_onset(c) for c in timed)),
    ]


def _holds_size(case: Judged) -> bool:
    return holds(case.number("amplitude_low"), case.number("amplitude_high"), case.number("size"))


def holds(low: float, high: float, size: float) -> bool:
    """Whether an interval holds a size, but for its sign."""
    return low <= size <= high or low <= -size <= high


def _holds_onset(case: Judged) -> bool:
    return case.number("onset_low") <= case.number("sets_in") <= case.number("onset_high")


def _pairs(pairs: Sequence[Judged]) -> list[Metric]:
    named = [c.hits(c.cells["leader"]) for c in pairs]
    return [
        share_of("pairs: both named", (n == 2 for n in named), 0.7),
        share_of("pairs: one named", (n >= 1 for n in named), 0.95),
        share_of("pairs: both in the set", (c.covered for c in pairs)),
    ]


def _unknown(alien: Sequence[Judged], strong: Sequence[Judged]) -> list[Metric]:
    of_alien, of_known = (
        np.array([c.number("unknown_probability") if c.claimed else -1.0 for c in cases]) for cases in (alien, strong)
    )
    limit = max(float(np.quantile(of_known, 0.9)), 0.0) if len(of_known) else 1.0
    sure = (c.number("leader_probability") > _SURE and c.cells["verdict"] in ("named", "ambiguous") for c in alien)
    return [
        share_of("unknown: gap claimed", (c.claimed for c in alien)),
        share_of("unknown: recall", (c.cells["verdict"] == "unknown" for c in alien), 0.8),
        share_of("unknown: recall at 0.10 of known rejected", (p > limit for p in of_alien), 0.56),
        share_of("unknown: known rejected", (c.cells["verdict"] == "unknown" for c in strong), 0.1, "<="),
        Metric("unknown: AUROC", auroc(of_alien, of_known), len(alien), 0.9),
        share_of("unknown: named with p > 0.9", sure, 0.05, "<="),
    ]


def _by_perpendicular(alien: Sequence[Judged]) -> list[Metric]:
    """Recall over what lies beyond one and two catalogued effects."""
    found = []
    for low, above in pairwise((0.0, _BEYOND, 8.0, 12.0, np.inf)):
        part = [c for c in alien if low <= c.number("perpendicular") < above]
        name = f"unknown: recall at d' beyond {low:g}-{above:g}"
        found.append(share_of(name, (c.cells["verdict"] == "unknown" for c in part)))
    return found


def auroc(positive: Array, negative: Array) -> float:
    """Probability that a positive scores above a negative, ties half."""
    if not len(positive) or not len(negative):
        return float("nan")
    above = positive[:, None] - negative[None]
    return float((above > 0).mean() + 0.5 * (above == 0).mean())


def calibration_of(cases: Sequence[Judged]) -> Metric:
    """How far sets are from holding what they say, of all that are told."""
    told = [c for c in cases if c.words("set")]
    said, true = np.array([c.number("set_probability") for c in told]), np.array([float(c.covered) for c in told])
    return Metric("calibration error of set_probability", calibration_error(said, true), len(told), 0.05, "<=")


def _calibration(cases: Sequence[Judged], strong: Sequence[Judged]) -> list[Metric]:
    first, hit = np.array([c.number("leader_probability") for c in strong]), np.array([float(c.right) for c in strong])
    prior = 1.0 / len(KNOWN)
    skill = 1.0 - float(np.mean((first - hit) ** 2) / np.mean((prior - hit) ** 2)) if strong else float("nan")
    return [
        calibration_of(cases),
        Metric("Brier skill of the leader over equal chances", skill, len(strong), 0.6),
    ]


def calibration_error(said: Array, true: Array) -> float:
    """Mean over bins of equal counts of |said - true|, weighed by their counts."""
    if not len(said):
        return float("nan")
    parts = np.array_split(np.argsort(said, kind="stable"), min(_CALIBRATION_BINS, len(said)))
    return float(sum(len(p) * abs(said[p].mean() - true[p].mean()) for p in parts) / len(said))


def _closure(told: Sequence[Judged]) -> list[Metric]:
    near = [abs(c.number("closure") - c.number("closed")) <= 0.1 for c in told]
    held = [c.number("closure_low") - 1e-9 <= c.number("closed") <= c.number("closure_high") + 1e-9 for c in told]
    return [
        share_of("closure within 0.10", near, 0.9),
        share_of("closure interval covers, at least", held, 0.85),
        share_of("closure interval covers, at most", held, 0.95, "<="),
        share_of("right cause closes 0.9 of the gap", (c.number("closed") >= 0.9 for c in told if c.right), 0.9),
    ]


def text_of(found: Sequence[Metric]) -> str:
    """A line a metric."""
    lines = [f"{'metric':44}{'value':>8}{'cases':>7}{'bar':>9}  met"]
    for m in found:
        bar = "" if m.bar is None else f"{m.side} {m.bar:.2f}"
        met = {None: "", True: "yes", False: "no"}[m.met]
        lines.append(f"{m.name:44}{m.value:8.3f}{m.cases:7d}{bar:>9}  {met}")
    return "\n".join(lines)
