"""What the product says of a cohort: the one file here that uses it."""

from __future__ import annotations

import time
from collections.abc import Sequence

from petkin.diagnosis import Member, in_common
from petkin.effects import EFFECTS
from petkin.study.diagnose import ALWAYS
from petkin.study.diagnosis.hypotheses import hypotheses
from petkin.study.diagnosis.judging import diagnose_curves, laws_in_common
from petkin_bench.withheld.cases import Scan
from petkin_bench.withheld.judge import said_of, simulator_of


def cohort_verdict(scans: Sequence[Scan], *, seed: int, draws: int) -> dict[str, object]:
    """One row: what all scans share, and what each says alone (`each`, "" where it claims nothing).

    Args:
        scans: of one study, which tell the law of their noise together.
        seed, draws: of the product's own noise draws.
    """
    started = time.process_time()
    simulators = [simulator_of(scan) for scan in scans]
    candidates = [hypotheses(EFFECTS, simulator, without=frozenset()) for simulator in simulators]
    values = [scan.values for scan in scans]
    laws = laws_in_common(list(zip(simulators, values, candidates, strict=True)), seed=seed, always=ALWAYS)
    alone = [
        diagnose_curves(simulator, curves, causes, always=ALWAYS, seed=seed, draws=draws, shared=law)[0]
        for simulator, curves, causes, law in zip(simulators, values, candidates, laws, strict=True)
    ]
    found = in_common([Member.of(str(i), one) for i, one in enumerate(alone)])
    seconds = time.process_time() - started
    leader = found.causes[0] if found.causes else None
    mean = None if leader is None else leader.mean
    moment = None if leader is None else leader.onset
    return said_of(found) | {
        "carriers": "" if leader is None else ";".join(f"{share:.4f}" for share in leader.carriers),
        "prevalence_low": "" if leader is None else leader.prevalence.low,
        "prevalence_high": "" if leader is None else leader.prevalence.high,
        "mean": "" if mean is None else mean.value,
        "mean_low": "" if mean is None else mean.low,
        "mean_high": "" if mean is None else mean.high,
        "unit": "" if leader is None else leader.unit,
        "onset_low": "" if moment is None else moment.low,
        "onset_high": "" if moment is None else moment.high,
        "further": ";".join(group.causes[0].label for group in found.further),
        "unnamed": "" if found.unnamed is None else ";".join(f"{share:.4f}" for share in found.unnamed.carriers),
        "each": ";".join(one.causes[0].label if one.kind in ("named", "ambiguous") else "" for one in alone),
        "seconds": round(seconds, 3),
    }
