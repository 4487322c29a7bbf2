"""Runs with one effect in them, made by another solver than the diagnosis has, and what the diagnosis says of them."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petkin import __version__
from petkin.diagnosis import Diagnosis, Hypothesis, Term, diagnose, indistinct
from petkin.errors import InputError
from petkin.study.diagnosis.answer import cause_entry
from petkin_bench.gaps.moving import Body, MovingBodies
from petkin_bench.withheld.bodies.rigs import RIGS

Array = NDArray[np.float64]


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


def diagnose_runs(body: Body, data: Array, *, without: frozenset[str] = frozenset(), seed: int = 0) -> Diagnosis:
    """What is missing in the body's law, camera and clock."""
    hypotheses: tuple[Hypothesis, ...] = tuple(h for h in body.hypotheses if h.name not in without)
    simulator = MovingBodies(body, data)
    return diagnose(simulator, simulator.samples, hypotheses, seed=seed)


def measure_body(body: Body, *, share: float, trials: int, noise: float, seed: int) -> list[dict[str, object]]:
    """A row an effect of the catalogue, and as many without any: what was in the runs, and what was said."""
    rows = []
    for i, entry in enumerate(body.hypotheses):
        for name in (entry.name, ""):
            rng = np.random.default_rng((seed, i, bool(name)))
            effects = {name: effect_at(body, name, share)} if name else {}
            data = simulate_runs(body, effects, trials=trials, noise=noise, rng=rng)
            started = time.process_time()
            found = diagnose_runs(body, data, seed=seed)
            seconds = time.process_time() - started
            rows.append(_row(body, name, found, share, trials, noise) | {"cpu_s": round(seconds, 2)})
    return rows


def one_case(body: Body, effect: str, *, trials: int, noise: float, seed: int) -> dict[str, Any]:
    """The answer about runs with an effect given as NAME or NAME=SHARE of its range, half of it by default.

    Raises:
        InputError: no such effect, or a share that is no number.
    """
    name, _, text = effect.partition("=")
    try:
        share = float(text or 0.5)
    except ValueError:
        raise InputError(f"--effect {effect!r}: {text!r} is not a number; write {name}=SHARE of its range.") from None
    started = time.process_time()
    effects = {name: effect_at(body, name, share)}
    data = simulate_runs(body, effects, trials=trials, noise=noise, rng=np.random.default_rng(seed))
    found = diagnose_runs(body, data, seed=seed)
    return body_answer(body, found, seed=seed, seconds=round(time.process_time() - started, 2))


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
    leader = found.causes[0].label if found.causes else ""
    said = {
        "none": "The law explains these runs: no gap beyond the noise.",
        "unknown": f"There is a gap that no catalogued effect explains; the nearest is {leader}.",
        "named": f"{leader} is missing.",
        "ambiguous": f"One of {', '.join(found.chosen)} is missing; these runs cannot split them.",
    }[found.kind]
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
            "sentence": said,
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


def single_flight(body: Body) -> Body:
    """The body watched so briefly that it meets no wall."""
    return replace(body, frames=24, wall=0.0)
