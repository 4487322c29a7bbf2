"""The answer as JSON: what contracts call the gap report."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petkin import __version__
from petkin.diagnosis import (
    DRIVE,
    Cause,
    Diagnosis,
    Estimate,
    State,
    Visible,
    indistinct,
    witnessed,
)
from petkin.effects import effect_named
from petkin.kinetics import compartment_model
from petkin.study.diagnosis.including import included
from petkin.study.diagnosis.regional import RegionalSimulator, kinetics
from petkin.study.diagnosis.sentences import sentence, told
from petkin.study.diagnosis.sidecar import Blunder
from petkin.study.diagnosis.state import StatesRead
from petkin.study.diagnosis.state_table import state_entry
from petkin.units import SECONDS_PER_MINUTE

Array = NDArray[np.float64]

SCHEMA = "petkin-gap/1"
#: What is reported of every region before and after the cause is added.
_REPORTED = ("K1", "VT", "Ki")
#: State that a stage's effects change.
_STATES = {"input": "C_P", "vascular": "C_B", "tissue": "C_T"}
_DIGITS = 6
#: The smallest d' that is said as a number.
_LEAST = 0.01


def answer(
    found: Diagnosis,
    simulator: RegionalSimulator,
    *,
    subject: str,
    model: str,
    seed: int,
    seconds: float,
    shown: tuple[Blunder, ...] = (),
    states: StatesRead | None = None,
) -> dict[str, Any]:
    """The whole answer, ready to be written.

    `shown` is what the sidecar tells without any curve, `states` what learned residuals find missing.
    """
    return rounded(
        {
            "schema": SCHEMA,
            "subject": subject,
            "simulator": {
                "model": model.lower(),
                "includes": [e.name for e in simulator.includes],
                "fitted": [_included(one) for one in included(simulator, found.base)],
            },
            "gap": {
                "present": found.present,
                "p_value": found.p_value,
                "chi2_per_dof": found.chi2_per_dof,
                "noise_floor": 1.0,
                "frame_common_share": found.noise.share,
            },
            "where": _where(found, simulator, states),
            "causes": [cause_entry(cause) for cause in found.causes],
            "verdict": {
                "kind": found.kind,
                "set": list(found.chosen),
                "set_probability": found.set_probability,
                "split_by": split_by(found),
                "sentence": sentence(found) + told(shown),
            },
            "cannot_tell": cannot_tell(witnessed(found.visible, found.shown), simulator, shown),
            "parameters": _parameters(found, simulator),
            "provenance": {"petkin": __version__, "seed": seed, "seconds": seconds},
        }
    )


def _included(one: Estimate) -> dict[str, Any]:
    """A quantity of an included effect; a setting, which is not refitted, has no interval."""
    entry = {"effect": one.effect, "symbol": one.symbol} | _quantity(one)
    return entry if one.low < one.high else {key: entry[key] for key in entry if key not in ("low", "high")}


def _quantity(one: Estimate) -> dict[str, Any]:
    place = {"region": one.channel} if one.channel else {}
    return {"value": one.value, "low": one.low, "high": one.high, "unit": one.unit} | place


def _where(found: Diagnosis, simulator: RegionalSimulator, states: StatesRead | None) -> dict[str, Any]:
    frames = simulator.clock.frames
    regions = zip(found.channels, found.claims(found.regions), found.regions.shares)
    return {
        "stages": [{"stage": s, "probability": p} for s, p in found.stages.items()],
        "regions": [{"region": r, "q_value": q, "share": share} for r, q, share in regions],
        "frames": [
            {
                "index": k,
                "start_s": frames.start[k] * SECONDS_PER_MINUTE,
                "end_s": frames.end[k] * SECONDS_PER_MINUTE,
                "q_value": q,
            }
            for k, q in enumerate(found.claims(found.frames))
        ],
        "onset_frame": onset_frame(found, simulator),
        "state": [*_state(found), *(state_entry(states) if found.present else ())],
    }


def onset_frame(found: Diagnosis, simulator: RegionalSimulator) -> int | None:
    """Frame that holds the leader's onset, or is the one that it concerns."""
    if found.frame is not None:
        return found.frame
    if found.onset is None:
        return None
    frames = simulator.clock.frames
    return int(min(np.searchsorted(frames.end, found.onset + 1e-9), len(frames) - 1))


def _state(found: Diagnosis) -> list[dict[str, Any]]:
    """Effects of blood and tissue that the data speak for, each with the state that it changes."""
    named = [
        {"state": _STATES[stage], "term": effect_named(name).meaning, "evidence": evidence}
        for name, (stage, evidence) in found.evidence.items()
        if stage in _STATES and evidence > 0 and found.present
    ]
    if found.kind == "unknown":
        term = "a smooth departure that no catalogued effect makes"
        state = "C_P" if found.unknown_place == DRIVE else "C_T"
        return [{"state": state, "term": term, "evidence": found.unknown_evidence}, *named]
    return named


