"""What withdraws a claim: tables on which the printed analysis alone would claim too much."""

import itertools
import re

import numpy as np
import pandas as pd
import pytest
from scipy.stats import f_oneway
from scipy.stats import t as student

from study.api import contrasts
from study.ground.errors import RefusedError
from study.reporting.content.report_facts import facts
from study.reporting.content.sentences import verdicts_of
from study.reporting.output.analysis_page import analysis_data
from study.statistics.analysis.anova import anova
from study.statistics.analysis.data import prepare, refuse_copied_rows
from study.statistics.analysis.equal_variance import own_variances, variances_beside_blocks
from study.statistics.analysis.linear_model import CellLayout as Layout
from study.statistics.analysis.linear_model import model_matrix
from study.statistics.analysis.mixed_model import mixed_model
from study.statistics.analysis.simple_effects import CANNOT_TELL, MATTERS, NO_DIFFERENCE
from study.statistics.analysis.sums_of_squares import factor


def crossed(**levels):
    rows = itertools.product(*(range(k) for k in levels.values()))
    return pd.DataFrame(list(rows), columns=list(levels))


def sign(table, *factors):
    return (2 * table[list(factors)] - 1).prod(axis=1)


def analyzed(table, factors, **asked):
    """Analysis with a practical difference of 1 where no other is asked for."""
    return anova(table, "y", list(factors), **{"practical": 1.0, "exact": False} | asked)


def verdicts(table, factors, **asked):
    found = analyzed(table, factors, **asked)
    return {found.effect(name).verdict for name in factors}


def judged(table, factor="a", **asked):
    return analyzed(table, asked.pop("factors", [factor]), **asked).effect(factor)


def withdrawn(why, table, factor="a", **asked):
    """Effect of a factor of which nothing is claimed, for that reason."""
    effect = judged(table, factor, **asked)
    assert effect.verdict == CANNOT_TELL
    assert why in effect.why
    return effect


def groups(seed, counts, sds):
    random = np.random.default_rng(seed)
    code = np.repeat(np.arange(len(counts)), counts)
    return pd.DataFrame({"a": code, "y": 5 + random.normal(size=code.size) * np.array(sds)[code]})


def test_an_interaction_of_an_unreplicated_design_is_seen_in_simple_effects():
    table = crossed(a=2, b=2, c=2, d=2)
    noise = np.random.default_rng(3).normal(0, 0.2, 16)
    table["y"] = 10 + 2 * sign(table, "a", "b") + noise
    found = analyzed(table, "abcd")
    assert found.error_term.source == "E6"
    assert [found.effect(f).verdict for f in "ab"] == [MATTERS, MATTERS]
    assert found.effect("a").deciding_simple.difference == pytest.approx(4, abs=0.8)
    # at a practical difference of 4 itself neither claim may be made
    at_limit = analyzed(table, "abcd", practical=4.0)
    assert NO_DIFFERENCE not in {at_limit.effect(f).verdict for f in "ab"}
    assert verdicts(table.assign(y=10 + noise), "abcd", practical=3.0) == {NO_DIFFERENCE}


@pytest.mark.parametrize("block", [None, "s"])
def test_a_model_that_leaves_an_interaction_out_claims_nothing(block):
    table = crossed(s=5, a=2, b=2)
    random = np.random.default_rng(1)
    noise = random.normal(0, 0.05, 20) + (0 if block is None else table["s"])
    asked = {"block": block, "model": ["a", "b"]}
    crossing = table.assign(y=3 * sign(table, "a", "b") + noise)
    # so does the full model
    assert verdicts(crossing, "ab", **asked, practical=8.0) == {NO_DIFFERENCE}
    found = analyzed(crossing, "ab", **asked, practical=4.0)
    assert {e.verdict for e in found.effects} == {CANNOT_TELL}
    if block:
        assert "leaves out interactions" in found.effect("a").why
    assert any("lack of fit of the declared model: F(1, " in note for note in found.notes)
    assert verdicts(table.assign(y=noise), "ab", **asked) == {NO_DIFFERENCE}


def test_blocks_that_lack_a_cell_are_pooled_only_where_that_is_asked_for():
    """By default each effect has the error of a whole table, with its 5 degrees of freedom."""
    table = crossed(s=6, a=2, m=4)
    random = np.random.default_rng(2)
    own = random.normal(0, 0.5, 6)[table["s"]] * table["a"]
    table["y"] = 2 * table["a"] + own + 0.02 * random.normal(size=len(table))
    cut = table.drop(index=[8 * s + s % 8 for s in range(6)])
    for error in ("auto", "own"):
        found, whole = (analyzed(rows, "am", block="s", error=error) for rows in (cut, table))
        assert "6 of 6 levels of s lack a cell" in found.error_term.reason
        assert found.error_term.df["a"] == pytest.approx(5.0, abs=0.1)
        assert found.anova.row("a").p == pytest.approx(whole.anova.row("a").p, rel=0.1)
        assert (found.effect("a").verdict, found.effect("m").verdict) == (MATTERS, NO_DIFFERENCE)
        assert found.effect("a").range == pytest.approx(2 + own[table["a"] == 1].mean(), abs=0.3)
    asked = analyzed(cut, "am", block="s", error="pooled")
    assert asked.effect("a").verdict == MATTERS
    assert asked.error_term.reason == "asked for"


