"""Tissue learned from a population, for any scan: one tissue compartment, its f_NN's hypernetwork, and the prior.

Curves and inputs are scaled together to a common level, so that a dose more or less changes nothing. A card says what
was learned from; what lies outside of it is refused where it makes no sense (another nuclide), and else said.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from petkin.errors import InputError
from petkin.hybrid import Settings, load_tensors, save_tensors
from petkin.hybrid.checkpoint import below
from petkin.learning.ensemble import draw_ensemble, posterior
from petkin.learning.population import Population, draw
from petkin.learning.prior import TRIAL, Curves, Keep, TissuePrior, identify, learn
from petkin.learning.quantities import REPORTED, late_plasma, quantities, tissue_and_residual, with_errors
from petkin.learning.responses import Known
from petkin.learning.tissue import Conditions, tissue_task

#: Mean of a scan's curves after scaling: the scale of f_NN.
LEVEL = 10.0
#: Largest sum of rates that is tabulated, 1/min.
HIGHEST = 2.0
#: c_p unless the card says otherwise.
BOUNDS = {"K1": (0.0, 1.0), "k2": (0.0, 1.0), "vB": (0.0, 0.2)}
KIND = "tissue of one compartment and what it lacks"
_IDENTIFY = Settings(steps=300, rate=1e-2)
#: Share of errors that one standard error holds.
_TWO_THIRDS = 0.683
#: Relative difference of half-lives, and of lengths and heights, that is let pass.
_SAME, _BEYOND = 0.01, 0.1


@dataclass(frozen=True)
class Measured:
    """One scan.

    Args:
        values: frame values (R, K), kBq/mL.
        weights: relative inverse variances (K,) or (R, K).
        known: input and frames.
    """

    values: Float[Tensor, "R K"]
    weights: Tensor
    known: Known

    @property
    def scale(self) -> float:
        """To the common level."""
        return LEVEL / float(self.values.mean())


def together(scans: Sequence[Measured]) -> Curves:
    """Curves of scans, scaled; each scan's input has the amount that it is scaled by."""
    one = torch.eye(len(scans))
    return Curves(
        torch.cat([scan.scale * scan.values for scan in scans]).float(),
        torch.cat([scan.weights.expand_as(scan.values) for scan in scans]).float(),
        torch.cat([scan.scale * one[j].expand(len(scan.values), -1) for j, scan in enumerate(scans)]),
    )


def train_tracer(
    conditions: Conditions,
    curves: Curves,
    path: Path,
    settings: Settings,
    card: Mapping[str, Any],
    *,
    residual: str,
    half_life: float,
    progress: Callable[[int, float], None],
) -> None:
    """Learn from the curves of a population, and keep it.

    Args:
        conditions: their inputs and frames.
        curves: at the common level.
        path: checkpoint to write, or to go on from.
        settings: of the training.
        card: where the population comes from.
        residual: what f_NN sees, see `RESIDUALS`.
        half_life: of the radionuclide, min.
        progress: told the step and the misfit.

    Raises:
        InputError: a checkpoint of another training.
    """
    full = {
        "kind": KIND,
        "residual": residual,
        "bounds": {symbol: list(pair) for symbol, pair in BOUNDS.items()},
        "half_life_min": half_life,
        "end_min": float(conditions.grid.nodes[-1]),
        "highest": float(curves.values.max()),
        "curves": len(curves.values),
        "steps": settings.steps,
        "seed": settings.seed,
        **card,
    }
    prior = TissuePrior(tissue_task("meta_hylad", conditions, BOUNDS, residual=residual), settings.seed)
    learn(prior, curves, settings, progress, Keep(path, full))


def conditions_of(scans: Sequence[Measured]) -> Conditions:
    """Inputs and frames of scans, which have as many frames each.

    Raises:
        InputError: they have not.
    """
    return Conditions.of([scan.known for scan in scans], torch.eye(len(scans)), highest=HIGHEST)


