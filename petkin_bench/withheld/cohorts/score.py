"""Metrics of cohorts: what several scans say together beside what each says alone.

A shared cause is right when it is in the class of what was withheld. A cause that one scan
alone carries is not called shared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from petkin_bench.withheld.cohorts.cases import BINS, SHARE, SPREAD
from petkin_bench.withheld.score import Judged, Metric, auroc, calibration_of, holds, share_of

Array = NDArray[np.float64]

#: A scan carries a cause from this probability on; so many do at least where it is shared.
_CARRIES, _SEVERAL = 0.5, 2
#: Groups of scans with a cause each; probability of a confident name.
_BOTH, _SURELY = 2, 0.9
#: Causes whose size the generator means as the product does.
_SIZED = ("dispersion", "gain_drift", "gain_step")


def cohort_metrics(cases: Sequence[Judged]) -> list[Metric]:
    """Every metric of a run of cohorts."""
    shared = [c for c in cases if c.kind in ("all", "some")]
    right = [c for c in shared if c.right]
    apart, two, alien = ([c for c in cases if c.kind == kind] for kind in ("apart", "two", "unnamed"))
    count = len(cases[0].cells["each"].split(";")) if cases else 0
    found = [
        share_of("false alarms", [c.claimed for c in cases if c.kind == "none"], 0.05, "<="),
        share_of("different causes called shared", [_several(c) for c in apart]),
        share_of("two causes: both named, each of some scans", [_named(c) == _BOTH for c in two]),
        share_of("two causes: one named at least", [_named(c) > 0 for c in two]),
        share_of("a second cause named where there is none", [bool(c.cells["further"]) for c in (*shared, *apart)]),
        share_of("of no name in all: called unknown", [c.cells["verdict"] == "unknown" for c in alien]),
        share_of("of no name in all: said to be shared", [bool(c.cells["unnamed"]) for c in alien]),
        share_of("of no name in all: named with p > 0.9", [_surely(c) for c in alien]),
        share_of("named called of no name", [bool(c.cells["unnamed"]) for c in (*shared, *two)]),
        *_by_strength(shared),
        share_of("set covers", [c.covered for c in shared if _middle(c) >= BINS[1][0]], 0.87),
        share_of("scans rightly said to carry it or not", [said for c in right for said in _told(c)]),
        _carriers([c for c in right if c.kind == "some"]),
        share_of(
            "prevalence interval holds it, held by some", [_holds_prevalence(c) for c in right if c.kind == "some"]
        ),
        share_of("interval of the mean size holds it", [_holds_size(c) for c in right if _is_sized(c)]),
        share_of("a moment in common is said", [bool(c.cells["onset_low"]) for c in right if _begins(c)]),
        share_of("its interval holds it", [_holds_moment(c) for c in right if _begins(c) and c.cells["onset_low"]]),
        share_of("moments of their own said to be one", [bool(c.cells["onset_low"]) for c in right if not _begins(c)]),
        calibration_of(cases),
        Metric("CPU s a scan, median", _seconds(cases), len(cases)),
    ]
    return [replace(metric, name=f"cohorts of {count}: {metric.name}") for metric in found]


def _numbers(case: Judged, column: str) -> Array:
    return np.array([float(word) for word in case.words(column)])


def _middle(case: Judged) -> float:
    """Median d' of the scans that hold the cause."""
    found = _numbers(case, "detectability")
    return float(np.median(found[found > 0]))


def _several(case: Judged) -> bool:
    return bool(case.words("set")) and int((_numbers(case, "carriers") > _CARRIES).sum()) >= _SEVERAL


def _named(case: Judged) -> int:
    """How many of the groups' causes are named, each by what other scans share."""
    said = [case.cells["leader"] if case.words("set") else "", *case.words("further")]
    return sum(any(label in group.split("|") for label in said) for group in case.words("groups"))


def _surely(case: Judged) -> bool:
    return bool(case.words("set")) and case.number("leader_probability") > _SURELY


def _by_strength(shared: Sequence[Judged]) -> list[Metric]:
    found = []
    for low, above in pairwise((0.0, *(low for low, _ in BINS), BINS[-1][1], np.inf)):
        part = [c for c in shared if low <= _middle(c) < above]
        alone = [c.hits(label) > 0 for c in part for label in _of_holders(c)]
        for kind in ("all", "some"):
            mine = [c.right for c in part if c.kind == kind]
            found.append(share_of(f"class first, held by {kind}, d' {low:g}-{above:g}", mine))
        found.append(share_of(f"class first in a scan alone, d' {low:g}-{above:g}", alone))
    return found


def _of_holders(case: Judged) -> list[str]:
    """What each scan that holds the cause says alone."""
    each = case.cells["each"].split(";")
    return [label for label, held in zip(each, _numbers(case, "detectability") > 0, strict=True) if held]


def _told(case: Judged) -> list[bool]:
    held = _numbers(case, "detectability") > 0
    return [bool(same) for same in (_numbers(case, "carriers") > _CARRIES) == held]


def _carriers(some: Sequence[Judged]) -> Metric:
    said = [(_numbers(c, "carriers"), _numbers(c, "detectability") > 0) for c in some]
    with_it, without = (
        np.concatenate([np.zeros(0), *(shares[held == there] for shares, held in said)]) for there in (True, False)
    )
    return Metric("AUROC of carriers, held by some", auroc(with_it, without), len(with_it) + len(without))


def _holds_prevalence(case: Judged) -> bool:
    return case.number("prevalence_low") <= SHARE <= case.number("prevalence_high")


def _is_sized(case: Judged) -> bool:
    name = case.cells["name"]
    return (
        case.cells["form"] == "known" and name in _SIZED and case.cells["leader"] == name and bool(case.cells["mean"])
    )


def _holds_size(case: Judged) -> bool:
    """The mean of what is log-normal about a size."""
    mean = abs(case.number("size")) * float(np.exp(0.5 * SPREAD**2))
    return holds(case.number("mean_low"), case.number("mean_high"), mean)


def _begins(case: Judged) -> bool:
    """Whether its scans have a moment in common."""
    return case.number("onset") >= 0.0


def _holds_moment(case: Judged) -> bool:
    return holds(case.number("onset_low"), case.number("onset_high"), case.number("onset"))


def _seconds(cases: Sequence[Judged]) -> float:
    each = [c.number("seconds") / len(c.cells["each"].split(";")) for c in cases]
    return float(np.median(each)) if each else float("nan")
