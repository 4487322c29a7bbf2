"""Arrays have the shapes that annotations give them, on a tour of the commands and of the rooms below them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

import petkin

from .array_shapes import Tally, watched

_HERE = Path(__file__).parent
_TOUR = (
    "hybrid/test_hybrid_training.py::test_a_resumed_run_goes_on_to_the_same_losses",
    "dynamics/test_linear.py::test_batches_of_everything",
    "dynamics/test_jumps.py::test_a_batch_equals_a_loop",
    "phantoms/test_painting.py",
    "bench/test_systems.py::test_energy_is_kept_where_nothing_is_lost[pendulum]",
    "bench/test_systems.py::test_every_way_of_modelling_has_finite_gradients[meta_hylad-bouncing_ball]",
    "bench/test_systems.py::test_pictures_are_bright_inside_and_their_errors_agree_with_them[rigid_body]",
    "shape_tour.py",
)
#: A little below what the tour calls today.
_CALLED = 75


def test_arrays_have_the_shapes_of_their_annotations(tmp_path: Path) -> None:
    found = tmp_path / "shapes.json"
    plugins = ["-p", "array_shapes", "-p", "no:cacheprovider", "--shapes", str(found)]
    path = os.pathsep.join((str(_HERE), str(Path(petkin.__file__).parents[1])))
    ran = subprocess.run(
        [sys.executable, "-m", "pytest", *plugins, *(str(_HERE / part) for part in _TOUR)],
        cwd=_HERE.parent,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stdout
    tally = json.loads(found.read_text())
    assert tally["violations"] == {}
    assert tally["unread"] == {}
    assert len(tally["called"]) >= _CALLED, sorted(set(tally["annotated"]) - set(tally["called"]))


def _doubled(values: Float[Tensor, "n K"], start: Float[Tensor, " n"] | None = None) -> Float[Tensor, "K n"]:
    return 2.0 * values.mT


def _as_it_is(values: tuple[Float[NDArray, "a b"], float | Float[NDArray, " b"]]) -> Float[NDArray, "a b"]:
    return values[0]


@pytest.mark.parametrize(
    ("given", "wrong"),
    [
        ({"values": torch.ones(2, 3)}, []),
        ({"values": torch.ones(2, 3), "start": torch.ones(2)}, []),
        ({"values": torch.ones(2, 3), "start": torch.ones(3)}, ["start"]),
        ({"values": torch.ones(2, 3).long()}, ["values"]),
        ({"values": torch.ones(4, 2, 3)}, ["values", "return"]),
    ],
)
def test_a_wrong_shape_is_told(given: Mapping[str, Tensor], wrong: list[str]) -> None:
    hints = {
        "values": Float[Tensor, "n K"],
        "start": Float[Tensor, " n"] | None,
        "return": Float[Tensor, "K n"],
    }
    assert _told(_doubled, hints, given) == wrong


@pytest.mark.parametrize(("second", "wrong"), [(1.0, []), (np.ones(3), []), (np.ones(2), ["values"])])
def test_arrays_within_are_looked_at(second: object, wrong: list[str]) -> None:
    hints = {"values": tuple[Float[NDArray, "a b"], float | Float[NDArray, " b"]]}
    assert _told(_as_it_is, hints, {"values": (np.ones((2, 3)), second)}) == wrong


def _told(function: object, hints: Mapping[str, object], given: Mapping[str, object]) -> list[str]:
    tally = Tally()
    watched(function, hints, "here", tally)(**given)
    assert tally.called == {"here"}
    return [where.removeprefix("here, ") for where in tally.violations]
