"""How a run does on dynamics that it does not train on: the best of its end is kept, a plateau ends it.

While the learning rate is high a check says little (it may double and halve again), so neither counts before the last
part of the steps, where the rate is small.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from torch import Tensor, nn

#: Checks count from this share of the steps on; one is better by this share at least.
_LATE, _BETTER = 0.7, 0.01


@dataclass
class Validation:
    """The checks of a run.

    Args:
        steps: of the whole run.
        patience: checks without a better one after which a run ends; 0 for never.
        checks: (step, mean squared error of observations) so far.
        best: weights at the best check that counts.
    """

    steps: int
    patience: int
    checks: list[tuple[int, float]] = field(default_factory=list)
    best: dict[str, Tensor] = field(default_factory=dict)

    def see(self, step: int, error: float, model: nn.Module) -> None:
        """A check; the weights are kept where it is the best that counts."""
        late = self._late()
        self.checks.append((step, error))
        if step > _LATE * self.steps and error < min(late, default=math.inf):
            self.best = {name: value.clone() for name, value in model.state_dict().items()}

    @property
    def plateau(self) -> bool:
        """The last `patience` checks that count are no better than those before."""
        late = self._late()
        if not self.patience or len(late) <= self.patience:
            return False
        return min(late[-self.patience :]) > (1.0 - _BETTER) * min(late[: -self.patience])

    def _late(self) -> list[float]:
        return [error for step, error in self.checks if step > _LATE * self.steps]
