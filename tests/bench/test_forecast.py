"""Forecasts of withheld halves: on curves whose model is known, the right fit is right and what is withheld unseen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from petkin.errors import InputError
from petkin.hybrid import Settings
from petkin.imaging import FrameObservation, FrameSchedule
from petkin.inputs import InputFunction, feng_plasma
from petkin.kinetics import TWO_TISSUE
from petkin.learning import Known
from petkin_bench import forecast
from petkin_bench.forecast import Scan, measure_forecasts, read_scans, summary

_SEEN = FrameObservation(
    FrameSchedule(np.array([0, 1, 2, 4, 7, 12, 18, 24, 30, 40.0]), np.array([1, 2, 4, 7, 12, 18, 24, 30, 40, 60.0])),
    0.0063,
)


def scans() -> tuple[Scan, ...]:
    plasma = feng_plasma()
    rates = torch.tensor([[0.2, 0.2, 0.05, 0.03, 0.04], [0.1, 0.1, 0.02, 0.02, 0.03]]).double()
    values = TWO_TISSUE.frame_values(rates, InputFunction(plasma, plasma), _SEEN).numpy()
    seen = _SEEN.frames.end <= 30
    return tuple(
        Scan(
            f"sub-{person}",
            person,
            (1.0 + 0.1 * i) * values,
            ("a", "b"),
            Known(plasma, plasma, _SEEN),
            np.ones(10),
            seen,
        )
        for i, person in enumerate("123")
    )


def test_every_curve_is_forecast_in_every_way_from_what_is_seen(monkeypatch):
    monkeypatch.setattr(forecast, "_LEARN", Settings(steps=4, rate=1e-2))
    monkeypatch.setattr(forecast, "_IDENTIFY", Settings(steps=4, rate=1e-2))
    rows = [row for some in measure_forecasts(scans()) for row in some]
    found = summary(rows)
    assert set(found.index) == {"fit_1TCM", "fit_2TCM", *(name for name, *_ in forecast.LEARNED)}
    assert len(rows) == 6 * len(found)
    assert found.loc["fit_2TCM", "error"] < 1e-3
    assert 1e-3 < found.loc["fit_1TCM", "error"] < 0.5
    assert found.loc["fit_2TCM", "better"] == 1.0
    other = tuple(replace(s, curves=np.where(s.seen, s.curves, 99.0)) for s in scans())
    for a, b in zip(scans(), other):
        np.testing.assert_array_equal(forecast._fit(a, "1TCM"), forecast._fit(b, "1TCM"))
        assert forecast._scale(a) == forecast._scale(b)


def test_a_folder_without_scans_is_one_line(tmp_path):
    with pytest.raises(InputError, match="no PET scan"):
        read_scans(tmp_path)
