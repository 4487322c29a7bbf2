"""The answer in words: what a reader sees first."""

from __future__ import annotations

from collections.abc import Mapping

from petkin.diagnosis import CLAIM, DRIVE, ONE, SWINGING, WITHIN, Cause, Diagnosis, Estimate
from petkin.effects.noise import NOISE_VARIANCE
from petkin.imaging import PLANES
from petkin.study.diagnosis.sidecar import Blunder

#: What a gap of no name looks like, where that says more than that it is smooth.
_UNNAMED = {
    DRIVE: "; it looks as if the plasma input departed from its record (see --read-blood)",
    ONE: "; it is likeliest in one region alone",
    SWINGING: "; it swings in all regions alike, as the gain of a scanner may",
    WITHIN: "; it differs within regions, as a gain of the image would that varies smoothly, in rings or by planes",
}
#: How a picture moves, by the number of the way.
_WAYS = (
    *(f"along the image's {axis} axis" for axis in "xyz"),
    *(f"of its rim, turning in the image's {''.join('xyz'[axis] for axis in plane)} plane" for plane in PLANES),
)
#: Share of noise common to frames in which much could hide.
_MUCH = 0.3
#: Log evidence of a gap of no name in what a cause leaves, from which on it is said.
_LEFT = 5.0
#: P-value below which a reader wants to know from which on there is a gap.
DOUBTFUL = 0.1


def sentence(found: Diagnosis) -> str:
    """The verdict in a sentence, and what it leaves in a second."""
    if found.kind == "none":
        near = f"; a gap is claimed at {CLAIM:g}" if found.p_value < DOUBTFUL else ""
        return f"The simulator explains these data: no gap beyond the noise ({_p(found)}{near}){_hidden(found)}."
    if found.kind == "unknown":
        nearest = f"; the nearest is {words(found.causes[0].label)}" if found.causes else ""
        looks = _UNNAMED.get(found.unknown_place, "")
        return f"There is a gap ({_p(found)}) that no catalogued effect explains{looks}{nearest}."
    leader = found.causes[0]
    if leader.effects == (NOISE_VARIANCE.name,):
        return f"{sized(leader)} (0: as counts, 1: one size in all frames); no gap in the mean is claimed."
    return explained(found, "these data")


def explained(found: Diagnosis, data: str) -> str:
    """The likeliest cause with its share of the gap, what else some data may show, and what it leaves."""
    leader = found.causes[0]
    closed, verb = leader.closure, "explains" if len(leader.effects) == 1 else "together explain"
    share = "" if closed is None else f" {verb} {closed.value:.0%} of the gap ({closed.low:.0%} to {closed.high:.0%})"
    others = " or ".join(words(label) for label in found.chosen[1:])
    split = f"; {data} cannot split it from {others}" if others else ""
    return f"{sized(leader)}{share}{split}.{_remaining(leader)}"


def _remaining(cause: Cause) -> str:
    """What is left beside a cause, as a second sentence; nothing where that looks like noise."""
    if cause.left is None or cause.left < _LEFT:
        return ""
    return (
        f" What that leaves is more than noise (log evidence {cause.left:.2g}): "
        "its course may be another than the catalogue's, or something else be there besides."
    )


def _p(found: Diagnosis) -> str:
    """The p-value in words, as far as draws can tell it."""
    least = 1.0 / (1 + len(found.against.drawn))
    return f"p {'=' if found.p_value > least else '<='} {found.p_value:.2g}"


def _hidden(found: Diagnosis) -> str:
    """What may hide where no gap is claimed."""
    if len(found.channels) < 2:
        return "; one region says little of its own noise, which can hide a gap: give more if there are"
    if found.noise.share < _MUCH:
        return ""
    return f"; what regions of a frame have in common, {found.noise.share:.0%} of the noise, could hide a change of all"


def sized(cause: Cause) -> str:
    """A cause with how strong it is, where and from when on; of a pair both."""
    parts = []
    for name in cause.effects:
        known = {e.symbol: e for e in cause.estimates if e.effect in ("", name)}
        parts.append(words(name) + _strength(known))
    text = " and ".join(parts)
    return text[:1].upper() + text[1:]


def _strength(known: Mapping[str, Estimate]) -> str:
    """How strong an effect is, of its estimates by symbol."""
    size = known.get("amplitude")
    if size is None or size.unit == "flag":
        return ""
    unit = "" if size.unit == "1" else f" {size.unit}"
    way = f" {_WAYS[int(known['axis'].value)]}" if "axis" in known and size.unit == "mm" else ""
    place = f" in {size.channel}" if size.channel else ""
    if "frame" in known:
        slipped = "edge" in known and known["edge"].value > 0
        place += f" in frame {known['frame'].value:.0f}" + (", whose end slipped" if slipped else "")
    return f" of {size.value:.3g}{unit}{way}{place}" + (
        f" from {known['onset'].value:.3g} min on" if "onset" in known else ""
    )


def told(shown: tuple[Blunder, ...]) -> str:
    """What the sidecar is sure of, as a second sentence; nothing where it is in order."""
    clauses = [f"{blunder.why} ({words(blunder.effect)})" for blunder in shown if blunder.sure]
    return f" The sidecar shows: {'; '.join(clauses)}." if clauses else ""


def words(label: str) -> str:
    """A cause in words: "gain step with motion drift"."""
    return " with ".join(name.replace("_", " ") for name in label.split("+"))
