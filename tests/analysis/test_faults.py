"""The fault table of the statistics, F14 to F23: each row with the behavior it must have."""

import itertools
import json

import numpy as np
import pandas as pd
import pytest

from study.cli.app import run
from study.ground.errors import InputError, RefusedError
from study.ground.tabular import read_tidy_csv as read_csv
from study.statistics.analysis.anova import anova
from study.statistics.analysis.equal_variance import levene


def factorial(shape, repeats=1, seed=0, **effect):
    """Full grid with unit normal scatter and a slope along some factors."""
    rows = [
        {**dict(zip(shape, (f"L{i}" for i in cell), strict=True)), "rep": r}
        for cell in itertools.product(*(range(k) for k in shape.values()))
        for r in range(repeats)
    ]
    table = pd.DataFrame(rows)
    table["y"] = 10 + np.random.default_rng(seed).normal(size=len(table))
    for factor, slope in effect.items():
        table["y"] += slope * table[factor].str[1:].astype(int)
    return table


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_f14_a_response_that_is_no_number_is_listed_and_json_stays_valid(bad):
    table = factorial({"a": 3, "b": 2}, 3, 1)
    table.loc[[0, 5], "y"] = bad
    result = anova(table, "y", ["a", "b"], exact=False)
    assert any("y is missing in 2 of 18 rows (rows 1, 6)" in w for w in result.notes)
    assert "NaN" not in json.dumps(result.to_json(), allow_nan=False)
    with pytest.raises(InputError, match="has 0 values"):
        anova(table.assign(y=bad), "y", ["a", "b"])


def test_f15_repeated_cells_of_a_study_are_replicates_only_if_declared():
    table = factorial({"a": 3, "b": 2}, 5, 2)
    with pytest.raises(RefusedError, match=r"6 cells hold several runs \(L0 L0; L0 L1"):
        anova(table, "y", ["a", "b"], records=True)
    declared = anova(table, "y", ["a", "b"], records=True, replicates="mesh-seeds", exact=False)
    assert declared.error_term.source == "E3"
    # the order of the rows means nothing: a case is known by its content
    shuffled = table.sample(frac=1, random_state=1)
    again = anova(shuffled, "y", ["a", "b"], records=True, replicates="mesh-seeds", exact=False)
    assert again.anova.row("a").f == pytest.approx(declared.anova.row("a").f, rel=1e-10)


def test_f17_a_group_that_does_not_vary_is_named_and_the_rest_is_reported():
    table = factorial({"a": 3}, 3, 1)
    table.loc[table["a"] == "L1", "y"] = 1.0
    result = anova(table, "y", ["a"], exact=False)
    assert "bartlett and levene: not applied, because group L1 has zero variance" in result.notes
    assert any("zero spread (ties)" in w for w in result.notes)
    assert result.to_json()["variance"]["bartlett"] is None
    assert result.anova.row("a").f is not None
    assert result.assumptions.normality is not None
    lone = pd.concat([factorial({"a": 3}, 3, 1), pd.DataFrame([{"a": "L9", "y": 9.0}])])
    result = anova(lone, "y", ["a"], exact=False)
    assert "bartlett and levene: not applied, because group L9 has one value" in result.notes
    assert levene([[1.0, 2.0, 3.0], [4.0]]).reason.startswith("group 2 has one value")


@pytest.mark.parametrize("noise", [0.0, 1e-15])
def test_f19_f20_a_constant_response_has_no_anova(noise):
    table = factorial({"a": 2, "b": 2}, 3, 1)
    rng = np.random.default_rng(0)
    table["y"] = 1.0 + noise * rng.normal(size=len(table))
    for options in ({}, {"block": "rep"}, {"transform": "log"}):
        result = anova(table, "y", ["a", "b"], **options)
        assert result.anova.rows == ()
        assert result.effects == ()
        assert any("is constant" in w for w in result.notes)
        json.dumps(result.to_json(), allow_nan=False)


def test_f21_aliases_are_named_and_a_saturated_model_has_no_f():
    half = factorial({"a": 2, "b": 2, "c": 2}, 1, 1)
    half = half[sum(half[f].str[1:].astype(int) for f in "abc") % 2 == 0]
    result = anova(half, "y", ["a", "b", "c"])
    assert result.error_term.source == "E7"
    assert all(row.f is None and row.p is None for row in result.anova.rows)
    assert [row.term for row in result.anova.rows] == ["a", "b", "c", "residual"]
    (left_out,) = [w for w in result.notes if "left out, for these runs cannot tell them" in w]
    for main, pair in [("a", "b:c"), ("b", "a:c"), ("c", "a:b")]:
        assert f"{pair} (= {main})" in left_out


