"""The scan: templates of all hypotheses against the residual, and against draws of noise, as matrix products."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis import evidence
from petkin.diagnosis.covariance import Noise
from petkin.diagnosis.effect import Hypothesis, Simulator, Term
from petkin.diagnosis.nuisance import Projection
from petkin.diagnosis.refit import Fit
from petkin.diagnosis.unknown import Smooth

Array = NDArray[np.float64]

#: A second start is within this of the best in log evidence, and its template has no larger cosine with it.
_NEAR, _OTHERWISE = 6.0, 0.8


@dataclass(frozen=True)
class Template:
    """What a hypothesis adds at a weak amplitude, per unit of it: `change` (C, K), and whitened columns, (n, 1) or one
    a channel (n, C); `told` is how much likelier its setting is than an average one."""

    hypothesis: Hypothesis
    setting: dict[str, float]
    change: Array
    columns: Array
    told: float = 0.0

    @classmethod
    def of(
        cls, hypothesis: Hypothesis, setting: dict[str, float], change: Array, noise: Noise, told: float = 0.0
    ) -> Template:
        local = np.eye(len(change))[:, :, None] * change[None] if hypothesis.by_channel else change[None]
        return cls(hypothesis, setting, change, noise.whiten(local).T, told)

    def under(self, noise: Noise) -> Template:
        """The same under another noise."""
        return Template.of(self.hypothesis, self.setting, self.change, noise, self.told)


def templates(simulator: Simulator, noise: Noise, fit: Fit, hypotheses: Sequence[Hypothesis]) -> tuple[Template, ...]:
    """Whitened templates of all hypotheses at all their settings, around a fit."""
    found = []
    count = len(simulator.channels)
    base = fit.state.terms
    for hypothesis in hypotheses:
        for setting, told in hypothesis.ways:
            size = hypothesis.typical
            term = Term(hypothesis, np.full(count, size) if hypothesis.by_channel else size, dict(setting))
            moved = simulator.predict(fit.state.own, fit.state.shared, (*base, term))
            found.append(Template.of(hypothesis, dict(setting), (moved - fit.values) / size, noise, told))
    return tuple(found)


class Scan:
    """All templates at once against residuals that a refit left, and against as many draws of noise as are wanted."""

    def __init__(self, found: Sequence[Template], projection: Projection, smooth: Smooth | None) -> None:
        self.templates = tuple(found)
        self.columns = np.concatenate([t.columns for t in found], axis=1)
        axes = projection.axes[: projection.rows]
        self.projected = self.columns - axes @ (axes.T @ self.columns)
        self.projection = projection
        ends = np.cumsum([t.columns.shape[1] for t in found])
        self._places = [slice(end - t.columns.shape[1], end) for t, end in zip(found, ends)]
        self._information = [self.columns[:, p].T @ self.projected[:, p] for p in self._places]
        self._told = np.array([t.told for t in found])
        self._smooth = smooth

    def by_template(self) -> list[tuple[Array, Array]]:
        """The columns of every template, and what the projection leaves of them."""
        return [(self.columns[:, place], self.projected[:, place]) for place in self._places]

    def amplitude(self, index: int, residual: Array) -> Array:
        """Linear fit of a template's amplitude to a residual, one or one a channel."""
        score = residual @ self.projected[:, self._places[index]]
        return np.asarray(np.linalg.solve(self.information(index), score), np.float64)

    def look(self, index: int, residual: Array) -> Array:
        """What a template would explain of a residual, of length one."""
        seen = self.projected[:, self._places[index]] @ self.amplitude(index, residual)
        return seen / max(float(np.linalg.norm(seen)), 1e-300)

    def information(self, index: int) -> Array:
        """What data and prior tell of a template's amplitude, one or one a channel."""
        found = self._information[index]
        return found + np.eye(len(found)) * self.templates[index].hypothesis.width ** -2.0

    def best(self, each: Array, name: str) -> int:
        """Place of the template of a hypothesis that the scan likes best."""
        return max((i for i, t in enumerate(self.templates) if t.hypothesis.name == name), key=lambda i: each[i])

    def each(self, residuals: Array) -> Array:
        """log evidence of every template for what a refit left of data (..., n), with what is told of its setting:
        (..., templates)."""
        scores = residuals @ self.projected
        found = np.empty((*residuals.shape[:-1], len(self.templates)))
        for (alike, signed), (which, spread) in self._by_channel.items():
            mine = np.stack([scores[..., self._places[i]] for i in which], axis=-2)
            found[..., which] = spread.by_channel(mine, alike, signed)
        for kind, templates in self._alone.items():
            found[..., templates.which] = kind(scores[..., templates.columns], templates.information)
        return found + self._told

    @cached_property
    def _alone(self) -> dict[Callable[[Array, Array], Array], _Alone]:
        """Templates that have one amplitude or none, by how their evidence is told."""
        which: dict[Callable[[Array, Array], Array], list[int]] = {}
        for i, template in enumerate(self.templates):
            if not template.hypothesis.by_channel:
                which.setdefault(_evidence(template.hypothesis), []).append(i)
        return {kind: self._of(members) for kind, members in which.items()}

    def _of(self, members: list[int]) -> _Alone:
        known = [(0.0, 0.0) if (h := self.templates[i].hypothesis).flag else _precisions(h) for i in members]
        information = np.array([self._information[i][0, 0] for i in members])[:, None] + known
        return _Alone(np.array(members), np.array([self._places[i].start for i in members]), information)

    @cached_property
    def _by_channel(self) -> dict[tuple[bool, bool], tuple[list[int], evidence.Spread]]:
        """Templates that have an amplitude a channel, by whether those are alike and may be negative."""
        which: dict[tuple[bool, bool], list[int]] = {}
        for i, hypothesis in enumerate(t.hypothesis for t in self.templates):
            if hypothesis.by_channel:
                which.setdefault((hypothesis.alike, hypothesis.signed), []).append(i)
        each = {kind: np.stack([self.information(i) for i in members]) for kind, members in which.items()}
        return {kind: (which[kind], evidence.Spread.of(information)) for kind, information in each.items()}

    def unknown(self, residuals: Array) -> Array:
        """log evidence of a smooth discrepancy (...)."""
        if self._smooth is None:
            return np.full(residuals.shape[:-1], -np.inf)
        return self._smooth.evidence(residuals)

    def unnamed(self, residual: Array) -> str:
        """Where a smooth discrepancy is likeliest, "" where none is looked for."""
        return "" if self._smooth is None else self._smooth.likeliest(residual)

    def excess(self, each: Array, name: str) -> float:
        """What choosing the best setting of a hypothesis gains over an average one, beyond what was told of it."""
        values = np.array([e for t, e in zip(self.templates, each) if t.hypothesis.name == name])
        best = self.best(each, name)
        return float(each[best] - self.templates[best].told - evidence.mean(values))

    def by_hypothesis(self, each: Array) -> dict[str, Array]:
        """Evidence averaged over the settings of every hypothesis."""
        found, place = {}, 0
        for name, group in groupby(self.templates, key=lambda t: t.hypothesis.name):
            count = len(list(group))
            found[name] = evidence.mean(each[..., place : place + count])
            place += count
        return found

    @property
    def names(self) -> tuple[str, ...]:
        """Of the hypotheses, and "" of a smooth discrepancy, as `evidence` has them."""
        return (*dict.fromkeys(t.hypothesis.name for t in self.templates), "")

    def evidence(self, residuals: Array) -> Array:
        """log evidence of every hypothesis, and of a smooth discrepancy (..., H + 1)."""
        found = [*self.by_hypothesis(self.each(residuals)).values(), self.unknown(residuals)]
        return np.stack(found, axis=-1)


