"""Metrics of image cases, each beside its bar."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from petkin_bench.withheld.images.cases import BINS
from petkin_bench.withheld.noise import KINDS
from petkin_bench.withheld.score import Judged, Metric, auroc, calibration_of, of_reader, share_of

#: From here most bars hold; a strength beyond the catalogue from which a gap must be called unknown; a sure name.
_STRONG, _BEYOND, _SURE = 6.0, 5.0, 0.9
_IN_MM = ("partial_volume", "motion_step", "motion_drift")


def image_metrics(cases: Sequence[Judged]) -> list[Metric]:
    """Every metric of a run of image cases."""
    named = [c for c in cases if c.classes]
    strong = [c for c in named if c.strength >= _STRONG]
    alien = [c for c in cases if c.kind == "unknown" and c.number("perpendicular") >= _BEYOND]
    return [
        *_alarms([c for c in cases if c.kind == "none"]),
        *_by_strength(named),
        *_sets(strong),
        *_places(strong),
        *_unknown(alien, strong),
        replace(calibration_of(cases), name="images: calibration error of set_probability"),
        Metric("images: CPU s a scan, median", _middle([c.number("seconds") for c in cases]), len(cases)),
    ]


def _middle(values: Sequence[float]) -> float:
    return float(np.median(values)) if values else float("nan")


def _share(name: str, hits: Sequence[bool], bar: float | None = None, side: str = ">=") -> Metric:
    return share_of(f"images: {name}", hits, bar, side)


def _alarms(nulls: Sequence[Judged]) -> list[Metric]:
    each = [
        _share(f"false alarms, {k}", [c.claimed for c in nulls if c.cells["noise"] == k], 0.05, "<=") for k in KINDS
    ]
    return [*each, _share("false alarms, all", [c.claimed for c in nulls], 0.05, "<=")]


def _by_strength(named: Sequence[Judged]) -> list[Metric]:
    found = []
    edges = [0.9 * low for low, _ in BINS] + [np.inf]
    for (low, high), (start, stop) in zip(BINS, pairwise(edges), strict=True):
        part = [c for c in named if start <= c.strength < stop]
        ceiling = float(np.mean([c.number("ceiling") for c in part])) if part else float("nan")
        name, allowed = f"d' {low:g}-{high:g}", 0.15 if low < _STRONG else 0.05
        found += [
            _share(f"gap claimed, {name}", [c.claimed for c in part]),
            Metric(f"images: matched filter, {name}", ceiling, len(part)),
            of_reader(f"images: must find settings, {name}", part, "ideal"),
            of_reader(f"images: must find settings and claim, {name}", part, "ideal_claimed"),
            _share(f"class first, {name}", [c.right for c in part], ceiling - allowed),
        ]
    for kind in ("known", "other form", "plain"):
        part = [c.right for c in named if c.kind == kind and c.strength >= _STRONG]
        found.append(_share(f"class first, {kind}, d' >= 6", part))
    for name in sorted({c.words("names")[0] for c in named if c.kind in ("known", "other form")}):
        part = [c.right for c in named if c.words("names")[0] == name and c.strength >= _STRONG]
        found.append(_share(f"class first, {name}, d' >= 6", part))
    return found


def _sets(strong: Sequence[Judged]) -> list[Metric]:
    told = [c for c in strong if c.words("set")]
    sizes = [len(c.words("set")) for c in told]
    return [
        _share("set covers, d' >= 6, at least", [c.covered for c in strong], 0.87),
        _share("set covers, d' >= 6, at most", [c.covered for c in strong], 0.93, "<="),
        Metric("images: set size, median", _middle(sizes), len(sizes), 2.0, "<="),
        _share("set size <= class + 1", [n <= len(c.classes[0]) + 1 for n, c in zip(sizes, told, strict=True)], 0.9),
    ]


def _places(strong: Sequence[Judged]) -> list[Metric]:
    timed = [c for c in strong if c.number("frame") >= 0 and c.right]
    moved = [c for c in timed if "motion_step" in c.words("names")]
    local = [c for c in strong if c.number("region") >= 0 and c.claimed]
    inside = [c.cells["region"] in c.words("regions") for c in local]
    told = sum(len(c.words("regions")) for c in local)
    sized = [c for c in strong if c.right and c.words("names")[0] in _IN_MM and c.cells["unit"] == "mm"]
    near = [abs(c.number("amplitude") / c.number("size") - 1.0) <= 0.25 for c in sized]
    return [
        _share("stage first, d' >= 6", [c.cells["stage"] == c.cells["stages"] for c in strong], 0.85),
        _share("onset within a frame", [_on_time(c) for c in timed], 0.9),
        _share("onset of motion within a frame", [_on_time(c) for c in moved], 0.9),
        Metric("images: regions: precision", sum(inside) / max(told, 1), told, 0.9),
        _share("regions: recall", inside, 0.9),
        _share("blur and motion within a quarter of their mm", near),
    ]


def _on_time(case: Judged) -> bool:
    return abs(case.number("onset_frame") - case.number("frame")) <= 1


def _unknown(alien: Sequence[Judged], strong: Sequence[Judged]) -> list[Metric]:
    of_alien, of_named = (
        np.array([c.number("unknown_probability") if c.claimed else -1.0 for c in cases]) for cases in (alien, strong)
    )
    sure = [c.number("leader_probability") > _SURE and c.cells["verdict"] in ("named", "ambiguous") for c in alien]
    return [
        _share("unknown: gap claimed", [c.claimed for c in alien]),
        of_reader("images: unknown: one who knows its forms must find settings and claim", alien, "ideal_claimed"),
        _share("unknown: recall", [c.cells["verdict"] == "unknown" for c in alien], 0.8),
        Metric("images: unknown: AUROC", auroc(of_alien, of_named), len(alien), 0.9),
        _share("unknown: named with p > 0.9", sure, 0.05, "<="),
        _share("unknown: known rejected", [c.cells["verdict"] == "unknown" for c in strong], 0.1, "<="),
    ]
