"""A reader of image cases who is told the laws of noise and kinetics, but must find a cause's settings for itself.

Of a cause of no name it is told more than any diagnosis can know: the forms that such causes have.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from petkin_bench.withheld.images.cases import ImageAnswer
from petkin_bench.withheld.images.causes import UNKNOWN
from petkin_bench.withheld.images.columns import WEAK, columns_of, drawn_columns
from petkin_bench.withheld.images.making import Made

Array = NDArray[np.float64]

#: Onsets that are tried; draws of noise; false alarms that a claim allows.
_ONSETS, _READ, _ALARMS = 8, 400, 0.05
#: Draws of every form of a cause of no name.
_FORMS = 40
#: Standard deviation of a cause's size beforehand, as a share of the largest that is withheld.
_USUAL = 0.5


def ideal(answer: ImageAnswer, made: Made | None, *, split: str, seed: int) -> dict[str, object]:
    """Shares of noise draws in which the class, or no name, has the highest evidence (`ideal`), and a gap is claimed
    besides (`ideal_claimed`); "" where nothing is withheld.

    Every cause that images withhold, averaged over its onsets, axes and regions and over its size; a gap is claimed
    where all together have more evidence than in all but 0.05 of draws without one. Where a cause of no name is
    withheld, such causes stand beside those, all forms of the split together.

        log B = z^2 / 2 tau^2 / (1 + tau^2) - log(1 + tau^2) / 2

    with z the matched filter's score and tau the prior's width in units of its error.
    """
    if made is None:
        return {"ideal": "", "ideal_claimed": ""}
    frames = made.scene.scanned.subject.frames
    onsets = np.linspace(0.12, 0.8, _ONSETS) * frames.end[-1]
    found = list(columns_of(made, onsets=list(onsets)))
    if made.of_simulator:  # which has no setting to be found, and is seldom weak
        found = [(name, left) for name, left in found if name != made.cause.name]
        found.append((made.cause.name, made.left * WEAK / _USUAL))
    if not answer.names:
        rng = np.random.default_rng((seed, _FORMS))
        found += [("", left) for left in drawn_columns(made, UNKNOWN[split], _FORMS, rng)]
    names, lefts = [name for name, _ in found], [left for _, left in found]
    scale = made.detectability / float(np.linalg.norm(made.left))
    stacked = np.stack(lefts, axis=1)
    size = np.linalg.norm(stacked, axis=0)
    unit = stacked / size
    tau = scale * size * _USUAL / WEAK
    values, vectors = np.linalg.eigh(unit.T @ unit)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    noise = np.random.default_rng(seed).standard_normal((2 * _READ, len(names))) @ root.T
    kinds = list(dict.fromkeys(names))
    seen = _by_name(noise[:_READ] + scale * (made.left @ unit), tau, names, kinds)
    alone = _by_name(noise[_READ:], tau, names, kinds)
    wanted = answer.classes[0] if answer.names else ("",)
    right = np.isin(seen.argmax(axis=1), [k for k, name in enumerate(kinds) if name in wanted])
    claimed = _any(seen) > np.quantile(_any(alone), 1.0 - _ALARMS)
    return {"ideal": round(float(right.mean()), 4), "ideal_claimed": round(float((right & claimed).mean()), 4)}


def _by_name(scores: Array, tau: Array, names: list[str], kinds: list[str]) -> Array:
    """Log evidence of every name (draws, kinds), its settings any as likely."""
    each = 0.5 * (scores * tau) ** 2 / (1.0 + tau**2) - 0.5 * np.log1p(tau**2)
    mine = [np.array([name == kind for name in names]) for kind in kinds]
    return np.stack([logsumexp(each[:, own], axis=1) - np.log(own.sum()) for own in mine], axis=1)


def _any(evidence: Array) -> Array:
    """Log evidence of a gap of whatever name, but for a constant."""
    return np.asarray(logsumexp(evidence, axis=1))
