"""What ``study analyze`` prints: the table of a Minitab user, and how repeats would mislead."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from study.cli.app import run
from study.statistics.analysis.anova import anova

DESIGNS = Path(__file__).resolve().parents[2] / "validation" / "statistics"


def printed(capsys, *arguments):
    assert run(["analyze", *arguments]) == 0
    out = capsys.readouterr()
    return out.out, out.err


def lines_of(text, start):
    """Words of the lines after ``start``, up to the next empty line."""
    lines = text.split("\n")
    at = next(i for i, line in enumerate(lines) if line.startswith(start))
    block = lines[at + 1 :]
    end = next((i for i, line in enumerate(block) if not line.strip()), len(block))
    return [line.split() for line in block[:end]]


def test_the_table_is_the_one_of_minitab(capsys):
    path = str(DESIGNS / "crossed.csv")
    out, _ = printed(capsys, path, "--response", "y", "--factors", "a,b", "--type", "III")
    table = lines_of(
        out.replace(" \N{MULTIPLICATION SIGN} ", ":"), "Analysis of Variance: y, type III"
    )
    assert " ".join(table[0]) == "source DF Adj SS Adj MS F p"
    assert [line[0] for line in table[1:]] == ["a", "b", "a:b", "error", "total"]
    assert [line[1] for line in table[1:]] == ["2", "1", "2", "30", "35"]
    frame = pd.read_csv(path)
    assert float(table[-1][2]) == pytest.approx(frame["y"].var() * 35, rel=1e-4)
    head, summary, _ = lines_of(out.replace(" %", "%"), "Model Summary")
    assert " ".join(head) == "S R-sq R-sq (adjusted) R-sq (predicted)"
    assert all(value.endswith("%") for value in summary[1:])
    # S is the root of the error mean square
    assert float(summary[0]) == pytest.approx(np.sqrt(float(table[4][3])), rel=1e-3)
    seq, _ = printed(capsys, path, "--response", "y", "--factors", "a,b", "--type", "I")
    assert "Seq SS" in seq


def test_strata_say_what_each_line_is_tested_against(capsys):
    path = str(DESIGNS / "splitplot.csv")
    arguments = (path, "--response", "y", "--factors", "mix,speed", "--block", "specimen")
    out, _ = printed(capsys, *arguments, "--error", "pooled")
    table = lines_of(out, "Analysis of Variance")
    assert " ".join(table[0]).endswith("p tested against")
    assert [(line[0], line[-1]) for line in table[1:4:2]] == [
        ("mix", "specimen"),
        ("speed", "residual"),
    ]
    out, _ = printed(capsys, *arguments)
    assert "epsilon" in lines_of(out, "Analysis of Variance")[0]
    blocks = (str(DESIGNS / "splitblocks.csv"), "--response", "y", "--factors", "v,n")
    out, _ = printed(capsys, *blocks, "--block", "k", "--whole-plot", "v")
    assert "k:v" in out
    latin = (str(DESIGNS / "latin.csv"), "--response", "y", "--factors", "t", "--block", "r,c")
    out, err = printed(capsys, *latin)
    assert "another r and c" in out
    assert "unbalanced" not in err


def test_mesh_seeds_are_declared_on_the_command_line(capsys, tmp_path):
    path = tmp_path / "seeds.csv"
    pd.read_csv(DESIGNS / "crossed.csv").to_csv(path, index=False)
    arguments = (str(path), "--response", "y", "--factors", "a,b", "--replicates", "mesh-seeds")
    out, err = printed(capsys, *arguments)
    assert out.startswith("error term E3: is the effect larger than the mesh noise")
    assert "common to all seeds" in err


def test_missing_responses_are_bounded_in_print(capsys, tmp_path):
    path = tmp_path / "lost.csv"
    table = pd.read_csv(DESIGNS / "crossed.csv")
    table.loc[[1, 5], "y"] = np.nan
    table.to_csv(path, index=False)
    err = printed(capsys, str(path), "--response", "y", "--factors", "a,b")[1]
    assert "the 2 missing responses" in " ".join(err.split())
    assert "y is missing in 2 of 36 rows" in err


def test_the_real_factorial_says_how_ten_independent_tests_would_have_misled(capsys, data_dir):
    """Five repeats on each of two specimens in 15 cells: R gives both F of the log force."""
    path = data_dir / "ecoflex_compression" / "factorial_3x5_force6mm.csv"
    arguments = (
        str(path), "--response", "F_at_6mm_N", "--factors", "family,thinner_pct",
        "--unit", "specimen", "--transform", "log", "--practical", "5 % of mean",
    )  # fmt: skip
    out, _ = printed(capsys, *arguments)
    assert "would the effect show with other levels of specimen?" in out
    assert "What 150 'independent' rows would have claimed" in out
    assert "F(2, 135) = 5.478e+04" in out
    assert "correlate by 0.59" in out
    assert "tell as much as 45 independent ones" in out
    document = json.loads(printed(capsys, *arguments, "--json")[0])
    nested = document["nested"]
    # R's naive residual sum and F (factorial_3x5_logforce_expected_R.csv) against the strata
    table = pd.read_csv(path)
    table["y"] = np.log(table["F_at_6mm_N"])
    expected = dict(
        pd.read_csv(path.parent / "factorial_3x5_logforce_expected_R.csv").to_numpy().tolist()
    )
    family = nested["terms"][0]
    assert family["naive_f"] == pytest.approx(expected["anova_family_F"], rel=1e-8)
    means = table.groupby(["family", "thinner_pct", "specimen"])["y"].mean()
    between = 5 * float(means.groupby(["family", "thinner_pct"]).var().mean())
    assert family["f"] == pytest.approx(expected["anova_family_ss"] / 2 / between, rel=1e-8)
    within = float(table.groupby(["family", "thinner_pct", "specimen"])["y"].var().mean())
    share = (between - within) / 5
    assert nested["correlation"] == pytest.approx(share / (share + within), rel=1e-8)
    assert nested["naive_size"] > 0.4
    assert nested["too_narrow"] > 2
    # no conclusion on a factor changes here, and that is said by its absence
    assert not any("the conclusion changes" in w for w in document["warnings"])


def test_the_naive_size_is_what_null_studies_show():
    """Two levels, 4 specimens each, 6 repeats, correlation 0.5: 2,000 null studies."""
    rng = np.random.default_rng(3)
    table = pd.DataFrame(
        [(a, s, r) for a in "xz" for s in range(4) for r in range(6)], columns=["a", "s", "r"]
    )
    unit = np.repeat(np.arange(8), 6)
    y = 1 + rng.normal(size=8)[unit] + rng.normal(size=48)
    nested = anova(table.assign(y=y), "y", ["a"], unit="s", exact=False).nested
    assert nested.units == 8
    from study.statistics.analysis.repeats import _naive_size

    z = rng.normal(size=(2000, 8))[:, unit] + rng.normal(size=(2000, 48))
    first, second = z[:, :24], z[:, 24:]
    pooled = (first.var(axis=1, ddof=1) + second.var(axis=1, ddof=1)) / 2
    t2 = (first.mean(axis=1) - second.mean(axis=1)) ** 2 / (pooled / 12)
    # F(1, 46) at 5 %: 4.0517; binomial sd of the rate is 1.1 %
    rate = float(np.mean(t2 > 4.051749))
    assert _naive_size(3.5, 0.5, 1, 6, 40, 1) == pytest.approx(rate, abs=0.044)


def test_a_term_is_no_picture(capsys):
    """``s:a:b`` holds ``:a:``, which a terminal library may take for an emoji."""
    path = str(DESIGNS / "repeated.csv")
    arguments = ("--response", "y", "--factors", "a,b", "--block", "s", "--error", "own")
    out, _ = printed(capsys, path, *arguments)
    out = out.replace(" \N{MULTIPLICATION SIGN} ", ":")
    assert [line[0] for line in lines_of(out, "Analysis of Variance")] == [
        "source", "a", "b", "a:b", "s", "s:a", "s:b", "s:a:b", "total",
    ]  # fmt: skip


def test_detectable_differences_come_from_the_error_found():
    from study.statistics.analysis.power import detectable

    table = pd.read_csv(DESIGNS / "repeated.csv")
    one = anova(table[table["b"] == "b1"], "y", ["a"], block="s", error="own", exact=False)
    ms = one.anova.row("s:a").ms
    assert ms is not None
    assert [r.n for r in one.power["a"]] == [4, 8, 16, 32]
    for row in one.power["a"]:
        assert row.df == (2, 2 * (row.n - 1))
        expected = detectable(float(np.sqrt(ms)), row.n, row.df, 0.05, 0.8)
        assert row.detectable == pytest.approx(expected, rel=1e-9)
