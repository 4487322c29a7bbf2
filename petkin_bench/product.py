"""A method that is little more than a matrix product, timed beside a loop over voxels and beside that product."""

from __future__ import annotations

from petkin_bench.timing import Work, measure, side_by_side


def beside_product(
    label: str,
    voxels: int,
    ours: Work,
    by_hand: Work,
    curves_by_hand: int,
    product: Work,
    *,
    baseline: str,
    **others: Work,
) -> dict[str, object]:
    """One row.

    Args:
        label: of the method.
        voxels: curves that `ours`, `product` and `others` take at once.
        ours: the method, with errors and status.
        by_hand: a loop over a few curves.
        curves_by_hand: how many.
        product: numpy that returns unknowns and nothing else.
        baseline: what by hand is.
        others: more to time, by what their columns are called.
    """
    loop, bare, mine, *rest = side_by_side(by_hand, product, ours, *others.values())
    hand = loop.cpu / curves_by_hand
    return {
        "fit": label,
        "frames": 26,
        "noise_percent": 5.0,
        "voxels": voxels,
        "voxels_per_s": voxels / measure(ours).wall,
        "cpu_us_per_voxel": 1e6 * mine.cpu / voxels,
        "by_hand_cpu_us": 1e6 * hand,
        "ratio_cpu": hand * voxels / mine.cpu,
        "product_cpu_us": 1e6 * bare.cpu / voxels,
        **{name: 1e6 * timing.cpu / voxels for name, timing in zip(others, rest)},
        "baseline": baseline,
    }
