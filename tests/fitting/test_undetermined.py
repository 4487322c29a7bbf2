"""What a fit says in words of quantities that its curves do not tell."""

from __future__ import annotations

import numpy as np

from petkin.fitting import VOXELS, NonlinearSettings, Status, fit_curves, undetermined
from petkin.kinetics import TWO_TISSUE_TRAPPING

from .fitting_problems import ARTERIAL, FRAMES, PLAIN, basis_averages, blood_averages, frame_averages


def fitted(*curves):
    return fit_curves(np.stack(curves), ARTERIAL, PLAIN, FRAMES.duration, NonlinearSettings(TWO_TISSUE_TRAPPING))


def sentence(result, symbol: str) -> str:
    (found,) = [line for line in undetermined(result) if line.startswith(f"2TCM3k: {symbol} ")] or [""]
    return found


TOLD = frame_averages("2TCM3k", np.array([[0.1, 0.15, 0.05, 0.05]]))[0]
#: Nothing returns from this tissue: k2 = 0, and K1 / k2 has no end.
TRAPPED = 0.95 * 0.03 * basis_averages(np.array([0.0]))[0] + 0.05 * blood_averages()


def test_an_infinite_distribution_volume_is_named_as_not_told():
    result = fitted(TOLD, TRAPPED)
    assert np.isinf(result["VND"][1])
    assert np.isinf(result.percent_se("VND")[1])
    assert sentence(result, "VND") == (
        "2TCM3k: VND cannot be told from these data in 1 of 2 curves (standard error above 100 %)."
    )
    assert sentence(result, "Ki") == ""


def test_curves_without_a_fit_do_not_count():
    result = fitted(TOLD, TRAPPED, np.zeros_like(TOLD), np.full_like(TOLD, np.nan))
    assert list(result.status[2:]) == [Status.NO_SIGNAL, Status.NOT_FINITE]
    assert "in 1 of 2 curves" in sentence(result, "VND")


def test_nothing_is_said_of_curves_that_tell_everything():
    noise = 1e-4 * TOLD.mean() * np.random.default_rng(0).standard_normal((20, len(FRAMES)))
    settings = NonlinearSettings(TWO_TISSUE_TRAPPING, effort=VOXELS)
    result = fit_curves(TOLD + noise, ARTERIAL, PLAIN, FRAMES.duration, settings)
    assert (result.status == Status.OK).all()
    assert undetermined(result) == ()
