"""What may be withheld: effects of the product's catalogue, the same in another form, and causes in no catalogue.

Written from the words of the effects' table, not from the product's code. A cause's size is scaled to a detectability;
what differs between scans besides, it draws for itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from petkin_bench.withheld.changes import (
    MEAN_LIFE,
    Build,
    Draw,
    blood,
    clipped,
    corrected,
    course,
    delayed,
    dispersed,
    dispersed_twice,
    from_next,
    from_others,
    hot,
    later,
    leaked,
    metabolised,
    metabolised_exponential,
    metabolised_power,
    misread,
    more_metabolites,
    one_frame,
    passed,
    plateau_course,
    ramp_course,
    released,
    scanner,
    second_bolus,
    shapes,
    sooner_metabolised,
    step_course,
    trapped,
    triangle_course,
    trickle,
    wave_course,
    wrong_half_life,
)
from petkin_bench.withheld.observe import Change, Clock
from petkin_bench.withheld.subject import Subject


@dataclass(frozen=True)
class Cause:
    """One cause.

    Args:
        name: in the catalogue's words; "" where it has none.
        stage: of the chain.
        build: the change.
        most: size beyond which it would not be plausible; a flag has none.
        onset, local, framed: whether it sets in at a time, acts in one region, concerns one frame.
        flag: there or not.
    """

    name: str
    stage: str
    build: Build
    most: float
    onset: bool = False
    local: bool = False
    framed: bool = False
    flag: bool = False


def draw(rng: np.random.Generator, subject: Subject) -> Draw:
    """Everything but the size; onsets lie after the bolus and before the last fifth of the scan."""
    end, regions = float(subject.frames.end[-1]), len(subject.rates)
    return Draw(
        onset=rng.uniform(0.12, 0.8) * end,
        region=int(rng.integers(regions)),
        frame=int(rng.integers(6, subject.frames.start.size - 2)),
        sign=float(rng.choice([-1.0, 1.0])),
        length=rng.uniform(5.0, 15.0),
        weights=rng.standard_normal(regions),
    )


#: As the catalogue words it.
KNOWN: tuple[Cause, ...] = (
    Cause("arterial_delay", "input", blood(delayed), 60.0),
    Cause("dispersion", "input", blood(dispersed), 15.0),
    Cause("parent_fraction", "input", blood(metabolised(2.0)), 0.9),
    Cause("vascular_trapping", "vascular", trapped(0.0), 1.5),
    Cause("tissue_metabolite", "tissue", leaked(0.0), 1.0),
    Cause("tissue_heterogeneity", "tissue", lambda s, d: Change(spread=((0.5, 1 + s), (0.5, 1 - s))), 0.85),
    Cause("time_varying_kinetics", "tissue", course(released, 1, local=True), 3.0, onset=True, local=True),
    Cause("flow_change", "tissue", course(step_course, 0, 1), 0.7, onset=True),
    Cause("saturable_binding", "tissue", lambda s, d: Change(filling=(s, False)), 0.95),
    Cause(
        "partial_volume",
        "imaging",
        scanner(lambda x, f, s, d: x + s * d.chosen * (from_others(x) - x)),
        0.4,
        local=True,
    ),
    Cause(
        "motion_step",
        "imaging",
        scanner(lambda x, f, s, d: x + s * d.chosen * later(f, d.onset) * (from_others(x) - x)),
        0.4,
        onset=True,
        local=True,
    ),
    Cause(
        "motion_drift",
        "imaging",
        scanner(lambda x, f, s, d: x + s * d.chosen * passed(f) * (from_others(x) - x)),
        0.4,
        local=True,
    ),
    Cause(
        "attenuation_mismatch",
        "imaging",
        scanner(lambda x, f, s, d: x * (1 + d.sign * s * d.chosen * later(f, d.onset))),
        0.4,
        onset=True,
        local=True,
    ),
    Cause("scatter_background", "imaging", scanner(lambda x, f, s, d: x + s * x.mean(axis=0)), 0.25),
    Cause(
        "randoms_offset",
        "imaging",
        scanner(lambda x, f, s, d: x + d.sign * s * x.mean(axis=0).max() * np.exp(f.decay * (f.mid - f.end[-1]))),
        0.08,
    ),
    Cause("dead_time", "imaging", scanner(lambda x, f, s, d: x * (1 - s * hot(x, f))), 0.4),
    Cause("gain_drift", "imaging", scanner(lambda x, f, s, d: x * (1 + d.sign * s * passed(f))), 0.1),
    Cause(
        "gain_step", "imaging", scanner(lambda x, f, s, d: x * (1 + d.sign * s * later(f, d.onset))), 0.2, onset=True
    ),
    Cause("frame_offset", "clock", lambda s, d: Change(clock=Clock(late=s / 60.0)), 30.0),
    Cause("frame_duration", "clock", scanner(one_frame), 0.8, framed=True),
    Cause("half_life_error", "clock", corrected(0.0), 0.1),
    Cause("mean_life_swap", "clock", corrected(MEAN_LIFE), 1.0, flag=True),
    Cause("decay_applied_twice", "clock", corrected(1.0), 1.0, flag=True),
    Cause("decay_not_applied", "clock", corrected(-1.0), 1.0, flag=True),
    Cause("nonnegativity_bias", "noise", scanner(lambda x, f, s, d: clipped(x, f, s)), 0.3),
)

#: The same effects in another mathematical form: seen in training, and kept for the score.
OTHER_FORMS: dict[str, tuple[Cause, ...]] = {
    "training": (
        Cause("parent_fraction", "input", blood(metabolised(1.3)), 0.9),
        Cause("parent_fraction", "input", blood(metabolised_power), 0.9),
        Cause("time_varying_kinetics", "tissue", course(triangle_course, 1, local=True), 3.0, onset=True, local=True),
        Cause(
            "gain_step",
            "imaging",
            scanner(lambda x, f, s, d: x * (1 + d.sign * s * later(f, d.onset, 1.0))),
            0.2,
            onset=True,
        ),
        Cause("gain_drift", "imaging", scanner(lambda x, f, s, d: x * (1 + d.sign * s * passed(f) ** 2)), 0.1),
        Cause(
            "motion_step",
            "imaging",
            scanner(lambda x, f, s, d: x + s * later(f, d.onset) * (from_others(x) - x)),
            0.4,
            onset=True,
        ),
        Cause("vascular_trapping", "vascular", trapped(0.01), 1.5),
    ),
    "scored": (
        Cause("dispersion", "input", blood(dispersed_twice), 20.0),
        Cause("parent_fraction", "input", blood(metabolised_exponential), 0.9),
        Cause("parent_fraction", "input", blood(more_metabolites), 0.6),
        Cause("parent_fraction", "input", blood(sooner_metabolised), 1.0),
        Cause("tissue_metabolite", "tissue", leaked(4.0), 1.0),
        Cause(
            "tissue_heterogeneity",
            "tissue",
            lambda s, d: Change(spread=((0.25, 1 - s), (0.5, 1.0), (0.25, 1 + s))),
            0.85,
        ),
        Cause("time_varying_kinetics", "tissue", course(plateau_course, 1, local=True), 3.0, onset=True, local=True),
        Cause("flow_change", "tissue", course(ramp_course, 0, 1), 0.7, onset=True),
        Cause("saturable_binding", "tissue", lambda s, d: Change(filling=(s, True)), 3.0),
        Cause(
            "motion_step",
            "imaging",
            scanner(lambda x, f, s, d: x + s * d.chosen * later(f, d.onset) * (from_next(x) - x)),
            0.4,
            onset=True,
            local=True,
        ),
        Cause(
            "attenuation_mismatch",
            "imaging",
            scanner(lambda x, f, s, d: x * np.exp(d.sign * s * d.chosen * later(f, d.onset, 0.7))),
            0.4,
            onset=True,
            local=True,
        ),
        Cause("dead_time", "imaging", scanner(lambda x, f, s, d: x * np.exp(-s * hot(x, f) ** 2)), 0.4),
        Cause(
            "gain_drift",
            "imaging",
            scanner(lambda x, f, s, d: x * (1 + d.sign * s * (1 - np.exp(-3 * passed(f))))),
            0.1,
        ),
        Cause(
            "gain_step",
            "imaging",
            scanner(lambda x, f, s, d: x * (1 + d.sign * s * later(f, d.onset, 0.7))),
            0.2,
            onset=True,
        ),
        Cause("half_life_error", "clock", scanner(wrong_half_life(0.0)), 0.1),
        Cause("mean_life_swap", "clock", scanner(wrong_half_life(MEAN_LIFE)), 1.0, flag=True),
        Cause("decay_applied_twice", "clock", scanner(wrong_half_life(1.0)), 1.0, flag=True),
    ),
}


#: Causes that no entry of the catalogue is: seen in training, and kept for the score.
UNKNOWN: dict[str, tuple[Cause, ...]] = {
    "training": (
        Cause(
            "", "imaging", scanner(lambda x, f, s, d: x * (1 + s * np.sin(2.2 * np.sqrt(f.mid) + d.weights[0]))), 0.6
        ),
        Cause(
            "",
            "imaging",
            scanner(lambda x, f, s, d: x * (1 + s * d.chosen * np.exp(-0.5 * ((f.mid - d.onset) / d.length) ** 2))),
            0.6,
        ),
        Cause("", "imaging", scanner(lambda x, f, s, d: x * np.maximum(x / x.max(), 0.01) ** (d.sign * s)), 0.5),
        Cause("", "tissue", course(wave_course, 0), 0.9),
        Cause("", "tissue", course(step_course, 3), 0.95),
        Cause("", "input", blood(trickle), 0.1),
        Cause("", "input", blood(misread), 2.0),
    ),
    "scored": (
        Cause("", "input", blood(second_bolus), 0.5),
        Cause("", "tissue", lambda s, d: Change(trapped=s), 0.2),
        Cause("", "tissue", course(wave_course, 2, local=False), 0.95),
        Cause("", "imaging", scanner(shapes), 0.4),
        Cause(
            "",
            "imaging",
            scanner(
                lambda x, f, s, d: (
                    x * (1 + s * np.sign(d.weights)[:, None] * np.sin(2 * np.pi * f.mid / (2.5 * d.length)))
                )
            ),
            0.5,
        ),
        Cause(
            "",
            "imaging",
            scanner(lambda x, f, s, d: x * (1 + s * np.exp(-0.5 * ((f.mid - d.onset) / d.length) ** 2))),
            0.5,
        ),
    ),
}
