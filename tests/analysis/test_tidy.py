"""Strict reading of tidy CSV files."""

from __future__ import annotations

from pathlib import Path

import pytest

from study.errors import InputError
from study.tidy_csv import read_csv

GOOD = "a,b,y\nx,1,1.5\nx,2,2.5\nz,1,\nz,2,4e0\n"


def write(folder: Path, text: str) -> Path:
    path = folder / "data.csv"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "text",
    [GOOD, "\ufeff" + GOOD.replace("\n", "\r\n"), GOOD.replace(",", ";"), GOOD.replace(",", "\t")],
)
def test_reads_common_shapes(tmp_path: Path, text: str) -> None:
    table = read_csv(write(tmp_path, text), "y", ["a"], "b")
    assert table["b"].tolist() == ["1", "2", "1", "2"]
    assert table["y"].isna().sum() == 1


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (GOOD.replace("a,b", "A,b"), "did you mean 'A'|Valid: A, b, y"),
        ("", "has no data"),
        ("a,b,y\n", "has no data"),
        (GOOD.replace("1.5", "1_0"), "row 2, column 'y': '1_0' is not a finite number"),
        (GOOD.replace("1.5", "inf"), "is not a finite number"),
        (GOOD.replace("1.5", "1e400"), "is not a finite number"),
        (GOOD.replace("1.5", "\u0661"), "is not a finite number"),
        (GOOD.replace(",", ";").replace("1.5", "1,5"), "write a decimal point"),
        (GOOD.replace("x,1,1.5", "x,1,1,5"), "has 4 cells, expected 3"),
        (GOOD.replace("x,1", ",1"), "the level is empty"),
        (GOOD.replace("z,1", "z, 1"), "differ in blanks alone"),
        (GOOD.replace("a,b", "b,b"), "occurs twice"),
    ],
)
def test_bad_files_are_named(tmp_path: Path, text: str, match: str) -> None:
    with pytest.raises(InputError, match=match):
        read_csv(write(tmp_path, text), "y", ["a"], "b")


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_csv(tmp_path / "none.csv", "y", ["a"])
