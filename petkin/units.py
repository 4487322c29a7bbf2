"""Constants and conversions. Inside petkin: minutes, kBq/mL, K1 in mL/cm3/min, rate constants in 1/min."""

import math

from petkin.errors import InputError

SECONDS_PER_MINUTE = 60.0

#: Activity concentration units met in files, as factors to kBq/mL. 1 Ci = 3.7e10 Bq (exact by definition).
KBQ_PER_ML = {
    "Bq/mL": 1e-3,
    "Bq/ml": 1e-3,
    "BQML": 1e-3,
    "Bq/cc": 1e-3,
    "kBq/mL": 1.0,
    "kBq/ml": 1.0,
    "kBq/cc": 1.0,
    "MBq/mL": 1e3,
    "nCi/mL": 0.037,
    "nCi/cc": 0.037,
    "uCi/mL": 37.0,
    "uCi/cc": 37.0,
}


def minutes(seconds: float) -> float:
    """Seconds to minutes."""
    return seconds / SECONDS_PER_MINUTE


def kbq_per_ml_factor(unit: str, *, where: str) -> float:
    """Factor that takes an activity concentration in `unit` to kBq/mL.

    Args:
        unit: unit as the file spells it, e.g. "Bq/mL".
        where: file and field, for the message.

    Raises:
        InputError: the unit is not one of `KBQ_PER_ML`.
    """
    factor = KBQ_PER_ML.get(unit.strip())
    if factor is None:
        raise InputError(
            f"{where}: unit {unit!r} is not an activity concentration; use one of {', '.join(KBQ_PER_ML)}."
        )
    return factor


def decay_constant(half_life_min: float) -> float:
    """lambda = ln 2 / T_half, in 1/min; an infinite half-life gives 0 (a stable or decay-free curve)."""
    return math.log(2.0) / half_life_min
