"""How good predicted frames are: as curves, and as the pictures that they fill."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from petkin.hybrid import Dataset, Identifier, find_strategy, signal_to_noise

#: Shares of a 32 x 32 picture that five regions fill; the rest is background, which holds nothing.
SHARES = (0.099, 0.116, 0.029, 0.027, 0.010)


@torch.no_grad()
def predict(model: Identifier, measured: Dataset, k: int) -> tuple[Tensor, Tensor]:
    """States predicted for every series from k others of its tissue, and the c_p that they told."""
    was, _ = model.training, model.eval()
    said = model.encode(model.task.emission.observe(measured.states))
    found = find_strategy("meta")(said, k, model.aggregate)
    states = model.predict(found)
    model.train(was)
    return states, found.physics


def curve_errors(
    predicted: Float[Tensor, "M S T d"], clean: Float[Tensor, "M S T d"], shares: Sequence[float] = SHARES
) -> dict[str, float]:
    """Errors against what is true; tissues are the regions of one picture after another.

    Returns:
        mse_z: of C_T at the frames' ends, all regions alike.
        mse_x: of the picture, sum over regions of share x squared error.
        psnr_x: 10 log10(highest value^2 / mse_x) of every series of pictures, on average, dB.
    """
    squares = ((predicted - clean) ** 2)[..., :2].unflatten(0, (-1, len(shares)))
    frames = clean[..., 1].unflatten(0, (-1, len(shares)))
    weights = torch.tensor(shares)[:, None]
    pictures = (squares[..., 1].mean(dim=-1) * weights).sum(dim=1)
    peaks = frames.amax(dim=(1, 3))
    return {
        "mse_x": float(pictures.mean()),
        "mse_z": float(squares[..., 0].mean()),
        "psnr_x": float(signal_to_noise(pictures, peaks).mean()),
    }
