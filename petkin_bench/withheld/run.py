"""Runs: verdicts of many cases, appended as they come; answers in a file of their own, sealed by a digest."""

from __future__ import annotations

import csv
import hashlib
import json
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from petkin.errors import InputError
from petkin_bench.withheld.ablations import ENGINE, PARTS, without
from petkin_bench.withheld.bodies.cases import ALL, FilmAnswer, film_case
from petkin_bench.withheld.bodies.rigs import RIGS
from petkin_bench.withheld.cases import SPLITS, Answer, case
from petkin_bench.withheld.cohorts.cases import SCANS, cohort_case
from petkin_bench.withheld.subject import SCHEDULES_S

if TYPE_CHECKING:
    from petkin_bench.withheld.images.cases import ImageAnswer

#: Seed of the training cases that the network alone learns from.
LEARNED_SEED = 901


@dataclass(frozen=True)
class Plan:
    """Which cases, of how many scans each, what the product is asked, and which part of it is taken out; the file of a
    network alone."""

    split: str
    seed: int
    cases: int
    regions: int
    draws: int
    without: str = ""
    images: bool = False
    network: Path = Path()
    frames: str = "clinical"
    scans: int = 1
    system: str = ""

    def __post_init__(self) -> None:
        if self.split not in SPLITS:
            raise InputError(f"--split {self.split!r}: give {' or '.join(SPLITS)}.")
        if self.without and self.without not in (*PARTS, ENGINE):
            raise InputError(f"--without {self.without!r}: give one of {', '.join((*PARTS, ENGINE))}.")
        if self.without == ENGINE and self.split == "training" and self.seed == LEARNED_SEED:
            raise InputError(f"--seed {self.seed}: the network learned from those training cases; give another.")
        if self.frames not in SCHEDULES_S:
            raise InputError(f"--frames {self.frames!r}: give {' or '.join(SCHEDULES_S)}.")
        if self.images and self.without:
            raise InputError("--images judges the whole product: leave --without away.")
        if self.scans > 1 and not SCANS[0] <= self.scans <= SCANS[1]:
            raise InputError(f"--scans {self.scans}: give 1, or {SCANS[0]} to {SCANS[1]} for cohorts.")
        if self.scans > 1 and (self.images or self.without or self.frames != "clinical"):
            raise InputError(f"--scans {self.scans}: leave --images, --without and --frames away.")
        if self.system not in ("", ALL, *RIGS):
            raise InputError(f"--system {self.system!r}: give {ALL} or one of {', '.join(RIGS)}.")
        if self.system and (self.images or self.without or self.scans > 1 or self.frames != "clinical"):
            raise InputError(f"--system {self.system}: leave --images, --without, --scans and --frames away.")

    @property
    def stem(self) -> str:
        if self.images:
            return f"withheld_{self.split}_seed{self.seed}_images"
        if self.system:
            return f"withheld_{self.split}_seed{self.seed}_{self.system}"
        if self.scans > 1:
            return f"withheld_{self.split}_seed{self.seed}_regions{self.regions}_scans{self.scans}"
        lacking = f"_without_{self.without}" if self.without else ""
        frames = f"_{self.frames}" if self.frames != "clinical" else ""
        return f"withheld_{self.split}_seed{self.seed}_regions{self.regions}{frames}{lacking}"


def run(
    plan: Plan, folder: Path, *, workers: int = 1, told: Callable[[int], None] = lambda _: None
) -> tuple[Path, Path]:
    """Judge all cases that have no row yet.

    Returns:
        the files of verdicts and of answers; a verdict holds the digest of its answer.
    """
    folder.mkdir(parents=True, exist_ok=True)
    verdicts, answers = folder / f"{plan.stem}_verdicts.csv", folder / f"{plan.stem}_answers.csv"
    left = [i for i in range(plan.cases) if i not in _done(verdicts)]
    for done, (answer, row) in enumerate(_judged(plan, left, workers), 1):
        _append(answers, answer)
        _append(verdicts, row)
        told(done)
    return verdicts, answers


def _judged(plan: Plan, indices: list[int], workers: int) -> Iterator[tuple[dict[str, object], dict[str, object]]]:
    if workers == 1:
        yield from (judged(plan, i) for i in indices)
        return
    with ProcessPoolExecutor(workers) as pool:
        yield from pool.map(judged, [plan] * len(indices), indices)


