"""Training states on disk: safetensors (numbers and text alone), written whole or not at all; losses as CSV."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from petkin.errors import InputError

_CARD = "card"


def save_tensors(path: Path, tensors: Mapping[str, Tensor], card: Mapping[str, Any]) -> None:
    """Tensors by name, and a card of plain values that says what they are."""
    from safetensors.torch import save_file

    text = json.dumps(card, sort_keys=True, ensure_ascii=False)
    plain = {name: tensor.detach().contiguous().cpu() for name, tensor in tensors.items()}
    with _whole(path) as beside:
        save_file(plain, beside, {_CARD: text})


@contextmanager
def _whole(path: Path) -> Iterator[Path]:
    """A file to write beside `path`; it takes its place once it is complete, and is gone if it never was."""
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        yield beside
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


def load_tensors(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """What `save_tensors` wrote.

    Raises:
        InputError: there is no such file, or it is not one of these.
    """
    from safetensors import SafetensorError, safe_open

    if not path.is_file():
        raise InputError(f"{path}: no such checkpoint.")
    try:
        with safe_open(path, framework="pt") as file:
            card = json.loads((file.metadata() or {})[_CARD])
            return {name: file.get_tensor(name) for name in file.keys()}, card  # noqa: SIM118 (no mapping)
    except (SafetensorError, KeyError, ValueError) as failure:
        raise InputError(f"{path}: not a checkpoint of petkin ({failure}).") from failure


def load_model(path: Path, model: torch.nn.Module) -> dict[str, Any]:
    """The weights of a training's checkpoint into a model of the same form, set to be evaluated; returns the card."""
    tensors, card = load_tensors(path)
    model.load_state_dict(dict(below("best." if "best.lower" in tensors else "model.", tensors)))
    model.eval()
    return card


def below(prefix: str, tensors: Mapping[str, Tensor]) -> Iterator[tuple[str, Tensor]]:
    """Tensors whose name begins so, without it."""
    return ((name.removeprefix(prefix), value) for name, value in tensors.items() if name.startswith(prefix))


def optimiser_tensors(optimiser: torch.optim.Optimizer) -> dict[str, Tensor]:
    """Adam's memory by parameter number."""
    state = optimiser.state_dict()["state"]
    return {f"{index}.{name}": value for index, memory in state.items() for name, value in memory.items()}


def restore_optimiser(optimiser: torch.optim.Optimizer, tensors: Mapping[str, Tensor]) -> None:
    """The memory back into a fresh optimiser over the same parameters."""
    state: dict[int, dict[str, Tensor]] = {}
    for name, value in tensors.items():
        index, _, field = name.partition(".")
        state.setdefault(int(index), {})[field] = value
    optimiser.load_state_dict({**optimiser.state_dict(), "state": state})


def write_log(path: Path, losses: Sequence[float], checks: Sequence[tuple[int, float]]) -> None:
    """A CSV row a step: its loss and, where there was a check, the error on the validation dynamics."""
    found = dict(checks)
    with _whole(path) as beside, beside.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(("step", "loss", "validation"))
        rows.writerows((step, loss, found.get(step, "")) for step, loss in enumerate(losses, 1))
