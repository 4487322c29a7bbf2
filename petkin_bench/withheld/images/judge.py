"""What the product says of an image case: the one file here that uses it, through the files of a study."""

from __future__ import annotations

import tempfile
from pathlib import Path

from petkin.study.diagnose import diagnose_study
from petkin.study.diagnosis.request import DiagnoseRequest
from petkin_bench.withheld.images.cases import ImageScan
from petkin_bench.withheld.images.study import write_study

#: A region is claimed where its q-value is at most this.
_CLAIMED = 0.05


def verdict(scan: ImageScan, *, seed: int) -> dict[str, object]:
    """One row: what the gap report says.

    Args:
        scan: what the product is given.
        seed: of the product's own noise draws.
    """
    with tempfile.TemporaryDirectory() as folder:
        study, out = Path(folder) / "study", Path(folder) / "out"
        write_study(scan, study)
        (one,) = diagnose_study(DiagnoseRequest(study, model=scan.model, include=scan.includes, out=out, seed=seed))
    found = one.answer
    causes, where, said = found["causes"], found["where"], found["verdict"]
    leader = causes[0] if causes else {"effects": [], "probability": 0.0, "estimate": {}}
    amplitude = leader["estimate"].get("amplitude", {"value": 0.0, "unit": ""})
    stage = where["stages"][0]["stage"] if where["stages"] else ""
    frame = where["onset_frame"]
    return {
        "verdict": said["kind"],
        "p_value": found["gap"]["p_value"],
        "leader": "+".join(leader["effects"]),
        "leader_probability": leader["probability"],
        "set": ";".join(said["set"]),
        "set_probability": said["set_probability"],
        "unknown_probability": max(0.0, 1.0 - sum(c["probability"] for c in causes)) if causes else 0.0,
        "stage": stage,
        "onset_frame": -1 if frame is None else frame,
        "regions": ";".join(str(r) for r, e in enumerate(where["regions"]) if e["q_value"] <= _CLAIMED),
        "amplitude": amplitude["value"],
        "unit": amplitude["unit"],
        "evidence": ";".join(f"{'+'.join(c['effects'])}:{c['log_evidence_gain']:.3g}" for c in causes),
        "seconds": found["provenance"]["seconds"],
    }
