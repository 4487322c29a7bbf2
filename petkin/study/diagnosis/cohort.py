"""The answer about several scans: what they share, which of them, and how strong."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from petkin import __version__
from petkin.diagnosis import Cohort, SharedCause
from petkin.effects import effect_named
from petkin.study.diagnosis.answer import rounded, words

SCHEMA = "petkin-gap-cohort/1"
#: A scan that carries the cause with more than this probability is counted; for sure with more than the other, as one
#: that says nothing of it carries it with the probability that any of them does.
_CARRIES, _SURELY = 0.5, 0.9


def cohort_answer(found: Cohort, answers: Sequence[dict[str, Any]], *, seed: int, seconds: float) -> dict[str, Any]:
    """The whole answer, ready to be written; `answers` are those about every scan, in the cohort's order."""
    return rounded(
        {
            "schema": SCHEMA,
            "simulator": {key: answers[0]["simulator"][key] for key in ("model", "includes")},
            "gap": {"present": found.present, "p_value": found.p_value},
            "members": [_member(member.label, one) for member, one in zip(found.members, answers, strict=True)],
            "causes": [_cause(cause, found) for cause in found.causes],
            "verdict": {
                "kind": found.kind,
                "set": list(found.chosen),
                "set_probability": found.set_probability,
                "split_by": _split_by(found),
                "sentence": sentence(found),
            },
            "provenance": {"petkin": __version__, "seed": seed, "seconds": seconds},
        }
    )


def _member(label: str, one: dict[str, Any]) -> dict[str, Any]:
    gap, verdict = one["gap"], one["verdict"]
    return {
        "subject": label,
        "present": gap["present"],
        "p_value": gap["p_value"],
        "kind": verdict["kind"],
        "set": verdict["set"],
    }


def _cause(cause: SharedCause, found: Cohort) -> dict[str, Any]:
    strength = None
    if cause.mean is not None:
        bounds = {"value": cause.mean.value, "low": cause.mean.low, "high": cause.mean.high, "unit": cause.unit}
        strength = {**bounds, "between_scans_sd": cause.between}
    prevalence = cause.prevalence
    return {
        "effects": list(cause.effects),
        "probability": cause.probability,
        "log_evidence_gain": cause.log_evidence,
        "prevalence": {"value": prevalence.value, "low": prevalence.low, "high": prevalence.high},
        "amplitude": strength,
        "members": [
            {"subject": member.label, "probability": share, "amplitude": _strength(member.strengths.get(cause.label))}
            for member, share in zip(found.members, cause.carriers, strict=True)
        ],
    }


def _strength(strength: Any) -> dict[str, Any] | None:
    if strength is None:
        return None
    return {"value": strength.value, "low": strength.low, "high": strength.high, "unit": strength.unit}


def _split_by(found: Cohort) -> str | None:
    if found.kind != "ambiguous":
        return None
    names = [name for label in found.chosen for name in label.split("+")]
    return next((text for name in names if (text := effect_named(name).split_by)), "a longer or a second scan")


def sentence(found: Cohort) -> str:
    """The verdict on the cohort in one sentence."""
    count = len(found.members)
    if found.kind == "none":
        return f"The simulator explains these {count} scans: no gap beyond the noise (p = {found.p_value:.2g})."
    if found.kind == "unknown":
        return f"There are gaps (p = {found.p_value:.2g}) but no cause that these {count} scans share."
    leader = found.causes[0]
    carriers, surely = (int((leader.carriers > share).sum()) for share in (_CARRIES, _SURELY))
    by = f"{surely} to {carriers}" if 0 < surely < carriers else str(carriers)
    size = ""
    if leader.mean is not None:
        unit = "" if leader.unit == "1" else f" {leader.unit}"
        size = f", {leader.mean.value:.3g}{unit} on average ({leader.mean.low:.3g} to {leader.mean.high:.3g})"
    text = f"{words(leader.label).capitalize()} is shared by {by} of {count} scans{size}"
    if found.kind == "named":
        return f"{text}."
    others = " or ".join(words(label) for label in found.chosen[1:])
    return f"{text}; these data cannot split it from {others}."
