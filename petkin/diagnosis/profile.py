"""How evidence for an effect goes with its setting and its size, for what several data sets may have in common.

One amplitude a of a template g: log B(s, a) = a g'Pr - a^2 (g'Pg + 1 / width^2) / 2, with its prior. One a channel:
normal about zero with a width a in all channels, or of that size in one alone, as likely. Both with templates, which
are linear, so that of a glaring gap no more is believed than a few units beyond the average.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from petkin.diagnosis import evidence
from petkin.diagnosis.effect import Hypothesis
from petkin.diagnosis.scan import Scan, Template
from petkin.diagnosis.strength import Strength

Array = NDArray[np.float64]

#: Sizes asked, in plausible ranges.
_SIZES = np.geomspace(0.01, 3.0, 30)
#: How far from each setting's strength, in errors, probabilities are asked.
_ERRORS = np.linspace(-3.0, 3.0, 13)
#: How much more evidence there may be at the likeliest setting and size than on average.
_BEYOND = 15.0
#: By what factor templates may be off at most.
_OFF = 3.0
#: The least log evidence that tells how far templates are off.
_LEAST = 1.0


@dataclass(frozen=True)
class Profile:
    """Of one effect.

    Args:
        settings: of its other parameters.
        sizes: of its amplitude, with a sign where there is one amplitude that may be negative (Z,).
        by_size: log evidence at each (S, Z).
        by_setting: averaged over what sizes one data set may show (S,).
        values, errors: the amplitude at each setting (S,); NaN where channels have one each.
        missed: share of it that a template misses of one halfway to the next setting (S,).
    """

    settings: tuple[Mapping[str, float], ...]
    sizes: Array
    by_size: Array
    by_setting: Array
    values: Array
    errors: Array
    missed: Array

    def on(self, settings: Sequence[Mapping[str, float]]) -> Profile:
        """At the settings that are nearest to others."""
        if settings == self.settings:
            return self
        symbols = sorted({symbol for one in (*self.settings, *settings) for symbol in one})
        own, others = (
            np.log1p([[one.get(symbol, 0.0) for symbol in symbols] for one in s]) for s in (self.settings, settings)
        )
        nearest = np.abs(own - others[:, None]).sum(axis=-1).argmin(axis=-1)
        there = (by[nearest] for by in (self.by_size, self.by_setting, self.values, self.errors, self.missed))
        return Profile(tuple(settings), self.sizes, *there)

    def over_settings(self, strength: Strength) -> Strength:
        """A strength with the interval that it has where its setting is not known.

        Templates tell it at each setting, as likely as the data make that; where they are off at the likeliest, as
        after a refit of a strong effect, by the same factor elsewhere."""
        if len(self.settings) == 1 or np.isnan(self.values).any():
            return strength
        best = int(self.by_setting.argmax())
        weight = np.exp(self.by_setting - self.by_setting[best])
        alike = strength.value * self.values[best] > 0
        ratio = float(np.clip(strength.value / self.values[best], 1.0 / _OFF, _OFF)) if alike else 1.0
        values, errors = ratio * self.values, abs(ratio) * self.errors
        asked = np.sort(np.concatenate([values + k * errors for k in _ERRORS]))
        below = ndtr((asked[:, None] - values) / errors) @ weight / weight.sum()
        low, high = np.interp([0.05, 0.95], below, asked)
        return replace(strength, low=min(strength.low, float(low)), high=max(strength.high, float(high)))

    def reaching(self, log_evidence: float) -> Profile:
        """With an average that refits tell: what templates say is wrong by as much where they say most, and by nothing
        where there is as good as no effect."""
        off = log_evidence - float(evidence.mean(self.by_setting))

        def right(log: Array) -> Array:
            found = log + off * np.clip(log / max(float(log.max()), _LEAST), 0.0, 1.0)
            return np.minimum(found, max(log_evidence, 0.0) + _BEYOND)

        return replace(self, by_size=right(self.by_size), by_setting=right(self.by_setting))


def profiles(scan: Scan, residual: Array) -> dict[str, Profile]:
    """Of every effect that is there more or less, by name.

    Args:
        scan: of all templates.
        residual: that a refit left, whitened.
    """
    each = scan.each(residual)
    found: dict[str, list[int]] = {}
    for i, template in enumerate(scan.templates):
        if not template.hypothesis.flag:
            found.setdefault(template.hypothesis.name, []).append(i)
    columns = scan.by_template()
    return {
        name: _profile([(scan.templates[i], *columns[i], float(each[i])) for i in places], residual)
        for name, places in found.items()
    }


def _profile(templates: list[tuple[Template, Array, Array, float]], residual: Array) -> Profile:
    hypothesis = templates[0][0].hypothesis
    sizes, several = _sizes(hypothesis), hypothesis.by_channel and not hypothesis.alike
    by_size, values, errors = [], [], []
    for template, columns, projected, _ in templates:
        score, information = residual @ projected, columns.T @ projected
        ridge = hypothesis.width**-2.0
        if several:
            known = evidence.Spread.of(information + ridge * np.eye(len(information)))
            log = known.at_sizes(score, sizes, hypothesis.signed)
            values.append(np.nan)
            errors.append(np.nan)
        else:
            toward, tells = float(score.sum()), max(float(information.sum()), 1e-300)
            log = sizes * toward - 0.5 * sizes**2 * (tells + ridge)
            values.append(toward / tells)
            errors.append(tells**-0.5)
        by_size.append(log + template.told)
    settings = tuple(template.setting for template, *_ in templates)
    by_setting = np.array([each for *_, each in templates])
    return Profile(
        settings, sizes, np.stack(by_size), by_setting, np.array(values), np.array(errors), _missed(templates, settings)
    )


def _missed(templates: list[tuple[Template, Array, Array, float]], settings: Sequence[Mapping[str, float]]) -> Array:
    """Half of what each misses of its neighbours' on average; none but where settings are a course of moments."""
    if len(settings) == 1 or any(set(setting) != {"onset"} for setting in settings):
        return np.zeros(len(settings))
    columns = np.stack([one.sum(axis=1) for _, one, _, _ in templates])
    seen = columns @ np.stack([one.sum(axis=1) for _, _, one, _ in templates]).T
    of_next = np.clip(seen / np.maximum(np.diag(seen)[:, None], 1e-300), 0.0, 1.0)
    beside = [(of_next[i, max(i - 1, 0)], of_next[i, min(i + 1, len(seen) - 1)]) for i in range(len(seen))]
    return 0.5 * (1.0 - np.mean(beside, axis=1))


def _sizes(hypothesis: Hypothesis) -> Array:
    found = _SIZES * max(abs(hypothesis.lower), abs(hypothesis.upper))
    one = hypothesis.alike or not hypothesis.by_channel
    return np.concatenate([-found[::-1], found]) if hypothesis.signed and one else found
