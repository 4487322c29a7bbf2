"""Blood that cannot be used is refused in one line that says what, where, and what to do."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from petkin.errors import InputError
from petkin.inputs import from_blood


def _table(**changes) -> pd.DataFrame:
    table = pd.DataFrame(
        {
            "time": [0.5, 1, 2, 5, 10, 30, 60.0],
            "plasma_radioactivity": [5.0, 80, 30, 12, 8, 6, 4],
            "whole_blood_radioactivity": [4.0, 60, 25, 10, 7, 5, 4],
            "metabolite_parent_fraction": [np.nan, 0.99, np.nan, 0.9, 0.7, 0.4, 0.3],
        }
    )
    return table.assign(**changes)


def _automatic() -> pd.DataFrame:
    return pd.DataFrame({"time": [0.1, 0.2, 0.3, 0.4], "whole_blood_radioactivity": [0.0, 1, 4, 3]})


REFUSED = {
    "no time": (lambda: from_blood(_table().drop(columns="time"), where="a.tsv"), "no column 'time'"),
    "no rows": (lambda: from_blood(_table().iloc[:0], where="a.tsv"), "no rows"),
    "double time": (lambda: from_blood(_table(time=[0.5, 1, 1, 5, 10, 30, 60]), where="a.tsv"), "1 min.*appears twice"),
    "descending": (
        lambda: from_blood(_table(time=[0.5, 1, 2, 10, 5, 30, 60]), where="a.tsv"),
        "10 min .*followed by 5",
    ),
    "negative time": (lambda: from_blood(_table(time=[-1, 1, 2, 5, 10, 30, 60]), where="a.tsv"), "-1 min, before inj"),
    "missing time": (
        lambda: from_blood(_table(time=[0.5, 1, np.nan, 5, 10, 30, 60]), where="a.tsv"),
        "row 3 is missing",
    ),
    "text": (
        lambda: from_blood(_table(plasma_radioactivity=list("12345x7")), where="a.tsv"),
        "holds 'x' in data row 6",
    ),
    "infinite": (
        lambda: from_blood(_table(plasma_radioactivity=[1, 2, np.inf, 4, 5, 6, 7]), where="a.tsv"),
        "infinite",
    ),
    "empty column": (lambda: from_blood(_table(whole_blood_radioactivity=np.nan), where="a.tsv"), "no value at all"),
    "one value": (
        lambda: from_blood(_table(plasma_radioactivity=[5.0, *[np.nan] * 6]), where="a.tsv"),
        "one value only",
    ),
    "not positive": (lambda: from_blood(_table(plasma_radioactivity=-1.0), where="a.tsv"), "nowhere positive"),
    "fraction above 1": (
        lambda: from_blood(_table(metabolite_parent_fraction=[1, 1.2, 0.9, 0.8, 0.7, 0.6, 0.5]), where="a.tsv"),
        "1.2 at 1 min; a fraction lies between 0 and 1",
    ),
    "fraction below 0": (
        lambda: from_blood(_table(metabolite_parent_fraction=[1, 1, 0.9, 0.8, 0.7, 0.1, -0.5]), where="a.tsv"),
        "-0.5 at 60 min",
    ),
    "percent": (
        lambda: from_blood(_table(metabolite_parent_fraction=[99, 98, 90, 70, 50, 30, 20]), where="a.tsv"),
        "percent; divide by 100",
    ),
    "no plasma": (
        lambda: from_blood(_table().drop(columns="plasma_radioactivity"), where="a.tsv"),
        "plasma_from='whole_blood'",
    ),
    "no blood at all": (
        lambda: from_blood(_table()[["time", "metabolite_parent_fraction"]], where="a.tsv", plasma_from="whole_blood"),
        "no column 'whole_blood_radioactivity', manual or automatic",
    ),
    "no fraction to fit": (
        lambda: from_blood(_table().drop(columns="metabolite_parent_fraction"), where="a.tsv", parent_fraction="hill"),
        "to fit the model 'hill' to",
    ),
    "ends early": (
        lambda: from_blood(_table(), where="a.tsv", scan_end=90, required_until=85),
        "blood ends at 60 min but the last frame starts at 85 min; add samples",
    ),
    "minutes as seconds": (
        lambda: from_blood(_table(time=np.array([0.5, 1, 2, 5, 10, 30, 60]) / 60), where="a.tsv", required_until=55),
        "in minutes where seconds are stated",
    ),
    "seconds as minutes": (
        lambda: from_blood(_table(time=np.array([0.5, 1, 2, 5, 10, 30, 60]) * 60), where="a.tsv", scan_end=60),
        "in seconds where minutes are stated",
    ),
    "unknown plasma_from": (lambda: from_blood(_table(), where="a.tsv", plasma_from="serum"), "'serum'; use 'plasma'"),
    "haematocrit in percent": (lambda: from_blood(_table(), where="a.tsv", haematocrit=42.0), "such as 0.42"),
    "dispersion of nothing": (lambda: from_blood(_table(), where="a.tsv", dispersion=0.04), "no autosampler"),
    "autosampler without blood": (
        lambda: from_blood(
            _table(), _automatic().rename(columns={"whole_blood_radioactivity": "plasma_radioactivity"}), where="a.tsv"
        ),
        "read as whole blood",
    ),
    "autosampler double time": (
        lambda: from_blood(_table(), _automatic().assign(time=[0.1, 0.1, 0.2, 0.3]), where="a.tsv"),
        r"\(autosampler\): time 0.1 min",
    ),
    "nothing in common": (
        lambda: from_blood(_table().drop(columns="whole_blood_radioactivity"), _automatic(), where="a.tsv"),
        "no time in common",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused_in_one_clear_line(case):
    call, words = REFUSED[case]
    with pytest.raises(InputError, match=words) as caught:
        call()
    assert str(caught.value).startswith("a.tsv")
    assert "\n" not in str(caught.value)


def test_unknown_models_name_those_that_exist():
    with pytest.raises(InputError, match="'cubic'; use one of auto, constant, linear, exponential, interpolated"):
        from_blood(_table(), _automatic(), plasma_ratio="cubic")
    with pytest.raises(InputError, match="use one of auto, hill, power, exponential, sigmoid, interpolated"):
        from_blood(_table(), parent_fraction="gamma")
