"""ANOVA against other codes, the error-term ledger, and the guards F14 to F23."""

from itertools import product

import numpy as np
import pandas as pd
import pytest

from study.ground.errors import InputError, RefusedError
from study.statistics.analysis.anova import anova
from tests.analysis.test_faults import factorial


def test_records_take_own_interactions_and_group_copies():
    cells = list(product(range(9), "ABCD", ("axi", "3d")))
    table = pd.DataFrame(cells, columns=["mix", "material", "space"]).astype({"mix": str})
    table["y"] = np.repeat(5 + 0.2 * np.random.default_rng(2).normal(size=36), 2)
    table["y"] += 1e-9 * (table["space"] == "3d")
    asked = {"block": "mix", "records": True, "practical": "0.5 pp", "exact": False}
    result = anova(table, "y", ["material", "space"], **asked)
    assert result.error_term.source == "E1"
    assert result.distinct == 4
    standing = result.cell_means[result.cell_means["representative"]]
    assert list(standing["material"]) == list("ABCD")
    assert set(standing["space"]) == {"axi"}
    # each contrast over the nine mixes is a sample of its own
    assert result.assumptions.normality.n == 9
    assert {row.term for row in result.assumptions.normality_rows} == {"material"}
    assert result.anova.row("space").f is None
    assert result.effect("space").verdict == "no practical difference"
    assert any("cells differ: the others give the same numbers" in w for w in result.notes)
    from_csv = anova(table.round(6), "y", ["material", "space"], block="mix", exact=False)
    assert isinstance(from_csv.error_term.df, dict), "copies betray a study's table"


def test_incomplete_blocks_of_records_are_no_reason_to_leave_rows_out():
    table = factorial({"a": 3, "mix": 5}, 1, 4)
    table.loc[3, "y"] = np.nan
    result = anova(table, "y", ["a"], block="mix", records=True, exact=False)
    assert "1 of 5 levels of mix lack a cell" in result.error_term.reason
    # 6 of the four complete blocks, 8 of all five
    assert 6 < result.anova.row("a").df_error < 8