def test_f21_more_terms_than_rows():
    few = factorial({"a": 3, "b": 3, "c": 3}, 1, 1).iloc[[0, 4, 8, 12, 13, 22]]
    result = anova(few, "y", ["a", "b", "c"], exact=False)
    assert all(row.f is None for row in result.anova.rows)
    assert sum("left out, for these runs cannot tell them" in w for w in result.notes) == 1
    assert any("no residual degrees of freedom" in w for w in result.notes)
    json.dumps(result.to_json(), allow_nan=False)


def test_f22_a_lost_run_switches_to_type_three_and_an_empty_cell_to_type_one():
    table = factorial({"a": 3, "b": 2}, 3, 1)
    lost = anova(table.drop(4), "y", ["a", "b"], exact=False)
    assert lost.anova.type == "III"
    assert "unbalanced: Type III with sum-to-zero contrasts" in lost.notes
    asked = anova(table.drop(4), "y", ["a", "b"], type="II", exact=False)
    assert "unbalanced: Type II as asked" in asked.notes
    empty = table[~((table["a"] == "L2") & (table["b"] == "L1"))]
    result = anova(empty, "y", ["a", "b"], exact=False)
    assert result.anova.row("a:b").df == 1
    assert result.effect("a:b").verdict == "cannot tell"
    assert any("empty cells leave: a:b 1 of 2" in w for w in result.notes)
    third = anova(empty, "y", ["a", "b"], type="III", exact=False)
    assert any("a:b: 1 of 2 degrees of freedom are not estimable" in w for w in third.notes)
    assert third.anova.row("a:b").f is None
    assert "means are not estimable: a at L2; b at L1; a:b at L2 L1" in result.notes
    of_settings = "main effects are those of the settings with all levels of the factor: "
    assert f"{of_settings}a at 1 of 2 settings of b; b at 2 of 3 settings of a" in result.notes
    assert not any(of_settings in note for note in lost.notes)
    assert result.effect("a").mean[:2] != (None, None)


def test_complete_settings_are_counted_from_what_the_model_can_estimate():
    rng = np.random.default_rng(1)
    table = pd.DataFrame(
        [
            {"a": a, "b": b, "c": c, "y": rng.normal() * 1e-6 + (a == "B") * gap}
            for (b, c), gap in {
                ("u", "x"): 1.0, ("u", "y"): 2.0, ("u", "z"): 4.0, ("v", "x"): 5.0, ("v", "y"): 6.0
            }.items()
            for a in "AB"
            for _ in range(3)
        ]
    )  # fmt: skip
    terms, what = ["a", "b", "c", "a:b", "b:c", "a:c"], "main effects are those of the settings"
    found = anova(table, "y", ["a", "b", "c"], model=terms, replicates="runs", exact=False)
    # without a:b:c the difference at v, z follows from the others: 4 + 5 - 1 = 8
    assert found.effect("a").range == pytest.approx((1 + 2 + 4 + 5 + 6 + 8) / 6, abs=1e-5)
    (note,) = (note for note in found.notes if note.startswith(what))
    assert note.endswith(": b at 4 of 6 settings of a, c; c at 2 of 4 settings of b, a")
    # a factor that interacts with none is compared at all settings, although no mean is known
    alone = anova(table, "y", ["a", "b", "c"], model=["a", "b", "c", "b:c"], replicates="runs")
    (note,) = (note for note in alone.notes if note.startswith(what))
    assert note.endswith(": b at 2 of 3 settings of c; c at 1 of 2 settings of b")
    assert "complete" not in alone.effect("b").to_json()


def study(seed, gap):
    """Records of 2 models x 2 spaces on six specimens; models differ by ``gap``."""
    rng = np.random.default_rng(seed)
    rows = [
        {"model": m, "space": s, "specimen": f"s{k}", "y": 5.0 + k / 4 + (m == "B") * gap}
        for k, m, s in itertools.product(range(6), "AB", ("axi", "3d"))
    ]
    table = pd.DataFrame(rows)
    return table.assign(y=table["y"] + rng.normal(size=len(table)) * 0.05)


def test_f22_failed_cells_bound_the_conclusion():
    options = {"block": "specimen", "records": True, "practical": 0.5, "exact": False}
    table = study(3, gap=1.0)
    whole = anova(table, "y", ["model", "space"], **options)
    assert whole.failure_bounds == ()
    table.loc[9, "y"] = np.nan
    result = anova(table, "y", ["model", "space"], **options)
    bound = {b.term: b for b in result.failure_bounds}["model"]
    truth = whole.effect("model").range
    assert bound.low <= truth <= bound.high
    assert result.effect("model").verdict == "matters"
    # by hand: one of twelve rows of model A moves between the lowest and the highest value
    y = table["y"].to_numpy()
    low, high = np.nanmin(y), np.nanmax(y)
    b = table.loc[table["model"] == "B", "y"].mean()
    a = table.loc[(table["model"] == "A"), "y"].sum()
    assert bound.high == pytest.approx(b - (a + low) / 12, rel=1e-9)
    assert bound.low == pytest.approx(b - (a + high) / 12, rel=1e-9)


