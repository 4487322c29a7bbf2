"""What is told of a state map: an entry of the answer, a table with its JSON, and sentences."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from petkin import __version__
from petkin.diagnosis import ALIKE
from petkin.io import descriptions
from petkin.study.diagnosis.state import NEAR, StatesRead
from petkin.units import SECONDS_PER_MINUTE

_EQUATION = "dC_T/dt = K1 C_P - k2 C_T + flux"


def state_entry(states: StatesRead | None) -> list[dict[str, Any]]:
    """The state that lacks a term, what that looks like, and the log evidence of the hybrids; none without a claim."""
    if states is None or not states.found.claimed.any():
        return []
    return [{"state": "C_T", "term": f"learned residual, {looks(states)}", "evidence": states.found.evidence}]


def looks(states: StatesRead) -> str:
    """Which tissue effect would add the likest course, and which others could as well."""
    if not states.nearest or states.nearest[0][1] < NEAR:
        return "unlike what any tissue effect of the catalogue would add"
    name, cosine = states.nearest[0]
    others = [_words(other) for other in states.alike]
    also = f"; {' and '.join(others)} would look the same (cosine {ALIKE:g} or more)" if others else ""
    return f"nearest to what {_words(name)} would add (cosine {cosine:.2f}){also}"


def _words(name: str) -> str:
    return name.replace("_", " ")


def told(states: StatesRead) -> tuple[str, ...]:
    """What the map shows, and what it does not, in sentences."""
    claimed, count = states.found.claimed, states.members
    if not claimed.any():
        return (
            f"{count} hybrids of one compartment and a learned residual claim nothing: where their band excludes "
            "nought, it is what they learned and not what these curves ask for.",
        )
    regions = int(claimed.any(axis=1).sum())
    return (
        f"{count} hybrids of one compartment and a learned residual find a term missing in {regions} of "
        f"{len(states.regions)} regions ({int(claimed.sum())} of {claimed.size} frames of regions are claimed); "
        f"it is {looks(states)}.",
        "This suggests where and how the law of the tissue falls short; it names no cause: whatever bends a curve "
        "of tissue, an error of the input as well, looks like a term of tissue here.",
    )


def state_table(states: StatesRead) -> pd.DataFrame:
    """A row a region and frame."""
    frames, found = states.frames, states.found
    count = len(frames)
    columns = {"C_T": states.state, "flux": found.term, "low": found.low, "high": found.high}
    return pd.DataFrame(
        {
            "region": np.repeat(np.array(states.regions, object), count),
            "frame_start": np.tile(frames.start * SECONDS_PER_MINUTE, len(states.regions)),
            "frame_end": np.tile(frames.end * SECONDS_PER_MINUTE, len(states.regions)),
            **{name: part.ravel().astype(np.float32) for name, part in columns.items()},
            "claimed": found.claimed.ravel().astype(int),
        }
    )


def state_sidecar(states: StatesRead, *, sources: Sequence[str], command: str, seed: int) -> dict[str, Any]:
    """JSON of the table."""
    extra = {
        "Equation": _EQUATION,
        "Members": states.members,
        "PValue": states.found.p_value,
        "LogEvidence": float(f"{states.found.evidence:.6g}"),
        "Cosines": {name: round(cosine, 4) for name, cosine in states.nearest},
        "LooksLikeTheNearest": list(states.alike),
        "Remarks": [*told(states), *states.remarks],
        "Seed": seed,
    }
    shared = descriptions.provenance("", sources=sources, version=__version__, command=command, extra=extra)
    return descriptions.states_sidecar(shared)
