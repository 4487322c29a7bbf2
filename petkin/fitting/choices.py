"""What a user may choose of a fit, whatever the method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from petkin.fitting.nonlinear import FASTEST_RATE, SLOWEST_RATE


@dataclass(frozen=True)
class Choices:
    """What a user may choose; a method takes what concerns it.

    Args:
        bounds: lowest and highest value by symbol.
        fixed: values held, by symbol.
        rate_bounds: interval of the exponentials' rates, 1/min.
        t_star: start of the linear part of a graphical method, min; None lets the curves tell.
        window: start and end of the time that uptake values are averaged over, min; None: from t* to the end.
        share: symbols that all regions of a scan have in common.
        certify: whether voxels too are proven to be near the best of all fits, where the method can.
        scrutiny: whether regions are asked for other minima, for asymmetry and for that proof, where it can.
        device: where torch searches voxels of compartment models, e.g. "cuda"; None for compiled code on the CPU.
        checkpoint: what a learned method learned.
    """

    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    fixed: Mapping[str, float] = field(default_factory=dict)
    rate_bounds: tuple[float, float] = (SLOWEST_RATE, FASTEST_RATE)
    t_star: float | None = 30.0
    window: tuple[float, float] | None = None
    share: tuple[str, ...] = ()
    certify: bool = False
    scrutiny: bool = True
    device: str | None = None
    checkpoint: Path | None = None
