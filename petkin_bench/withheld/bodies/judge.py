"""What the product says of runs: the one file here that uses it."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from petkin_bench.gaps import MovingBodies, find_body
from petkin_bench.gaps.runs import diagnose_runs
from petkin_bench.withheld.bodies.cases import Film
from petkin_bench.withheld.judge import closed_by, said_of, sizes_of

Array = NDArray[np.float64]


def verdict(film: Film, clean: Array, *, seed: int) -> dict[str, object]:
    """One row: the verdict and, beside it, the share of the gap in the noise-free points that its leader closes.

    Args:
        film: what the product sees.
        clean: points without noise (runs, P 2 T); looked at when the verdict is final.
        seed: of the product's noise draws.
    """
    started = time.process_time()
    body = find_body(film.system)
    found = diagnose_runs(body, film.places, seed=seed)
    seconds = time.process_time() - started
    simulator = MovingBodies(body, clean)
    leader = found.causes[0] if found.causes else None
    closed = None if leader is None else leader.closure
    return said_of(found) | {
        "unknown_probability": found.unknown,
        "stage": next(iter(found.stages), ""),
        "amplitude": sizes_of(found)["amplitude"],
        "amplitude_low": sizes_of(found)["amplitude_low"],
        "amplitude_high": sizes_of(found)["amplitude_high"],
        "evidence": ";".join(f"{c.label}:{c.log_evidence:.3f}" for c in found.causes),
        "unknown_evidence": round(found.unknown_evidence, 3),
        "closure": "" if closed is None else closed.value,
        "closure_low": "" if closed is None else closed.low,
        "closure_high": "" if closed is None else closed.high,
        "closed": "" if leader is None else closed_by(found, simulator, simulator.samples),
        "seconds": round(seconds, 3),
    }
