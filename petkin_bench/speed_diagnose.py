"""How long a diagnosis takes on one core: over regions and frames, with more draws of noise, and of a cohort."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from petkin.diagnosis import Diagnosis, Hypothesis, Member, in_common
from petkin.effects import EFFECTS
from petkin.study.diagnose import ALWAYS
from petkin.study.diagnosis.hypotheses import hypotheses
from petkin.study.diagnosis.judging import diagnose_curves, laws_in_common
from petkin.study.diagnosis.regional import RegionalSimulator
from petkin.study.diagnosis.shared_law import SharedLaw
from petkin_bench.timing import measure
from petkin_bench.withheld.cases import Scan
from petkin_bench.withheld.judge import simulator_of
from petkin_bench.withheld.noise import law, noisy
from petkin_bench.withheld.observe import Change, observe
from petkin_bench.withheld.subject import Frames, draw_subject

#: (regions, frames, draws of noise) of every row, and the scans of the cohort.
SIZES = ((1, 36, 400), (5, 18, 400), (5, 36, 400), (5, 72, 400), (5, 36, 500), (10, 36, 400), (20, 36, 400))
COHORT = 20
_SCANS, _PERCENT = 7, 2.0


def scan_of(seed: int, regions: int, frames: int) -> Scan:
    """A scan of [11C] whose scanner gains 8 % after 40 min, which a diagnosis has to name."""
    rng = np.random.default_rng(seed)
    subject = draw_subject(rng, regions)
    edges = np.interp(
        np.linspace(0.0, 1.0, frames + 1), np.linspace(0.0, 1.0, subject.frames.start.size + 1), _edges(subject.frames)
    )
    subject = replace(subject, frames=Frames(edges[:-1], edges[1:], subject.frames.decay))
    gain = Change(scanner=lambda x, f: x * (1.0 + 0.08 * (f.mid > 40.0)))
    clean = observe(subject, (gain,))
    values = noisy(clean, law(clean, subject.frames, _PERCENT, 0.3), 0, rng)
    names = tuple(f"region{r + 1}" for r in range(regions))
    return Scan(names, subject.frames, values, subject.blood, "2tcm", ("blood_volume", "arterial_delay"))


def _edges(frames: Frames) -> np.ndarray:
    return np.append(frames.start, frames.end[-1])


def _asked(scan: Scan) -> tuple[RegionalSimulator, np.ndarray, tuple[Hypothesis, ...]]:
    simulator = simulator_of(scan)
    return simulator, scan.values, tuple(hypotheses(EFFECTS, simulator, without=frozenset()))


def _diagnosed(scan: Scan, draws: int, shared: SharedLaw | None = None) -> Diagnosis:
    return diagnose_curves(*_asked(scan), always=ALWAYS, draws=draws, shared=shared)[0]


def measure_sizes(told: Callable[[str], None] = lambda _: None) -> list[dict[str, object]]:
    """A row a size: median processor time of a scan, with reading its blood."""
    rows: list[dict[str, object]] = []
    for regions, frames, draws in SIZES:
        told(f"{regions} regions, {frames} frames, {draws} draws ...")
        scans = [scan_of(seed, regions, frames) for seed in range(_SCANS)]
        _diagnosed(scans[0], draws)
        times = [measure(partial(_diagnosed, scan, draws), 1, warm_up=False).cpu for scan in scans]
        rows.append(
            {
                "scans": 1,
                "regions": regions,
                "frames": frames,
                "draws": draws,
                "cpu_s": round(float(np.median(times)), 3),
            }
        )
    return rows


def measure_cohort(told: Callable[[str], None] = lambda _: None) -> dict[str, object]:
    """One row: processor time of all scans of a cohort, of the law of their noise, and of what they share."""
    told(f"a cohort of {COHORT} ...")
    scans = [scan_of(seed, 5, 36) for seed in range(COHORT)]

    def all_of_them() -> object:
        laws = laws_in_common([_asked(scan) for scan in scans], seed=0, always=ALWAYS)
        return in_common([Member.of(str(i), _diagnosed(scans[i], 400, law)) for i, law in enumerate(laws)])

    cpu = measure(all_of_them, 1, warm_up=False).cpu
    return {"scans": COHORT, "regions": 5, "frames": 36, "draws": 400, "cpu_s": round(cpu, 3)}


def text_of(rows: list[dict[str, object]]) -> str:
    """A line a row."""
    lines = [f"{'scans':>6}{'regions':>9}{'frames':>8}{'draws':>7}{'CPU s':>9}"]
    lines += [f"{r['scans']:>6}{r['regions']:>9}{r['frames']:>8}{r['draws']:>7}{r['cpu_s']:>9}" for r in rows]
    return "\n".join(lines)
