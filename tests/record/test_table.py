"""The tidy table: a row per case, failed ones visible, safe in a spreadsheet."""

import math

import pandas as pd
import pytest

from study.ground.errors import InputError, StoreError
from study.record.record import table, write_csv
from tests.record.samples import record


def test_one_row_a_case_and_failures_stay(tmp_path):
    frame = table(
        [
            record("a1"),
            record("b2", status="timeout", responses={}),
            record("c3", status="not-converged"),
        ]
    )
    columns = "case_id block material space status error seconds dofs"
    assert frame.columns.tolist() == columns.split()
    assert frame["status"].tolist() == ["converged", "timeout", "not-converged"]
    assert frame["error"][0] == 1.25
    assert frame["error"].isna().tolist() == [False, True, True]
    assert frame.attrs["units"] == {"error": "%"}
    assert frame["dofs"].tolist() == [120, 120, 120]


def test_seconds_as_a_response_is_one_column():
    frame = table([record(responses={"seconds": {"value": 2.0, "unit": "s"}})])
    assert frame.columns.tolist().count("seconds") == 1
    assert frame["seconds"].tolist() == [2.0]


def test_no_records():
    assert len(table([])) == 0
    assert "status" in table([]).columns


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (record("b2", levels={"material": "x"}), "different studies"),
        (record("a1"), "stands twice"),
        (record("b2", responses={"error": {"value": 1.0, "unit": "N"}}), "is in 'N', elsewhere"),
    ],
)
def test_what_does_not_belong_together_is_not_mixed(other, words):
    with pytest.raises(StoreError, match=words):
        table([record("a1"), other])


def test_a_factor_may_not_hide_a_column():
    with pytest.raises(StoreError, match="'status'"):
        table([record(levels={"status": "x"})])


def test_csv_comes_back_exactly(tmp_path):
    frame = table(
        [
            record(
                "a1",
                responses={"error": {"value": -1 / 3, "unit": "%"}},
                levels={"n": "-5", "m": 'a "b", c'},
            ),
            record("b2", status="crashed", levels={"n": "1", "m": "x"}, block=None),
        ]
    )
    write_csv(frame, tmp_path / "t.csv")
    again = pd.read_csv(tmp_path / "t.csv", dtype={"n": str})
    assert again["error"][0] == -1 / 3
    assert math.isnan(again["error"][1])
    assert again["n"].tolist() == ["-5", "1"]
    assert again["m"].tolist() == ['a "b", c', "x"]


@pytest.mark.parametrize(
    "name", ["=cmd|' /c calc'!A0", "+x", "-x", "@SUM(1)", "\tx", "\rx", "\uff1d1+1", " =1"]
)
def test_names_that_a_spreadsheet_would_run_are_refused(tmp_path, name):
    for frame in (table([record(levels={name: "x"})]), table([record(levels={"m": name})])):
        with pytest.raises(InputError, match="as a formula"):
            write_csv(frame, tmp_path / "t.csv")
    assert list(tmp_path.iterdir()) == []


def test_text_that_is_no_text(tmp_path):
    with pytest.raises(InputError, match="not valid text"):
        write_csv(table([record(levels={"m": "\ud800"})]), tmp_path / "t.csv")
