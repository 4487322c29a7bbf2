"""Several processes that train one model, each with its share of a step's episodes (started by torchrun).

All draw the same episodes and hold the same weights; gradients are averaged, so a step does not depend on their number
beyond rounding.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import torch
import torch.distributed as dist

# Read before any group is joined: defaults of its functions hold, for good, the group that there is when it is read,
# else by the first optimizer, and a group that is held keeps its threads, which may abort the interpreter as it ends.
import torch.distributed.nn
from torch import Tensor


@contextmanager
def processes() -> Iterator[int]:
    """Join the processes that torchrun started, and say how many they are; 1 without it."""
    count = int(os.environ.get("WORLD_SIZE", "1"))
    if count == 1:
        yield 1
        return
    dist.init_process_group("gloo")
    try:
        yield count
        wait()
    finally:
        dist.destroy_process_group()


def device() -> str:
    """Where this process should train: its own GPU where there is one, else the processor."""
    return f"cuda:{os.environ.get('LOCAL_RANK', '0')}" if torch.cuda.is_available() else "cpu"


def place() -> tuple[int, int]:
    """Which of how many processes this is."""
    return (dist.get_rank(), dist.get_world_size()) if dist.is_initialized() else (0, 1)


def wait() -> None:
    """Until all processes are here."""
    if dist.is_initialized():
        dist.barrier()


def average(tensors: Iterable[Tensor]) -> None:
    """The mean over all processes, in place."""
    parts = list(tensors)
    if not dist.is_initialized() or not parts:
        return
    flat = torch.cat([part.reshape(-1).cpu() for part in parts])
    dist.all_reduce(flat)
    flat /= dist.get_world_size()
    for part, mean in zip(parts, flat.split([part.numel() for part in parts])):
        part.copy_(mean.view_as(part))
