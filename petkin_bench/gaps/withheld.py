"""Runs with one effect in them, made by another solver than the diagnosis has, and what the diagnosis says of them."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from petkin import __version__
from petkin.diagnosis import Diagnosis, Hypothesis, Term, diagnose, indistinct
from petkin.errors import InputError
from petkin.study.diagnosis.answer import cause_entry
from petkin_bench.gaps.moving import Body, MovingBodies, seen, size

Array = NDArray[np.float64]

#: Starts and parameters that runs are drawn from, by body.
_Ranges = tuple[tuple[float, float], ...]
_DRAWN: Mapping[str, tuple[_Ranges, _Ranges]] = {
    "pendulum": (((-1.4, 1.4), (-2.0, 2.0)), ((6.0, 14.0),)),
    "mass_spring": (((-4.5, -2.0), (2.0, 4.5), (-0.5, 0.5), (-0.5, 0.5)), ((6.0, 14.0),)),
    "bouncing_ball": (((-4.0, 4.0), (-2.0, 4.0), (-3.0, 3.0), (-3.0, 3.0)), ((1.5, 5.0),)),
    "double_pendulum": (((-1.2, 1.2), (-1.2, 1.2), (-1.0, 1.0), (-1.0, 1.0)), ((6.0, 14.0),)),
    "rigid_body": (
        ((-0.8, 0.8), (-0.8, 0.8), (-0.3, 0.3), *[(-0.5, 0.5)] * 6, *[(-1.0, 1.0)] * 3),
        ((-10.0, 10.0), (-10.0, 10.0)),
    ),
}
_RTOL, _ATOL = 1e-9, 1e-10


def simulate_runs(
    body: Body, effects: Mapping[str, Term], *, trials: int, noise: float, rng: np.random.Generator
) -> Array:
    """Places of the points in pictures (trials, P 2 T), from starts and parameters drawn anew.

    Args:
        body: which.
        effects: by name.
        trials: how many.
        noise: standard deviation of a place, in units of the picture's half.
        rng: randomness.
    """
    _, shared = drawn_start(body, rng)
    runs = [run(body, drawn_start(body, rng)[0], shared, effects) for _ in range(trials)]
    points = seen(body.points(np.stack(runs)), body.interval, effects)
    values = np.moveaxis(points, 1, -1).reshape(trials, -1)
    return values + noise * rng.standard_normal(values.shape)


def drawn_start(body: Body, rng: np.random.Generator) -> tuple[Array, Array]:
    """A start and the law's parameters."""
    ranges, levels = _DRAWN[body.name]
    return np.array([rng.uniform(*r) for r in ranges]), np.array([rng.uniform(*level) for level in levels])


def run(body: Body, start: Array, shared: Array, effects: Mapping[str, Term]) -> Array:
    """Places at every frame (T, n): an adaptive solver, stopped and turned round at every wall."""
    count, half = body.frames, body.dimensions
    times = np.arange(count) * body.interval * (1.0 + float(size(effects, "frame_rate")))
    found, state, now = np.empty((count, half)), start, 0.0
    done = 0
    while done < count:
        solved = solve_ivp(
            lambda t, y: np.concatenate(
                [body.rate(y[:half], y[half:]), body.law(t, y[:half], y[half:], shared, effects)]
            ),
            (now, times[-1] + 1e-9),
            state,
            method="DOP853",
            dense_output=True,
            events=[_Wall(body, i) for i in range(half)] if body.wall else None,
            rtol=_RTOL,
            atol=_ATOL,
        )
        end = float(solved.t[-1])
        here = (times >= now - 1e-12) & (times <= end + 1e-12)
        found[here] = solved.sol(times[here])[:half].T
        done = int(np.count_nonzero(times <= end + 1e-12))
        if done < count:
            state, now = _turned(solved, half, effects), end
    return found


class _Wall:
    """Event of `solve_ivp`: a place reaches the wall."""

    terminal, direction = True, -1

    def __init__(self, body: Body, axis: int) -> None:
        self._body, self._axis = body, axis

    def __call__(self, t: float, y: Array) -> float:
        outwards = y[self._axis] * y[self._body.dimensions + self._axis] > 0
        return self._body.wall - abs(y[self._axis]) if outwards else 1.0


def _turned(solved: Any, half: int, effects: Mapping[str, Term]) -> Array:
    state = solved.y[:, -1].copy()
    axis = next(i for i, times in enumerate(solved.t_events) if times.size)
    state[half + axis] *= -(1.0 - float(size(effects, "restitution")))
    others = [half + i for i in range(half) if i != axis]
    state[others] *= 1.0 - float(size(effects, "wall_friction"))
    return state


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
    return diagnose(MovingBodies(body, data), data, hypotheses, seed=seed)


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
