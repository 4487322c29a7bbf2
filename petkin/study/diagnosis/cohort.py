"""The answer about several scans: what they share, which of them, and how strong."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from petkin import __version__
from petkin.diagnosis import CLAIM, Cohort, Group, Interval, SharedCause
from petkin.effects import effect_named
from petkin.study.diagnosis.answer import rounded
from petkin.study.diagnosis.sentences import DOUBTFUL, words

SCHEMA = "petkin-gap-cohort/1"
#: A scan that carries the cause with more than this probability is counted; for sure with more than the other, as one
#: that says nothing of it carries it with the probability that any of them does.
_CARRIES, _SURELY = 0.5, 0.9
#: So many scans with a gap of their own are called by name.
_FEW = 3


def cohort_answer(found: Cohort, answers: Sequence[dict[str, Any]], *, seed: int, seconds: float) -> dict[str, Any]:
    """The whole answer, ready to be written; `answers` are those about every scan, in the cohort's order."""
    return rounded(
        {
            "schema": SCHEMA,
            "simulator": {key: answers[0]["simulator"][key] for key in ("model", "includes")},
            "gap": {"present": found.present, "p_value": found.p_value},
            "members": [_member(member.label, one) for member, one in zip(found.members, answers, strict=True)],
            "causes": [_cause(cause, found) for cause in found.causes],
            "further": [
                {
                    "causes": [_cause(cause, found) for cause in group.causes],
                    "set": list(group.chosen),
                    "set_probability": group.set_probability,
                }
                for group in found.further
            ],
            "unnamed": None if found.unnamed is None else _cause(found.unnamed, found),
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
        strength = _interval(cause.mean) | {"unit": cause.unit, "between_scans_sd": cause.between}
    return {
        "effects": list(cause.effects),
        "probability": cause.probability,
        "log_evidence_gain": cause.log_evidence,
        "prevalence": _interval(cause.prevalence),
        "amplitude": strength,
        "onset": None if cause.onset is None else _interval(cause.onset) | {"unit": "min"},
        "closure": None if cause.closure is None else _interval(cause.closure),
        "members": [
            {"subject": member.label, "probability": share, "amplitude": _strength(member.strength(cause.label))}
            for member, share in zip(found.members, cause.carriers, strict=True)
        ],
    }


def _interval(found: Interval) -> dict[str, Any]:
    return {"value": found.value, "low": found.low, "high": found.high}


def _strength(strength: Any) -> dict[str, Any] | None:
    if strength is None:
        return None
    return {"value": strength.value, "low": strength.low, "high": strength.high, "unit": strength.unit}


def _split_by(found: Cohort) -> str | None:
    ambiguous = [group.chosen for group in _named(found) if len(group.chosen) > 1]
    names = [name for chosen in ambiguous for label in chosen for name in label.split("+")]
    advice = (text for name in names if (text := effect_named(name).split_by))
    return next(advice, "a longer or a second scan") if names else None


def _named(found: Cohort) -> list[Group]:
    """What members share that has a name, in order."""
    first = (found.groups[0],) if found.chosen else ()
    return [*first, *found.further]


def sentence(found: Cohort) -> str:
    """The verdict on the cohort in one sentence for everything that is shared."""
    count = len(found.members)
    if found.kind == "none":
        near = f"; a gap is claimed at {CLAIM:g}" if found.p_value < DOUBTFUL else ""
        return f"The simulator explains these {count} scans: no gap beyond the noise (p = {found.p_value:.2g}{near})."
    told = [_of_group(group, count) for group in _named(found)]
    if found.unnamed is not None:
        holding = f"{_number(found.unnamed)} of {count} scans hold a gap that no effect of the catalogue explains"
        told.insert(len(told) if found.chosen else 0, f"{holding} (p = {found.p_value:.2g}).")
    if not told:
        return f"There are gaps (p = {found.p_value:.2g}) but no cause that these {count} scans share{_alone(found)}."
    return " Beside it, ".join([told[0], *(more[0].lower() + more[1:] for more in told[1:])])


def _alone(found: Cohort) -> str:
    """The few scans that have a gap of their own."""
    labels = [member.label for member in found.members if member.p_value <= CLAIM]
    if not 0 < len(labels) <= _FEW:
        return ""
    return f"; by {'itself' if len(labels) == 1 else 'themselves'}: {', '.join(labels)}"


def _number(cause: SharedCause) -> str:
    carriers, surely = (int((cause.carriers > share).sum()) for share in (_CARRIES, _SURELY))
    return f"{surely} to {carriers}" if 0 < surely < carriers else str(carriers)


def _of_group(group: Group, count: int) -> str:
    leader = group.causes[0]
    size = ""
    if leader.mean is not None:
        unit = "" if leader.unit == "1" else f" {leader.unit}"
        size = f", {leader.mean.value:.3g}{unit} on average ({leader.mean.low:.3g} to {leader.mean.high:.3g})"
    if leader.onset is not None:
        size += f", from {leader.onset.value:.3g} min on ({leader.onset.low:.3g} to {leader.onset.high:.3g})"
    if leader.closure is not None:
        closed = leader.closure
        size += f", and explains {closed.value:.0%} of their gaps ({closed.low:.0%} to {closed.high:.0%})"
    text = f"{words(leader.label).capitalize()} is shared by {_number(leader)} of {count} scans{size}"
    if len(group.chosen) == 1:
        return f"{text}."
    others = " or ".join(words(label) for label in group.chosen[1:])
    return f"{text}; these data cannot split it from {others}."