def drawn_curves(population: Population, subjects: int, seed: int) -> tuple[Conditions, Curves]:
    """Simulated scans, one a subject, at the common level.

    Args:
        population: what to draw from.
        subjects: how many.
        seed: of the draw.
    """
    conditions = Conditions.of(
        [Known(u, u, population.observation) for u in population.inputs], population.told, highest=HIGHEST
    )
    _, measured = draw(population, subjects, 1, seed)
    values, amounts = measured.states[:, 0, :, 1], measured.states[:, 0, 0, 2:]
    level = values.unflatten(0, (subjects, -1)).mean(dim=(1, 2)).repeat_interleave(population.regions)[:, None]
    weights = torch.tensor(population.observation.divisor).float() / (values / level).clamp_min(0.05)
    return conditions, Curves(LEVEL * values / level, weights / weights.mean(), LEVEL * amounts / level)


@dataclass(frozen=True)
class Identified:
    """Curves of one scan as a learned tissue explains them, in the scan's own unit.

    Args:
        quantities: K1, k2, vB, VT and mean f_NN, see `petkin.learning.quantities` (n, 5).
        percent_se: of them, from the curvature of misfit and prior (n, 5).
        predicted: frame values (n, K).
        nodes: times, min (N,).
        tissue: C_T at the nodes (n, N), kBq/mL.
        learned: f_NN there (n, N), kBq/mL/min.
        misfit: weighted sum of squares over frames with weight (n,).
        remarks: what lies outside of what was learned from, a sentence each.
    """

    quantities: Tensor
    percent_se: Tensor
    predicted: Tensor
    nodes: Tensor
    tissue: Tensor
    learned: Tensor
    misfit: Tensor
    remarks: tuple[str, ...]


def identify_scan(path: Path, scan: Measured, *, half_life: float) -> Identified:
    """What a checkpoint makes of a scan.

    Raises:
        InputError: no such checkpoint, another kind of one, one not trained to its end, or of another radionuclide.
    """
    tensors, card = load_tensors(path)
    require_tracer(path, card, half_life)
    conditions = conditions_of([scan])
    prior, curves = restored(tensors, card, conditions), together([scan])
    u = identify(prior, curves, _IDENTIFY)
    with torch.no_grad():
        tissue, learned = tissue_and_residual(prior, u, curves.amounts)
        predicted = prior.predict(u, curves.amounts)[..., 1]
        found, errors = with_errors(prior, u, curves, late_plasma(conditions, curves.amounts))
    back = 1.0 / scan.scale
    return Identified(
        _in_unit_of_scan(found, scan.scale),
        torch.maximum(errors, _tried(card)),
        back * predicted,
        conditions.grid.nodes,
        back * tissue,
        back * learned,
        back**2 * prior.misfit(u, curves).detach() / curves.weights.count_nonzero(dim=1),
        (*beyond(card, scan), _said_of_trial(card)),
    )


@dataclass(frozen=True)
class Mapped:
    """Many curves of one scan as a learned tissue explains them, in the scan's own unit.

    Args:
        quantities: as of `Identified`, posterior means (of logarithms, but for f_NN) (n, 5).
        percent_se: posterior standard deviations, no smaller than what the checkpoint missed the truth by (n, 5).
        misfit: weighted mean square over frames with weight (n,).
        remarks: what lies outside of what was learned from, a sentence each.
    """

    quantities: Tensor
    percent_se: Tensor
    misfit: Tensor
    remarks: tuple[str, ...]


def identify_voxels(path: Path, scan: Measured, *, half_life: float, level: float) -> Mapped:
    """What a checkpoint makes of many noisy curves of a scan, see `petkin.learning.ensemble`.

    Args:
        path: the checkpoint.
        scan: the curves.
        half_life: of the radionuclide, min.
        level: mean of all curves of the scan, whichever these are, kBq/mL.

    Raises:
        InputError: as `identify_scan`.
    """
    tensors, card = load_tensors(path)
    require_tracer(path, card, half_life)
    conditions, scale = conditions_of([scan]), LEVEL / level
    drawn = draw_ensemble(restored(tensors, card, conditions), conditions, scale, scan.weights)
    found, errors, misfit = posterior(drawn, scale * scan.values)
    remarks = (*_longer(card, scan), _said_of_trial(card))
    return Mapped(_in_unit_of_scan(found, scale), torch.maximum(errors, _tried(card)), misfit / scale**2, remarks)


def _in_unit_of_scan(found: Tensor, scale: float) -> Tensor:
    """f_NN is a rate of activity, all else is not."""
    return torch.cat([found[:, :-1], found[:, -1:] / scale], dim=1)


