"""Strict reading of tidy CSV files."""

import numpy as np
import pandas as pd
import pytest

import study
from study.ground.errors import InputError, RefusedError
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
        ("made by X\n" + GOOD, "the first is line 2: if it names the columns, delete the lines"),
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


def test_levels_that_are_one_number_or_quantity_are_named():
    random = np.random.default_rng(4)
    for levels, named in (
        (["1", "1.0", "2"], "'1' and '1.0' are one quantity"),
        (["10 mm", "1 cm", "5 mm"], "'10 mm' and '1 cm' are one quantity"),
        (["2024-03-01", "01.03.2024", "02.03.2024"], "'2024-03-01' and '01.03.2024' are one date"),
        (["25/3/2024", "1/3/2024", "2024-03-25"], "'25/3/2024' and '2024-03-25' are one date"),
        (["5 mm", "5 cm", "5 N"], ""),
    ):
        table = pd.DataFrame({"a": levels * 4, "y": random.normal(10, 0.2, 12)})
        notes = [note for note in study.anova(table, "y", ["a"]).notes if "are one " in note]
        assert [named in note for note in notes] == [True] * bool(named)


def test_blocks_that_were_copied_and_moved_are_refused():
    """Another zero of the instrument leaves what a block adds to differences as it is."""
    random = np.random.default_rng(20)
    y = (10 + random.normal(0, 0.5, (3, 4))).round(3)
    rows = [(b, a, y[b, a]) for b in range(3) for a in range(4)]
    table = pd.DataFrame(rows, columns=["s", "a", "y"]).astype({"s": str, "a": str})
    moved = table.assign(s="again " + table["s"], y=(table["y"] + 5).round(3))
    assert study.anova(table, "y", ["a"], block="s").effects
    with pytest.raises(RefusedError, match="again 0 repeats 0"):
        study.anova(pd.concat([table, moved]), "y", ["a"], block="s")


def test_a_mark_among_responses_is_to_be_left_empty_not_deleted(tmp_path):
    """Without the rows below a limit the mean of what is left lies above it."""
    file = tmp_path / "runs.csv"
    for mark in ("<0.5", "n.d."):
        file.write_text(f"a,y\nA,{mark}\nA,.8\nB,1.1\nB,1.2\n")
        with pytest.raises(InputError) as refused:
            study.analyze(file, "y", ["a"])
        assert "leave the cell empty" in str(refused.value)
        assert "delete" not in str(refused.value)


@pytest.mark.parametrize("seed", range(5))
def test_blocks_far_apart_that_lack_cells_are_no_copies(seed):
    """What cells that are missing leave of the blocks in cell means is no interaction."""
    random = np.random.default_rng(seed)
    table = pd.DataFrame([(b, a) for b in range(6) for a in range(4)], columns=["s", "a"])
    offset = 3000 * random.normal(size=6)
    table["y"] = (offset[table["s"]] + random.normal(0, 0.05, 24)).round(4)
    lacking = table.drop(index=random.choice(24, 5, replace=False))
    assert study.anova(lacking.astype({"s": str, "a": str}), "y", ["a"], block="s").effects