@dataclass(frozen=True)
class _Alone:
    """Templates of one amplitude: which, where their columns stand, and what data and prior tell of it (m, 2), below
    zero and above."""

    which: NDArray[np.intp]
    columns: NDArray[np.intp]
    information: Array


def _evidence(hypothesis: Hypothesis) -> Callable[[Array, Array], Array]:
    """How scores (..., m) and the information on them (m, 2) give log evidence."""
    if hypothesis.flag:
        return _of_flags
    return _of_signed if hypothesis.signed else _of_positive


def _precisions(hypothesis: Hypothesis) -> tuple[float, float]:
    below, above = hypothesis.widths
    return below**-2.0, above**-2.0


def _of_flags(score: Array, information: Array) -> Array:
    return score - 0.5 * information[:, 1]


def _of_signed(score: Array, information: Array) -> Array:
    return evidence.two_sided(*(score / np.sqrt(side) for side in information.T))


def _of_positive(score: Array, information: Array) -> Array:
    return evidence.one_sided(score / np.sqrt(information[:, 1]))


def starts(scan: Scan, residual: Array, each: Array, name: str, most: int = 1) -> list[Term]:
    """A hypothesis where the scan likes it best, with the amplitude of a linear fit to the residual; likeliest first.

    Args:
        scan: of the residual.
        residual: whitened.
        each: log evidence of every template.
        name: of the hypothesis.
        most: how many; further ones look otherwise, and are not much less likely.
    """
    mine = [i for i, t in enumerate(scan.templates) if t.hypothesis.name == name]
    mine.sort(key=lambda i: -each[i])
    found, looks = [], []
    for i in mine:
        if len(found) == most or each[i] < each[mine[0]] - _NEAR:
            break
        look = scan.look(i, residual)
        if all(abs(look @ other) < _OTHERWISE for other in looks):
            found.append(_start(scan.templates[i], scan.amplitude(i, residual)))
            looks.append(look)
    return found


def _start(template: Template, amplitude: Array) -> Term:
    hypothesis, count = template.hypothesis, template.columns.shape[1]
    local = {s.symbol: np.full(count, template.setting[s.symbol]) for s in hypothesis.shapes if s.by_channel}
    if hypothesis.flag:
        return Term(hypothesis, 1.0, template.setting)
    low, high = hypothesis.limits
    inside = np.clip(amplitude, low if hypothesis.signed else min(hypothesis.typical, high), high)
    return Term(hypothesis, inside if hypothesis.by_channel else float(inside[0]), {**template.setting, **local})
