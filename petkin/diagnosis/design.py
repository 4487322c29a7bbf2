"""What a design can tell before any data: detectability of every hypothesis, and what each is taken for.

d'(e) = |a P g_e|,   c(e, e') = |g_e' P g_e'| / (|P g_e| |P g_e'|),   P the projector off all that is refitted
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis.covariance import Noise
from petkin.diagnosis.effect import Hypothesis, Simulator, Term
from petkin.diagnosis.nuisance import Projection
from petkin.diagnosis.refit import Fit
from petkin.diagnosis.scan import Template

Array = NDArray[np.float64]

#: An effect below this d' at the end of its range cannot be seen; two above this cosine cannot be told apart.
INVISIBLE, SAME = 1.5, 0.97
#: Derivatives by a signed amplitude are taken over this share of its range, to both sides.
_STEP = 0.02
#: An effect of which the refit leaves less than this looks like nothing else.
ABSORBED = 1e-6


@dataclass(frozen=True)
class Visible:
    """One hypothesis in a design.

    Args:
        hypothesis: which.
        detectability: d' at the end of its range, after the refit.
        kept: share of its whitened size that the refit leaves.
        own: own coordinates around which this holds (C, Po).
        shift: of them when it is there at the end of its range and left out (C, Po).
        partners: names and cosines of those it is taken for, most alike first.
    """

    hypothesis: Hypothesis
    detectability: float
    kept: float
    own: Array
    shift: Array
    partners: tuple[tuple[str, float], ...]

    @property
    def invisible(self) -> bool:
        return self.detectability < INVISIBLE


def foresee(simulator: Simulator, noise: Noise, fit: Fit, found: Sequence[Template]) -> tuple[Visible, ...]:
    """Every hypothesis at its most visible setting, without any prior on what is refitted.

    Args:
        simulator: what predicts.
        noise: its covariance.
        fit: to data, or to expected values.
        found: templates around it.
    """
    projection = Projection.of(fit.jacobian, np.full(len(fit.penalty), 1e-12))
    straight = [_tangent(simulator, noise, fit, template) for template in _strongest(found, projection)]
    return _all([(t.hypothesis, _column(t)) for t in straight], projection, fit, simulator)


def _tangent(simulator: Simulator, noise: Noise, fit: Fit, template: Template) -> Template:
    """The template of one signed amplitude as a derivative: two that undo one another differ where they are curved."""
    hypothesis = template.hypothesis
    if hypothesis.by_channel or hypothesis.flag or not hypothesis.signed:
        return template
    step = _STEP * max(hypothesis.upper, -hypothesis.lower)
    ends = (Term(hypothesis, side * step, template.setting) for side in (1.0, -1.0))
    above, below = (simulator.predict(fit.state.own, fit.state.shared, (*fit.state.terms, end)) for end in ends)
    return Template.of(hypothesis, template.setting, (above - below) / (2.0 * step), noise)


def _strongest(found: Sequence[Template], projection: Projection) -> list[Template]:
    """One template a hypothesis, at the setting where it is seen best."""
    columns = np.stack([_column(template) for template in found], axis=1)
    best: dict[str, tuple[float, Template]] = {}
    for template, size in zip(found, projection.norms(columns)):
        name = template.hypothesis.name
        if name not in best or size > best[name][0]:
            best[name] = (float(size), template)
    return [template for _, template in best.values()]


def _column(template: Template) -> Array:
    """What a template adds at the end of its range, all channels alike."""
    hypothesis = template.hypothesis
    reach = 1.0 if hypothesis.flag else max(hypothesis.upper, -hypothesis.lower)
    return reach * template.columns.sum(axis=1)


def _all(
    entries: Sequence[tuple[Hypothesis, Array]], projection: Projection, fit: Fit, simulator: Simulator
) -> tuple[Visible, ...]:
    columns = np.stack([column for _, column in entries], axis=1)
    inner = projection.inner(columns, columns)
    size = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    raw = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    seen = size > ABSORBED * raw
    cosine = np.where(np.outer(seen, seen), np.abs(inner) / np.outer(size, size), 0.0)
    shape = (len(simulator.channels), len(simulator.own))
    solved = np.linalg.lstsq(fit.jacobian, columns, rcond=1e-10)[0]
    shifts = np.asarray(solved[: shape[0] * shape[1]], np.float64)
    names = [hypothesis.name for hypothesis, _ in entries]
    return tuple(
        Visible(
            hypothesis,
            float(size[i]),
            float(size[i] / raw[i]),
            fit.state.own,
            shifts[:, i].reshape(shape),
            tuple((names[j], float(cosine[i, j])) for j in np.argsort(-cosine[i]) if j != i)[:3],
        )
        for i, (hypothesis, _) in enumerate(entries)
    )


def witnessed(visible: Sequence[Visible], seen: Collection[str]) -> tuple[Visible, ...]:
    """Those that other data do not show, alone or against another."""
    return tuple(
        replace(v, partners=tuple(partner for partner in v.partners if partner[0] not in seen))
        for v in visible
        if v.hypothesis.name not in seen
    )


def indistinct(visible: Sequence[Visible]) -> list[tuple[tuple[str, ...], Visible]]:
    """Effects that a design cannot show, and pairs that it cannot split."""
    found: list[tuple[tuple[str, ...], Visible]] = [((v.hypothesis.name,), v) for v in visible if v.invisible]
    hidden = {v.hypothesis.name for v in visible if v.invisible}
    seen: set[frozenset[str]] = set()
    for v in (v for v in visible if not v.invisible):
        for name, cosine in v.partners:
            pair = frozenset((v.hypothesis.name, name))
            if cosine >= SAME and name not in hidden and pair not in seen:
                seen.add(pair)
                found.append((tuple(sorted(pair)), v))
    return found
