"""A record comes back as it went, or is found to be damaged; the tidy table of records."""

from __future__ import annotations

import json
import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from study.ground.curve import Curve
from study.ground.errors import InputError, StoreError
from study.record.record import CurveKey, Record, replicate, seal, table, write_csv
from tests.record.samples import record

finite = st.floats(allow_nan=False, allow_infinity=False)
names = st.text(min_size=1, max_size=20)
MEASURED = CurveKey("measured", "p")


@given(value=finite, unit=names, force=st.lists(finite, min_size=1, max_size=5), level=names)
def test_round_trip_is_exact(value, unit, force, level):
    values = np.array(force)
    curve = Curve(np.arange(1.0, len(force) + 1), values, values, {"C10": values})
    one = record(
        levels={"m": level},
        responses={"e": {"value": value, "unit": unit}},
        curves={MEASURED: curve},
    )
    two = Record.from_json(one.to_json())
    assert two == one
    assert two.to_json() == one.to_json()
    assert two.curves[MEASURED].force_N.tolist() == force
    assert two.levels == {"m": level}


def test_numbers_that_are_not_finite_become_null_with_a_reason():
    one = record(
        responses={"error": {"value": math.nan, "unit": "%"}},
        timings={"total": math.inf},
        curves={MEASURED: Curve(np.array([1.0, 2.0]), np.array([1.0, math.nan]))},
    )
    text = one.to_json()
    assert "NaN" not in text
    assert "Infinity" not in text
    two = Record.from_json(text)
    assert two.responses["error"]["value"] is None
    assert two.extra["not_finite"] == {
        "responses.error.value": "nan",
        "timings.total": "inf",
        "curves.measured:p.force_N.1": "nan",
    }
    assert math.isnan(two.curves[MEASURED].force_N[1])
    # once read, writing changes nothing any more, and what was lost stays listed
    again = Record.from_json(two.to_json())
    assert again.extra["not_finite"].keys() == two.extra["not_finite"].keys()


def test_a_failed_case_has_no_response():
    assert record().response("error") == 1.25
    assert math.isnan(record(status="not-converged").response("error"))
    assert math.isnan(record().response("unknown"))


def test_an_unknown_status_is_a_bug_that_raises():
    with pytest.raises(ValueError, match="did you mean 'converged'"):
        record(status="convergd")


def test_what_json_cannot_hold_raises():
    with pytest.raises(TypeError, match=r"extra\.x: set has no place"):
        record(extra={"x": {1}}).to_json()
    with pytest.raises(TypeError, match="keys must be text"):
        record(extra={"x": {1: 2}}).to_json()


def test_every_single_changed_byte_is_found():
    text = record().to_json().encode()
    for k in range(0, len(text) - 1, 7):
        damaged = text[:k] + bytes([text[k] ^ 1]) + text[k + 1 :]
        with pytest.raises(StoreError):
            Record.from_json(damaged)
    for k in range(0, len(text) - 2, 11):
        with pytest.raises(StoreError):
            Record.from_json(text[:k])


def forged(**changes):
    """A record with a right checksum and wrong content."""
    content = json.loads(record().to_json())["content"]
    return seal({**content, **changes})


@pytest.mark.parametrize(
    "text",
    [
        forged(status="great"),
        forged(curves={"p": {"displacement_mm": [1], "force_N": [1]}}),
        forged(more=1),
        seal([1]),
        record().to_json().replace('"schema":1', '"schema":2'),
        "[" * 100_000,
        '{"schema":1,"checksum":"","content":1e999}',
        '{"schema":1,"checksum":"","content":NaN}',
        b"\xff\xfe",
        b"",
    ],
)
def test_wrong_content_is_refused_cleanly(text):
    with pytest.raises(StoreError):
        Record.from_json(text, "here")


#: a record as an earlier version wrote it, its checksum with it
STORED = (
    '{"schema":1,"checksum":"2e6305fe768f2e120168a8b8304ff640a61c0714aa8826b1490498a200592027",'
    '"content":{"block":"M1","case_id":"a1b2","curves":{"measured:B":{"displacement_mm":[1.0,2.0],'
    '"force_N":[3.0,7.0]},"predicted:B":{"displacement_mm":[1.0,2.0],"force_N":[3.5,7.5]}},'
    '"extra":{"directions":[{"fit":"A","responses":{"mu0":{"unit":"kPa","value":10.5}},'
    '"role":"score","scatter_N":[0.1,0.2],"score":"B"}],"mesh_seed":2},"fit":{"A":{"identifiable":'
    'true,"key":"f1","method":"inverse-fem","names":["C10"],"values":{"C10":0.00525}}},'
    '"input_hash":"h1","levels":{"material":"neo-hookean"},"mesh":{"dofs":120,"elements":40,'
    '"mesh_size_mm":1.5},"message":"","parameters":{"C10":{"ci95":[4.0,6.5],"standard_error":0.5,'
    '"unit":"kPa","value":5.25}},"responses":{"mu0":{"unit":"kPa","value":10.5},"rms_force_error":'
    '{"u_steps":0.01,"unit":"N","value":0.25}},"solver":{"name":"pardiso","snaps_mm":[]},"status":'
    '"converged","study":"small","timings":{"total":2.0},"versions":{"study":"1"}}}\n'
)


def test_a_stored_record_is_read_and_written_as_it_was():
    found = Record.from_json(STORED)
    assert found.to_json() == STORED
    assert found.response("mu0") == 10.5
    assert found.responses["rms_force_error"]["u_steps"] == 0.01
    assert found.fits[0]["values"] == {"C10": 0.00525}
    assert [one["score"] for one in found.scores] == ["B"]
    measured, predicted = found.pair("B") or pytest.fail("the curves are there")
    assert (measured.force_N[1], predicted.force_N[1]) == (7.0, 7.5)
    assert found.first_pair() is not None
    assert found.pair("A") is None
    assert replicate(found.extra, "mesh_seed") == 2
    assert replicate(found.extra, "noise_seed") == 0


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