def judged(plan: Plan, index: int) -> tuple[dict[str, object], dict[str, object]]:
    """Answer and verdict of one case as rows."""
    if plan.images:
        return _judged_image(plan, index)
    if plan.scans > 1:
        return _judged_cohort(plan, index)
    if plan.system:
        return _judged_film(plan, index)
    from petkin_bench.withheld.judge import ideal, verdict

    scan, truth = case(plan.split, plan.seed, index, plan.regions, plan.frames)
    answer = {"index": index} | row_of(truth) | {"size": round(truth.size, 6), "sets_in": round(truth.onset, 4)}
    if plan.without == ENGINE:
        from petkin_bench.withheld.network import network_verdict

        found = network_verdict(scan, plan.network)
        return answer, _sealed(answer) | found | ideal(scan, truth, seed=index)
    with without(plan.without):
        found = verdict(scan, truth.clean, seed=index, draws=plan.draws)
    return answer, _sealed(answer) | found | ideal(scan, truth, seed=index)


def _judged_image(plan: Plan, index: int) -> tuple[dict[str, object], dict[str, object]]:
    from petkin_bench.withheld.images.cases import made_case
    from petkin_bench.withheld.images.judge import verdict
    from petkin_bench.withheld.images.reader import ideal

    scan, truth, made = made_case(plan.split, plan.seed, index)
    answer = {"index": index} | row_of(truth) | {"size": round(truth.size, 4), "width": truth.width}
    read = ideal(truth, made, split=plan.split, seed=index)
    return answer, _sealed(answer) | verdict(scan, seed=index) | read


def _judged_film(plan: Plan, index: int) -> tuple[dict[str, object], dict[str, object]]:
    from petkin_bench.withheld.bodies.judge import verdict

    film, truth = film_case(plan.split, plan.seed, index, plan.system)
    about = {"index": index, "system": truth.system, "runs": truth.runs}
    answer = about | row_of(truth) | {"size": round(truth.size, 6)}
    return answer, _sealed(answer) | verdict(film, truth.clean, seed=index)


def _judged_cohort(plan: Plan, index: int) -> tuple[dict[str, object], dict[str, object]]:
    from petkin_bench.withheld.cohorts.judge import cohort_verdict

    scans, truth = cohort_case(plan.split, plan.seed, index, plan.scans, plan.regions)
    answer: dict[str, object] = {
        "index": index,
        "kind": truth.kind,
        "noise": truth.noise,
        "percent": truth.percent,
        "name": truth.name,
        "form": truth.form,
        "classes": "|".join((*truth.same, *truth.other)),
        "groups": ";".join("|".join(same) for same in (truth.same, truth.other) if same),
        "detectability": ";".join(f"{strength:.4f}" for strength in truth.detectability),
        "sizes": ";".join(f"{size:.6g}" for size in truth.sizes),
        "size": round(truth.size, 6),
        "onset": round(truth.onset, 4),
    }
    return answer, _sealed(answer) | cohort_verdict(scans, seed=index, draws=plan.draws)


def _sealed(answer: dict[str, object]) -> dict[str, object]:
    """The case's number, and the digest of its answer."""
    digest = hashlib.sha256(json.dumps(answer, sort_keys=True).encode()).hexdigest()
    return {"index": answer["index"], "answer_sha256": digest}


def row_of(answer: Answer | FilmAnswer | ImageAnswer) -> dict[str, object]:
    """An answer as a row, without its curves; of classes, "a|b;c" is a or b, and c."""
    return {
        "kind": answer.kind,
        "noise": answer.noise,
        "percent": answer.percent,
        "names": ";".join(answer.names),
        "classes": ";".join("|".join(c) for c in answer.classes),
        "stages": ";".join(answer.stages),
        "detectability": round(answer.detectability, 4),
        "perpendicular": round(answer.perpendicular, 4),
        "ceiling": round(answer.ceiling, 4),
        "frame": answer.frame,
        "region": answer.region,
    }


def _done(path: Path) -> set[int]:
    if not path.is_file():
        return set()
    with path.open(newline="") as stream:
        return {int(row["index"]) for row in csv.DictReader(stream)}


def _append(path: Path, row: dict[str, object]) -> None:
    new = not path.is_file()
    with path.open("a", newline="") as stream:
        writer = csv.DictWriter(stream, list(row), lineterminator="\n")
        if new:
            writer.writeheader()
        writer.writerow(row)
