"""What a fit says in words of quantities that its curves do not tell."""

from __future__ import annotations

import numpy as np

from petkin.fitting import VOXELS, FitResult, NonlinearSettings, Status, fit_curves, undetermined
from petkin.kinetics import TWO_TISSUE_TRAPPING

from .fitting_problems import ARTERIAL, FRAMES, PLAIN, basis_averages, blood_averages, frame_averages

TOLD = frame_averages("2TCM3k", np.array([[0.1, 0.15, 0.05, 0.05]]))
#: Nothing returns from this tissue: k2 = 0, and VND = K1 / k2 has no end.
TRAPPED = 0.95 * 0.03 * basis_averages(np.array([0.0])) + 0.05 * blood_averages()


def fitted(clean: np.ndarray, share: float, *odd: np.ndarray) -> FitResult:
    """Forty noisy copies of a curve, then others as they are."""
    noise = share * clean.mean() * np.random.default_rng(0).standard_normal((40, len(FRAMES)))
    settings = NonlinearSettings(TWO_TISSUE_TRAPPING, effort=VOXELS)
    return fit_curves(np.vstack([clean + noise, *odd]), ARTERIAL, PLAIN, FRAMES.duration, settings)


def test_infinite_distribution_volumes_are_counted_as_not_told():
    result = fitted(TRAPPED, 0.02, np.zeros_like(TRAPPED), np.full_like(TRAPPED, np.nan))
    assert list(result.status[40:]) == [Status.NO_SIGNAL, Status.NOT_FINITE]
    endless = np.isinf(result["VND"])
    assert endless.sum() > 5
    assert np.isinf(result.percent_se("VND")[endless]).all()
    untold = np.count_nonzero(result.percent_se("VND")[:40] > 100.0)
    assert untold >= endless.sum()
    told = f"2TCM3k: VND cannot be told from these data in {untold} of 40 curves (standard error above 100 %)."
    assert told in undetermined(result)
    assert not any(": Ki cannot" in sentence for sentence in undetermined(result))


def test_nothing_is_said_of_curves_that_tell_everything():
    result = fitted(TOLD, 1e-4)
    assert (result.status == Status.OK).all()
    assert undetermined(result) == ()
