"""Simulated brains of sixteen regions, one effect in each, diagnosed as a user would: `petkin simulate`, its files,
`petkin diagnose`.

It is no blind check, since one forward model makes the brains and judges them. It goes through all that lies between
two commands instead: a whole brain with small regions, files, image and blood, defaults.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from petkin.errors import InputError
from petkin.study.diagnose import diagnose_study
from petkin.study.diagnosis.request import DiagnoseRequest
from petkin.study.simulate import simulate
from petkin.study.simulation.settings import SimulationSettings

#: Voxels small enough for a point spread and large enough for a minute a brain, and their noise in percent.
_VOXEL_MM, _NOISE = 7.0, 8.0


@dataclass(frozen=True)
class Brain:
    """One brain: what is put into it, and what a right answer names.

    Args:
        name: of the brain.
        effects: as options of `petkin simulate`.
        answer: effects to be named, each with those that nothing here tells from it; none where there is no gap.
        includes: what the simulator has.
        psf: FWHM of the scanner, mm.
        tracer: population of kinetics; `tissue` is the simulator's model.
    """

    name: str
    effects: tuple[str, ...] = ()
    answer: tuple[frozenset[str], ...] = ()
    includes: tuple[str, ...] = ("blood_volume",)
    psf: float = 0.0
    tracer: str = "reversible"
    tissue: str = "2TCM"


def _one(name: str, value: str, *alike: str) -> Brain:
    """A brain with one effect."""
    return Brain(f"{name}={value}", (f"{name}={value}",), (frozenset({name, *alike}),))


#: What the record's clock cannot tell from an input that comes late.
_LATE = ("arterial_delay", "frame_offset")
_BLURRED = ("blood_volume", "partial_volume")
BRAINS = (
    Brain("nothing"),
    Brain("nothing, a point spread of 5 mm", psf=5.0, includes=_BLURRED),
    Brain("no blood volume in the simulator", answer=(frozenset({"blood_volume"}),), includes=()),
    Brain("no second tissue in the simulator", answer=(frozenset({"second_tissue"}),), tissue="1TCM"),
    _one("partial_volume", "5"),
    _one("arterial_delay", "6", *_LATE),
    _one("dispersion", "6", "arterial_delay", "frame_offset"),
    _one("vascular_trapping", "0.2"),
    _one("saturable_binding", "0.5"),
    _one("attenuation_mismatch", "0.05,onset=30,region=3"),
    replace(_one("motion_step", "2,axis=1,onset=30"), psf=5.0, includes=_BLURRED),
    replace(_one("motion_drift", "4,axis=3"), psf=5.0, includes=_BLURRED),
    _one("gain_step", "0.05,onset=30"),
    _one("gain_drift", "0.04", "half_life_error"),
    _one("dead_time", "0.1"),
    _one("randoms_offset", "0.03"),
    _one("frame_duration", "0.2,frame=18"),
    _one("mean_life_swap", "1"),
    Brain(
        "a delay and a gain step",
        ("arterial_delay=6", "gain_step=0.06,onset=30"),
        (frozenset(_LATE), frozenset({"gain_step"})),
    ),
)


def measure_survey(
    folder: Path,
    *,
    only: tuple[str, ...] = (),
    seeds: int = 1,
    told: Callable[[str], None] = lambda _: None,
) -> list[dict[str, object]]:
    """A row a brain: what the report says, and whether it is right.

    Args:
        folder: for the studies; brains that lie there already are judged again, not made again.
        only: parts of names of the brains; empty for all.
        seeds: brains of each kind.
        told: hears of each.

    Raises:
        InputError: no brain has such a name.
    """
    wanted = [b for b in BRAINS if not only or any(part in b.name for part in only)]
    if not wanted:
        raise InputError(f"No brain's name holds {' or '.join(only)}; there are: {'; '.join(b.name for b in BRAINS)}.")
    rows = []
    for place, brain in ((BRAINS.index(b), b) for b in wanted):
        for seed in range(seeds):
            row = _row(brain, folder / f"{place:02}-{seed}", seed)
            told(f"{brain.name}: {row['verdict']} {row['set']}")
            rows.append(row)
    return rows


def _row(brain: Brain, study: Path, seed: int) -> dict[str, object]:
    if not study.is_dir():
        simulate(
            SimulationSettings(
                out=study,
                phantom="brain3d",
                tracer=brain.tracer,
                voxel_size=_VOXEL_MM,
                noise=_NOISE,
                psf=brain.psf,
                effects=brain.effects,
                seed=seed,
            )
        )
    request = DiagnoseRequest(study, model=brain.tissue, include=brain.includes, seed=seed)
    (one,) = diagnose_study(request)
    seconds = one.answer["provenance"]["seconds"]
    return {"brain": brain.name, "seed": seed} | _said(one.answer, brain) | {"cpu_s": seconds}


def _said(answer: dict[str, Any], brain: Brain) -> dict[str, object]:
    verdict, causes = answer["verdict"], answer["causes"]
    leader = causes[0] if causes else {"effects": [], "probability": 0.0, "estimate": {}, "closure": None}
    size, closed = leader["estimate"].get("amplitude"), leader["closure"]
    return {
        "verdict": verdict["kind"],
        "set": " ".join(verdict["set"]),
        "probability": round(leader["probability"], 3),
        "amplitude": "" if size is None else round(size["value"], 4),
        "unit": "" if size is None else size["unit"],
        "closure": "" if closed is None else round(closed["value"], 3),
        "p": round(answer["gap"]["p_value"], 4),
        "first": _right(brain, verdict["kind"], leader["effects"]),
        "in_set": _right_set(brain, verdict["kind"], verdict["set"]),
    }


def _right(brain: Brain, kind: str, names: list[str]) -> bool:
    """Whether these are the effects that were put in, and no more; of no gap, that none is claimed."""
    if not brain.answer:
        return kind == "none"
    claimed = kind in ("named", "ambiguous") and len(names) == len(brain.answer)
    return claimed and all(any(name in alike for name in names) for alike in brain.answer)


def _right_set(brain: Brain, kind: str, labels: list[str]) -> bool:
    return any(_right(brain, kind, label.split("+")) for label in labels or [""])


def text_of(rows: list[dict[str, object]]) -> str:
    """Counts by brain."""
    lines = [f"{'brain':44} {'first':>7} {'in set':>7}  said"]
    for name in dict.fromkeys(str(row["brain"]) for row in rows):
        mine = [row for row in rows if row["brain"] == name]
        first, held = (sum(bool(row[key]) for row in mine) for key in ("first", "in_set"))
        said = "; ".join(dict.fromkeys(str(row["set"] or row["verdict"]) for row in mine))
        lines.append(f"{name:44} {f'{first}/{len(mine)}':>7} {f'{held}/{len(mine)}':>7}  {said}")
    return "\n".join(lines)