def restored(tensors: Mapping[str, Tensor], card: Mapping[str, Any], conditions: Conditions) -> TissuePrior:
    """What a checkpoint holds, for other inputs and frames."""
    bounds = {symbol: (pair[0], pair[1]) for symbol, pair in card["bounds"].items()}
    prior = TissuePrior(tissue_task("meta_hylad", conditions, bounds, residual=card["residual"]))
    prior.load_state_dict(dict(below("prior.", tensors)))
    return prior


def try_out(path: Path, population: Population, subjects: int) -> None:
    """Write into a checkpoint how far it is from the truth of unseen tissue of the population that it was learned from.

    For each of K1, k2 and VT the median error, and what two thirds of the errors stay below, percent. Where f_NN can
    take the place of a rate constant no curvature shows it; the truth does.

    Args:
        path: checkpoint of a simulated population, trained to its end.
        population: the same.
        subjects: how many are drawn.
    """
    tensors, card = load_tensors(path)
    conditions, curves = drawn_curves(population, subjects, card["seed"] + 1)
    truth = draw(population, subjects, 1, card["seed"] + 1)[0].truth
    prior = restored(tensors, card, conditions)
    u = identify(prior, curves, _IDENTIFY)
    with torch.no_grad():
        found = quantities(prior, u, curves.amounts, late_plasma(conditions, curves.amounts))
    true = {"K1": truth[:, 0], "k2": truth[:, 1], "VT": population.model.macro(truth)["VT"]}
    trial = {}
    for symbol, values in true.items():
        off = 100.0 * (found[:, REPORTED.index(symbol)] / values - 1.0)
        off = off[torch.isfinite(off)]
        if len(off):
            trial[symbol] = [round(float(off.median()), 1), round(float(off.abs().quantile(_TWO_THIRDS)), 1)]
    save_tensors(path, tensors, {**card, TRIAL: trial})


def _tried(card: Mapping[str, Any]) -> Tensor:
    """Smallest percent standard errors that the trial allows."""
    trial = card.get(TRIAL, {})
    return torch.tensor([trial[symbol][1] if symbol in trial else 0.0 for symbol in REPORTED])


def _said_of_trial(card: Mapping[str, Any]) -> str:
    if TRIAL not in card:
        return "What it was learned from has no known truth: standard errors take the learned correction as given."
    parts = [
        f"{symbol} {middle:+.3g} % (two thirds within {most:.3g} %)" for symbol, (middle, most) in card[TRIAL].items()
    ]
    return f"Median error on unseen tissue of its own population: {', '.join(parts)}; standard errors are no smaller."


def require_tracer(path: Path, card: Mapping[str, Any], half_life: float) -> None:
    """Whether a checkpoint is one of `petkin train`, finished, and of this radionuclide.

    Raises:
        InputError: it is not.
    """
    if card.get("kind") != KIND:
        raise InputError(f"{path}: a checkpoint, but not one of petkin train.")
    if card["step"] < card["steps"]:
        raise InputError(f"{path}: trained for {card['step']} of {card['steps']} steps; finish it with petkin train.")
    if abs(half_life / card["half_life_min"] - 1.0) > _SAME:
        raise InputError(
            f"{path}: learned with a half-life of {card['half_life_min']:.4g} min, the scan's is {half_life:.4g} min: "
            "train on scans of this tracer."
        )


def beyond(card: Mapping[str, Any], scan: Measured) -> tuple[str, ...]:
    """What of a scan lies outside of what a checkpoint was learned from, a sentence each."""
    highest = scan.scale * float(scan.values.max())
    if highest <= (1.0 + _BEYOND) * card["highest"]:
        return _longer(card, scan)
    return (
        *_longer(card, scan),
        f"The highest value is {highest / LEVEL:.3g} x the mean of the scan's curves, in those learned from "
        f"{card['highest'] / LEVEL:.3g} x: f_NN is asked for what it has not seen.",
    )


def _longer(card: Mapping[str, Any], scan: Measured) -> tuple[str, ...]:
    end = float(scan.known.observation.frames.end[-1])
    if end <= (1.0 + _BEYOND) * card["end_min"]:
        return ()
    return (f"The scan ends at {end:.4g} min, those learned from at {card['end_min']:.4g} min: extrapolated.",)
