"""What docs/learning.md shows runs as it stands, and finds what it says."""

from __future__ import annotations

import re
from pathlib import Path

import torch

from petkin.hybrid import find_strategy, measure

_TEXT = (Path(__file__).parents[2] / "docs" / "learning.md").read_text()


def test_ones_own_equations_are_identified(capsys):
    blocks = re.findall(r"```python\n(.*?)```", _TEXT, flags=re.DOTALL)
    shown: dict = {}
    exec("\n".join(blocks), shown)
    unseen, found = shown["unseen"], measure(shown["model"], shown["unseen"], find_strategy("meta"), 5, physics=(0,))
    assert found["mse_z"] < 0.1 * float(unseen.states.var())
    assert found["mse_f"] < 0.3 * float(shown["task"].missing(unseen.states, unseen.truth[:, None, None]).var())
    better, truth = shown["better"], unseen.truth[:, None, :1]
    assert bool((better.after <= better.before).all())
    assert float((better.found.physics - truth).square().mean()) < 0.002
    spread = shown["bars"](shown["context_features"](shown["model"], shown["said"], 5))
    with torch.no_grad():
        inside = (find_strategy("meta")(shown["said"], 5).physics - truth).abs() < 1.645 * spread.physics
    assert float(inside.float().mean()) > 0.75
