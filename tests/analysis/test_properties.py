"""Metamorphic tests P15 to P19 of the statistics."""

import itertools

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from study.statistics.analysis.anova import anova
from study.statistics.analysis.equal_variance import bartlett
from study.statistics.analysis.normality import ryan_joiner, statistic

seeds = st.integers(0, 10_000)
shapes = st.tuples(st.integers(2, 3), st.integers(2, 4), st.integers(2, 3))


def table_of(shape, seed):
    a, b, r = shape
    rows = [(f"a{i}", f"b{j}") for i, j in itertools.product(range(a), range(b)) for _ in range(r)]
    table = pd.DataFrame(rows, columns=["a", "b"])
    return table.assign(y=np.random.default_rng(seed).normal(10, 1, len(table)))


def sums(table):
    return {":".join(sorted(r.term.split(":"))): (r.ss, r.f or 0.0) for r in table.rows}


def rows_of(table, factors, **options):
    return sums(anova(table, "y", factors, exact=False, **options).anova)


def same(one, two, rel, scale=1.0):
    assert one.keys() == two.keys()
    total = sum(ss for ss, _ in one.values())
    for term, (ss, f) in one.items():
        assert two[term][0] == pytest.approx(scale * ss, rel=rel, abs=rel * scale * total)
        assert two[term][1] == pytest.approx(f, rel=1e3 * rel, abs=1e3 * rel)


@settings(max_examples=15)
@given(shapes, seeds, st.integers(2, 3))
def test_p18_duplication_scales_sums(shape, seed, k):
    table = table_of(shape, seed)
    copied = pd.concat([table] * k)
    one = anova(table, "y", ["a", "b"], exact=False)
    many = anova(copied, "y", ["a", "b"], copies="independent", exact=False)
    for row in one.anova.rows:
        assert many.anova.row(row.term).ss == pytest.approx(k * row.ss, rel=1e-11)
    for effect in one.effects:
        assert many.effect(effect.term).range == pytest.approx(effect.range, rel=1e-10)


@settings(max_examples=25)
@given(st.integers(4, 40), seeds, st.floats(0.01, 100), st.floats(-100, 100))
def test_p19_location_scale(n, seed, scale, shift):
    x = np.random.default_rng(seed).normal(size=n)
    rj = statistic(x)
    assert 0 < rj <= 1
    assert statistic(scale * x + shift) == pytest.approx(rj, rel=1e-9)
    one = bartlett([x[: n // 2], x[n // 2 :]])
    two = bartlett([scale * x[: n // 2] + shift, scale * x[n // 2 :] + shift])
    assert 0 <= one.p <= 1
    assert two.statistic == pytest.approx(one.statistic, rel=1e-7, abs=1e-9)
    result = ryan_joiner(x, simulations=200)
    assert 0 < result.p_exact <= 1


ROUTES = {
    "rows": {},
    "blocks pooled": {"block": "s"},
    "own interactions": {"block": "s", "error": "own"},
    "split plot": {"block": "plot"},
    "split plot, own": {"block": "plot", "error": "own"},
    "whole plots in blocks": {"block": "s", "whole_plot": "a"},
    "two blocks": {"block": ["s", "t"]},
}


def blocked_table(seed):
    """3 x 2 cells in four blocks; ``plot`` is a block that holds one level of a."""
    cells = itertools.product(("a0", "a1", "a2"), ("b0", "b1"), range(4))
    table = pd.DataFrame(list(cells), columns=["a", "b", "s"])
    table["plot"] = table["a"] + "/" + table["s"].astype(str)
    table["t"] = (table["s"] + table["a"].str[1:].astype(int)) % 4
    y = np.random.default_rng(seed).normal(10, 1, len(table))
    # rounded so that adding 1e8 is exact in binary
    return table.assign(y=np.round(y * 1024) / 1024)


@pytest.mark.parametrize("route", ROUTES)
@settings(max_examples=2)
@given(seeds)
def test_p15_to_p17_hold_for_blocks_and_strata(route, seed):
    options, table = ROUTES[route], blocked_table(seed)
    whole = anova(table, "y", ["a", "b"], exact=False, **options).anova
    base = sums(whole)
    shuffled = table.sample(frac=1, random_state=seed)
    same(base, rows_of(shuffled, ["b", "a"], **options), 1e-11)
    renamed = shuffled.assign(a=shuffled["a"].map({"a0": "z", "a1": "y", "a2": "<x>"}))
    same(base, rows_of(renamed, ["a", "b"], **options), 1e-11)
    for factor, shift in [(-2.0, 0.0), (1.0, 1e8)]:
        moved = table.assign(y=factor * table["y"] + shift)
        same(base, rows_of(moved, ["a", "b"], **options), 1e-10, factor**2)
    total = float(((table["y"] - table["y"].mean()) ** 2).sum())
    assert whole.ss_total == pytest.approx(total, rel=1e-10)
    if route == "rows":
        types = [rows_of(table, ["a", "b"], type=t) for t in ("I", "II", "III")]
        same(types[0], types[1], 1e-12)
        same(types[0], types[2], 1e-12)
    if route != "blocks pooled" and route != "two blocks":
        # the strata are all listed, so their sums add up
        assert sum(ss for ss, _ in base.values()) == pytest.approx(total, rel=1e-10)
