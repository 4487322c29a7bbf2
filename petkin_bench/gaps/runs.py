"""Runs with one effect in them, made by another solver than the diagnosis has, and what the diagnosis says of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from petkin import __version__
from petkin.diagnosis import Diagnosis, Term, diagnose, indistinct
from petkin.errors import InputError
from petkin.study.diagnosis.answer import cause_entry
from petkin.study.diagnosis.sentences import explained, words
from petkin_bench.gaps.moving import Body, MovingBodies
from petkin_bench.withheld.bodies.rigs import RIGS

Array = NDArray[np.float64]

#: What is being done, and how far it is from 0 to 1.
Told = Callable[[str, float], None]
#: What a table of runs needs; its largest size, bytes; fewest frames.
_COLUMNS, _LARGEST, _FEWEST = ("trial", "frame", "point", "x", "y"), 100_000_000, 16


def simulate_runs(
    body: Body, effects: Mapping[str, Term], *, trials: int, noise: float, rng: np.random.Generator
) -> Array:
    """Places of the points in pictures (trials, P 2 T), from starts and parameters drawn anew, by the blind check's
    own mechanics.

    Args:
        body: which.
        effects: by name.
        trials: how many.
        noise: standard deviation of a place, in units of the picture's half.
        rng: randomness.
    """
    rig = replace(RIGS[body.name], frames=body.frames, wall=body.wall)
    starts, parameters = rig.drawn(rng, trials)
    kit: dict[str, float] = {}
    for name, term in effects.items():
        kit |= {name: float(term.amplitude), **term.setting}
    points = rig.seen(starts, np.tile(parameters, (trials, 1)), kit)
    values = np.moveaxis(points, 1, -1).reshape(trials, -1)
    return np.asarray(values + noise * rng.standard_normal(values.shape), np.float64)


def effect_at(body: Body, name: str, share: float) -> Term:
    """An effect at a share of the upper end of its plausible range.

    Raises:
        InputError: it is not in the body's catalogue.
    """
    for entry in body.hypotheses:
        if entry.name == name:
            return Term(entry, share * entry.upper, dict(entry.settings[-1]))
    known = ", ".join(h.name for h in body.hypotheses)
    raise InputError(f"{body.name} has no effect {name!r}; choose one of {known}.")


def diagnose_runs(body: Body, data: Array, *, seed: int = 0, progress: Told = lambda *_: None) -> Diagnosis:
    """What is missing in the body's law, camera and clock."""
    simulator = MovingBodies(body, data)
    return diagnose(simulator, simulator.samples, body.hypotheses, seed=seed, progress=progress)


def measure_body(
    body: Body, *, share: float, trials: int, noise: float, seed: int, progress: Told = lambda *_: None
) -> list[dict[str, object]]:
    """A row an effect of the catalogue, and as many without any: what was in the runs, and what was said."""
    rows = []
    for i, entry in enumerate(body.hypotheses):
        progress(entry.name, i / len(body.hypotheses))
        for name in (entry.name, ""):
            rng = np.random.default_rng((seed, i, bool(name)))
            effects = {name: effect_at(body, name, share)} if name else {}
            data = simulate_runs(body, effects, trials=trials, noise=noise, rng=rng)
            started = time.process_time()
            found = diagnose_runs(body, data, seed=seed)
            seconds = time.process_time() - started
            rows.append(_row(body, name, found, share, trials, noise) | {"cpu_s": round(seconds, 2)})
    return rows


def one_effect(body: Body, effect: str, *, trials: int, noise: float, seed: int) -> Array:
    """Runs with an effect given as NAME or NAME=SHARE of its range, half of it by default.

    Raises:
        InputError: no such effect, or a share that is no number.
    """
    name, _, text = effect.partition("=")
    try:
        share = float(text or 0.5)
    except ValueError:
        raise InputError(f"--effect {effect!r}: {text!r} is not a number; write {name}=SHARE of its range.") from None
    effects = {name: effect_at(body, name, share)}
    return simulate_runs(body, effects, trials=trials, noise=noise, rng=np.random.default_rng(seed))


def answer_about(
    body: Body, data: Array, *, seed: int, progress: Told = lambda *_: None
) -> tuple[Diagnosis, dict[str, Any]]:
    """What is found of runs (trials, P 2 T), and the answer about it."""
    started = time.process_time()
    found = diagnose_runs(body, data, seed=seed, progress=progress)
    return found, body_answer(body, found, seed=seed, seconds=round(time.process_time() - started, 2))


def written_runs(body: Body, data: Array) -> str:
    """Runs as a table of comma-separated values, a place a row, with trial, frame, point, x, y."""
    seen = data.reshape(len(data), -1, 2, body.frames)
    trial, point, frame = np.meshgrid(*map(np.arange, (len(data), seen.shape[1], body.frames)), indexing="ij")
    columns = {"trial": trial + 1, "frame": frame, "point": point + 1, "x": seen[:, :, 0], "y": seen[:, :, 1]}
    table = pd.DataFrame({name: column.ravel() for name, column in columns.items()})
    return table.sort_values(["trial", "frame", "point"]).to_csv(index=False, lineterminator="\n")


