"""Strict reading of tidy CSV files."""

import pytest

from study.ground.errors import InputError
from study.ground.tabular import read_tidy_csv as read_csv

GOOD = "a,b,y\nx,1,1.5\nx,2,2.5\nz,1,\nz,2,4e0\n"


def write(folder, text):
    path = folder / "data.csv"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "text",
    [GOOD, "\ufeff" + GOOD.replace("\n", "\r\n"), GOOD.replace(",", ";"), GOOD.replace(",", "\t")],
)
def test_reads_common_shapes(tmp_path, text):
    table = read_csv(write(tmp_path, text), "y", ["a"], "b")
    assert table["b"].tolist() == ["1", "2", "1", "2"]
    assert table["y"].isna().sum() == 1


@pytest.mark.parametrize("mark", ["-", "\u2013", "--", "#N/A", "None", "NA", "*"])
def test_marks_of_a_missing_response(tmp_path, mark):
    table = read_csv(write(tmp_path, GOOD.replace("z,1,", f"z,1,{mark}")), "y", ["a"], "b")
    assert table["y"].isna().tolist() == [False, False, True, False]


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (GOOD.replace("a,b", "A,b"), "did you mean 'A'|Valid: A, b, y"),
        ("", "the file is empty"),
        ("a,b,y\n", "no row of data"),
        (GOOD.replace("1.5", "1_0"), "data.csv:2: column 'y': must be a finite number, got '1_0'"),
        (GOOD.replace("1.5", "inf"), "must be a finite number"),
        (GOOD.replace("1.5", "1e400"), "must be a finite number"),
        (GOOD.replace("1.5", "\u0661"), "must be a finite number"),
        (GOOD.replace(",", ";").replace("1.5", "1,5"), "write --decimal ,"),
        (GOOD.replace(",", ";").replace("2.5", "2,5"), "(?s)data.csv:3:.* declared: --decimal ,"),
        (GOOD.replace("x,1,1.5", "x,1,1,5"), "data.csv:2: has 4 cells where the header has 3"),
        ("\n" + GOOD.replace("z,1", ",1"), "data.csv:5: column 'a': the level is empty"),
        (GOOD.replace("z,1", "z, 1"), "data.csv:4: .* of line 2 differ in blanks alone"),
        (GOOD.replace("a,b", "b,b"), "stands 2 times in the header"),
    ],
)
def test_bad_files_are_named(tmp_path, text, match):
    with pytest.raises(InputError, match=match):
        read_csv(write(tmp_path, text), "y", ["a"], "b")


def test_a_decimal_comma_is_read_where_it_is_declared(tmp_path):
    text = GOOD.replace(",", ";").replace(".", ",")
    table = read_csv(write(tmp_path, text), "y", ["a"], "b", decimal=",")
    assert table["y"].tolist()[:2] == [1.5, 2.5]


def test_lines_of_a_spreadsheet_without_a_cell_are_left_out(tmp_path):
    assert len(read_csv(write(tmp_path, GOOD + ",,\n,,\n"), "y", ["a"], "b")) == 4


def test_missing_file(tmp_path):
    with pytest.raises(InputError, match="there is no such file"):
        read_csv(tmp_path / "none.csv", "y", ["a"])
