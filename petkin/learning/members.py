"""Several trainings of one population: an ensemble, whose members differ by nothing but their seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from petkin.errors import InputError
from petkin.hybrid import load_tensors
from petkin.hybrid.checkpoint import below
from petkin.learning.flux import Reader, Scene
from petkin.learning.prior import TRIAL
from petkin.learning.tracer import HIGHEST, Measured, beyond, require_tracer, restored

#: What a card says that follows from the seed.
_OF_SEED = ("seed", "step", "highest", "version", TRIAL)


@dataclass(frozen=True)
class Members:
    """Checkpoints of `petkin train`, as read.

    Args:
        paths: where they came from.
        tensors, cards: what they hold.
    """

    paths: tuple[Path, ...]
    tensors: tuple[Mapping[str, Tensor], ...]
    cards: tuple[Mapping[str, Any], ...]

    def require(self, half_life: float) -> None:
        """Whether they can read a scan of this half-life (min).

        Raises:
            InputError: one is not of `petkin train`, not finished, or of another radionuclide.
        """
        for path, card in zip(self.paths, self.cards):
            require_tracer(path, card, half_life)

    def scene(self, scan: Measured) -> Scene:
        """Input and frames of a scan, made ready for all of them."""
        return Scene.of(scan.known, scan.scale, highest=HIGHEST)

    def readers(self, scene: Scene) -> list[Reader]:
        """Every member under a scan's input."""
        return [
            Reader(restored(tensors, card, scene.seen), restored(tensors, card, scene.stepped), scene)
            for tensors, card in zip(self.tensors, self.cards)
        ]

    def remarks(self, scan: Measured) -> tuple[str, ...]:
        """What of a scan lies outside of what they were learned from; of members that say alike, the first."""
        return tuple(f"Hybrid: {remark}" for remark in beyond(self.cards[0], scan))


def open_members(paths: Sequence[Path]) -> Members:
    """Read checkpoints.

    Raises:
        InputError: one is missing or something else, two are one training, or they were not trained alike.
    """
    read = [load_tensors(path) for path in paths]
    found = Members(tuple(paths), tuple(tensors for tensors, _ in read), tuple(card for _, card in read))
    first = found.cards[0]
    found.require(float(first.get("half_life_min", 1.0)))
    for i, (path, card) in enumerate(zip(found.paths, found.cards)):
        other = next((k for k in sorted({*card, *first} - {*_OF_SEED}) if card.get(k) != first.get(k)), None)
        if other is not None:
            raise InputError(
                f"{path}: trained otherwise than {found.paths[0]} ({other.replace('_', ' ')} is not the same); members "
                "of an ensemble differ by --seed of petkin train alone."
            )
        same = next((j for j in range(i) if _alike(found.tensors[i], found.tensors[j])), None)
        if same is not None:
            raise InputError(f"{path}: the same training as {found.paths[same]}; give petkin train another --seed.")
    return found


def _alike(one: Mapping[str, Tensor], two: Mapping[str, Tensor]) -> bool:
    first, second = dict(below("prior.", one)), dict(below("prior.", two))
    return first.keys() == second.keys() and all(torch.equal(first[name], second[name]) for name in first)
