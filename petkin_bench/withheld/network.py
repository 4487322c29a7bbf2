"""A network alone: a plain classifier of normalised residuals in place of the engine, which must score worse.

It sees what is left of every region's curve after the simulator's own fit, in units of the noise, and the curve itself,
on a common ladder of times; regions are pooled, so that their order and number do not matter. It learned from cases of
the training split, whose forms and unnamed causes are not those of the score.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.torch import load_model, save_model
from torch import Tensor, nn

from petkin.diagnosis import base_fit
from petkin_bench.withheld.cases import Scan, case
from petkin_bench.withheld.causes import KNOWN
from petkin_bench.withheld.judge import simulator_of

Array = NDArray[np.float64]

#: What it can say: a name, nothing, or something that has no name.
NOTHING, OTHER = "", "unknown"
_PARTS = ("second_tissue", "blood_volume", "arterial_delay")
LABELS = (NOTHING, OTHER, *sorted({c.name for c in KNOWN} | set(_PARTS)))
#: Times of the ladder, min.
_TIMES = np.geomspace(0.3, 85.0, 28)
_FACTS, _WIDTH = 4, 96
_STEPS, _BATCH, _RATE, _DECAY = 1500, 64, 2e-3, 1e-3
#: Probability that a set must hold.
_MASS = 0.9


class Classifier(nn.Module):
    """Regions one by one, their mean and maximum, and what is known of the scan, to a label."""

    def __init__(self) -> None:
        super().__init__()
        each = 2 * _TIMES.size
        self.region = nn.Sequential(nn.Linear(each, _WIDTH), nn.SiLU(), nn.Linear(_WIDTH, _WIDTH), nn.SiLU())
        self.head = nn.Sequential(
            nn.Linear(2 * _WIDTH + _FACTS, _WIDTH), nn.SiLU(), nn.Dropout(0.2), nn.Linear(_WIDTH, len(LABELS))
        )

    def forward(self, regions: Tensor, facts: Tensor) -> Tensor:
        """Logits [b, labels] of regions [b, R, features] and facts [b, F]."""
        seen = self.region(regions)
        return self.head(torch.cat([seen.mean(dim=-2), seen.amax(dim=-2), facts], dim=-1))


@dataclass(frozen=True)
class Features:
    """What the network is shown of a scan: regions (R, 2 T) and facts (F,)."""

    regions: Array
    facts: Array


def features(scan: Scan) -> Features:
    """Residuals after the simulator's own fit, in units of the noise, and curves over their peak."""
    simulator = simulator_of(scan)
    fit, noise, *_ = base_fit(simulator, scan.values)
    left = noise.whiten(scan.values - fit.values).reshape(scan.values.shape)
    mid = scan.frames.mid
    ladder = [
        np.concatenate([np.interp(_TIMES, mid, np.arcsinh(row)), np.interp(_TIMES, mid, curve / curve.max())])
        for row, curve in zip(left, scan.values, strict=True)
    ]
    there = (scan.model == "2tcm", "blood_volume" in scan.includes, "arterial_delay" in scan.includes)
    return Features(np.stack(ladder), np.array([*there, scan.frames.decay > 0.02], float))


def examples(seed: int, count: int, regions: int) -> tuple[list[Features], Array]:
    """Training cases and what was withheld from them, a pair as half of each (N, labels)."""
    seen, wanted = [], np.zeros((count, len(LABELS)))
    for index in range(count):
        scan, answer = case("training", seed, index, regions)
        seen.append(features(scan))
        names = answer.names or ((OTHER,) if answer.kind == "unknown" else (NOTHING,))
        for name in names:
            wanted[index, LABELS.index(name)] += 1.0 / len(names)
    return seen, wanted


def learned(seen: list[Features], wanted: Array, *, seed: int) -> Classifier:
    """A classifier that was shown them."""
    torch.manual_seed(seed)
    network = Classifier()
    regions = torch.from_numpy(np.stack([f.regions for f in seen])).float()
    facts = torch.from_numpy(np.stack([f.facts for f in seen])).float()
    target = torch.from_numpy(wanted).float()
    optimiser = torch.optim.AdamW(network.parameters(), lr=_RATE, weight_decay=_DECAY)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, _STEPS)
    for _ in range(_STEPS):
        chosen = torch.randint(len(seen), (_BATCH,))
        loss = nn.functional.cross_entropy(network(regions[chosen], facts[chosen]), target[chosen])
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    return network.eval()


def train_network(path: Path, *, seed: int, count: int, regions: int) -> None:
    """Learn from training cases of a seed, and keep what was learned."""
    save_model(learned(*examples(seed, count, regions), seed=seed), str(path))


@lru_cache(maxsize=1)
def _kept(path: Path) -> Classifier:
    network = Classifier()
    load_model(network, str(path))
    return network.eval()


def network_verdict(scan: Scan, path: Path) -> dict[str, object]:
    """A row as `judge.verdict` gives it; where, closure and evidence it cannot tell."""
    started = time.process_time()
    shown, network = features(scan), _kept(path)
    with torch.no_grad():
        regions, facts = (torch.from_numpy(a).float()[None] for a in (shown.regions, shown.facts))
        p = network(regions, facts)[0].double().softmax(dim=-1).numpy()
    probability = dict(zip(LABELS, p.tolist(), strict=True))
    nothing, other = probability.pop(NOTHING), probability[OTHER]
    ranked = sorted(probability, key=lambda name: -probability[name])
    said = "none" if nothing >= 0.5 else "unknown" if ranked[0] == OTHER else "named"
    named = [name for name in ranked if name != OTHER]
    chosen: list[str] = []
    if said == "named":
        total = sum(probability[name] for name in named)
        held = 0.0
        while held < _MASS * total:
            chosen.append(named[len(chosen)])
            held += probability[chosen[-1]]
    given = max(1.0 - nothing, 1e-12)
    stages = {c.name: c.stage for c in KNOWN} | dict(zip(_PARTS, ("tissue", "vascular", "input"), strict=True))
    leader = "" if said == "none" else named[0]
    return {
        "verdict": "ambiguous" if len(chosen) > 1 else said,
        "p_value": nothing,
        "leader": leader,
        "leader_probability": probability[leader] / given if leader else 0.0,
        "set": ";".join(chosen),
        "set_probability": sum(probability[name] for name in chosen) / given,
        "unknown_probability": other / given,
        "stage": stages.get(leader, ""),
        "onset_frame": -1,
        "regions": "",
        **dict.fromkeys(("amplitude", "amplitude_low", "amplitude_high", "onset", "onset_low", "onset_high"), ""),
        "evidence": "",
        "unknown_evidence": 0.0,
        "closure": "",
        "closure_low": "",
        "closure_high": "",
        "closed": "",
        "seconds": round(time.process_time() - started, 3),
    }
