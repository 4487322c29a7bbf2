"""A laboratory that samples blood whose truth is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

_Array = NDArray[np.float64]

#: Manual samples (min) as in common 90 min protocols.
BLOOD_TIMES = np.array([1, 2, 3, 4, 5, 6, 7, 8, 9, 10.5, 15, 20, 30, 40, 50, 60, 75, 90.0])
FRACTION_TIMES = np.array([1, 3, 5, 10, 20, 40, 60, 90.0])


@dataclass(frozen=True)
class Laboratory:
    """Total plasma: a bolus at 0.5 min with a tail; Hill parent fraction; plasma over blood rises from 1.1 to 1.5."""

    dispersion: float = 2.6 / 60

    def total_plasma(self, t: _Array) -> _Array:
        s = np.maximum(t - 0.5, 0.0)
        return (900 * s - 45) * np.exp(-4.2 * s) + 27 * np.exp(-0.3 * s) + 18 * np.exp(-0.003 * s)

    def fraction(self, t: _Array) -> _Array:
        return 0.06 + 0.94 / (1 + (t / 9.0) ** 2.2)

    def plasma(self, t: _Array) -> _Array:
        return self.total_plasma(t) * self.fraction(t)

    def whole_blood(self, t: _Array) -> _Array:
        return self.total_plasma(t) / (1.5 - 0.4 * np.exp(-t / 12))

    def area(self, curve, until: float, start: float = 0.0) -> float:
        t = np.arange(start, until + 1e-9, 1e-3)
        return float(np.trapezoid(curve(t), t))

    def dispersed_blood(self, t: _Array) -> _Array:
        """dy/dt = (C_B - y)/tau by scipy, independent of the responses in petkin."""
        solution = solve_ivp(
            lambda s, y: (self.whole_blood(np.array([s]))[0] - y) / self.dispersion,
            (0.0, t[-1]),
            [0.0],
            t_eval=t,
            rtol=1e-8,
            atol=1e-8,
            max_step=0.05,
        )
        return solution.y[0]

    def manual(self, noise: float = 0.0, seed: int = 0) -> pd.DataFrame:
        rng = np.random.default_rng(seed)
        times = np.union1d(BLOOD_TIMES, FRACTION_TIMES)
        table = pd.DataFrame(
            {
                "time": times,
                "whole_blood_radioactivity": self.whole_blood(times) * (1 + noise * rng.standard_normal(times.size)),
                "plasma_radioactivity": self.total_plasma(times) * (1 + noise * rng.standard_normal(times.size)),
                "metabolite_parent_fraction": self.fraction(times)
                * (1 + 0.5 * noise * rng.standard_normal(times.size)),
            }
        )
        table.loc[~table.time.isin(FRACTION_TIMES), "metabolite_parent_fraction"] = np.nan
        return table

    def automatic(self, noise: float = 0.0, seed: int = 0, until: float = 10.0) -> pd.DataFrame:
        rng = np.random.default_rng(seed + 1000)
        times = np.arange(1, 60 * until + 0.5) / 60
        blood = self.dispersed_blood(times)
        scatter = noise * np.sqrt(np.maximum(blood, 0.1) * 10) * rng.standard_normal(times.size)
        return pd.DataFrame({"time": times, "whole_blood_radioactivity": blood + scatter})


@pytest.fixture(scope="session")
def laboratory() -> Laboratory:
    return Laboratory()