def cause_entry(cause: Cause) -> dict[str, Any]:
    """A cause as the answer has it; what is of the second effect of a pair says so."""
    estimate = {}
    for entry in cause.estimates:
        key = {"onset": "onset_min"}.get(entry.symbol, entry.symbol)
        key = key if entry.effect in ("", cause.effects[0]) else f"second_{key}"
        estimate[key] = _quantity(entry)
    closed = cause.closure
    return {
        "effects": list(cause.effects),
        "probability": cause.probability,
        "estimate": estimate,
        "log_evidence_gain": cause.log_evidence,
        "closure": None if closed is None else {"value": closed.value, "low": closed.low, "high": closed.high},
    } | ({} if cause.left is None else {"log_evidence_left": cause.left})


def split_by(found: Diagnosis) -> str | None:
    """The measurement that would split the set of an ambiguous verdict."""
    if found.kind != "ambiguous":
        return None
    for label in found.chosen:
        for name in label.split("+"):
            if effect_named(name).split_by:
                return effect_named(name).split_by
    return "a longer or a second scan"


def cannot_tell(
    visible: tuple[Visible, ...], simulator: RegionalSimulator, shown: tuple[Blunder, ...] = ()
) -> list[dict[str, Any]]:
    """Effects that this design hides, and pairs that look alike in it; with what an unseen one does to K1 and VT.

    What the sidecar shows of a pure scale comes first: no curve ever could.
    """
    found: list[dict[str, Any]] = [
        {
            "effects": [b.effect],
            "why": f"the sidecar alone shows it: {b.why}",
            "worst_bias": {"K1": b.scale, "VT": b.scale},
        }
        for b in shown
        if b.scale
    ]
    for names, entry in indistinct(visible):
        if names in {(b.effect,) for b in shown if b.scale}:
            continue
        if len(names) == 1:
            seen = f"{entry.detectability:.2g}" if entry.detectability >= _LEAST else f"below {_LEAST}"
            why = f"the refitted kinetics absorb it: d' is {seen} at the end of its plausible range"
        else:
            why = f"after the refit they look alike (cosine {entry.partners[0][1]:.2f})"
        found.append({"effects": list(names), "why": why, "worst_bias": _bias(entry, simulator)})
    return found


def _bias(entry: Visible, simulator: RegionalSimulator) -> dict[str, float]:
    """Largest relative change over regions of K1 and VT when the effect is there and left out."""
    count = compartment_model(simulator.label).rates
    own = entry.own
    before = _quantities(simulator.label, np.exp(own[:, :count]))
    after = _quantities(simulator.label, np.exp(own[:, :count] + np.clip(entry.shift[:, :count], -2.0, 2.0)))
    return {s: float(np.abs(after[s] / before[s] - 1.0).max()) for s in _REPORTED if s in before}


def _quantities(label: str, rates: Array) -> dict[str, Array]:
    model = compartment_model(label)
    columns = tuple(rates.T)
    found = dict(zip(model.parameters.symbols, columns))
    return found | {macro.symbol: macro.formula(*columns) for macro in model.macros}


def _parameters(found: Diagnosis, simulator: RegionalSimulator) -> list[dict[str, Any]]:
    before = _of_state(simulator, found.base.state)
    leader = found.causes[0].fit if found.causes else None
    after = before if leader is None else _of_state(simulator, leader.state)
    units = {q.symbol: q.unit for q in compartment_model("2TCM").quantities} | {
        q.symbol: q.unit for q in compartment_model(simulator.label).quantities
    }
    return [
        {
            "region": region,
            "symbol": symbol,
            "unit": units[symbol].replace("cm^-3", "/cm3").replace("min^-1", "/min").replace(" ", ""),
            "before": None if symbol not in before else before[symbol][r],
            "after": None if symbol not in after else after[symbol][r],
        }
        for r, region in enumerate(simulator.channels)
        for symbol in _REPORTED
        if symbol in before or symbol in after
    ]


def _of_state(simulator: RegionalSimulator, state: State) -> dict[str, Array]:
    tissue = simulator.model(state.own, state.shared, state.terms).tissue
    symbols = kinetics(tissue.model)
    return _quantities(tissue.model, np.stack([np.asarray(tissue.rates[s]) for s in symbols], axis=-1))


def rounded(value: Any) -> Any:
    """Plain numbers of six digits; what is not finite has no value."""
    if isinstance(value, dict):
        return {key: rounded(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(entry) for entry in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(f"{float(value):.{_DIGITS}g}") if math.isfinite(value) else None
    return value
