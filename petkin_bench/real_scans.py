"""Effects withheld from the simulator, and blunders put into the curves, on real scans; and twins that hold no gap.

A withheld effect is real: what the simulator is denied, the scan has. A blunder is known: real noise, real kinetics,
and one mistake. A twin is the simulator's own fit with noise of the covariance that was estimated, and nothing else;
the twin of an erring record is what the fitted kinetics make of a plasma input that errs as its samples scatter.

All scans of one case are one study: they tell the law of their noise together, as `petkin diagnose` has them do, and
what they share is said of the group.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis import Cohort, Diagnosis, Member, in_common
from petkin.diagnosis.covariance import Noise
from petkin.diagnosis.refit import Fit, State, refit
from petkin.dynamics import PiecewiseLinear
from petkin.effects import EFFECTS, Effect, effect_named
from petkin.effects.clock import grown
from petkin.errors import InputError
from petkin.imaging import FrameObservation
from petkin.io import RegionalCurves
from petkin.study.diagnose import ALWAYS
from petkin.study.diagnosis.blood import errors_of
from petkin.study.diagnosis.hypotheses import hypotheses
from petkin.study.diagnosis.judging import diagnose_curves, law_of_noise, laws_in_common
from petkin.study.diagnosis.preparing import prepared, sources_of
from petkin.study.diagnosis.regional import RegionalSimulator, width
from petkin.study.diagnosis.request import RECORDED, DiagnoseRequest
from petkin.study.diagnosis.shared_law import SharedLaw
from petkin.units import SECONDS_PER_MINUTE
from petkin_bench.withheld.ablations import PARTS, without

Array = NDArray[np.float64]

#: What the simulator has besides two tissue compartments where nothing is withheld.
FULL = ("blood_volume", "arterial_delay", "vascular_trapping", "vascular_release")
#: What else goes where an effect is withheld: there is nothing to return where nothing is trapped.
_WITH = {"vascular_trapping": ("vascular_release",)}
#: Sizes of the blunders: a gain step and the excess of one frame, relative; clocks that are off, s.
_STEP, _EXCESS, _DELAYS = 0.10, 0.20, {"delay+10s": 10.0, "delay-10s": -10.0}
#: Cases that are made of the full simulator's fit.
_TWIN, _ERRING, _EXACT = "twin", "erring_record", "erring_record_as_exact"
_OF_FIT = (_TWIN, _ERRING, _EXACT, *_DELAYS)
#: An erring record keeps at least this share of what it holds.
_LEAST = 0.05
#: The frame and the onset lie in this part of the schedule, drawn by scan.
_MIDDLE = (0.35, 0.85)
#: Stands for all scans of a case.
_GROUP = "group"


@dataclass(frozen=True)
class Case:
    """One diagnosis with a known answer.

    Args:
        group: withheld, blunder or twin.
        name: of the case.
        accepted: effects that are the answer; more than one where nothing can split them; none for a twin.
        values: curves (C, K).
        simulator: what they are compared with.
        rival: curves and simulator without what was withheld or put in; None for a twin.
        blunder: factor on the curves (K,).
    """

    group: str
    name: str
    accepted: tuple[str, ...]
    values: Array
    simulator: RegionalSimulator
    rival: tuple[Array, RegionalSimulator] | None = None
    blunder: Array | float = 1.0


@dataclass(frozen=True)
class _Recording:
    """A scan and its simulators, by what they lack."""

    label: str
    curves: RegionalCurves
    full: RegionalSimulator
    one_tissue: RegionalSimulator
    blood: str

    def cut(self, effect: str) -> RegionalSimulator:
        """The full simulator without an effect, and without what is nothing without it."""
        gone = (effect, *_WITH.get(effect, ()))
        return replace(self.full, includes=tuple(e for e in self.full.includes if e.name not in gone))


def measure_real(
    folder: Path,
    *,
    subjects: tuple[str, ...] = (),
    seg: str | None = "rois",
    only: tuple[str, ...] = (),
    rivals: tuple[str, ...] = (),
    blood: str = RECORDED,
    lacking: str = "",
    seed: int = 0,
) -> Iterator[list[dict[str, object]]]:
    """Case by case as they come, one row a scan: what was withheld or put in, and what the diagnosis says.

    Args:
        folder: PET-BIDS study with regional curves and blood.
        subjects: labels; empty for all.
        seg: which table of curves.
        only: names of cases; empty for all.
        rivals: effects that compete with the answer; empty for the whole catalogue.
        blood: how it is read, "recorded" or "fitted".
        lacking: a part of the engine that is taken out, "" for none.
        seed: of blunders, twins and draws.

    Raises:
        InputError: no such study, scans that cannot be diagnosed, no such effect or part.
    """
    for name in rivals:
        effect_named(name)
    if lacking and lacking not in PARTS:
        raise InputError(f"--without {lacking!r}: there are {', '.join(PARTS)}.")
    with without(lacking):
        scans = list(_recordings(folder, subjects, seg, blood))
        fits = _fits(scans) if not only or set(only).intersection(_OF_FIT) else [None] * len(scans)
        studies: dict[tuple[str, str], list[tuple[str, Case]]] = {}
        for scan, fit in zip(scans, fits, strict=True):
            for case in _cases(scan, fit, np.random.default_rng((seed, *scan.label.encode()))):
                if not only or case.name in only:
                    studies.setdefault((case.name, _label(case.simulator)), []).append((scan.label, case))
        for study in studies.values():
            yield _rows(study, rivals, seed)


def _recordings(folder: Path, subjects: tuple[str, ...], seg: str | None, blood: str) -> Iterator[_Recording]:
    request = DiagnoseRequest(folder, model="2tcm", include=FULL, subjects=subjects, seg=seg, blood=blood)
    lesser = replace(request, model="1tcm")
    for source in sources_of(request)[2]:
        curves, full = prepared(source, request)
        yield _Recording(source.label, curves, full, prepared(source, lesser)[1], blood)


def _laws(
    asked: Sequence[tuple[RegionalSimulator, Array]], catalogue: Sequence[Effect], seed: int
) -> tuple[SharedLaw | None, ...]:
    """The law of noise of every scan as all tell it together."""
    candidates = [hypotheses(catalogue, simulator, without=frozenset()) for simulator, _ in asked]
    scans = [(*one, causes) for one, causes in zip(asked, candidates, strict=True)]
    return laws_in_common(scans, seed=seed, always=ALWAYS)


def _cases(scan: _Recording, fitted: tuple[Fit, Noise] | None, rng: np.random.Generator) -> Iterator[Case]:
    """All cases of a scan; without its usual fit, none of those that need it."""
    values = scan.curves.values
    rival = (values, scan.full)
    drawn = rng.standard_normal(values.size)
    if fitted is not None:
        yield from _of_fit(scan, *fitted, drawn, rng.spawn(1)[0])
    yield Case("withheld", "nothing", (), values, scan.full)
    for name in ("blood_volume", "vascular_trapping", "vascular_release"):
        yield Case("withheld", name, (name,), values, scan.cut(name), rival)
    yield Case("withheld", "second_tissue", ("second_tissue",), values, scan.one_tissue, rival)
    record = scan.full.input
    if record.total_plasma is not None:
        bare = replace(record, plasma=record.total_plasma, parent_fraction=None, parent_fraction_fit=None)
        yield Case(
            "withheld",
            "parent_fraction",
            ("parent_fraction",),
            values,
            replace(scan.full, input=bare, measured=frozenset(), errors=errors_of(bare, scan.full.nodes, scan.blood)),
            rival,
        )
    for name, blunder in _BLUNDERS.items():
        factor = blunder(scan.full.clock, rng)
        for simulator in (scan.cut("vascular_trapping"), scan.full):
            yield Case("blunder", name, (name,), values * factor, simulator, (values, simulator), factor)


def _of_fit(scan: _Recording, fit: Fit, noise: Noise, drawn: Array, rng: np.random.Generator) -> Iterator[Case]:
    """Twins, and clocks that are late or early by the delay that was fitted and more."""
    values = scan.curves.values
    yield Case("twin", _TWIN, (), fit.values + noise.coloured(drawn), scan.full)
    if len(scan.full.errors):
        erring = _erring(scan.full, fit, noise, rng)
        yield Case("twin", _ERRING, (), erring, scan.full)
        exact = replace(scan.full, errors=np.zeros((0, scan.full.nodes.size)))
        yield Case("twin", _EXACT, (), erring, exact)
    timed = scan.cut("arterial_delay")
    fitted_s = float(fit.state.shared[0]) * width(effect_named("arterial_delay"))
    for name, late in _DELAYS.items():
        moved = replace(timed, input=scan.full.input.delayed((fitted_s + late) / SECONDS_PER_MINUTE))
        yield Case("withheld", name, ("arterial_delay", "frame_offset"), values, moved, (values, scan.full))


def _fits(scans: Sequence[_Recording]) -> list[tuple[Fit, Noise]]:
    """The fit of every full simulator, and the noise about it under the law that all scans tell."""
    laws = _laws([(scan.full, scan.curves.values) for scan in scans], EFFECTS, 0)
    return [_usual(scan.full, scan.curves.values, law)[1:] for scan, law in zip(scans, laws, strict=True)]


def _usual(
    simulator: RegionalSimulator, values: Array, shared: SharedLaw | None
) -> tuple[RegionalSimulator, Fit, Noise]:
    """A simulator under the law by which curves scatter, its fit, and the noise about it."""
    candidates = hypotheses(EFFECTS, simulator, without=frozenset())
    _, simulator, detected = law_of_noise(simulator, values, candidates, seed=0, always=ALWAYS, shared=shared)
    return simulator, *detected.based[:2]


def _erring(simulator: RegionalSimulator, fit: Fit, noise: Noise, rng: np.random.Generator) -> Array:
    """Curves (C, K) of a plasma input that departs from its record, with the noise beside it."""
    factor = np.maximum(1.0 + rng.standard_normal(len(simulator.errors)) @ simulator.errors, _LEAST)
    plasma = PiecewiseLinear(simulator.nodes, factor * np.asarray(simulator.input.plasma(simulator.nodes)))
    other = replace(simulator, input=replace(simulator.input, plasma=plasma))
    beside = Noise(noise.spread, noise.size, noise.share)
    return other.predict(fit.state.own, fit.state.shared) + beside.coloured(rng.standard_normal(fit.values.size))


def _stepped(clock: FrameObservation, rng: np.random.Generator) -> Array:
    later = np.arange(len(clock.frames)) >= _middle(clock, rng)
    return 1.0 + _STEP * later.astype(np.float64)


def _misjudged(clock: FrameObservation, rng: np.random.Generator) -> Array:
    hit = np.arange(len(clock.frames)) == _middle(clock, rng)
    return 1.0 + _EXCESS * hit.astype(np.float64)


def _middle(clock: FrameObservation, rng: np.random.Generator) -> int:
    first, last = (int(part * len(clock.frames)) for part in _MIDDLE)
    return int(rng.integers(first, last))


_BLUNDERS: dict[str, Callable[[FrameObservation, np.random.Generator], Array]] = {
    "mean_life_swap": lambda clock, rng: grown(clock, (1.0 / np.log(2.0) - 1.0) * clock.decay),
    "decay_applied_twice": lambda clock, rng: grown(clock, clock.decay),
    "gain_step": _stepped,
    "frame_duration": _misjudged,
}


def _rows(study: Sequence[tuple[str, Case]], rivals: tuple[str, ...], seed: int) -> list[dict[str, object]]:
    """What is said of one case, a row a scan."""
    accepted = study[0][1].accepted
    catalogue = [e for e in EFFECTS if not rivals or e.name in (*rivals, *accepted)]
    laws = _laws([(case.simulator, case.values) for _, case in study], catalogue, seed)
    rows, members = [], []
    for (label, case), law in zip(study, laws, strict=True):
        row, found = _row(label, case, catalogue, law, seed)
        rows.append(row)
        members.append(Member.of(label, found))
    if len(members) > 1:
        rows.append(_shared_row(study[0][1], in_common(members)))
    return [row | {"rivals": " ".join(rivals) or "all"} for row in rows]


def _said(scan: str, case: Case, found: Diagnosis | Cohort) -> dict[str, object]:
    """What is said of a scan, or of all scans, against the answer."""
    leader = found.causes[0] if found.causes else None
    return {
        "scan": scan,
        "group": case.group,
        "case": case.name,
        "simulator": _label(case.simulator),
        "kind": found.kind,
        "p": round(found.p_value, 4),
        "leader": "" if leader is None else leader.label,
        "probability": 0.0 if leader is None else round(leader.probability, 3),
        "set": " ".join(found.chosen),
        "first": _names(found.chosen[:1], case.accepted),
        "in_set": _names(found.chosen, case.accepted),
        "leads": leader is not None and _names((leader.label,), case.accepted),
        **dict.fromkeys(("chi2", "closure", "detectability", "cpu_s", "place", "carriers"), ""),
    }


def _shared_row(case: Case, found: Cohort) -> dict[str, object]:
    """What all scans of a case share."""
    carriers = int((found.causes[0].carriers > 0.5).sum()) if found.causes else 0
    return _said(_GROUP, case, found) | {"carriers": carriers}


def _label(simulator: RegionalSimulator) -> str:
    return " ".join([simulator.label, *(e.name for e in simulator.includes)])


def _row(
    label: str, case: Case, catalogue: Sequence[Effect], law: SharedLaw | None, seed: int
) -> tuple[dict[str, object], Diagnosis]:
    """What is said of one scan."""
    started = time.process_time()
    candidates = hypotheses(catalogue, case.simulator, without=frozenset())
    found, *_ = diagnose_curves(case.simulator, case.values, candidates, always=ALWAYS, seed=seed, shared=law)
    seconds = time.process_time() - started
    leader = found.causes[0] if found.causes else None
    row = _said(label, case, found) | {
        "chi2": round(found.chi2_per_dof, 3),
        "closure": "" if leader is None or leader.closure is None else round(leader.closure.value, 3),
        "detectability": _detectability(case, law),
        "cpu_s": round(seconds, 2),
        "place": found.unknown_place,
    }
    return row, found


def _names(labels: tuple[str, ...], accepted: tuple[str, ...]) -> bool:
    """Whether some label names an accepted effect, alone or with another."""
    return any(name in accepted for label in labels for name in label.split("+"))


def _detectability(case: Case, law: SharedLaw | None) -> object:
    """d' after the refit: how far the simulator stays from what it would predict with the answer, in that noise.

    d'^2 = min_theta |b f_with - f_without(theta)|^2, with b the blunder, which multiplies the noise as well. What these
    scans depart by otherwise is not in it, and neither is the noise itself.
    """
    if case.rival is None:
        return ""
    values, simulator = case.rival
    simulator, fit, noise = _usual(simulator, values, law)
    spoilt = replace(noise, spread=noise.spread * case.blunder)
    known = fit.objective - fit.chi2
    lacking = replace(case.simulator, law=simulator.law)
    without = min(
        refit(lacking, fit.values * case.blunder, spoilt, State(own, case.simulator.shared.mean)).objective
        for own in case.simulator.starts
    )
    return round(max(without - known, 0.0) ** 0.5, 1)


def summary(rows: list[dict[str, object]]) -> list[dict[str, object]]:
    """Counts by case, how often test and retest of a subject name the same first cause, and what all scans share.

    Raises:
        InputError: no rows.
    """
    if not rows:
        raise InputError("There are no scans to sum up; see --data and --subject.")
    found = []
    for name, simulator in dict.fromkeys((row["case"], row["simulator"]) for row in rows):
        both = [row for row in rows if (row["case"], row["simulator"]) == (name, simulator)]
        mine = [row for row in both if row["scan"] != _GROUP]
        together = [f"{row['set'] or row['kind']} ({row['carriers']})" for row in both if row["scan"] == _GROUP]
        found.append(
            {
                "case": name,
                "group": mine[0]["group"],
                "simulator": simulator,
                "scans": len(mine),
                "alarms": sum(row["kind"] != "none" for row in mine),
                "first": sum(bool(row["first"]) for row in mine),
                "in_set": sum(bool(row["in_set"]) for row in mine),
                "leads": sum(bool(row["leads"]) for row in mine),
                "median_set": float(np.median([len(str(row["set"]).split()) for row in mine])),
                "agree": _agreement(mine),
                "together": "".join(together),
            }
        )
    return found


def _agreement(rows: list[dict[str, object]]) -> str:
    """Pairs of scans of one subject whose sets share a cause, of how many pairs."""
    by_subject: dict[str, list[set[str]]] = {}
    for row in rows:
        by_subject.setdefault(str(row["scan"]).split("_")[0], []).append(set(str(row["set"]).replace("+", " ").split()))
    pairs = [sets for sets in by_subject.values() if len(sets) == 2]
    return f"{sum(bool(a & b) or a == b for a, b in pairs)}/{len(pairs)}"
