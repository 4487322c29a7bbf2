"""Noisy curves of a scan at once: the linear case in closed form, and beside the descent of a checkpoint."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from petkin.hybrid import load_tensors
from petkin.learning import conditions_of, identify_voxels
from petkin.learning.ensemble import Ensemble, draw_ensemble, posterior
from petkin.learning.quantities import REPORTED, late_plasma, quantities
from petkin.learning.tracer import LEVEL, restored

from .test_tracer import _HALF_LIFE, checkpoint, scan  # noqa: F401

_FRAMES = 24


def linear_population(seed: int = 0) -> tuple[Ensemble, torch.Tensor, torch.Tensor]:
    """Tissues whose curves, logarithms and correction are linear in three normal numbers."""
    generator = torch.Generator().manual_seed(seed)
    u = torch.randn(4096, 3, generator=generator, dtype=torch.float64)
    seen = torch.randn(3, 3, generator=generator, dtype=torch.float64) * 3.0
    told = torch.randn(3, 6, generator=generator, dtype=torch.float64) * 0.3
    told[:, 5] = 0.0
    directions = torch.linalg.qr(torch.randn(_FRAMES, 3, generator=generator, dtype=torch.float64)).Q
    nought = torch.zeros(_FRAMES, dtype=torch.float64)
    return Ensemble(nought + 1.0, nought, directions, u @ seen, u @ told + 0.5, 1e-9), seen, told


@pytest.mark.parametrize(("deviation", "rtol"), [(3.0, 0.05), (1.0, 0.05), (0.1, 0.03), (0.003, 0.03)])
def test_what_is_linear_is_told_as_by_bayes_rule(deviation, rtol):
    drawn, seen, told = linear_population()
    generator = torch.Generator().manual_seed(1)
    x = torch.randn(40, 3, generator=generator, dtype=torch.float64) @ seen
    x += deviation * torch.randn(x.shape, generator=generator, dtype=torch.float64)
    outside = torch.randn(40, _FRAMES, generator=generator, dtype=torch.float64)
    outside -= outside @ drawn.directions @ drawn.directions.T
    outside *= deviation * (_FRAMES - 3) ** 0.5 / outside.norm(dim=1, keepdim=True)
    values, errors, misfit = posterior(drawn, x @ drawn.directions.T + outside)

    gain = told.T @ seen @ torch.linalg.inv(seen.T @ seen + deviation**2 * torch.eye(3, dtype=torch.float64))
    mean = x @ gain.T + 0.5
    spread = (told.T @ told - gain @ seen.T @ told).diagonal().sqrt()
    assert torch.allclose(values[:, :4].log(), mean[:, :4], atol=float(0.35 * spread[:4].max()) + 1e-3)
    assert torch.allclose(values[:, 4], mean[:, 4], atol=float(0.35 * spread[4]) + 1e-3)
    torch.testing.assert_close(
        errors[:, :4].median(dim=0).values, 100.0 * spread[:4], rtol=0.15, atol=float(100 * rtol * spread.max())
    )
    assert bool((misfit >= deviation**2 * (_FRAMES - 3) / _FRAMES - 1e-9).all())


def test_where_most_that_look_alike_do_not_come_to_rest_there_is_no_volume():
    drawn, _, _ = linear_population()
    moving = drawn.quantities.clone()
    moving[:, 5] = (drawn.curves[:, 0] > 0).double()
    drawn = replace(drawn, quantities=moving)
    far = torch.tensor([[8.0, 0.0, 0.0], [-8.0, 0.0, 0.0]], dtype=torch.float64)
    noise = torch.zeros(2, _FRAMES, dtype=torch.float64)
    values, errors, _ = posterior(drawn, far @ drawn.directions.T + noise)
    assert torch.isnan(values[:, 3]).tolist() == [True, False]
    assert torch.isnan(errors[:, 3]).tolist() == [True, False]
    assert bool(torch.isfinite(values[:, :3]).all())


@pytest.mark.parametrize("percent", [10.0, 3.0])
def test_intervals_hold_the_truth_of_tissues_of_the_population(checkpoint: Path, percent: float):  # noqa: F811
    given, generator = scan(), torch.Generator().manual_seed(7)
    conditions = conditions_of([given])
    tensors, card = load_tensors(checkpoint)
    prior = restored(tensors, card, conditions)
    u = (
        prior.mean
        + torch.randn(400, len(prior.mean), generator=generator)
        @ torch.linalg.cholesky(torch.linalg.inv(prior.precision)).mT
    )
    amounts = torch.full((len(u), 1), given.scale)
    with torch.no_grad():
        curves = prior.predict(u, amounts)[..., 1]
        truth = quantities(prior, u, amounts, late_plasma(conditions, amounts))
    deviation = 0.01 * percent * LEVEL
    noisy = curves + deviation * torch.randn(curves.shape, generator=generator)
    drawn = replace(draw_ensemble(prior, conditions, given.scale, given.weights), least=1e-6)
    values, errors, misfit = posterior(drawn, noisy)
    for place in (0, 1, 2, 3):
        z = (values[:, place].log() - truth[:, place].log()) / (errors[:, place] / 100.0)
        z = z[torch.isfinite(z)]
        assert 0.83 < float((z.abs() < 1.645).double().mean()) < 0.96, REPORTED[place]
        assert abs(float(z.median())) < 0.25
    z = (values[:, 4] - truth[:, 4]) / (values[:, 4] * errors[:, 4] / 100.0)
    assert 0.83 < float((z.abs() < 1.645).double().mean()) < 0.96
    assert float(misfit.median()) == pytest.approx(deviation**2, rel=0.35)


def test_a_voxel_is_told_the_same_whatever_is_beside_it(checkpoint: Path):  # noqa: F811
    given = scan()
    noisy = given.values.repeat(300, 1)
    noisy += 0.1 * noisy * torch.randn(noisy.shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    level = float(noisy.mean())
    whole = identify_voxels(checkpoint, replace(given, values=noisy), half_life=_HALF_LIFE, level=level)
    part = identify_voxels(checkpoint, replace(given, values=noisy[:100]), half_life=_HALF_LIFE, level=level)
    torch.testing.assert_close(whole.quantities[:100], part.quantities, rtol=1e-4, atol=1e-5, equal_nan=True)
    spread = (whole.quantities[:, 0].log().unflatten(0, (300, 5)).std(dim=0) * 100.0).numpy()
    assert np.all(spread < 1.2 * whole.percent_se[:, 0].unflatten(0, (300, 5)).median(dim=0).values.numpy())
