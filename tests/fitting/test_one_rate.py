"""One free rate beside shared columns: every kind against a fine grid of ordinary least squares."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear, minimize_scalar

from petkin.fitting.one_rate import COST, STEPS, U1, X0, X1, X2, one_rate_tables, search_in_frames, search_one_rate
from petkin.fitting.projection import project_curves
from petkin.fitting.scan import SIGNED, SINGLE, TRAPPED
from petkin.fitting.table import RATE_OFFSET, build_table, compress
from petkin_bench.problems import fit_problem

from .fitting_problems import ARTERIAL, FRAMES, PLAIN, basis_averages, blood_averages, counting_sd

KINDS = pytest.mark.parametrize("kind", [SINGLE, TRAPPED, SIGNED], ids=["single", "trapped", "signed"])
SLOWEST, FASTEST = 0.0, 5.0
AMPLITUDES = {SINGLE: (0.05, 0.12), TRAPPED: (0.05, 0.1, 0.02), SIGNED: (1.2, -0.08)}
WEIGHTS = FRAMES.duration / (1.0 + blood_averages())


def columns(rate: float, kind: int) -> np.ndarray:
    """The design (K, 2 or 3) at a rate, without petkin."""
    rates = [rate, 0.0] if kind == TRAPPED else [rate]
    return np.vstack([blood_averages(), basis_averages(np.array(rates))]).T


def curves(kind: int, count: int, noise: float) -> np.ndarray:
    rng = np.random.default_rng(7)
    rates = rng.uniform(0.02, 0.6, count)
    clean = np.stack([columns(a, kind) @ AMPLITUDES[kind] for a in rates])
    return clean + noise * counting_sd(np.abs(clean), 0.1) * rng.standard_normal(clean.shape)


def found(kind: int, data: np.ndarray, nodes: int = 160) -> np.ndarray:
    packed = compress(build_table(ARTERIAL, PLAIN, rate_bounds=(SLOWEST, FASTEST), nodes=nodes), WEIGHTS)
    z, sizes, *_ = project_curves(packed, WEIGHTS, np.ascontiguousarray(data.T), 0, len(data))
    return search_one_rate(one_rate_tables(packed, kind), z, sizes)


def least_cost(kind: int, curve: np.ndarray) -> float:
    """Bounded linear least squares at 400 rates, the best two minima refined by Brent's method."""
    root = np.sqrt(WEIGHTS)
    bounds = (-np.inf, np.inf) if kind == SIGNED else (0.0, np.inf)

    def cost(u: float) -> float:
        design = columns(max(float(np.exp(u)) - RATE_OFFSET, 0.0), kind) * root[:, None]
        return 2.0 * lsq_linear(design, curve * root, bounds).cost

    grid = np.linspace(np.log(RATE_OFFSET), np.log(FASTEST + RATE_OFFSET), 120)
    costs = np.array([cost(u) for u in grid])
    low = np.flatnonzero(costs == np.array([costs[max(i - 1, 0) : i + 2].min() for i in range(len(grid))]))
    ends = [costs.min()]
    for i in low[np.argsort(costs[low])[:2]]:
        inside = (grid[max(i - 1, 0)], grid[min(i + 1, len(grid) - 1)])
        ends.append(minimize_scalar(cost, bounds=inside, method="bounded", options={"xatol": 1e-7}).fun)
    return float(min(ends))


@KINDS
def test_noisy_curves_reach_the_least_cost(kind):
    data = curves(kind, 24, noise=1.0)
    answer = found(kind, data)
    least = np.array([least_cost(kind, curve) for curve in data])
    np.testing.assert_allclose(answer[COST], least, rtol=1e-5)
    quick = found(kind, data, nodes=80)
    np.testing.assert_allclose(quick[COST], least, rtol=1e-4)


@KINDS
def test_clean_curves_give_back_rate_and_amplitudes(kind):
    data = curves(kind, 200, noise=0.0)
    answer = found(kind, data)
    rates = np.random.default_rng(7).uniform(0.02, 0.6, 200)
    np.testing.assert_allclose(np.exp(answer[U1]) - RATE_OFFSET, rates, rtol=1e-4)
    for row, value in zip((X0, X1, X2), AMPLITUDES[kind]):
        np.testing.assert_allclose(answer[row], value, rtol=1e-4)
    assert answer[STEPS].max() < 20


