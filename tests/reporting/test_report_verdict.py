"""The verdict, the comparison and the truth, on numbers worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from petkin.dynamics import PiecewiseLinear
from petkin.errors import InputError
from petkin.fitting.results import Estimate, FitResult, Status
from petkin.inputs.input_function import InputFunction
from petkin.reporting import (
    FitReport,
    InputCurves,
    MapSet,
    ModelSection,
    ParameterMap,
    RegionCurves,
    TruthRow,
    curve_times,
)
from petkin.reporting.comparison import compare
from petkin.reporting.html import delay_text
from petkin.reporting.residuals import sign_runs
from petkin.reporting.tables import truth_summary, truth_table
from petkin.reporting.verdict import headline_symbols, judge

from . import report_examples as examples

FRAMES = examples.frames([60, 60])
WEIGHTS = np.ones(2)
MASK = np.ones((3, 3, 3), np.bool_)


def _fit(
    model: str, aicc: list[float], *, status: list[Status] | None = None, weights: np.ndarray = WEIGHTS
) -> FitResult:
    n = len(aicc)
    codes = np.array(status or [Status.OK] * n, np.uint8)
    estimates = (
        Estimate("k2", "1/min", np.ones(n), np.full(n, 50.0)),
        Estimate("VT", "mL/cm3", np.ones(n), np.arange(1.0, n + 1)),
    )
    return FitResult(model, estimates, np.ones(n), np.array(aicc), codes, weights, np.ones((n, 2)))


def _report(*sections: ModelSection, **more: object) -> FitReport:
    fits = [s.regional for s in sections if s.regional is not None]
    n = fits[0].status.size if fits else 0
    regions = RegionCurves(tuple(f"r{i}" for i in range(n)), FRAMES, np.ones((n, 2))) if n else None
    return FitReport("t", sections, regions, **more)  # type: ignore[arg-type]


def _words(text: str) -> str:
    return text.replace("\u202f", " ")


def test_clean_fits_are_clear() -> None:
    verdict = judge(_report(ModelSection("2TCM", _fit("2TCM", [1, 2, 3]))))
    assert verdict.grade == "clear"
    assert _words(verdict.sentences[0]) == "2TCM: all 3 regions fitted, none flagged; median standard error VT 2.0 %."


def test_flags_are_counted_by_reason_and_named_and_kept_out_of_the_median() -> None:
    status = [Status.OK, Status.AT_BOUND, Status.NOT_IDENTIFIABLE, Status.NO_SIGNAL, Status.OK]
    verdict = judge(_report(ModelSection("2TCM", _fit("2TCM", [1] * 5, status=status))))
    assert verdict.grade == "care"
    assert verdict.headline == "Read with care: some fits are flagged."
    assert _words(verdict.sentences[0]) == (
        "2TCM: 4 of 5 regions fitted, 2 flagged (1 on a bound and 1 not identifiable); not fitted: 1 with no signal; "
        "median standard error VT 3.0 %. See r1 (on a bound), r2 (not identifiable) and r3 (no signal)."
    )


def test_nothing_usable_is_said_so() -> None:
    verdict = judge(_report(ModelSection("2TCM", _fit("2TCM", [1, 1], status=[Status.NOT_CONVERGED] * 2))))
    assert verdict.grade == "unusable"
    assert "2 flagged (not converged)" in verdict.sentences[0]


def test_warnings_alone_ask_for_care() -> None:
    verdict = judge(_report(ModelSection("2TCM", _fit("2TCM", [1])), warnings=("a", "b")))
    assert (verdict.grade, verdict.headline) == (
        "care",
        "Read with care: there is something to know first. 2 warnings below.",
    )


def test_voxels_are_counted_inside_the_mask_only() -> None:
    status = np.full((10, 10, 10), Status.OUTSIDE, np.uint8)
    status[:5] = Status.OK
    status[0, 0] = Status.AT_BOUND
    entry = ParameterMap("VT", "mL/cm3", np.ones(status.shape), np.full(status.shape, 12.0))
    maps = examples.maps_of((entry,), status, (1, 1, 1))
    verdict = judge(_report(ModelSection("Logan", maps=maps)))
    assert verdict.grade == "clear"
    assert _words(verdict.sentences[0]) == (
        "Logan: all 500 voxels fitted, 10 flagged (on a bound, 2.0 %); median standard error VT 12 %."
    )


def test_aicc_prefers_the_smaller_and_is_undecided_below_two() -> None:
    first = ModelSection("1TCM", _fit("1TCM", [10, 10, 10, np.nan]))
    second = ModelSection("2TCM", _fit("2TCM", [5, 9, 30, 4]))
    comparison = compare(_report(first, second))
    assert comparison is not None
    np.testing.assert_allclose(comparison.delta, [[5, 1, 0, np.nan], [0, 0, 20, 0]])
    assert [comparison.preferred(r) for r in range(4)] == ["2TCM", "undecided", "1TCM", ""]
    assert comparison.summary == "AICc prefers 1TCM in 1, 2TCM in 1 and neither (Δ < 2) in 1 of 3 regions."


def test_models_on_other_data_or_weights_are_left_out_of_the_comparison() -> None:
    one, two = ModelSection("1TCM", _fit("1TCM", [1])), ModelSection("2TCM", _fit("2TCM", [2]))
    logan = ModelSection("Logan", _fit("Logan", [-99]), comparable=False)
    reweighted = ModelSection("2TCM3k", _fit("2TCM3k", [0], weights=2 * WEIGHTS))
    comparison = compare(_report(one, two, logan, reweighted))
    assert comparison is not None
    assert comparison.models == ("1TCM", "2TCM")
    assert comparison.left_out == ("Logan", "2TCM3k")
    assert compare(_report(one, logan)) is None
    assert compare(_report(one)) is None


def test_truth_is_compared_in_percent() -> None:
    rows = (
        TruthRow("a", "K1", "mL/cm3/min", 0.5, 0.51),
        TruthRow("b", "K1", "mL/cm3/min", 0.2, 0.18),
        TruthRow("c", "K1", "mL/cm3/min", 0.4, 0.404),
        TruthRow("a", "k4", "1/min", 0.0, 0.01),
    )
    assert [r.percent_error for r in rows[:3]] == pytest.approx([2, -10, 1])
    summary = truth_summary(rows)
    assert [_words(c.text) for c in summary.rows[0][1:]] == ["+1.0 %", "2.0 %", "−10 %"]
    assert summary.rows[0][3].note == "b"
    assert [c.text for c in summary.rows[1][1:]] == ["n/a"] * 3
    table = truth_table(rows)
    assert [h[1] for h in table.heads] == ["", "mL/cm³/min", "min⁻¹"]
    assert (_words(table.rows[1][1].text), table.rows[1][1].note) == ("−10 %", "0.1800 (0.2000)")
    assert table.rows[1][2].text == "n/a"


def test_delay_is_told_in_minutes_and_seconds() -> None:
    fit = _fit("2TCM", [1])
    assert delay_text(replace(fit, delay=0.1, delay_se=0.01)) == "0.100 ± 0.010 min (6.00 ± 0.60 s), estimated"
    assert delay_text(replace(fit, delay=0.002, delay_se=0.0018)) == "0.0020 ± 0.0018 min (0.12 ± 0.11 s), estimated"
    assert delay_text(replace(fit, delay=0.1)) == "0.100 min (6.00 s), not estimated with an error"
    assert delay_text(fit) == "none"


def test_input_curves_come_from_an_input_function_with_its_samples() -> None:
    import pandas as pd
    import torch

    ramp = PiecewiseLinear(
        torch.tensor([0.0, 10.0], dtype=torch.float64), torch.tensor([0.0, 20.0], dtype=torch.float64)
    )
    table = pd.DataFrame(
        {"time": [1.0, 2.0], "plasma_radioactivity": [2.0, np.nan], "AIF": [2.0, 4.0], "other": ["x", "y"]}
    )
    curves = InputCurves.from_input(InputFunction(ramp, ramp, 10.0, table, ("repaired",)), 8.0)
    np.testing.assert_allclose(curves.aif, 2 * curve_times(8.0))
    assert [(s.curve, s.time.tolist()) for s in curves.samples] == [("AIF", [1.0, 2.0]), ("total plasma", [1.0])]
    assert (curves.end, curves.remarks) == (10.0, ("repaired",))
    assert InputCurves.from_input(InputFunction(ramp, ramp), 2.0).samples == ()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: FitReport("t", ()), "no model"),
        (lambda: ModelSection("2TCM"), "neither a regional fit nor maps"),
        (lambda: FitReport("t", (ModelSection("2TCM", _fit("2TCM", [1])),)), "no regional curves"),
        (lambda: RegionCurves(("a",), FRAMES, np.ones((2, 2))), "1 region names"),
        (
            lambda: replace(
                _report(ModelSection("2TCM", _fit("2TCM", [1]))), models=(ModelSection("2TCM", _fit("x", [1, 2])),)
            ),
            "2 curves",
        ),
        (lambda: MapSet((), np.zeros(9, np.uint8), MASK[0], (1, 1, 1)), "three axes"),
        (lambda: MapSet((), np.full(27, 99, np.uint8), MASK, (1, 1, 1)), "code 99"),
        (lambda: MapSet((), np.zeros(27, np.uint8), MASK, (1, 1, 1), "RRS"), "'RRS'"),
        (lambda: MapSet((), np.zeros(26, np.uint8), MASK, (1, 1, 1)), "status map .* 27 voxels"),
        (lambda: MapSet((ParameterMap("VT", "", np.ones(9)),), np.zeros(27, np.uint8), MASK, (1, 1, 1)), "VT map"),
        (
            lambda: MapSet(
                (ParameterMap("VT", "", np.ones(27), np.ones((3, 9))),), np.zeros(27, np.uint8), MASK, (1, 1, 1)
            ),
            "SE of VT map",
        ),
        (lambda: InputCurves(np.ones(3), np.ones(4)), "aif curve has 4 values for 3 times"),
    ],
)
def test_contents_that_do_not_fit_together_are_refused(make, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()


def _left_over(signs: str) -> tuple[RegionCurves, FitResult]:
    """A fit of ones whose residuals have these signs."""
    left = np.array([[0.1 if s == "+" else -0.1 for s in signs]])
    curves = RegionCurves(("a",), examples.frames([60] * len(signs)), 1 + left)
    return curves, replace(_fit("1TCM", [1]), predicted=np.ones(left.shape), weights=np.ones(len(signs)))


@pytest.mark.parametrize(
    ("signs", "found", "expected", "systematic"),
    [
        # mu = 2 * 10 * 10 / 20 + 1 = 11, sd = sqrt(10 * 9 / 19) = 2.176: 4 runs lie 3.2 sd below, 5 runs 2.8 sd
        ("+" * 5 + "-" * 5 + "+" * 5 + "-" * 5, 4, 11.0, True),
        ("+" * 5 + "-" * 5 + "+" * 4 + "-" * 5 + "+", 5, 11.0, False),
        ("+-" * 10, 20, 11.0, False),
        ("+" * 20, 1, 1.0, False),
    ],
)
def test_runs_of_one_sign_betray_a_systematic_misfit(signs: str, found: int, expected: float, systematic: bool) -> None:
    runs = sign_runs(*_left_over(signs), 0)
    assert (runs.found, runs.expected, runs.systematic) == (found, pytest.approx(expected), systematic)


def test_rounding_is_no_systematic_misfit() -> None:
    curves, fit = _left_over("+" * 10 + "-" * 10)
    assert sign_runs(curves, fit, 0).systematic
    assert not sign_runs(replace(curves, tacs=1 + 1e-5 * (curves.tacs - 1)), fit, 0).systematic


def test_a_systematic_misfit_is_in_the_verdict() -> None:
    curves, fit = _left_over("+" * 10 + "-" * 10)
    assert (
        "Residuals are systematic in 1 of 1 regions."
        in judge(FitReport("t", (ModelSection("1TCM", fit),), curves)).sentences[0]
    )


def test_one_outcome_and_one_delivery_are_quoted() -> None:
    assert headline_symbols(("K1", "k2", "Ki", "VT", "BPND")) == ("VT", "K1")
    assert headline_symbols(("BPND", "R1")) == ("BPND", "R1")
    assert headline_symbols(("slope",)) == ("slope",)
