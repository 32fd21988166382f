"""Which cases fail: published tables, enumerations, rates, and rules that were planted."""

import itertools
import math

import numpy as np
import pandas as pd
import pytest
from scipy.stats import fisher_exact

import study
from study import api
from study.statistics.analysis.failures import CaseFate, cause, failure_pattern


def design(bad, blocks):
    return [
        CaseFate(
            {"plates": p, "order": o, "depth": d}, str(k), (p, o, d) in bad,
            "not-converged" if (p, o, d) in bad else "",
        )
        for p, o, d in itertools.product(("bonded", "free"), ("1", "2"), ("20 %", "40 %", "60 %"))
        for k in range(blocks)
    ]  # fmt: skip


def test_a_planted_rule_is_found_and_counted():
    fates = design({("bonded", "2", "60 %")}, 8)
    fates[0] = CaseFate(fates[0].levels, fates[0].block, True, "timeout")
    found = failure_pattern(fates, "specimen")
    (rule,) = found.rules
    assert rule.settings == {"plates": "bonded", "order": "2", "depth": "60 %"}
    assert (rule.failed, rule.total, found.elsewhere) == (8, 8, (1, 88))
    assert found.causes == {"not-converged": 8, "timeout": 1}


def test_one_cell_that_fails_in_every_block_blames_no_factor():
    """Eight failures of one cell are one fact: taken as eight, bonded plates had p < 0.01."""
    fates = design({("bonded", "2", "60 %")}, 8)
    naive = fisher_exact([[8, 40], [0, 48]]).pvalue
    assert naive < 0.01
    assert min(test.p for test in failure_pattern(fates).tests) > 0.2


def test_a_factor_that_makes_cells_fail_is_blamed():
    bad = {(p, o, "60 %") for p in ("bonded", "free") for o in ("1", "2")}
    found = failure_pattern(design(bad, 4))
    assert found.tests[0].factor == "depth"
    assert found.tests[0].counts["60 %"] == (16, 16)
    # 4 of 12 cells fail, all of one level: 3 of the 495 ways to choose them are as extreme
    assert found.tests[0].p == pytest.approx(3 / 495, abs=0.003)
    assert [rule.settings for rule in found.rules] == [{"depth": "60 %"}]


def test_a_specimen_that_fails_everywhere_is_found_among_the_blocks():
    fates = [
        CaseFate(one.levels, one.block, one.block == "3", "bad") for one in design(set(), 6)
    ]  # fmt: skip
    found = failure_pattern(fates, "specimen")
    assert found.tests[0].factor == "specimen"
    assert found.tests[0].p_holm < 0.001
    assert [rule.settings for rule in found.rules] == [{"specimen": "3"}]


@pytest.mark.slow
def test_failures_by_chance_are_blamed_on_nothing_more_often_than_promised():
    """Cells that fail as a whole, at random: 5 % of data sets may blame a factor."""
    rng, blamed, ruled, sets = np.random.default_rng(7), 0, 0, 120
    for _ in range(sets):
        cells = list({tuple(one.levels.values()) for one in design(set(), 1)})
        bad = {cell for cell in sorted(cells) if rng.random() < 0.3}
        found = failure_pattern(design(bad, 3))
        blamed += any(test.p_holm < 0.05 for test in found.tests)
        ruled += any(len(rule.settings) < 2 for rule in found.rules)
    assert blamed <= 0.05 * sets + 3 * math.sqrt(0.05 * 0.95 * sets)
    assert ruled < sets / 2


@pytest.mark.slow
def test_rules_that_only_list_cases_by_chance_are_not_given():
    """Single cases fail at random: no conjunction is worth its name."""
    rng, given = np.random.default_rng(3), 0
    for _ in range(60):
        fates = [
            CaseFate(one.levels, one.block, bool(rng.random() < 0.1), "bad")
            for one in design(set(), 6)
        ]
        given += len(failure_pattern(fates).rules) > 0
    assert given <= 9


def test_all_or_none():
    everything = [CaseFate(one.levels, one.block, True, "timeout") for one in design(set(), 2)]
    found = failure_pattern(everything)
    assert (found.failed, found.total, found.tests, found.rules) == (24, 24, (), ())
    assert found.causes == {"timeout": 24}
    none = failure_pattern(design(set(), 2))
    assert (none.failed, none.causes, none.tests, none.rules) == (0, {}, (), ())


def test_ten_thousand_cases_fit_into_memory_and_seconds():
    fates = [
        CaseFate({"a": str(k % 100), "b": str(k // 100)}, "", k % 100 == 7, "bad")
        for k in range(10_000)
    ]
    assert [rule.settings for rule in failure_pattern(fates).rules] == [{"a": "7"}]


def test_a_cause_is_cut_between_words_and_says_so():
    told = "unstable below stretch 0.61 in uniaxial loading, " * 9
    found = cause("unstable", told)
    assert found.startswith("unstable: unstable below stretch … in uniaxial loading,")
    assert found.endswith(" …")
    words = {*told.replace(",", "").split(), "…"}
    assert found.removeprefix("unstable: ").replace(",", "").split()[-2] in words
    assert cause("unstable", "below stretch 0.61") == cause("unstable", "below stretch 0.7")


def test_an_imported_table_of_three_levels_has_the_p_of_fisher_in_r(tmp_path):
    """R 4.2.2: fisher.test(matrix(c(6, 4, 1, 9, 2, 8), 2)), p = 0.0773634161940021."""
    failed = {"soft": 6, "medium": 1, "stiff": 2}
    rows = [
        f"{kind},r{k},{'' if k < bad else 5 + k / 7}"
        for kind, bad in failed.items() for k in range(10)
    ]  # fmt: skip
    file = tmp_path / "runs.csv"
    file.write_text("\n".join(["kind,run,peak", *rows]))
    study = api.import_runs(file, "kind,run", "peak=N", results=tmp_path / "results")
    tests = {test["factor"]: test for test in study.to_json()["failures"]["tests"]}
    assert tests["kind"]["counts"] == {kind: [bad, 10] for kind, bad in failed.items()}
    assert tests["kind"]["p"] == pytest.approx(0.0773634161940021, rel=1e-12)
    assert tests["kind"]["method"] == "Freeman and Halton's exact test"


def test_a_table_names_the_pair_of_levels_that_has_no_response():
    levels = (["2D", "axi", "3D"], ["linear", "quadratic"], ["coarse", "fine"], ["neo", "ogden"])
    table = pd.DataFrame(itertools.product(*levels), columns=["space", "order", "mesh", "energy"])
    table["y"] = np.random.default_rng(3).normal(10, 1, 24) + (table.space == "3D")
    table.loc[(table.space == "3D") & (table.order == "quadratic"), "y"] = np.nan
    found = study.analyze(table, "y ~ space * order * mesh * energy", practical=0.5, exact=False)
    place = "y is missing where space is 3D and order is quadratic (4 of 4 rows); elsewhere in 0"
    assert any(place in note for note in found.notes)
    assert "(--model 1)" in found.effect("space").why
    # two contrasts make up space, and neither p is that of the factor
    assert {"space[1]", "space[2]"} < set(found.lenth.names)
    assert found.anova.row("space").p is None
    assert found.anova.row("mesh").p is not None
