"""Adam along the axes in which the gradients of a layer vary, not along those of its weights.

    L <- b L + (1 - b) G G^T,   R <- b R + (1 - b) G^T G,   L = Q_L D Q_L^T,   R = Q_R D' Q_R^T
    W <- W - rate Q_L Adam(Q_L^T G Q_R) Q_R^T

for the gradient G of a layer's weights as a matrix (out, rest). Encoders that must tell a state to a thousandth of its
range are badly conditioned: along these axes a third of the steps reach what Adam reaches along the weights' own.

Reference: Vyas N, Morwani D, Zhao R, Shapira I, Brandfonbrener D, Janson L, Kakade S. SOAP: improving and stabilizing
Shampoo using Adam. arXiv:2409.11321 (algorithm 3).
"""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor, nn

#: Memory of gradients, their squares and their axes, as in the reference.
_MEMORY = 0.95
#: A side of a layer with more numbers than this keeps its own axes: finding others would cost more than it gains.
_MOST = 400
#: Of a layer's usual gradient: what is smaller along an axis is rounding, and would be stepped like the rest.
_ROUNDING, _TINY = 1e-5, 1e-30


class TurnedAdam(torch.optim.Optimizer):
    """Adam along the axes of the gradients; biases, and single numbers, along their own.

    Args:
        parameters: what is trained.
        lr: learning rate, set anew by the training loop.
        every: steps between renewals of the axes.
    """

    def __init__(self, parameters: Iterable[nn.Parameter], lr: float, *, every: int = 10) -> None:
        super().__init__(parameters, {"lr": lr, "every": every})

    @torch.no_grad()
    def step(self, closure: None = None) -> None:  # type: ignore[override]
        """One step along the gradients. The first of all only looks for the axes."""
        for group in self.param_groups:
            for p in group["params"]:
                if p.grad is not None:
                    self._move(p, group["lr"], group["every"])

    def _move(self, p: nn.Parameter, rate: float, every: int) -> None:
        gradient, memory = p.grad.reshape(len(p), -1) if p.ndim else p.grad.reshape(1, 1), self.state[p]  # type: ignore[union-attr]
        if not memory:
            memory |= _started(gradient, turned=p.ndim > 1)
            return
        memory["step"] += 1
        memory["mean"].lerp_(gradient, 1.0 - _MEMORY)
        memory["square"].lerp_(_turn(memory, gradient).square(), 1.0 - _MEMORY)
        bias = 1.0 - _MEMORY ** float(memory["step"])
        least = _ROUNDING * memory["square"].mean().sqrt() + _TINY
        along = _turn(memory, memory["mean"]) / (memory["square"].sqrt() + least)
        p.sub_((rate * bias**-0.5) * _turn_back(memory, along).reshape(p.shape))
        _remember_axes(memory, gradient, renew=int(memory["step"]) % every == 0)


def _started(gradient: Tensor, *, turned: bool) -> dict[str, Tensor]:
    memory = {
        "step": torch.zeros(()),
        "mean": torch.zeros_like(gradient),
        "square": torch.zeros_like(gradient),
    }
    for side, product in (("left", gradient @ gradient.T), ("right", gradient.T @ gradient)):
        if turned and len(product) <= _MOST:
            memory[side] = (1.0 - _MEMORY) * product
            memory[f"{side}_axes"] = _axes(product)
    return memory


def _axes(product: Tensor) -> Tensor:
    """Eigenvectors, the largest first; in double precision, since these matrices have hardly any rank at the start."""
    scaled = product.double() / product.diagonal().max().clamp_min(_TINY)
    return torch.linalg.eigh(scaled)[1].flip(1).to(product)


def _turn(memory: dict[str, Tensor], x: Tensor) -> Tensor:
    """In the axes of the gradients."""
    x = memory["left_axes"].T @ x if "left_axes" in memory else x
    return x @ memory["right_axes"] if "right_axes" in memory else x


def _turn_back(memory: dict[str, Tensor], x: Tensor) -> Tensor:
    x = memory["left_axes"] @ x if "left_axes" in memory else x
    return x @ memory["right_axes"].T if "right_axes" in memory else x


def _remember_axes(memory: dict[str, Tensor], gradient: Tensor, *, renew: bool) -> None:
    """One power iteration at a renewal: the axes move slowly."""
    for side in ("left", "right"):
        if side not in memory:
            continue
        memory[side].lerp_(gradient @ gradient.T if side == "left" else gradient.T @ gradient, 1.0 - _MEMORY)
        if renew:
            memory[f"{side}_axes"] = torch.linalg.qr(memory[side] @ memory[f"{side}_axes"])[0]