def test_welch_withdraws_what_the_pooled_variance_claims_and_the_document_says_so():
    """Of effects and of contrasts by name; without a practical difference there is no verdict."""
    table = groups(5, (20, 20, 4), (0.2, 0.2, 2.0))
    effect = withdrawn("Welch", table, practical=2.5)
    assert effect.high < 2.5  # the pooled interval alone would claim
    even = groups(5, (20, 20, 4), (0.2, 0.2, 0.2))
    assert judged(even, practical=2.5).verdict == NO_DIFFERENCE
    found = analyzed(table, "a", practical=2.5)
    one, other = contrasts(found, ["a=0 - a=2", "a=0 - a=1"])
    assert (one.verdict, other.verdict) == (CANNOT_TELL, NO_DIFFERENCE)
    assert "Welch" in one.why
    document, (row,) = found.to_json(), found.verdicts()
    assert document["structure"]["empty_cells"] == 0
    assert len(row["withdrawn"]) == 1
    assert [(e["verdict"], e["withdrawn"]) for e in document["effects"]] == [
        (CANNOT_TELL, row["withdrawn"])
    ]
    (effect,) = analyzed(table, "a", practical=None).to_json()["effects"]
    assert {e["verdict"] for e in (effect, *effect["simple_effects"])} == {None}


def test_two_rows_that_agree_by_chance_do_not_make_their_group_sure():
    """Welch's interval alone would take them for the surest rows: .085 false claims, not .05."""
    table = groups(5, (10, 2), (0.3, 0.0))
    table.loc[10:, "y"] += [2.3, 2.35]
    withdrawn("Welch", table, practical=1.7)
    tests = pd.concat([table] + [table[10:] + [0, shift] for shift in (0.3, -0.3)])
    # the pairs one after the other would be pieces that were each measured twice
    assert judged(tests.sort_index(), practical=1.7).verdict == MATTERS


def test_readings_as_coarse_as_the_differences_claim_nothing():
    """Also where half of the blocks were read in whole units, whatever the unit is."""
    table = crossed(s=4, a=2)
    table["y"] = 7.0 + table["s"] + 2.0 * table["a"]  # one step more, in every block
    withdrawn("", table[:6], block="s", practical=1.5)
    fine = table[:6].assign(y=table["y"] + np.random.default_rng(0).normal(0, 0.01, 8))
    assert judged(fine, block="s", practical=1.5).verdict == MATTERS
    table.loc[4:, "y"] += [0.113, 0.108, -0.094, -0.102]
    for unit in (1.0, 1e-12):
        withdrawn("coarse", table.assign(y=unit * table["y"]), block="s", practical=1.75 * unit)


@pytest.mark.parametrize("times", [2, 3])
def test_copied_rows_are_refused_until_they_are_said_to_be_real(times):
    table = groups(2, (5, 5), (0.3, 0.3)).round(4)
    copied = pd.concat([table] * times, ignore_index=True)
    with pytest.raises(RefusedError, match=f"each row stands {times} times"):
        analyzed(copied, "a")
    assert analyzed(copied, "a", copies="independent").data.y.size == 10 * times
    part = pd.concat([copied, groups(9, (1, 1), (0.3, 0.3))], ignore_index=True)
    with pytest.raises(RefusedError, match="repeat another of their cell"):
        analyzed(part, "a")
    table = groups(9, (6, 6, 6), (0.3, 0.3, 0.3))
    table.loc[9:11, "y"] = table.loc[6:8, "y"].to_numpy()
    with pytest.raises(RefusedError, match="3 of 6 rows repeat another of their cell, as in 1"):
        analyzed(table, "a")


@pytest.mark.parametrize(("times", "digit"), [(2, 1e-9), (2, 1e-4), (3, 1e-5), (3, 1e-3)])
def test_copies_with_other_last_digits_are_refused(times, digit):
    random = np.random.default_rng(2)
    table = groups(3, (8, 8), (0.5, 0.5)).round(3)
    copied = pd.concat([table] * times, ignore_index=True)
    copied["y"] += digit * random.normal(size=len(copied))
    with pytest.raises(RefusedError, match="copied rows: .* to within"):
        anova(copied, "y", ["a"], exact=False)
    blocks = crossed(s=5, a=4)
    blocks["y"] = 3 * blocks["s"] + blocks["a"] + random.normal(0, 0.3, 20)
    for shift, how in ((1e-5, "to within 1e-05"), (0.0, "in every digit")):
        blocks.loc[blocks["s"] == 4, "y"] = blocks["y"][blocks["s"] == 1].to_numpy() + shift
        with pytest.raises(RefusedError, match=f"{how} s 4 repeats 1"):
            anova(blocks, "y", ["a"], block="s", exact=False)