def read_runs(path: Path, body: Body) -> tuple[Body, Array]:
    """Runs of a table as `written_runs` has it, and the body watched for as many frames as they have.

    Raises:
        InputError: it cannot be read, is too large, lacks a column or a place, or has points that the body has not.
    """
    try:
        if path.stat().st_size > _LARGEST:
            raise InputError(f"{path} is larger than {_LARGEST // 10**6} MB; give fewer trials.")
        table = pd.read_csv(path)
    except (OSError, UnicodeDecodeError, pd.errors.ParserError, pd.errors.EmptyDataError) as fault:
        raise InputError(f"{path} cannot be read as a table of comma-separated values: {fault}") from None
    lacking = [name for name in _COLUMNS if name not in table]
    if lacking:
        raise InputError(f"{path} has no column {lacking[0]}; it needs {', '.join(_COLUMNS)}.")
    table = table[list(_COLUMNS)].apply(pd.to_numeric, errors="coerce")
    if not np.isfinite(table.to_numpy(np.float64)).all():
        row = int(np.flatnonzero(~np.isfinite(table.to_numpy(np.float64)).all(axis=1))[0])
        raise InputError(f"{path}: row {row + 2} holds something that is no number.")
    places = table.set_index(["trial", "point", "frame"]).sort_index()
    trials, points, frames = (places.index.unique(level) for level in range(3))
    if len(places) != len(trials) * len(points) * len(frames) or not places.index.is_unique:
        raise InputError(f"{path}: every trial needs every point once in each of its {len(frames)} frames.")
    if len(points) != body.shown or len(frames) < _FEWEST or np.any(np.diff(frames) != 1):
        raise InputError(
            f"{path}: a {body.name.replace('_', ' ')} needs {body.shown} points a frame, and {_FEWEST} frames or more "
            f"that follow one another {body.interval:g} s apart; there are {len(points)} and {len(frames)}."
        )
    seen = places.to_numpy(np.float64).reshape(len(trials), len(points), len(frames), 2)
    return replace(body, frames=len(frames)), np.moveaxis(seen, 3, 2).reshape(len(trials), -1)


def _row(body: Body, name: str, found: Diagnosis, share: float, trials: int, noise: float) -> dict[str, object]:
    seen_as = {v.hypothesis.name: v for v in found.visible}
    named = [set(label.split("+")) for label in found.chosen]
    alike = {n for n, cosine in seen_as[name].partners if cosine >= 0.95} | {name} if name else set()
    return {
        "system": body.name,
        "effect": name,
        "share_of_range": share if name else 0.0,
        "trials": trials,
        "noise": noise,
        "d_prime": round(share * seen_as[name].detectability, 1) if name else 0.0,
        "kind": found.kind,
        "set": " ".join(found.chosen),
        "first": bool(named and name in named[0]),
        "class_first": bool(named and named[0] & alike),
        "in_set": any(name in labels for labels in named),
    }


def body_answer(body: Body, found: Diagnosis, *, seed: int, seconds: float) -> dict[str, Any]:
    """The answer of a gap report, regions being trials and frames being samples of all points together."""
    after = found.causes[0].fit.state.shared if found.causes and found.causes[0].fit is not None else None
    splits = [h.split_by for h in body.hypotheses if found.kind == "ambiguous" and h.name in found.chosen]
    trials = found.claims(found.regions)
    quality = found.claims(found.frames).reshape(-1, body.frames).min(axis=0)
    return {
        "schema": "petkin-gap/1",
        "subject": f"sub-{body.name.replace('_', '')}",
        "simulator": {"model": body.name, "includes": []},
        "gap": {
            "present": found.present,
            "p_value": found.p_value,
            "chi2_per_dof": found.chi2_per_dof,
            "noise_floor": 1.0,
            "frame_common_share": found.noise.share,
        },
        "where": {
            "stages": [{"stage": s, "probability": p} for s, p in found.stages.items()],
            "regions": [
                {"region": name, "q_value": float(q), "share": float(share)}
                for name, q, share in zip(found.channels, trials, found.regions.shares, strict=True)
            ],
            "frames": [
                {"index": k, "start_s": k * body.interval, "end_s": (k + 1) * body.interval, "q_value": float(q)}
                for k, q in enumerate(quality)
            ],
            "onset_frame": None,
            "state": [],
        },
        "causes": [cause_entry(cause) for cause in found.causes],
        "verdict": {
            "kind": found.kind,
            "set": list(found.chosen),
            "set_probability": found.set_probability,
            "split_by": splits[0] if splits else None,
            "sentence": _sentence(found),
        },
        "cannot_tell": [
            {"effects": list(names), "why": f"d' {v.detectability:.2g}, taken for {v.partners[0][0]}", "worst_bias": {}}
            for names, v in indistinct(found.visible)
        ],
        "parameters": [
            {
                "region": "all trials",
                "symbol": parameter,
                "unit": unit,
                "before": float(found.base.state.shared[i]),
                "after": None if after is None else float(after[i]),
            }
            for i, (parameter, unit, _, _) in enumerate(body.parameters)
        ],
        "provenance": {"petkin": __version__, "seed": seed, "seconds": seconds},
    }


def _sentence(found: Diagnosis) -> str:
    if found.kind == "none":
        return f"The law explains these runs: no gap beyond the noise (p = {found.p_value:.2g})."
    leader = found.causes[0] if found.causes else None
    if found.kind == "unknown" or leader is None:
        nearest = "" if leader is None else f"; the nearest is {words(leader.label)}"
        return f"There is a gap that no catalogued effect explains{nearest}."
    return explained(found, "these runs")


def single_flight(body: Body) -> Body:
    """The body watched so briefly that it meets no wall."""
    return replace(body, frames=24, wall=0.0)