def test_fake_replicates_are_refused():
    table = pd.concat([factorial({"a": 2, "b": 2}, 1, 1)] * 3, ignore_index=True)
    with pytest.raises(RefusedError, match="fake replicates") as info:
        anova(table, "y", ["a", "b"])
    assert info.value.exit_code == 3
    noisy = table.assign(y=table["y"] + 1e-12 * np.arange(len(table)))
    with pytest.raises(RefusedError, match="Instead"):
        anova(noisy, "y", ["a", "b"], records=True)
    hashed = factorial({"a": 2, "b": 2}, 2, 1).assign(input_hash="x")
    with pytest.raises(RefusedError, match="equal input"):
        anova(hashed, "y", ["a", "b"], records=True)
    with pytest.raises(RefusedError):
        anova(table.assign(run=np.arange(len(table)) // 4), "y", ["a", "b"], block="run")


@pytest.mark.parametrize(
    ("change", "options", "match"),
    [
        ({}, {"factors": ["a", "bb"]}, "did you mean 'b'"),
        ({}, {"factors": []}, "at least one factor"),
        ({"a": "one"}, {}, "needs at least two levels"),
        ({"a": [1, "1", 2, 2] * 2}, {}, "look the same"),
        ({"y": "text"}, {}, "is not a number"),
        ({}, {"error": "best"}, "must be auto, pooled, own or welch"),
        ({}, {"type": "IV"}, "must be auto, I, II or III"),
        ({}, {"model": ["a:z"]}, "'z' is no factor"),
        ({"y": -1.0}, {"transform": "sqrt"}, "must be none or log"),
        ({}, {"practical": "some"}, "cannot read"),
        ({}, {"practical": "1,5"}, "cannot read"),
    ],
)
def test_bad_input(change, options, match):
    table = factorial({"a": 2, "b": 2}, 2, 1).assign(**change)
    with pytest.raises(InputError, match=match):
        anova(table, "y", options.pop("factors", ["a", "b"]), **options)


def test_log_reports_ratios():
    table = factorial({"a": 2}, 5, 1)
    table["y"] = np.exp(0.01 * table["y"]) * np.where(table["a"] == "L1", 3.0, 2.0)
    result = anova(table, "y", ["a"], transform="log", practical="10 % of mean", exact=False)
    effect = result.effect("a")
    assert effect.scale == "ratio"
    assert effect.range == pytest.approx(1.5, rel=0.02)
    assert effect.practical == pytest.approx(1.10, rel=1e-12)
    assert effect.verdict == "matters"
    with pytest.raises(InputError, match="positive"):
        anova(table.assign(y=-table["y"]), "y", ["a"], transform="log")


@pytest.mark.parametrize(
    ("gap", "u_num", "verdict"),
    [
        (1.0, None, "matters"),
        (0.0, None, "no practical difference"),
        (0.3, None, "cannot tell"),
        (1.0, 0.4, "matters"),
        (1.0, 0.7, "not resolved by the mesh"),
        (0.3, 0.4, "cannot tell"),
        (0.0, 100.0, "not resolved by the mesh"),
    ],
)
def test_verdicts(gap, u_num, verdict):
    noise = np.tile([-0.1, 0.1, -0.1, 0.1], 2)
    table = pd.DataFrame({"a": ["x"] * 4 + ["z"] * 4, "y": noise + np.repeat([5, 5 + gap], 4)})
    result = anova(table, "y", ["a"], practical=0.3, u_num=u_num, exact=False)
    assert result.effect("a").verdict == verdict
    assert result.verdicts()[0]["verdict"] == verdict


def test_names_are_never_code(tmp_path):
    """A factor name that would run in a formula parser is only a name."""
    evil = f"__import__('pathlib').Path('{tmp_path}/ran').touch()"
    table = factorial({"a": 2, "b": 2}, 2, 1).rename(columns={"a": evil, "y": "1 + y"})
    result = anova(table, "1 + y", [evil, "b"], exact=False)
    assert result.anova.row(evil).f is not None
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize("block", ["blk", None])
def test_an_effect_that_an_empty_cell_leaves_in_part_has_no_p(block):
    """The note says "no test", and blocks had a p of what was left, which is not the effect."""
    rng = np.random.default_rng(5)
    rows = [
        (f"a{i}", f"b{j}", f"s{s}", i + rng.normal())
        for i in range(3) for j in range(2) for s in range(6)
        if (i, j) != (2, 1)
    ]  # fmt: skip
    table = pd.DataFrame(rows, columns=["A", "B", "blk", "y"])
    found = anova(table, "y", ["A", "B"], block=block, type="III", exact=False)
    assert found.anova.row("A").p_deciding is None
    assert any("A: 1 of 2 degrees of freedom are not estimable" in note for note in found.notes)


@pytest.mark.parametrize(
    ("column", "size", "practical", "warned"),
    [
        ("Kraft [mN]", "0.0005 N", 0.5, False),
        ("force (N)", "500 mN", 0.5, False),
        ("y (mean)", "0.5 N", 0.5, True),
        ("force", "0.5 N", 0.5, True),
        ("wear_um", "0.002 mm", 0.002, True),  # taken as um, of which nothing may be silent
        ("wear [um]", "0.002 mm", 2.0, False),
        ("force", "0.5", 0.5, False),
        ("force", "5 % of mean", 0.05 * 12.4 / 6, False),
    ],
)
def test_a_practical_difference_is_read_in_the_unit_of_its_column(column, size, practical, warned):
    """A unit that no column names is said to be unconverted."""
    table = pd.DataFrame({"a": list("xxyyzz"), column: [1.0, 1.2, 1.9, 2.2, 3.0, 3.1]})
    found = anova(table, column, ["a"], practical=size, exact=False)
    assert found.effects[0].practical == pytest.approx(practical)
    assert any("nothing is converted" in note for note in found.notes) == warned
    with pytest.raises(InputError, match=r"practical: is in mm, which is not of the kind of mN"):
        anova(table.rename(columns={column: "F [mN]"}), "F [mN]", ["a"], practical="1 mm")