def test_f22_many_failures_overturn_the_verdict_and_say_so():
    table = study(3, gap=0.7)
    table.loc[(table["model"] == "B") & (table["space"] == "3d"), "y"] = np.nan
    options = {"block": "specimen", "records": True, "practical": 0.4, "exact": False}
    result = anova(table, "y", ["model", "space"], **options)
    # at the space where both models ran, nothing that is missing can change what is seen
    assert result.effect("model").verdict == "matters"
    bounds = {b.term: b for b in result.failure_bounds}
    assert bounds["model"].holds
    bound = bounds["space"]
    assert not bound.holds
    assert len(bound.verdicts) > 1
    assert any("6 missing responses" in w and "difference of space" in w for w in result.notes)
    document = result.to_json()["failure_bounds"]
    assert {"term", "low", "high", "verdicts", "p", "holds"} <= set(document[0])


def test_f22_failures_that_cannot_overturn_anything():
    table = study(4, gap=8.0)
    table.loc[[3], "y"] = np.nan
    result = anova(table, "y", ["model", "space"], block="specimen", exact=False, practical=0.1)
    held = {b.term: b.holds for b in result.failure_bounds}
    assert held["model"]
    assert any("cannot overturn what is said of model" in w for w in result.notes)


def test_f22_a_level_that_failed_everywhere_is_bounded_too():
    table = study(5, gap=1.0)
    third = table[table["model"] == "B"].assign(model="C", y=np.nan)
    table = pd.concat([table, third], ignore_index=True)
    result = anova(table, "y", ["model", "space"], block="specimen", records=True, exact=False)
    assert any("no response at level C" in w for w in result.notes)
    bound = {b.term: b for b in result.failure_bounds}["model"]
    assert bound.high > 1.2


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("a,y\nx,1\nx,2\nx,3\n", "factor 'a': needs at least two levels, got"),
        ("a,y\nx,1\nx,2\nz,\n", "level z has no response: leave the factor out"),
        ("a,y\n1,1\n 1,2\n2,3\n2,4\n", "csv:3: column 'a': the level ' 1' and the level '1'"),
        ("a,y\nx,1\nx ,2\nz,3\n", "csv:3: column 'a': the level 'x ' and the level 'x'"),
    ],
)
def test_f23_levels_are_checked_with_row_and_column(tmp_path, text, match):
    path = tmp_path / "levels.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=match):
        anova(read_csv(path, "y", ["a"]), "y", ["a"])


def test_copies_end_the_program_with_code_three_and_what_to_do(tmp_path, capsys):
    path = tmp_path / "copies.csv"
    pd.concat([factorial({"a": 2, "b": 2}, 1, 1)] * 3).to_csv(path, index=False)
    arguments = ["analyze", str(path), "--response", "y", "--factors", "a,b", "--json"]
    assert run(arguments) == 3
    out, err = capsys.readouterr()
    assert out == ""
    for remedy in ("keep one run a cell", "--block", "new meshes", "numerical uncertainty"):
        assert remedy in err
    assert run([*arguments[:4], "--factors", "a,c"]) == 2
    assert "copies.csv: column 'c': no such column" in capsys.readouterr().err


def test_f22_a_unit_without_any_response_is_bounded_and_counted():
    table = factorial({"a": 3, "s": 4}, 3, 7, a=0.5)
    table.loc[:2, "y"] = np.nan  # the whole first specimen
    table.loc[20, "y"] = np.nan  # one repeat of another
    result = anova(table, "y", ["a"], unit="s", exact=False, practical=1.0)
    assert any("y is missing in 4 of 36 rows" in w for w in result.notes)
    assert any("y is missing in 1 of 12 rows" in w for w in result.notes)
    assert [b.term for b in result.failure_bounds] == ["a"]
    assert result.nested.rows == 32
    assert result.nested.units == 11


def test_a_fraction_with_lost_runs_says_which_smaller_model_to_ask_for():
    sign = np.array([[(i >> k & 1) * 2 - 1 for k in range(4)] for i in range(16)])
    table = pd.DataFrame(sign, columns=list("ABCD")).assign(E=sign.prod(axis=1))
    table["y"] = 10 + 2 * table["A"] + np.random.default_rng(5).normal(0, 0.1, 16)
    table.loc[[3, 8], "y"] = np.nan
    # 16 terms up to pairs, and 14 rows
    for model in ("full", 2):
        found = anova(table, "y", list("ABCDE"), model=model, practical=0.5, exact=False)
        assert any("left out" in note and "(--model 1, or" in note for note in found.notes)
        assert any("(E5: --model 1)" in note for note in found.notes)
        # nothing is said of terms that are in no table, nor of those without an error
        assert {b.term for b in found.failure_bounds} == {e.term for e in found.effects}
    assert not any("cannot overturn" in note and "A:B:C" in note for note in found.notes)
    claimed = anova(table, "y", list("ABCDE"), model=1, practical=0.5, exact=False)
    assert claimed.effect("A").verdict == "matters"
