"""Hypotheses refitted one by one, whatever the scan thinks of them: what each would make of the data at its best."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import NDArray

from petkin.diagnosis.covariance import Noise
from petkin.diagnosis.diagnose import scan_of
from petkin.diagnosis.effect import Hypothesis, Simulator
from petkin.diagnosis.refit import Fit, begun
from petkin.diagnosis.scan import starts
from petkin.diagnosis.which import refitted


def each_alone(
    simulator: Simulator, data: NDArray, noise: Noise, base: Fit, hypotheses: Sequence[Hypothesis]
) -> dict[str, Fit]:
    """The fit of every hypothesis by name, from where the scan likes it best.

    Args:
        simulator: what predicts.
        data: (C, K).
        noise: covariance.
        base: the simulator's own fit.
        hypotheses: one at least.
    """
    scan = scan_of(simulator, noise, base, hypotheses)
    each = scan.each(base.residual)
    found = {}
    for name in dict.fromkeys(t.hypothesis.name for t in scan.templates):
        terms = tuple(starts(scan, base.residual, each, name))
        fit = refitted(simulator, data, noise, base, begun(simulator, data, noise, base, terms)).fit
        if fit is not None:
            found[name] = fit
    return found
