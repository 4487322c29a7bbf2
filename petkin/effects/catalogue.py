"""The list of effects, and how an option names one."""

from __future__ import annotations

from petkin.effects.effect import Effect, Injection
from petkin.effects.input import ARTERIAL_DELAY, DISPERSION
from petkin.effects.tissue import SECOND_TISSUE
from petkin.effects.vascular import BLOOD_VOLUME_EFFECT
from petkin.errors import InputError

#: Every effect; a new one is a file or a value in its stage's file, and an entry here.
EFFECTS: tuple[Effect, ...] = (ARTERIAL_DELAY, DISPERSION, BLOOD_VOLUME_EFFECT, SECOND_TISSUE)


def effect_named(name: str) -> Effect:
    """The effect of this name.

    Raises:
        InputError: there is none.
    """
    for known in EFFECTS:
        if known.name == name:
            return known
    raise InputError(f"There is no effect {name!r}; choose one of {', '.join(e.name for e in EFFECTS)}.")


def read_injection(text: str) -> Injection:
    """An effect as options give it: "NAME", "NAME=AMPLITUDE" or "NAME=AMPLITUDE,SYMBOL=VALUE", in the effect's units.

    Raises:
        InputError: an unknown effect or symbol, or a value that is not a number.
    """
    name, _, rest = text.partition("=")
    found = effect_named(name.strip())
    given: dict[str, float] = {}
    for place, piece in enumerate(rest.split(",") if rest.strip() else ()):
        symbol, equals, value = piece.partition("=")
        if not equals:
            symbol, value = (found.amplitude.symbol, piece) if place == 0 else ("", piece)
        try:
            given[symbol.strip()] = float(value)
        except ValueError:
            unit = found.amplitude.unit
            raise InputError(
                f"--effect {text!r}: {value.strip()!r} is not a number; write {found.name}=VALUE ({unit})."
            ) from None
    return Injection(found, found.values(given))
