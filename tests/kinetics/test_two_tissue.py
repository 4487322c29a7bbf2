"""The two-tissue models against their limits and against 50-digit arithmetic."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
import torch

from petkin.dynamics import ExponentialSum
from petkin.kinetics import ONE_TISSUE, TWO_TISSUE, TWO_TISSUE_TRAPPING

TERMS = [(851.1225, -4.133859, 1), (-42.6911, -4.133859, 0), (21.8798, -0.1190996, 0), (20.8113, -0.01043449, 0)]
BOLUS = ExponentialSum(
    torch.tensor([c for c, _, _ in TERMS], dtype=torch.float64),
    torch.tensor([e for _, e, _ in TERMS], dtype=torch.float64),
    tuple(n for _, _, n in TERMS),
    0.735,
)
TIMES = torch.tensor([0.8, 2.0, 20.0, 90.0], dtype=torch.float64)


def tissue(model, *parameters: float) -> np.ndarray:
    return model.tissue(torch.tensor([*parameters, 0.05], dtype=torch.float64), BOLUS, TIMES).numpy()


def exact(K1, k2, k3, k4, t):
    """C_1 + C_2 from the exponential of state and input modes together, in 50 digits."""
    with mpmath.workdps(50):
        K1, k2, k3, k4 = (mpmath.mpf(v) for v in (K1, k2, k3, k4))
        M = mpmath.zeros(6, 6)
        M[0, 0], M[0, 1], M[1, 0], M[1, 1], M[2, 3] = -(k2 + k3), k4, k3, -k4, 1
        for j, (c, rate, _) in enumerate(TERMS):
            M[0, 2 + j], M[2 + j, 2 + j] = K1 * mpmath.mpf(c), mpmath.mpf(rate)
        state = mpmath.expm(M * (mpmath.mpf(t) - mpmath.mpf(0.735))) * mpmath.matrix([0, 0, 0, 1, 1, 1])
        return state[0] + state[1]


@pytest.mark.parametrize(
    "rates",
    [
        (0.1, 0.13, 0.05, 0.02),
        (0.1, 0.1, 0.0, 0.1),
        (0.1, 0.1, 1e-17, 0.1),
        (0.1, 0.1, 1e-13, 0.1 + 1e-13),
        (0.1, 0.1, 0.0, 0.1 + 1e-10),
        (0.1, 4.133859, 0.0, 4.133859),
        (0.1, 0.1190996, 1e-12, 0.1190996),
        (0.1, 0.01043449, 0.0, 0.01043449),
        (0.1, 5.0, 5.0, 5.0),
        (0.1, 1e-6, 1e-6, 1e-6),
        (0.1, 3.0, 1e-3, 1e-3),
    ],
)
def test_fifty_digits_agree_where_rates_meet_each_other_and_the_poles_of_the_input(rates):
    expected = [float(exact(*rates, float(t))) for t in TIMES]
    np.testing.assert_allclose(tissue(TWO_TISSUE, *rates), expected, rtol=1e-12)


def test_without_k3_the_second_compartment_stays_empty():
    for k4 in (0.0, 0.02, 0.1, 0.3):
        np.testing.assert_allclose(tissue(TWO_TISSUE, 0.1, 0.1, 0.0, k4), tissue(ONE_TISSUE, 0.1, 0.1), rtol=1e-12)
    np.testing.assert_allclose(tissue(TWO_TISSUE_TRAPPING, 0.1, 0.1, 0.0), tissue(ONE_TISSUE, 0.1, 0.1), rtol=1e-12)


def test_without_k4_the_second_compartment_traps():
    for k2, k3 in ((0.1, 0.05), (0.01, 1.0), (1.0, 1e-4)):
        reversible, trapping = tissue(TWO_TISSUE, 0.1, k2, k3, 0.0), tissue(TWO_TISSUE_TRAPPING, 0.1, k2, k3)
        np.testing.assert_allclose(reversible, trapping, rtol=1e-11)


def test_without_k2_nothing_leaves():
    delivered = 0.1 * BOLUS.integral(TIMES).numpy()
    np.testing.assert_allclose(tissue(TWO_TISSUE_TRAPPING, 0.1, 0.0, 0.05), delivered, rtol=1e-12)
    np.testing.assert_allclose(tissue(TWO_TISSUE_TRAPPING, 0.1, 0.0, 0.0), delivered, rtol=1e-12)
    np.testing.assert_allclose(tissue(TWO_TISSUE, 0.1, 0.0, 0.05, 0.02), delivered, rtol=1e-12)


def test_gradient_by_k3_where_both_rates_meet():
    """It was 3e8 times too large: the amplitudes' sum carried their rounding into 1/(a1 - a2)^2."""
    p = torch.tensor([0.1, 0.1, 0.0, 0.1, 0.05], dtype=torch.float64, requires_grad=True)
    (gradient,) = torch.autograd.grad(TWO_TISSUE.tissue(p, BOLUS, TIMES)[2], p)
    with mpmath.workdps(50):
        step = mpmath.mpf("1e-15")
        slope = (exact(0.1, 0.1, step, 0.1, 20.0) - exact(0.1, 0.1, 0.0, 0.1, 20.0)) / step
    assert float(gradient[2]) == pytest.approx(float(slope), rel=1e-6)


def test_macro_parameters_by_hand():
    # K1 .12, k2 .12, k3 .06, k4 .03: VND = 1, BPND = 2, VT = 3, Ki = .12 .06/.18 = .04
    p = torch.tensor([0.12, 0.12, 0.06, 0.03, 0.05], dtype=torch.float64)
    macro = {k: float(v) for k, v in TWO_TISSUE.macro(p).items()}
    assert macro == pytest.approx({"VT": 3.0, "VND": 1.0, "BPND": 2.0, "Ki": 0.04})
    macro = {k: float(v) for k, v in TWO_TISSUE_TRAPPING.macro(p[[0, 1, 2, 4]]).items()}
    assert macro == pytest.approx({"Ki": 0.04, "VND": 1.0})
    assert float(ONE_TISSUE.macro(p[[0, 1, 4]])["VT"]) == pytest.approx(1.0)