@pytest.mark.parametrize("seed", range(20))
def test_rows_that_are_close_by_chance_are_no_copies(seed):
    """Heavy tails crowd in the middle; a step that is no decimal number ties everywhere.

    A wrong decimal point, or one cell, makes the scatter of all rows a hundred times larger.
    """
    random = np.random.default_rng(seed)
    step = np.round(random.normal(size=80), 1) * 1.2345678 + 1e-9 * random.normal(size=80)
    typed = random.normal(2, 0.02, 16).round(3)
    typed[5] *= 10
    volatile = np.repeat([0.01, 0.01, 10.0], 8) * random.normal(size=24)
    coarse = random.normal(5, 0.3, 60)
    for cells, y in (
        (3, random.standard_t(2, 300)), (4, step), (2, typed), (3, volatile),
        (3, random.lognormal(0, 2, 180)), (2, coarse.round(1)), (2, np.log(coarse.round(1))),
        (2, coarse.round(0)),
    ):  # fmt: skip
        table = pd.DataFrame({"a": np.repeat(np.arange(cells), y.size // cells), "y": y})
        refuse_copied_rows(prepare(table, "y", ["a"]))


def test_skewed_differences_need_an_interval_without_a_normal_distribution():
    differences = np.array([0.05, 0.12, 0.2, 0.31, 0.45, 0.7])
    table = crossed(s=6, a=2)
    table["y"] = 3.7 * table["s"] + np.repeat(differences, 2) * table["a"]
    effect = withdrawn("skewed", table, block="s", practical=0.65)
    assert effect.high < 0.65


def test_a_share_of_a_mean_that_is_not_known_is_no_exact_limit():
    table = crossed(s=5, a=2)
    random = np.random.default_rng(6)
    table["y"] = np.repeat(20 + 3 * random.normal(size=5), 2) + 1.02 * table["a"]
    table["y"] += random.normal(0, 0.005, 10)
    withdrawn("5 % of a mean of", table, block="s", practical="5 % of mean")
    # a claim that stands says so of its limit, too
    found = analyzed(table.assign(y=table["y"] + 3 * table["a"]), "a", block="s",
                     practical="5 % of mean")  # fmt: skip
    assert found.effect("a").verdict == MATTERS
    assert any(note.startswith("what matters is 5 % of a mean of") for note in found.notes)


@pytest.mark.parametrize(
    ("levels", "block"), [({"s": 6, "a": 3}, "s"), ({"r": 6, "a": 2, "b": 2}, None)]
)
def test_the_gate_changes_no_number(levels, block):
    """Rivals withdraw claims; sums, F, p and intervals of clean tables are those without them."""
    table = crossed(**levels)
    table["y"] = 5 + np.random.default_rng(8).normal(0, 0.2, len(table))
    factors = [f for f in levels if f not in ("s", "r")]
    claims, refuses = (analyzed(table, factors, block=block, practical=p) for p in (1.5, 0.01))
    assert claims.anova == refuses.anova
    assert [e.ci95 for e in claims.effects] == [e.ci95 for e in refuses.effects]
    assert {e.verdict for e in claims.effects if e.is_main} == {NO_DIFFERENCE}


@pytest.mark.parametrize("sizes", [(4, 4, 4), (3, 4, 2)])
def test_levels_nested_with_names_of_their_own_are_strata(sizes):
    """F of the upper stratum is that of the batch means, that of the lower one within batches."""
    random = np.random.default_rng(12)
    table = pd.DataFrame(
        [(f"L{i}", f"L{i}b{j}", k) for i in range(3) for j in range(sizes[i]) for k in range(5)],
        columns=["lab", "batch", "k"],
    )
    batches = sum(sizes)
    batch = pd.Series(random.normal(0, 2, batches), index=table["batch"].unique())
    table["y"] = table["batch"].map(batch) + random.normal(0, 0.5, 5 * batches)
    found = anova(table, "y", ["lab", "batch"], practical=1.0, exact=False)
    means = table.groupby(["lab", "batch"])["y"].mean()
    expected = f_oneway(*(means[lab] for lab in ("L0", "L1", "L2")))
    upper, lower = found.anova.row("lab"), found.anova.row("lab:batch")
    assert (upper.df, upper.df_error, upper.error) == (2, batches - 3, "lab:batch")
    assert upper.f == pytest.approx(expected.statistic, rel=1e-9)
    assert upper.p == pytest.approx(expected.pvalue, rel=1e-9)
    assert (lower.df, lower.df_error) == (batches - 3, 4 * batches)
    within = table.groupby("batch")["y"].var().mean()
    scatter = table.groupby("batch")["y"].mean().groupby(lambda b: b[:2]).var()
    between = 5 * scatter @ (np.array(sizes) - 1) / (batches - 3)
    assert lower.f == pytest.approx(between / within, rel=1e-9)
    assert sum("batch lies within lab" in note for note in found.notes) == 1
    assert any("--model lab,lab:batch" in note for note in found.notes)


def test_a_nested_factor_that_meets_a_third_one_is_a_block_of_its_levels():
    """Its means at two temperatures are no two batches: temperature is compared within them."""
    random = np.random.default_rng(3)
    levels = itertools.product(range(2), range(4), ("cold", "hot"), range(3))
    rows = [(f"L{i}", f"L{i}b{j}", temp, k) for i, j, temp, k in levels]
    table = pd.DataFrame(rows, columns=["lab", "batch", "temp", "k"])
    batch = pd.Series(random.normal(0, 1, 8), index=table["batch"].unique())
    both = pd.Series(random.normal(0, 0.3, 16), index=(table["batch"] + table["temp"]).unique())
    table["y"] = table["batch"].map(batch) + (table["batch"] + table["temp"]).map(both)
    table["y"] += 1.5 * (table["temp"] == "hot") + random.normal(0, 0.1, len(table))
    found = anova(table, "y", ["lab", "batch", "temp"], error="pooled", exact=False)
    means = table.pivot_table("y", ["lab", "batch"], "temp")
    of_batch, change = means.mean(axis=1), means["hot"] - means["cold"]
    lab, temp = found.anova.row("lab"), found.anova.row("temp")
    assert (lab.error, lab.df_error) == ("lab:batch", 6)
    expected = f_oneway(of_batch["L0"], of_batch["L1"])
    assert (lab.f, lab.p) == pytest.approx((expected.statistic, expected.pvalue), rel=1e-9)
    scatter = change.groupby("lab").var().mean()
    assert temp.f == pytest.approx(8 * change.mean() ** 2 / scatter, rel=1e-9)
    assert temp.df_error == 6
    own = anova(table, "y", ["lab", "batch", "temp"], exact=False).anova.row("temp")
    assert (own.f, own.error) == (pytest.approx(temp.f), "lab:batch:temp")
    assert own.df_error < 6


def test_an_empty_cell_leaves_what_can_be_estimated():
    """Sequential sums by the residual sums of nested fits; the lost cell is named once."""
    table = crossed(a=3, b=2, r=4)
    table["y"] = table["a"] + 0.5 * table["b"] + np.random.default_rng(4).normal(0, 0.4, 24)
    table = table[(table["a"] != 2) | (table["b"] != 0)]
    found = anova(table, "y", ["a", "b"], practical=5.0, exact=False)
    y = table["y"].to_numpy()
    dummies = [np.ones((len(table), 1)), np.eye(3)[table["a"]], np.eye(2)[table["b"]]]
    cells = np.eye(6)[table["a"] * 2 + table["b"]]

    def rss(*columns):
        x = np.hstack(columns)
        return float(np.sum((y - x @ np.linalg.lstsq(x, y)[0]) ** 2))

    sums = [rss(*dummies[:k]) for k in (1, 2, 3)] + [rss(cells)]
    for k, (term, df) in enumerate((("a", 2), ("b", 1), ("a:b", 1))):
        row = found.anova.row(term)
        assert row.df == df
        assert row.f == pytest.approx((sums[k] - sums[k + 1]) / df / (sums[3] / 15), rel=1e-9)
    assert {e.verdict for e in found.effects if e.is_main} == {NO_DIFFERENCE}
    assert "2 of 6 have an empty cell" in found.effect("a").why
    assert found.effect("b").range == pytest.approx(
        abs(table[table["a"] < 2].pivot_table("y", "a", "b").diff(axis=1)[1].mean())
    )
    assert sum("empty" in note for note in found.notes) == 2


def test_failed_combinations_leave_the_good_cases_their_verdicts():
    table = crossed(space=2, material=2, order=2, mesh=3)
    table["y"] = 10 + 5.0 * table["material"] + 0.2 * table["space"] + 0.01 * table["mesh"]
    failed = (table["space"] == 1) & (table["order"] == 1)
    factors = ["space", "material", "order", "mesh"]
    found = analyzed(table.assign(y=table["y"].mask(failed)), factors, records=True)
    matters = {f: found.effect(f).verdict == MATTERS for f in factors}
    assert matters == {"space": False, "material": True, "order": False, "mesh": False}
    assert {found.effect(f).verdict for f in factors} == {MATTERS, NO_DIFFERENCE}
    assert {dict(e.at)["order"] for e in found.effect("space").simple_effects} == {"0"}
    assert sum("left out, for these runs" in note for note in found.notes) == 1


def test_a_fraction_with_a_lost_run_leaves_out_the_fewest_terms():
    table = crossed(A=2, B=2, C=2, D=2)
    table["E"] = table[list("ABCD")].sum(axis=1) % 2
    table["y"] = 10 + table["A"] + np.random.default_rng(1).normal(0, 0.1, 16)
    found = anova(table.iloc[1:], "y", list("ABCDE"), model=2, practical=1.0, exact=False)
    rows = [row for row in found.anova.rows if row.term != "residual"]
    assert len(rows) == 14
    assert all(row.df == 1 for row in rows)
    assert sum("D:E: left out" in note for note in found.notes) == 1
    assert len(found.notes) < 7
    assert found.effect("A").range == pytest.approx(1, abs=0.3)
    assert found.effect("A").verdict == CANNOT_TELL


@pytest.mark.parametrize("lost", [[], [2], [2, 9]])
@pytest.mark.parametrize("factors", ["ABCD", "ABCDE"])
def test_an_interaction_hidden_from_a_declared_model_withdraws_claims(factors, lost):
    """Without repeats, complete, a fraction, or short of runs: simple effects are 1.2."""
    table = crossed(A=2, B=2, C=2, D=2)
    table["E"] = table[list("ABCD")].sum(axis=1) % 2
    noise = np.random.default_rng(1).normal(0, 0.05, 16)
    table["y"] = 10 + 0.6 * sign(table, "A", "B") + noise
    found = analyzed(table.drop(index=lost), factors, model=1)
    assert [found.effect(f).verdict for f in "AB"] == [CANNOT_TELL, CANNOT_TELL]
    assert any("A:B stands out" in note for note in found.notes)
    flat = table.assign(y=10 + noise).drop(index=lost)
    assert verdicts(flat, factors, model=1) == {NO_DIFFERENCE}


def test_an_interaction_that_main_effects_share_withdraws_claims_too():
    """Twelve runs of Plackett and Burman, six directions left out: simple effects are 1.2."""
    row = np.array([1, 1, -1, 1, 1, 1, -1, -1, -1, 1, -1])
    runs = np.vstack([*(np.roll(row, k) for k in range(11)), -np.ones(11, int)])
    table = pd.DataFrame(runs[:, :5], columns=list("ABCDE"))
    noise = np.random.default_rng(12).normal(0, 0.05, 12)
    table["y"] = 10 + 0.6 * table["A"] * table["B"] + noise
    found = analyzed(table, "ABCDE", model=1)
    assert NO_DIFFERENCE not in {found.effect(f).verdict for f in "AB"}
    assert verdicts(table.assign(y=noise), "ABCDE", model=1) == {NO_DIFFERENCE}


def test_a_fraction_leaves_out_aliases_in_one_sentence():
    table = crossed(A=2, B=2, C=2, D=2)
    table["E"] = table[list("ABCD")].sum(axis=1) % 2
    table["y"] = 10 + 2 * sign(table, "A", "B") + np.random.default_rng(1).normal(0, 0.2, 16)
    found, declared = analyzed(table, "ABCDE"), analyzed(table, "ABCDE", model=2)
    assert found.anova == declared.anova
    assert {e.verdict for e in found.effects if e.is_main} == {CANNOT_TELL}
    assert [declared.effect(f).verdict for f in "AC"] == [MATTERS, NO_DIFFERENCE]
    assert sum("A:B:C (= D:E)" in note for note in found.notes) == 1
    assert len(found.notes) < 5


def test_a_level_that_fails_in_most_blocks_leaves_its_siblings():
    table = crossed(s=6, a=3)
    table["y"] = table["s"] + 2.0 * (table["a"] == 1)
    table["y"] += np.random.default_rng(5).normal(0, 0.1, 18)
    lost = table["y"].mask((table["a"] == 2) & (table["s"] > 1))
    found = anova(table.assign(y=lost), "y", ["a"], block="s", practical=1.0, exact=False)
    assert found.effect("a").verdict == MATTERS
    pairs = {(e.first, e.second): e.verdict for e in found.effect("a").simple_effects}
    assert MATTERS in pairs.values()
    assert CANNOT_TELL in {v for pair, v in pairs.items() if "2" in pair}


def sessions():
    """Eight subjects of two treatments in three sessions each."""
    table = crossed(treat=2, k=4, session=3)
    table["subject"] = [f"s{4 * t + k}" for t, k in zip(table["treat"], table["k"], strict=True)]
    return table.assign(y=np.random.default_rng(7).normal(size=24))


def test_a_unit_in_several_cells_is_a_block():
    table = sessions()
    unit = analyzed(table, ["treat", "session"], unit="subject")
    block = analyzed(table, ["treat", "session"], block="subject")
    assert unit.anova == block.anova
    assert [unit.anova.row(t).df for t in ("subject", "subject:session")] == [6, 12]
    assert any("--block subject" in note for note in unit.notes)


@pytest.mark.parametrize(("letter", "told"), [("S", True), ("", False)])
def test_a_unit_with_a_name_of_its_own_in_every_cell_may_be_one_and_the_same(letter, told):
    """Subjects at each of three temperatures, or samples that are numbered anew at each."""
    table = crossed(subject=6, a=3, k=2)
    table["y"] = np.random.default_rng(2).normal(0, 1, len(table))
    table["subject"] = letter + table["subject"].astype(str)
    notes = analyzed(table, ["a"], unit="subject").notes
    assert any("--block subject compares the cells within it" in note for note in notes) == told


def test_means_of_a_split_plot_have_intervals():
    """Of a whole plot's level: the scatter of whole plots; of the others: of both strata."""
    table = sessions()
    asked = {"block": "subject", "whole_plot": "treat", "practical": 9.0}
    found = analyzed(table, ["treat", "session"], **asked)
    ms = {row.term: row.ms for row in found.anova.rows}
    half = student.ppf(0.975, 6) * np.sqrt(ms["subject"] / 12)
    ((low, high), _) = found.effect("treat").mean_ci95
    assert (high - low) / 2 == pytest.approx(half)
    parts = np.array([ms["subject"] / 24, ms["residual"] / 12])
    df = parts.sum() ** 2 / np.sum(parts**2 / [6, 12])
    (low, high) = found.effect("session").mean_ci95[0]
    assert (high - low) / 2 == pytest.approx(student.ppf(0.975, df) * np.sqrt(parts.sum()))
    assert found.effect("session").simple_effects


def test_one_specimen_tells_nothing_of_another():
    table = crossed(a=3, r=2).assign(s="only")
    table["y"] = np.random.default_rng(1).normal(size=6) + 9 * table["a"]
    withdrawn("one specimen", table, block="s")
    assert any("one s (only)" in note for note in analyzed(table, "a", block="s").notes)


def test_differences_of_rounding_are_no_skewed_sample():
    """Cells that compute the same differ in their last digits alone, all to one side."""
    table = crossed(s=8, a=2)
    table["y"] = 3.0 + table["s"] + 4e-16 * (table["a"] * (1 + table["s"] ** 3))
    assert judged(table, block="s", records=True, practical=0.5).verdict == NO_DIFFERENCE


def test_a_declared_model_over_blocks_that_lack_cells_is_held_against_its_lack_of_fit():
    """Three by two in six blocks, each of which lacks one of its cells."""
    random = np.random.default_rng(59)
    table = crossed(s=6, a=3, c=2)
    bent = 0.3 * (1 - table["a"]) * (2 * table["c"] - 1)
    table["y"] = np.repeat(random.normal(0, 3, 6), 6) + bent + random.normal(0, 0.3, 36)
    table = table.drop(index=[6 * s + s for s in range(6)])
    asked = {"block": "s", "model": 1, "practical": 0.9}
    for name in "ac":
        effect = withdrawn("leaves out interactions", table, name, factors="ac", **asked)
        assert effect.withdrawn == (effect.why,)
    assert any(n.startswith("lack of fit") for n in analyzed(table, "ac", **asked).notes)


def test_three_rows_of_a_cell_share_what_they_tell_of_the_scatter():
    y, cell = np.array([1.0, 2.0, 3.0, 5.0, 5.2, 5.4, 7.0]), np.array([0, 0, 0, 1, 1, 1, 2])
    variance, df = own_variances(y, cell, shrinkage=1.0)
    pooled = (2 * 1.0 + 2 * 0.04) / 4
    assert variance == pytest.approx([(1 + pooled) / 2, (0.04 + pooled) / 2, pooled])
    assert df.tolist() == [4, 4, 4]
    assert own_variances(y, cell)[0] == pytest.approx([1, 0.04, np.inf])


@pytest.mark.parametrize("specimens", [2, 4])
def test_a_declared_model_of_groups_of_blocks_is_held_against_its_lack_of_fit(specimens):
    table = crossed(m=2, k=specimens, b=3)
    random = np.random.default_rng(1)
    bend = 1.5 * (2 * table["m"] - 1) * (table["b"] - 1)
    scatter = np.repeat(random.normal(0, 2, 2 * specimens), 3) + random.normal(0, 0.05, len(table))
    table = table.assign(s=10 * table["m"] + table["k"], y=bend + scatter)
    declared = analyzed(table, "mb", block="s", model=1)
    assert NO_DIFFERENCE not in {declared.effect(f).verdict for f in "mb"}
    if specimens > 2:
        assert "leaves out interactions" in declared.effect("b").why
        assert judged(table, "b", factors="mb", block="s").verdict == MATTERS


def test_a_declared_model_of_a_split_plot_is_held_against_its_lack_of_fit():
    table = crossed(s=5, a=2, b=3)
    random = np.random.default_rng(1)
    plots = np.repeat(random.normal(0, 2, 5), 6) + np.repeat(random.normal(0, 0.2, 10), 3)
    bend = 1.5 * (2 * table["a"] - 1) * (table["b"] - 1)
    table["y"] = plots + bend + random.normal(0, 0.1, 30)
    asked = {"factors": ["a", "b"], "block": "s", "whole_plot": "a", "model": 1}
    withdrawn("leaves out interactions", table, **asked)
    flat = table.assign(y=plots + random.normal(0, 0.1, 30))
    assert judged(flat, "b", **asked).verdict == NO_DIFFERENCE


@pytest.mark.parametrize(("k", "seed"), [(5, 3), (5, 20), (5, 21), (4, 42), (4, 46), (4, 47)])
def test_one_treatment_of_a_latin_square_scatters_more(k, seed):
    """Of 300 such squares, whose difference is the practical one, 46 made a claim; now 1 in 30."""
    random = np.random.default_rng([11, seed])
    table = crossed(r=k, c=k)
    table["v"] = random.permutation(k)[(table["r"] + table["c"]) % k]
    sd = np.where(table["v"] == k - 1, 1.5, 0.2)
    rows, columns = random.normal(0, 1, k), random.normal(0, 1, k)
    scatter = sd * random.normal(size=k * k)
    table["y"] = rows[table["r"]] + columns[table["c"]] + scatter + 1.5 * (table["v"] == k - 1)
    withdrawn("scatter unequally", table, "v", block=["r", "c"], practical=1.5)


def test_variances_beside_blocks_are_those_of_the_cells_where_there_are_none():
    cell = np.repeat([0, 1, 2], [3, 4, 6])
    y = np.random.default_rng(2).normal(size=13) * (1 + cell)
    layout = Layout({"v": ("a", "b", "c")}, {"v": cell})
    variance, df = variances_beside_blocks(factor(model_matrix(layout, [("v",)]), y), cell)
    assert variance == pytest.approx(own_variances(y, cell)[0])
    assert df == pytest.approx([2, 3, 5])


def test_groups_of_blocks_are_held_to_what_blocks_alone_are():
    """A limit that is a share of the mean has that mean's error; equal differences have none."""
    table = crossed(g=2, k=4, v=2)
    table["s"] = 4 * table["g"] + table["k"]
    random = np.random.default_rng(4)
    base = np.repeat(random.permutation([15, 17, 18, 20, 20, 22, 23, 25]), 2)
    table["y"] = base + 1.08 * table["v"] + random.normal(0, 0.01, 16)
    asked = {"factors": ["g", "v"], "block": "s"}
    withdrawn("is not known well enough", table, "v", practical="5 % of mean", **asked)
    assert judged(table, "v", **asked).verdict == MATTERS
    table["y"] = base + np.repeat(random.integers(0, 2**20, 8), 2) / 2**20 + 2.0 * table["v"]
    withdrawn("no scatter to judge by", table, "v", **asked)


def test_a_cell_without_scatter_beside_others_judges_nothing():
    random = np.random.default_rng(10)
    table = pd.DataFrame({"a": np.repeat([0, 1], 8), "y": 10 + random.normal(0, 0.15, 16).round(3)})
    table.loc[:7, "y"] = 10.0
    withdrawn("no scatter", table, practical=0.5)


def test_a_block_that_changes_with_a_factor_is_refused_with_the_words_to_type():
    table = pd.DataFrame({"a": np.repeat(list("xyz"), 4), "b": np.tile([0, 1], 6)})
    table["day"] = table["a"].map({"x": "mon", "y": "tue", "z": "wed"})
    table["y"] = np.random.default_rng(20).normal(size=12)
    with pytest.raises(RefusedError, match="day changes with a: .* the others alone .--factors b"):
        anova(table, "y", ["a", "b"], block="day", exact=False)


def test_plants_laboratories_and_batches_are_tested_each_against_the_next():
    """R: aov(y ~ plant + Error(lab/batch)) of these rows."""
    table = crossed(plant=3, lab=2, batch=3, row=2)
    y = [3, 5, 1, 2, 8, 7, 4, 4, 6, 9, 2, 3, 7, 6, 5, 9, 1, 4, 2, 2, 6, 3, 8, 8, 5, 4, 9, 7, 3, 1]
    table["y"] = [*y, 6, 7, 2, 5, 4, 8]
    for inner, outer in (("lab", "plant"), ("batch", "lab")):
        table[inner] = table[outer].astype(str) + "." + table[inner].astype(str)
    found = anova(table, "y", ["batch", "plant", "lab"], exact=False)
    assert found.notes[-1].startswith("lab lies within plant and batch lies within lab")
    rows = {row.error: row for row in found.anova.rows if row.f is not None}
    of_r = {
        "plant:lab": (2.227272727272726, 3, 0.2552995981678279),
        "plant:lab:batch": (0.04313725490196084, 12, 0.9874799723252182),
        "residual": (5.930232558139528, 18, 0.0004112289565596549),
    }
    for error, expected in of_r.items():
        row = rows[error]
        assert (row.f, row.df_error, row.p) == pytest.approx(expected, rel=1e-9)


def test_a_lost_run_of_a_factorial_is_judged_by_the_contrasts_that_remain():
    """A simple effect is the difference of two runs; that of the lost one is in no claim."""
    table = crossed(a=2, b=2, c=2, d=2)
    noise = np.random.default_rng(3).normal(0, 0.2, 16)
    table["y"] = 10 + 4 * table["a"] + noise
    lost = table.drop(index=9)
    found = analyzed(lost, "abcd")
    assert found.error_term.source == "E6"
    assert "Lenth's method on 14 contrasts" in found.error_term.reason
    a = found.effect("a")
    assert (a.verdict, len(a.simple_effects) > 0) == (MATTERS, True)
    # the rest scatters as it was drawn, so its contrasts tell its standard deviation
    assert found.lenth.pse == pytest.approx(0.2, rel=0.5)
    pairs = [lost["y"][i + 8] - lost["y"][i] for i in range(8) if i + 8 in lost.index]
    assert a.range == pytest.approx(np.mean(pairs))
    assert MATTERS not in {analyzed(lost, "abcd", practical=4.5).effect("a").verdict}
    assert verdicts(lost.assign(y=10 + noise[lost.index]), "abcd", practical=3.0) == {NO_DIFFERENCE}


def test_blocks_that_change_with_an_interaction_are_no_contrast_of_the_factors():
    """2^4 on two days that change with a:b:c:d: by default nothing, as asked Lenth without them."""
    table = crossed(a=2, b=2, c=2, d=2)
    table["day"] = table[["a", "b", "c", "d"]].sum(axis=1) % 2
    noise = np.random.default_rng(3).normal(0, 0.2, 16)
    table["y"] = 10 + 4 * table["a"] + 5 * table["day"] + noise
    default = analyzed(table, "abcd", block="day")
    assert {e.verdict for e in default.effects if e.is_main} == {CANNOT_TELL}
    assert (default.lenth, default.error_term.source) == (None, "E7")
    assert "--error reml" not in default.error_term.reason  # two days are too few for it
    asked = analyzed(table, "abcd", block="day", error="pooled")
    assert "a:b:c:d" not in asked.lenth.names
    assert len(asked.lenth.names) == 14
    assert "declare which are negligible (--model 2" in asked.effect("a").why
    declared = analyzed(table, "abcd", block="day", error="pooled", model=3)
    assert declared.effect("a").verdict == MATTERS
    assert "taken as none; Lenth's method on 14 contrasts" in declared.error_term.reason


def test_rounding_of_single_runs_is_no_missing_scatter():
    """A difference of .9 read in whole units: of 16 runs those with a read 1 more, or 0."""
    table = crossed(a=2, b=2, c=2, d=2)
    noise = np.random.default_rng(3).normal(0, 0.02, 16)
    read = table.assign(y=np.round(10.1 + 0.9 * table["a"] + noise))
    found = analyzed(read, "abcd", practical=0.95).effect("a")
    assert (found.verdict, found.range) == (CANNOT_TELL, pytest.approx(1.0))
    assert "readings are too coarse" in found.why
    # computed without any scatter: nothing to judge by
    smooth = analyzed(table.assign(y=10 + table["a"] / 3), "abcd", practical=0.1).effect("a")
    assert (smooth.verdict, "no scatter" in smooth.why) == (CANNOT_TELL, True)


@pytest.mark.parametrize(("generators", "order"), [(("d=ab", "e=ac"), 1), (("e=abcd",), 2)])
def test_the_order_that_is_to_be_declared_is_one_that_the_runs_tell_apart(generators, order):
    """Of a fraction of resolution III second order is aliased with main effects, of V it is not."""
    base = crossed(**dict.fromkeys("abcd"[: 5 - len(generators)], 2))
    for text in generators:
        name, product = text.split("=")
        base[name] = base[list(product)].sum(axis=1) % 2
    base["y"] = 10 + 4 * base["a"] + np.random.default_rng(3).normal(0, 0.2, len(base))
    found = analyzed(base, "abcde")
    assert f"(--model {order}, or the terms)" in found.effect("a").why
    typed = analyzed(base, "abcde", model=order)
    assert not any("cannot tell them" in note for note in typed.notes)


def test_a_declared_nesting_claims_nothing_of_the_outer_factor():
    """Three laboratories that differ by their batches alone; batches are numbered anew in each."""
    table = crossed(lab=3, batch=4, k=3)
    random = np.random.default_rng(5)
    of_batch = random.normal(0, 2, 12)[4 * table["lab"] + table["batch"]]
    table["y"] = of_batch + random.normal(0, 0.1, len(table))
    rows = analyzed(table, ["lab", "batch"], model=["lab", "lab:batch"])
    assert rows.anova.row("lab").p < 1e-6  # against the rows
    lab = rows.effect("lab")
    assert (lab.verdict, lab.simple_effects) == (CANNOT_TELL, ())
    assert "--unit batch" in lab.why
    typed = analyzed(table, ["lab"], unit="batch")
    means = table.groupby(["lab", "batch"])["y"].mean()
    assert typed.anova.row("lab").p == pytest.approx(f_oneway(*(means[i] for i in range(3))).pvalue)


def test_what_missing_rows_could_do_is_said_of_the_verdict_that_is_printed():
    table = crossed(a=2, r=4)
    table["y"] = [10.0, 10.2, 9.9, 10.1, 11.0, 11.2, np.nan, np.nan]
    found = analyzed(table, "a", practical=0.9)
    assert found.effect("a").verdict == CANNOT_TELL
    assert not any("is not certain" in note for note in found.notes)


def test_a_treatment_that_acts_on_in_a_crossover_is_no_effect_of_the_treatments():
    """Two periods: what A leaves for the second adds half of itself to the difference."""
    random, rows = np.random.default_rng(4), []
    for subject in range(12):
        order = ("A", "B") if subject % 2 else ("B", "A")
        level = random.normal(0, 0.5)
        for period, given in enumerate(order):
            left = 3.0 * (period == 1 and order[0] == "A")
            rows.append((subject, period, given, level + left + random.normal(0, 0.2)))
    table = pd.DataFrame(rows, columns=["subject", "period", "treat", "y"])
    treat = analyzed(table, ["treat"], block=["subject", "period"], practical=0.8).effect("treat")
    assert treat.ci95[0] > 0.8
    assert (treat.verdict, "may carry over into the next" in treat.why) == (CANNOT_TELL, True)
    table["y"] -= 3.0 * ((table["period"] == 1) & (table["treat"] == "B"))
    clean = table.assign(y=table["y"] + 2.0 * (table["treat"] == "B"))
    clean = analyzed(clean, ["treat"], block=["subject", "period"], practical=0.8)
    treat = clean.effect("treat")
    # twelve subjects hardly tell whether a treatment carries over: the claim names its condition
    condition = "if no effect of treat carries over into the next period"
    assert (treat.verdict, treat.condition) == (MATTERS, condition)
    assert condition in treat.to_json()["why"]
    (named,) = contrasts(clean, "treat=B - treat=A")
    assert (named.verdict, named.why) == (MATTERS, condition)
    assert any(condition in note and "F(1, 10)" in note for note in clean.notes)
    data = analysis_data(clean)
    assert condition in verdicts_of(data, facts(data)[0])


@pytest.mark.parametrize(("apart", "conditional"), [(1.5, True), (0.0, False)])
def test_a_covariate_with_errors_leaves_a_part_of_itself_in_levels_that_differ_in_it(
    apart, conditional
):
    """What is left of 2 times 1.5 at a reliability of .7 is 0.9 of a difference of 1."""
    random, code = np.random.default_rng(3), np.repeat([0, 1], 15)
    x = np.tile(random.normal(0, 1, 15), 2) + apart * code
    table = pd.DataFrame({"a": code, "x": x, "y": 2 * x + 3 * code + random.normal(0, 0.3, 30)})
    found = mixed_model(table, "y", ["a"], covariates=["x"], practical=1.0)
    assert found.effects[0].verdict == MATTERS
    assert found.effects[0].condition == "if x is measured without error" * conditional


def test_a_drift_over_the_rows_is_named_with_what_it_explains():
    """Levels were run one after the other while the response drifted by 0.1 a run."""
    random = np.random.default_rng(5)
    table = pd.DataFrame({"a": np.repeat([0, 1], 10), "y": random.normal(0, 0.1, 20)})
    assert not any("drifts" in note for note in analyzed(table, "a").notes)
    table["y"] += 0.1 * np.arange(20)
    (note,) = (note for note in analyzed(table, "a").notes if "drifts" in note)
    explained, difference = map(float, re.search(r"be (\S+) of (\S+) \(a\)", note).groups())
    assert (explained, difference) == pytest.approx((1.0, 1.0), abs=0.15)
    effect = analyzed(table, "a", practical=0.5).effect("a")
    assert (effect.verdict, "without the drift" in effect.why) == (CANNOT_TELL, True)
    table["y"] += 2.0 * table["a"]
    assert analyzed(table, "a", practical=0.5).effect("a").verdict == MATTERS
    # a table that was sorted by the response has no order of runs
    still = pd.DataFrame({"a": np.repeat([0, 1], 10), "y": random.normal(0, 0.1, 20)})
    still["y"] += still["a"]
    for rows in (still, still.sort_values(["a", "y"])):
        assert analyzed(rows, "a", practical=0.5).effect("a").verdict == MATTERS


def test_rows_in_line_that_are_alike_claim_no_more_than_fewer_would():
    """Three rows on each of four pieces, whose column is not named; runs in turn say nothing."""
    random = np.random.default_rng(2)
    pieces = np.repeat(random.normal(0, 0.5, 8), 3) + random.normal(0, 0.05, 24)
    table = pd.DataFrame({"a": np.repeat([0, 1], 12), "piece": np.repeat(np.arange(8), 3)})
    table["y"] = pieces + table["a"]
    effect = judged(table)
    assert (effect.verdict, "(--unit with its column)" in effect.why) == (CANNOT_TELL, True)
    assert any("follow one another are alike" in note for note in analyzed(table, "a").notes)
    assert not any("alike" in note for note in analyzed(table, "a", unit="piece").notes)
    assert judged(table.sample(frac=1, random_state=1)).verdict == MATTERS
    assert judged(table.assign(y=table["y"] + 8 * table["a"])).verdict == MATTERS


@pytest.mark.parametrize(("name", "refused"), [("batch", True), ("Lot no", True), ("heat", False)])
def test_units_that_have_numbers_alone_may_be_numbered_anew(name, refused):
    """Batches of three suppliers, numbered from 1 in each: suppliers differ by batches alone."""
    random = np.random.default_rng(6)
    table = crossed(supplier=3, batch=3, k=4)
    table["y"] = random.normal(0, 1, 9)[3 * table["supplier"] + table["batch"]]
    table["y"] += random.normal(0, 0.1, len(table))
    table = table.assign(batch=table["batch"] + 1).rename(columns={"batch": name})
    supplier = analyzed(table, ["supplier", name], practical=0.5).effect("supplier")
    assert (supplier.verdict == CANNOT_TELL) == refused
    assert (f"--unit {name}" in supplier.why) == refused
    named = table.assign(**{name: "b" + table[name].astype(str)})
    assert analyzed(named, ["supplier", name], practical=0.5).effect("supplier").verdict == MATTERS


def test_readings_that_end_at_a_limit_make_no_claim():
    """Three of ten are the largest value to the last digit, as of a load cell at its end."""
    table = crossed(a=2, k=10)
    table["y"] = 5 + 2.0 * table["a"] + np.random.default_rng(8).normal(0, 0.5, 20)
    assert analyzed(table, "a", practical=0.8).effect("a").verdict == MATTERS
    table["y"] = table["y"].clip(upper=table["y"].nlargest(3).iloc[-1])
    a = analyzed(table, "a", practical=0.8).effect("a")
    assert (a.verdict, "3 of 20 rows are" in a.why) == (CANNOT_TELL, True)
    measured = analyzed(table, "a", practical=0.8, copies="independent").effect("a")
    assert measured.verdict == MATTERS


def test_an_empty_cell_leaves_the_intervals_of_the_other_means():
    """Against the mean and the pooled scatter of the rows themselves."""
    table = crossed(a=3, b=2, k=4)
    table["y"] = table["a"] + np.random.default_rng(9).normal(0, 0.5, 24)
    table = table[(table["a"] < 2) | (table["b"] < 1)]
    cells = table.groupby(["a", "b"])["y"]
    half = student.ppf(0.975, 15) * np.sqrt(cells.var().mean() / 4)
    effect = analyzed(table, "ab").effect("a:b")
    assert effect.mean_ci95[-1] == (None, None)
    mean = cells.mean()[0, 1]
    assert effect.mean_ci95[1] == pytest.approx((mean - half, mean + half))
