"""VT of a learned tissue without a residual is K1 / k2."""

from __future__ import annotations

import torch

from petkin.learning import PAPER, TissuePrior, tissue_task
from petkin.learning.quantities import volume
from petkin.learning.tracer import BOUNDS

from .test_tissue import SHORT


def test_without_a_correction_it_is_k1_over_k2():
    prior = TissuePrior(tissue_task("meta_hylad", SHORT.conditions, {**BOUNDS, "k2": (0.05, 0.2)}))
    assert prior.hyper is not None
    last = prior.hyper.layers[-1]
    with torch.no_grad():
        for parameter in prior.hyper.parameters():
            parameter.zero_()
        last.bias.zero_()  # type: ignore[union-attr]
        u = torch.zeros(2, prior.mean.shape[0])
        u[1, :2] = torch.tensor([1.0, -1.0])
        physics = prior.physics(u)
        ratio, rests = volume(prior, u, torch.tensor([5.0, 9.0]))
    assert bool(rests.all())
    torch.testing.assert_close(ratio, physics[:, 0] / physics[:, 1], rtol=1e-4, atol=0.0)
    assert PAPER.model.rates == 4
