"""Quantiles and tails of F, against scipy's own distribution."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import f as fisher

from petkin.fitting.f_distribution import exceeded, quantile


@pytest.mark.parametrize(("numerator", "denominator"), [(1, 3), (1, 60), (2, 20), (11, 200)])
def test_is_the_f_distribution_for_any_value(numerator: int, denominator: int) -> None:
    for chance in (0.5, 0.683, 0.95):
        assert quantile(chance, numerator, denominator) == pytest.approx(
            fisher.ppf(chance, numerator, denominator), rel=1e-12
        )
    values = np.array([-1.0, -1e-17, 0.0, 0.3, 4.0, 1e6, np.inf, np.nan])
    np.testing.assert_allclose(
        exceeded(values, numerator, denominator), fisher.sf(values, numerator, denominator), rtol=1e-12, atol=1e-300
    )
