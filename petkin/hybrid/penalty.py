"""What keeps f_NN from saying what f_PHY could have said: a price on its size, and on its overlap with f_PHY.

References: Yin Y et al. APHYNITY, ICLR 2021, arXiv:2010.04456 (norm); Richter J, Kilbertus N, arXiv:2606.19145
(orthogonality).
"""

from __future__ import annotations

from torch import Tensor

from petkin.hybrid.model import Encoded, Identifier


def penalty(model: Identifier, found: Encoded, predicted: Tensor, *, norm: float, orthogonality: float) -> Tensor:
    """norm mean(f_NN^2) + orthogonality mean(f_PHY f_NN)^2 / (mean(f_PHY^2) mean(f_NN^2)) along predictions."""
    task, none = model.task, predicted.new_zeros(())
    if task.residual is None or task.known is None or not (norm or orthogonality):
        return none
    learned = model.residual(found.code, predicted, found.physics)
    price = norm * learned.square().mean()
    if orthogonality:
        seen = found.physics[..., None, :].expand(*predicted.shape[:-1], -1)
        known, added = task.known(none, predicted, None, seen), task.residual.acts(learned, predicted)
        overlap = (known * added).mean() ** 2 / (known.square().mean() * added.square().mean() + 1e-12)
        price = price + orthogonality * overlap
    return price
