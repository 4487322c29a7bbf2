"""The list of effects, and how an option names one."""

from __future__ import annotations

from petkin.effects import clock, imaging, input, noise, tissue, vascular
from petkin.effects.effect import Effect, Injection
from petkin.errors import InputError

#: Every effect; a new one is a value in its stage's file, and an entry here.
EFFECTS: tuple[Effect, ...] = (
    input.ARTERIAL_DELAY,
    input.DISPERSION,
    input.PARENT_FRACTION,
    input.INPUT_SCALE,
    input.INPUT_PARTIAL_VOLUME,
    vascular.BLOOD_VOLUME_EFFECT,
    vascular.VASCULAR_TRAPPING,
    vascular.VASCULAR_RELEASE,
    tissue.SECOND_TISSUE,
    tissue.TISSUE_METABOLITE,
    tissue.TISSUE_HETEROGENEITY,
    tissue.TIME_VARYING_KINETICS,
    tissue.FLOW_CHANGE,
    tissue.SATURABLE_BINDING,
    imaging.PARTIAL_VOLUME,
    imaging.MOTION_STEP,
    imaging.MOTION_DRIFT,
    imaging.ATTENUATION_MISMATCH,
    imaging.SCATTER_BACKGROUND,
    imaging.RANDOMS_OFFSET,
    imaging.DEAD_TIME,
    imaging.GAIN_DRIFT,
    imaging.GAIN_STEP,
    clock.FRAME_OFFSET,
    clock.FRAME_DURATION,
    clock.MID_FRAME_SAMPLING,
    clock.HALF_LIFE_ERROR,
    clock.MEAN_LIFE_SWAP,
    clock.DECAY_APPLIED_TWICE,
    clock.DECAY_NOT_APPLIED,
    noise.NOISE_VARIANCE,
    noise.NONNEGATIVITY_BIAS,
)


def effect_named(name: str) -> Effect:
    """The effect of this name.

    Raises:
        InputError: there is none.
    """
    for known in EFFECTS:
        if known.name == name:
            return known
    raise InputError(f"There is no effect {name!r}; choose one of {', '.join(e.name for e in EFFECTS)}.")


def read_injection(text: str, *, imaged: bool = False) -> Injection:
    """An effect as options give it: "NAME", "NAME=AMPLITUDE" or "NAME=AMPLITUDE,SYMBOL=VALUE", in the effect's units.

    Args:
        text: the option.
        imaged: whether it goes into a picture, not into curves of regions.

    Raises:
        InputError: an unknown effect or symbol, or a value that is not a number.
    """
    name, _, rest = text.partition("=")
    effect = effect_named(name.strip())
    found = effect.imaged if imaged and effect.imaged is not None else effect
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
