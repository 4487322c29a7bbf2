"""Effects: named changes of one stage of the forward model each; `EFFECTS` is the list."""

from petkin.effects.catalogue import EFFECTS, effect_named, read_injection
from petkin.effects.course import Course
from petkin.effects.effect import Effect, Injection
from petkin.effects.forward_model import STAGES, Camera, ForwardModel, Tissue, Vessels
from petkin.effects.input import ARTERIAL_DELAY, DISPERSION
from petkin.effects.responses import Tabulated
from petkin.effects.tissue import SECOND_TISSUE
from petkin.effects.vascular import BLOOD_VOLUME_EFFECT

__all__ = [
    "ARTERIAL_DELAY",
    "BLOOD_VOLUME_EFFECT",
    "DISPERSION",
    "EFFECTS",
    "SECOND_TISSUE",
    "STAGES",
    "Camera",
    "Course",
    "Effect",
    "ForwardModel",
    "Injection",
    "Tabulated",
    "Tissue",
    "Vessels",
    "effect_named",
    "read_injection",
]
