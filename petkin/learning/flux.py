"""What one tissue compartment lacks beside its own refit, frame by frame, as a learned tissue reads curves.

A learned tissue reads a curve y_k of variance v_k as the u = (logits of c_p, c_n) that makes small

    sum_k (y_k - x_k(u))^2 / v_k + (u - m)' P (u - m),

and u has a course C_T(t) of tissue. What one compartment lacks is what must be added to its law so that it takes that
course; frame k lasts from t_k to t'_k, and means are over it:

    f_k = [C_T(t'_k) - C_T(t_k)] / (t'_k - t_k) - (K1 mean C_P - k2 mean C_T)

K1, k2 and vB are refitted to the frames of that course. f_NN alone would not do: part of it K1 and k2 can take, and
where it ends and they begin no curve tells (Plumlee M. J Am Stat Assoc 2017;112:1274-1285). Beside a refit it is
nought wherever one compartment is enough. Blood is no part of it: vB is free in both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from petkin.imaging import FrameObservation, FrameSchedule
from petkin.kinetics import ONE_TISSUE
from petkin.learning.flow import TissueFlow
from petkin.learning.prior import TissuePrior
from petkin.learning.responses import Known
from petkin.learning.search import Posterior, likeliest
from petkin.learning.tissue import Conditions

#: Steps of differences: in u; in the logarithms of K1 and k2, and in vB.
_STEP, _REFIT_STEP = 1e-2, 1e-3
#: Least length of a frame after time zero, min; what lies before holds nothing.
_SHORTEST = 1e-6
#: Smallest and largest K1 and k2 of a refit.
_RATES = (1e-4, 2.0)


@dataclass(frozen=True)
class Edges:
    """Frames as steps from edge to edge.

    Args:
        schedule: the steps, one after the other from time zero (J).
        first, last: steps that each frame begins and ends with (K,).
    """

    schedule: FrameSchedule
    first: Tensor
    last: Tensor

    @classmethod
    def of(cls, frames: FrameSchedule) -> Edges:
        edges = np.unique(np.concatenate([[0.0], frames.start, frames.end]).clip(0.0))
        first, last = np.searchsorted(edges, frames.start.clip(0.0)), np.searchsorted(edges, frames.end.clip(0.0)) - 1
        return cls(FrameSchedule(edges[:-1], edges[1:]), torch.tensor(first), torch.tensor(last))

    @property
    def observation(self) -> FrameObservation:
        """Plain means over the steps."""
        return FrameObservation(self.schedule)

    def change(self, at_ends: Float[Tensor, "*b J"]) -> Float[Tensor, "*b K"]:
        """Change a minute, over every frame, of a curve that is nought at time zero."""
        return self._over(torch.nn.functional.pad(at_ends, (1, 0)))

    def mean(self, over_steps: Float[Tensor, "*b J"]) -> Float[Tensor, "*b K"]:
        """Means over frames of means over steps."""
        steps = torch.tensor(self.schedule.duration).to(over_steps)
        return self._over(torch.nn.functional.pad((over_steps * steps).cumsum(dim=-1), (1, 0)))

    def _over(self, at_edges: Float[Tensor, "*b edges"]) -> Float[Tensor, "*b K"]:
        times = torch.tensor(np.append(0.0, self.schedule.end))
        lasts = times[self.last + 1] - times[self.first]
        changed = at_edges[..., self.last + 1] - at_edges[..., self.first]
        return changed / lasts.clamp_min(_SHORTEST).to(at_edges)


@dataclass(frozen=True)
class Scene:
    """A scan's input and frames, made ready once for every member of an ensemble.

    Args:
        seen: as the frames were measured.
        stepped: from edge to edge, without decay.
        edges: which those are.
        plasma: mean C_P over each frame (K,), kBq/mL.
        amount: what values and input are scaled by to the common level.
    """

    seen: Conditions
    stepped: Conditions
    edges: Edges
    plasma: Float[Tensor, " K"]
    amount: float

    @classmethod
    def of(cls, known: Known, amount: float, *, highest: float) -> Scene:
        edges, one = Edges.of(known.observation.frames), torch.eye(1)
        seen = Conditions.of([known], one, highest=highest)
        stepped = Conditions.of([replace(known, observation=edges.observation)], one, highest=highest)
        plasma = edges.mean(torch.as_tensor(edges.observation.of_forcing(known.plasma)))
        return cls(seen, stepped, edges, plasma.float(), amount)

    def amounts(self, count: int) -> Float[Tensor, "n 1"]:
        return torch.full((count, 1), self.amount)


@dataclass(frozen=True)
class Course:
    """Courses of tissue, kBq/mL.

    Args:
        frames: what the frames report, blood included (n, K).
        at_ends: C_T at the ends of the steps (n, J).
        over_steps: mean C_T over the steps (n, J).
    """

    frames: Float[Tensor, "n K"]
    at_ends: Float[Tensor, "n J"]
    over_steps: Float[Tensor, "n J"]


def lacking(
    course: Course, scene: Scene, variances: Float[Tensor, "n K"], near: Float[Tensor, "n 3"]
) -> Float[Tensor, "n K"]:
    """f, what one compartment lacks on a course, kBq/mL/min.

    Args:
        course: of tissue.
        scene: input and frames.
        variances: of frames, which weigh the refit.
        near: K1, k2 and vB where the refit begins.
    """
    flow = TissueFlow(ONE_TISSUE, scene.seen.responses, scene.seen.grid)
    blood, (low, high) = flow.responses.blood[0], _RATES

    def frames(theta: Tensor) -> Tensor:
        rates, vB = theta[:, :2].exp().clamp(low, high), theta[:, 2:]
        return (1.0 - vB) * flow.linear(rates, torch.ones(len(theta), 1))[2] + vB * blood

    begin = torch.cat([near[:, :2].clamp(low, high).log(), near[:, 2:]], dim=1).float()
    posterior = Posterior(frames, torch.zeros(3), torch.zeros(3, 3), _REFIT_STEP)
    found = likeliest(posterior, course.frames.float(), (1.0 / variances).float(), begin)[:, :2]
    K1, k2 = found.exp().clamp(low, high).split(1, dim=1)
    return scene.edges.change(course.at_ends) - (K1 * scene.plasma - k2 * scene.edges.mean(course.over_steps))


@dataclass(frozen=True)
class Read:
    """Curves as a learned tissue reads them, and how what it reads follows u.

    Args:
        frames: predicted (n, K), kBq/mL.
        tissue: mean C_T over each frame (n, K), kBq/mL.
        flux: f, what one compartment lacks (n, K), kBq/mL/min.
        frames_by_u, flux_by_u: derivatives (n, K, v).
        covariance: of u, from the curvature of misfit and prior (n, v, v).
        gain: by which u follows the curve (n, v, K).
    """

    frames: Tensor
    tissue: Tensor
    flux: Tensor
    frames_by_u: Tensor
    flux_by_u: Tensor
    covariance: Tensor
    gain: Tensor


class Reader:
    """A learned tissue under one scan's input.

    Args:
        prior: under the frames.
        stepped: the same from edge to edge.
        scene: input and frames.
    """

    def __init__(self, prior: TissuePrior, stepped: TissuePrior, scene: Scene) -> None:
        flow = stepped.task.flow
        assert isinstance(flow, TissueFlow)
        stepped.task = replace(stepped.task, flow=replace(flow, blood=False))
        self.prior, self.stepped, self.scene = prior, stepped, scene

    @torch.no_grad()
    def read(self, values: Float[Tensor, "n K"], variances: Float[Tensor, "n K"], near: Float[Tensor, "n 3"]) -> Read:
        """What the learned tissue makes of curves.

        Args:
            values: kBq/mL.
            variances: of them.
            near: K1, k2 and vB of one compartment through them.
        """
        prior, amount = self.prior, self.scene.amount
        posterior = Posterior(self._frames, prior.mean, prior.precision, _STEP)
        weights = (1.0 / (amount**2 * variances)).float()
        u = likeliest(posterior, (amount * values).float(), weights, prior.mean.expand(len(values), -1))
        count = u.shape[1]
        around = torch.cat([u[None], u + _STEP * torch.eye(count)[:, None]])
        course = self._course(around.flatten(0, 1))
        times = 1 + count
        flux = lacking(course, self.scene, variances.repeat(times, 1), near.repeat(times, 1))
        tissue = self.scene.edges.mean(course.over_steps)[: len(u)]
        (frames, by_u), (flux, flux_by_u) = (
            _with_slopes(part.unflatten(0, (times, -1))) for part in (course.frames, flux)
        )
        weighted = by_u / variances[..., None]
        covariance = torch.linalg.inv(by_u.mT @ weighted + prior.precision.double())
        return Read(frames, tissue.double(), flux, by_u, flux_by_u, covariance, covariance @ weighted.mT)

    def _frames(self, u: Tensor) -> Tensor:
        return self.prior.predict(u, self.scene.amounts(len(u)))[..., 1]

    def _course(self, u: Tensor) -> Course:
        """In the scan's unit."""
        states = self.stepped.predict(u, self.scene.amounts(len(u)))
        return Course(*(part / self.scene.amount for part in (self._frames(u), states[..., 0], states[..., 1])))


def _with_slopes(parts: Float[Tensor, "times n K"]) -> tuple[Float[Tensor, "n K"], Float[Tensor, "n K v"]]:
    parts = parts.double()
    return parts[0], ((parts[1:] - parts[0]) / _STEP).movedim(0, -1)
