"""What one compartment lacks: nought where it is enough, and what a second one adds; how a learned tissue reads it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.optimize import least_squares

from petkin.errors import InputError
from petkin.hybrid import Settings, load_tensors, save_tensors
from petkin.imaging import FrameObservation, FrameSchedule
from petkin.inputs import InputFunction, paper_plasma
from petkin.kinetics import ONE_TISSUE, TWO_TISSUE
from petkin.learning import PAPER, Course, Known, Measured, Scene, drawn_curves, lacking, open_members, train_tracer
from petkin.learning.flux import Edges
from petkin.learning.search import Posterior, likeliest

_HALF_LIFE = 110.0
#: Two minutes without counts.
_FRAMES = FrameSchedule(np.r_[0.0, 1, 2, 4, 8, 12, 18, 24, 30], np.r_[1.0, 2, 4, 6, 12, 18, 24, 30, 40])
_SEEN = FrameObservation(_FRAMES, 0.0063)
_PLASMA = paper_plasma(150.0)
_KNOWN = Known(_PLASMA, _PLASMA, _SEEN)
_POPULATION = replace(PAPER, observation=_SEEN, ranges={**PAPER.ranges, "vB": (0.02, 0.06)}, noise=1.0)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene.of(_KNOWN, 0.2, highest=2.0)


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory: pytest.TempPathFactory):
    path = tmp_path_factory.mktemp("flux") / "one.safetensors"
    conditions, curves = drawn_curves(_POPULATION, 4, 0)
    settings = Settings(steps=60, rate=1e-2)
    card = {"from": "simulation"}
    train_tracer(conditions, curves, path, settings, card, residual="held", half_life=_HALF_LIFE, progress=lambda *_: 0)
    return path


def course(model, parameters, scene: Scene) -> Course:
    """The truth's, of rates and vB (n, P)."""
    tissue = torch.cat([parameters[:, : model.rates], torch.zeros(len(parameters), 1)], dim=1)
    steps = InputFunction(_PLASMA, _PLASMA)
    return Course(
        model.frame_values(parameters, steps, _SEEN),
        model.tissue(tissue, _PLASMA, torch.tensor(scene.edges.schedule.end)),
        model.frame_values(tissue, steps, scene.edges.observation),
    )


def test_changes_and_means_over_frames_with_a_gap() -> None:
    edges = Edges.of(_FRAMES)
    start, end = torch.tensor(edges.schedule.start), torch.tensor(edges.schedule.end)
    change, mean = edges.change(end**2), edges.mean((end**3 - start**3) / (3.0 * (end - start)))
    a, b = _FRAMES.start, _FRAMES.end
    np.testing.assert_allclose(change, a + b, rtol=1e-12)
    np.testing.assert_allclose(mean, (b**3 - a**3) / (3.0 * (b - a)), rtol=1e-12)


def test_one_compartment_lacks_nothing_of_itself(scene: Scene) -> None:
    truth = torch.tensor([[0.2, 0.1, 0.05], [0.1, 0.02, 0.0]], dtype=torch.float64)
    near = torch.tensor([[0.1, 0.05, 0.02]]).expand(2, -1)
    found = lacking(course(ONE_TISSUE, truth, scene), scene, torch.ones(2, 9), near)
    assert float(found.abs().max()) < 2e-3 * float(truth[0, 0] * scene.plasma.max())


def test_of_two_it_lacks_what_a_refit_cannot_take(scene: Scene) -> None:
    truth = torch.tensor([[0.2, 0.15, 0.05, 0.03, 0.04]], dtype=torch.float64)
    given = course(TWO_TISSUE, truth, scene)
    found = lacking(given, scene, torch.ones(1, 9), torch.tensor([[0.2, 0.05, 0.05]]))[0].numpy()

    def residual(theta: np.ndarray) -> np.ndarray:
        values = ONE_TISSUE.frame_values(torch.tensor(theta[None]), InputFunction(_PLASMA, _PLASMA), _SEEN)
        return (values - given.frames)[0].numpy()

    K1, k2, _ = least_squares(residual, [0.2, 0.05, 0.05], xtol=1e-12, ftol=1e-12).x
    change, tissue = scene.edges.change(given.at_ends)[0], scene.edges.mean(given.over_steps)[0]
    expected = change - (K1 * scene.plasma - k2 * tissue)
    np.testing.assert_allclose(found, expected, atol=0.01 * float(expected.abs().max()))
    assert np.abs(found).max() > 0.5


def test_the_likeliest_of_a_linear_law_is_its_closed_form() -> None:
    rng = torch.Generator().manual_seed(0)
    A, values = torch.randn(6, 2, generator=rng), torch.randn(3, 6, generator=rng)
    weights, mean = torch.rand(3, 6, generator=rng) + 0.5, torch.ones(2)
    precision = torch.diag(torch.tensor([0.5, 2.0]))
    found = likeliest(Posterior(lambda u: u @ A.T, mean, precision, 1e-2), values, weights, torch.zeros(3, 2))
    for u, y, w in zip(found, values, weights):
        expected = torch.linalg.solve(A.T @ (w[:, None] * A) + precision, A.T @ (w * y) + precision @ mean)
        torch.testing.assert_close(u, expected, atol=0.05, rtol=0.02)


def test_a_reading_explains_the_curve_and_follows_it(checkpoint) -> None:
    members = open_members([checkpoint])
    truth = torch.tensor([[0.2, 0.15, 0.05, 0.03, 0.04]], dtype=torch.float64)
    values = TWO_TISSUE.frame_values(truth, InputFunction(_PLASMA, _PLASMA), _SEEN)
    scene = members.scene(Measured(values, torch.ones(9), _KNOWN))
    (reader,) = members.readers(scene)
    variances, near = (0.02 * values.clamp_min(1.0)) ** 2, torch.tensor([[0.2, 0.05, 0.05]])
    found = reader.read(values, variances, near)
    assert float(((found.frames - values) ** 2 / variances).mean()) < 4.0
    assert found.flux.shape == found.tissue.shape == (1, 9)
    moved = torch.zeros(9, dtype=torch.float64)
    moved[5] = 0.05 * values[0, 5]
    before, after = (reader.read(values + sign * moved, variances, near).frames for sign in (-1.0, 1.0))
    expected = found.frames_by_u[0] @ found.gain[0] @ (2.0 * moved)
    torch.testing.assert_close((after - before)[0], expected, atol=0.3 * float(expected.abs().max()), rtol=0.0)


def test_members_differ_by_their_seed_alone(checkpoint, tmp_path) -> None:
    tensors, card = load_tensors(checkpoint)
    other = tmp_path / "other.safetensors"
    save_tensors(other, tensors, {**card, "seed": 1})
    with pytest.raises(InputError, match=r"other.safetensors: the same training as .*; give petkin train"):
        open_members([checkpoint, other])
    moved = {name: value + 1e-3 for name, value in tensors.items()}
    save_tensors(other, moved, {**card, "seed": 1, "residual": "C_T"})
    with pytest.raises(InputError, match=r"trained otherwise than .*residual is not the same"):
        open_members([checkpoint, other])
    save_tensors(other, moved, {**card, "seed": 1, "highest": 3.0})
    members = open_members([checkpoint, other])
    with pytest.raises(InputError, match="half-life of 110 min, the scan's is 20"):
        members.require(20.4)
    save_tensors(other, moved, {**card, "step": 3})
    with pytest.raises(InputError, match="trained for 3 of 60 steps"):
        open_members([checkpoint, other])
    with pytest.raises(InputError, match="no such checkpoint"):
        open_members([tmp_path / "none.safetensors"])
