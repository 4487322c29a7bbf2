"""From blood samples to the input function, against a laboratory whose truth is known."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from petkin.inputs import from_blood, input_table

TAU = 2.6 / 60


def _at(forcing, *times: float) -> np.ndarray:
    return forcing(torch.tensor(times, dtype=torch.float64)).numpy()


def _area(forcing, until: float) -> float:
    return float(forcing.integral(torch.tensor([until], dtype=torch.float64)))


@pytest.fixture(scope="module")
def noise_free(laboratory):
    return from_blood(laboratory.manual(), laboratory.automatic(), dispersion=TAU, scan_end=90.0, required_until=85.0)


def test_noise_free_areas_are_recovered_to_half_a_percent(laboratory, noise_free):
    for until in (2.0, 10.0, 90.0):
        assert noise_free.area(until) == pytest.approx(laboratory.area(laboratory.plasma, until), rel=5e-3)
        assert _area(noise_free.whole_blood, until) == pytest.approx(
            laboratory.area(laboratory.whole_blood, until), rel=5e-3
        )
        assert _area(noise_free.total_plasma, until) == pytest.approx(
            laboratory.area(laboratory.total_plasma, until), rel=5e-3
        )


def test_noise_free_curve_follows_the_truth(laboratory, noise_free):
    t = np.concatenate([np.arange(1.0, 10.0, 0.05), np.arange(10.0, 90.0, 0.5)])
    np.testing.assert_allclose(_at(noise_free.plasma, *t), laboratory.plasma(t), rtol=0.02)
    peak = laboratory.plasma(np.arange(0.5, 1.2, 1e-3)).max()
    assert _at(noise_free.plasma, *np.arange(0.5, 1.2, 1e-3)).max() == pytest.approx(peak, rel=0.02)
    assert noise_free.parent_fraction_fit.name == "hill"


def test_noisy_areas_are_recovered_without_bias(laboratory):
    errors = []
    for seed in range(8):
        manual = laboratory.manual(0.03, seed)
        manual["metabolite_parent_fraction"] = manual["metabolite_parent_fraction"].clip(upper=1.0)
        found = from_blood(manual, laboratory.automatic(0.03, seed), dispersion=TAU, scan_end=90.0)
        errors.append(found.area(90.0) / laboratory.area(laboratory.plasma, 90.0) - 1)
    assert abs(np.mean(errors)) < 0.01
    assert np.abs(errors).max() < 0.04


def test_manual_samples_alone_recover_all_but_the_peak(laboratory):
    found = from_blood(laboratory.manual(), scan_end=90.0)
    truth = laboratory.area(laboratory.plasma, 90.0, 2.0)
    assert found.area(90.0) - found.area(2.0) == pytest.approx(truth, rel=5e-3)
    assert found.plasma.knots.size < 400


def test_the_knots_are_few_and_the_pieces_true(laboratory, noise_free):
    assert noise_free.plasma.knots.size < 800
    t = np.linspace(0, 92, 9173)
    product = _at(noise_free.total_plasma, *t) * noise_free.parent_fraction_fit(t)
    np.testing.assert_allclose(_at(noise_free.plasma, *t), product, rtol=1e-3, atol=1e-3)


def test_dispersion_smears_the_rise_and_its_correction_restores_it(laboratory):
    t = np.arange(0.55, 0.75, 1e-3)
    truth = laboratory.whole_blood(t)
    corrected = from_blood(laboratory.manual(), laboratory.automatic(), dispersion=TAU)
    left = from_blood(laboratory.manual(), laboratory.automatic())
    assert np.abs(_at(corrected.whole_blood, *t) - truth).max() < 0.02 * truth.max()
    assert np.abs(_at(left.whole_blood, *t) - truth).max() > 0.15 * truth.max()
    assert any("dispersion of 2.6 s" in remark for remark in corrected.remarks)


@pytest.mark.parametrize("model", ["constant", "linear", "exponential", "interpolated", "auto"])
def test_every_ratio_model_works_and_the_right_one_is_exact(laboratory, model):
    found = from_blood(laboratory.manual(), laboratory.automatic(), dispersion=TAU, plasma_ratio=model)
    rel = 2e-3 if model in {"exponential", "auto"} else 0.2
    assert found.area(2.0) == pytest.approx(laboratory.area(laboratory.plasma, 2.0), rel=rel)
    assert any(remark.startswith("Plasma over whole blood:") for remark in found.remarks)


def test_a_gap_between_the_samplers_is_bridged(laboratory):
    manual = laboratory.manual()
    manual = manual[(manual.time == 1.0) | (manual.time > 12)]
    found = from_blood(manual, laboratory.automatic(until=8.0), dispersion=TAU, plasma_ratio="auto")
    assert any("gap to the first manual sample at 15.00 min" in remark for remark in found.remarks)
    assert _area(found.whole_blood, 90.0) == pytest.approx(laboratory.area(laboratory.whole_blood, 90.0), rel=0.01)
    assert np.diff(_at(found.whole_blood, *np.linspace(8, 15, 200))).max() < 1e-9


def test_an_autosampler_that_outlasts_the_manual_samples_is_used_alone(laboratory):
    manual = laboratory.manual()
    found = from_blood(manual[manual.time < 25], laboratory.automatic(until=30.0), dispersion=TAU, plasma_ratio="auto")
    assert found.end == pytest.approx(30.0)
    assert any("used alone" in remark for remark in found.remarks)
    assert any("too few to fit" in remark for remark in found.remarks)  # five samples up to 20 min, held after
    assert found.area(20.0) == pytest.approx(laboratory.area(laboratory.plasma, 20.0), rel=0.01)
    assert found.area(30.0) == pytest.approx(laboratory.area(laboratory.plasma, 30.0), rel=0.05)


def test_an_autosampler_out_of_tune_is_reported_and_left(laboratory):
    automatic = laboratory.automatic()
    automatic["whole_blood_radioactivity"] *= 1.3
    found = from_blood(laboratory.manual(), automatic, dispersion=TAU)
    assert any("1.30 x the manual whole blood" in remark for remark in found.remarks)
    assert found.area(2.0) == pytest.approx(1.3 * laboratory.area(laboratory.plasma, 2.0), rel=0.01)
    assert _at(found.plasma, 30.0)[0] == pytest.approx(laboratory.plasma(np.array([30.0]))[0], rel=0.01)


def test_negative_samples_are_kept_and_counted(laboratory):
    automatic = laboratory.automatic()
    automatic.loc[3, "whole_blood_radioactivity"] = -0.4
    found = from_blood(laboratory.manual(), automatic)
    assert any("1 of 600 autosampler values are negative (lowest -0.4)" in remark for remark in found.remarks)
    assert _at(found.whole_blood, automatic.time[3])[0] == pytest.approx(-0.4)


def test_rows_with_whole_blood_alone_give_plasma_by_the_ratio(laboratory):
    manual = laboratory.manual()
    manual.loc[~manual.time.isin([1, 5, 10.5, 20, 40, 60, 90]), "plasma_radioactivity"] = np.nan
    found = from_blood(manual, plasma_ratio="auto")
    assert any("hold whole blood alone" in remark for remark in found.remarks)
    t = np.array([3.0, 8.0, 30.0, 75.0])
    np.testing.assert_allclose(_at(found.total_plasma, *t), laboratory.total_plasma(t), rtol=5e-3)


def test_manual_plasma_alone_takes_whole_blood_from_the_autosampler(laboratory):
    manual = laboratory.manual().drop(columns="whole_blood_radioactivity")
    found = from_blood(manual, laboratory.automatic(), dispersion=TAU, plasma_ratio="constant")
    assert any("Manual samples hold plasma alone" in remark for remark in found.remarks)
    assert _area(found.whole_blood, 10.0) == pytest.approx(laboratory.area(laboratory.whole_blood, 10.0), rel=0.01)


def test_plasma_alone_stands_for_whole_blood_with_a_remark(laboratory):
    manual = laboratory.manual().drop(columns="whole_blood_radioactivity")
    t = np.array([5.0, 40.0])
    found = from_blood(manual)
    np.testing.assert_allclose(_at(found.whole_blood, *t), laboratory.total_plasma(t), rtol=1e-9)
    assert any("no whole blood; it is taken as 1 x plasma" in remark for remark in found.remarks)
    with_cells = from_blood(manual, haematocrit=0.4)
    np.testing.assert_allclose(_at(with_cells.whole_blood, *t), 0.6 * laboratory.total_plasma(t), rtol=1e-9)


def test_whole_blood_stands_for_plasma_where_asked(laboratory):
    manual = laboratory.manual().drop(columns="plasma_radioactivity")
    t = np.array([5.0, 40.0])
    found = from_blood(manual, plasma_from="whole_blood")
    np.testing.assert_allclose(_at(found.total_plasma, *t), laboratory.whole_blood(t), rtol=1e-9)
    np.testing.assert_allclose(
        _at(found.plasma, 40.0), laboratory.whole_blood(t[1:]) * laboratory.fraction(t[1:]), rtol=0.01
    )
    with_cells = from_blood(manual, plasma_from="whole_blood", haematocrit=0.4)
    np.testing.assert_allclose(_at(with_cells.total_plasma, *t), laboratory.whole_blood(t) / 0.6, rtol=1e-9)


def test_without_parent_fraction_plasma_is_the_input_with_a_remark(laboratory):
    manual = laboratory.manual()
    bare = from_blood(manual.drop(columns="metabolite_parent_fraction"))
    asked = from_blood(manual, parent_fraction="none")
    for found in (bare, asked):
        np.testing.assert_allclose(
            _at(found.plasma, 5.0, 40.0), laboratory.total_plasma(np.array([5.0, 40.0])), rtol=1e-9
        )
        assert found.parent_fraction is None
    assert any("No parent fraction" in remark for remark in bare.remarks)
    assert any("as asked" in remark for remark in asked.remarks)


def test_a_given_aif_is_used_as_it_is(laboratory):
    manual = laboratory.manual()
    manual["AIF"] = 7.0 * laboratory.plasma(manual.time.to_numpy())
    found = from_blood(manual, scan_end=90.0)
    t = manual.time.to_numpy()
    np.testing.assert_allclose(_at(found.plasma, *t), manual.AIF, rtol=1e-9)
    np.testing.assert_allclose(_at(found.total_plasma, *t), manual.plasma_radioactivity, rtol=1e-9)
    assert any("input function itself" in remark for remark in found.remarks)
    alone = from_blood(manual[["time", "AIF"]])
    np.testing.assert_allclose(_at(alone.whole_blood, *t), manual.AIF, rtol=1e-9)
    assert alone.total_plasma is None


def test_the_tail_goes_on_exponentially(laboratory):
    times = np.array([0.5, 1, 2, 5, 10, 20, 30, 40, 50, 60.0])
    table = pd.DataFrame({"time": times, "plasma_radioactivity": 20 * np.exp(-0.02 * times)})
    table["whole_blood_radioactivity"] = table.plasma_radioactivity
    found = from_blood(table, scan_end=90.0, required_until=55.0)
    np.testing.assert_allclose(_at(found.plasma, 75.0, 90.0), 20 * np.exp(-0.02 * np.array([75.0, 90.0])), rtol=1e-3)
    assert found.end == 60.0
    assert any("plasma and whole blood end at 60.00 min" in remark for remark in found.remarks)
    rising = table.assign(plasma_radioactivity=5 + 0.01 * times)
    held = from_blood(rising, scan_end=90.0)
    assert _at(held.plasma, 89.0)[0] == pytest.approx(5.6, rel=1e-6)


def test_a_late_first_sample_is_reported(laboratory):
    manual = laboratory.manual()
    found = from_blood(manual)
    assert any("The first sample, at 1.00 min, holds" in remark for remark in found.remarks)
    assert _at(found.total_plasma, 0.5)[0] == pytest.approx(0.5 * laboratory.total_plasma(np.array([1.0]))[0], rel=1e-9)


def test_nothing_comes_before_the_bolus(noise_free):
    assert _at(noise_free.plasma, -1.0)[0] == 0.0
    assert abs(_at(noise_free.plasma, 0.3)[0]) < 0.05


@pytest.mark.parametrize("delay", [-0.2, 0.35])
def test_a_delay_moves_every_part_alike(noise_free, delay):
    moved = noise_free.delayed(delay)
    t = np.array([1.0, 5.0, 40.0])
    there, here = input_table(moved, t + delay), input_table(noise_free, t)
    for column in ("whole_blood_radioactivity", "plasma_radioactivity", "metabolite_parent_fraction", "AIF"):
        np.testing.assert_allclose(there[column], here[column], rtol=1e-9)
    assert moved.end == pytest.approx(noise_free.end + delay)
    assert noise_free.delayed(0.0) is noise_free


def test_the_samples_come_back_for_reports(noise_free):
    assert set(noise_free.samples.sampler) == {"manual", "autosampler"}
    assert noise_free.samples.time.is_monotonic_increasing
    assert noise_free.samples.metabolite_parent_fraction.count() == 8


@settings(max_examples=5, deadline=None)
@given(st.floats(0.01, 100.0))
def test_activity_scales_through(factor):
    times = np.array([0.5, 1, 2, 5, 10, 20, 40, 60.0])
    values = np.array([5.0, 80, 30, 12, 8, 6, 5, 4])
    fractions = np.array([np.nan, 0.98, np.nan, 0.9, 0.7, 0.5, 0.3, 0.2])

    def table(scale: float) -> pd.DataFrame:
        return pd.DataFrame(
            {
                "time": times,
                "plasma_radioactivity": scale * values,
                "whole_blood_radioactivity": 0.8 * scale * values,
                "metabolite_parent_fraction": fractions,
            }
        )

    assert from_blood(table(factor)).area(60.0) == pytest.approx(factor * from_blood(table(1.0)).area(60.0), rel=1e-9)