@KINDS
def test_neighbours_do_not_change_a_bit(kind):
    data = curves(kind, 150, noise=2.0)
    together = found(kind, data)
    for part in (slice(0, 1), slice(37, 38), slice(60, 131)):
        assert found(kind, data[part]).tobytes() == together[:, part].tobytes()


@pytest.mark.parametrize("kind", [SINGLE, TRAPPED], ids=["single", "trapped"])
def test_amplitudes_that_would_be_negative_are_zero(kind):
    blood = blood_averages()
    data = np.stack([0.3 * blood, -blood, columns(0.1, kind) @ np.array([-0.05, 0.2, 0.0][: 2 + (kind == TRAPPED)])])
    answer = found(kind, data)
    assert (answer[[X0, X1, X2]] >= 0.0).all()
    assert answer[X0, 0] == pytest.approx(0.3, rel=1e-6)
    assert answer[X1, 0] == pytest.approx(0.0, abs=1e-6)
    assert (answer[[X0, X1, X2], 1] == 0.0).all()
    assert answer[X0, 2] == 0.0
    np.testing.assert_allclose(answer[COST, 2], least_cost(kind, data[2]), rtol=1e-5)


def test_without_the_axis_one_exponential_stands_alone():
    packed = compress(build_table(ARTERIAL, PLAIN, rate_bounds=(SLOWEST, FASTEST), nodes=160), WEIGHTS)
    data = 0.2 * basis_averages(np.array([0.07]))
    z, sizes, *_ = project_curves(packed, WEIGHTS, np.ascontiguousarray(data.T), 0, 1)
    answer = search_one_rate(one_rate_tables(packed, SINGLE, axis=False), z, sizes)
    assert np.exp(answer[U1, 0]) - RATE_OFFSET == pytest.approx(0.07, rel=1e-5)
    assert answer[X1, 0] == pytest.approx(0.2, rel=1e-5)
    assert answer[X0, 0] == 0.0


def test_without_the_axis_the_first_look_leaves_it_out() -> None:
    """Three in two hundred curves ended far from their best rate when the scan counted blood that took no part."""
    problem = fit_problem(voxels=2000, model="2TCM3k")
    table = build_table(problem.arterial, problem.observation, rate_bounds=(0.0, 5.0), nodes=80)
    packed = compress(table, problem.weights, size=16)
    frames = np.ascontiguousarray((problem.curves - 0.05 * table.blood).T)
    z, sizes, *_ = project_curves(packed, problem.weights, frames, 0, frames.shape[1])
    cost = search_one_rate(one_rate_tables(packed, TRAPPED, axis=False), z, sizes)[COST]
    b, trapped = packed.basis[1:], packed.basis[0]
    g, near, held = (b * b).sum(axis=1)[:, None], (b @ trapped)[:, None], trapped @ trapped
    along, kept = b @ z, trapped @ z
    x, y = (along * held - kept * near) / (g * held - near**2), (kept * g - along * near) / (g * held - near**2)
    explained = np.where((x >= 0) & (y >= 0), along * x + kept * y, np.maximum(along, 0.0) ** 2 / g)
    assert (cost <= (sizes - explained.max(axis=0)) * (1.0 + 1e-6)).all()


@pytest.mark.parametrize("kind", [SINGLE, TRAPPED], ids=["single", "trapped"])
def test_frames_and_coordinates_give_the_same(kind):
    """Blood that is known is taken off, for a number of curves that fills no block."""
    data = curves(kind, 70, noise=1.0)
    packed = compress(build_table(ARTERIAL, PLAIN, rate_bounds=(SLOWEST, FASTEST), nodes=80), WEIGHTS, size=16)
    frames, off = np.ascontiguousarray(data.T), 0.03 * packed.blood
    tables = one_rate_tables(packed, kind, axis=False)
    z, sizes, *flags = project_curves(packed, WEIGHTS, frames, 0, 70)
    sizes, z[0] = sizes - off * (2.0 * z[0] - off), z[0] - off
    answer, left, *seen = search_in_frames(tables, packed, WEIGHTS, frames, slice(0, 70), off=off)
    np.testing.assert_allclose(left, sizes, rtol=1e-12)
    np.testing.assert_allclose(answer, search_one_rate(tables, z, sizes), rtol=1e-9)
    assert all((a == b).all() for a, b in zip(seen, flags))
