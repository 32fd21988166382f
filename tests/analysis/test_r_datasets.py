"""R's own data sets: the rows come from R, the figures from ``validation/statistics``."""

import csv
import shutil
import subprocess
from pathlib import Path

import pandas as pd
import pytest

import study
from study.statistics.analysis.anova import anova
from study.statistics.analysis.mixed_model import mixed_model

FOLDER = Path(__file__).parents[2] / "validation" / "statistics"
FIGURES = {
    (row["data"], row["term"], row["quantity"]): float(row["value"])
    for row in csv.DictReader((FOLDER / "r_datasets.csv").read_text().splitlines()[1:])
}


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    if shutil.which("Rscript") is None:
        pytest.skip("R is not installed, and the rows of its data sets stay there")
    folder = tmp_path_factory.mktemp("rows")
    script = ["Rscript", str(FOLDER / "r_datasets.R"), "rows", str(folder)]
    made = subprocess.run(script, capture_output=True, text=True, check=False)
    if made.returncode:
        pytest.skip(f"R lacks MASS or lme4: {made.stderr[-200:]}")
    return folder


@pytest.mark.parametrize(
    ("name", "formula", "options"),
    [
        ("npk", "yield ~ (N + P + K)^2 + Error(block)", {"error": "pooled"}),
        ("warpbreaks", "breaks ~ wool * tension", {}),
        ("ToothGrowth", "len ~ supp * dose", {}),
        ("InsectSprays", "count ~ spray", {}),
    ],
)
def test_analyses_of_variance(rows, name, formula, options):
    found = study.analyze(rows / f"{name}.csv", formula, copies="independent", exact=False,
                          **options)  # fmt: skip
    terms = [row for row in found.anova.rows if (name, row.term, "f") in FIGURES]
    assert len(terms) == sum(key[0] == name and key[2] == "f" for key in FIGURES)
    for row in terms:
        assert row.f == pytest.approx(FIGURES[name, row.term, "f"], rel=1e-9)
        assert row.p == pytest.approx(FIGURES[name, row.term, "p"], rel=1e-7)


def test_spread_of_insect_sprays(rows):
    table = pd.read_csv(rows / "InsectSprays.csv")
    found = anova(table, "count", ["spray"], copies="independent", exact=False)
    tests = found.assumptions
    assert tests.bartlett.statistic == pytest.approx(FIGURES["InsectSprays", "", "bartlett"])
    assert tests.fligner[0] == pytest.approx(FIGURES["InsectSprays", "", "fligner"])
    welch = anova(table, "count", ["spray"], copies="independent", error="welch", exact=False)
    row = welch.anova.row("spray")
    assert row.f == pytest.approx(FIGURES["InsectSprays", "spray", "welch_f"], rel=1e-9)
    assert row.p == pytest.approx(FIGURES["InsectSprays", "spray", "welch_p"], rel=1e-7)


def test_the_split_plot_of_oats(rows):
    found = study.analyze(rows / "oats.csv", "Y ~ N * V + Error(B/V)", exact=False)
    for term in ("N", "V", "N:V"):
        assert found.anova.row(term).f == pytest.approx(FIGURES["oats", term, "f"], rel=1e-9)


@pytest.mark.parametrize(
    ("name", "response", "block", "random", "model", "sds", "term"),
    [
        ("oats_lost", "Y", "B", ["V"], ["N", "V"], {"B": "B", "B:V": "V:B"}, "N"),
        ("CO2", "uptake", "Plant", [], ["Type", "Treatment", "conc", "Type:Treatment"],
         {"Plant": "Plant"}, "conc"),
    ],
)  # fmt: skip
def test_mixed_models(rows, name, response, block, random, model, sds, term):
    table, factors = pd.read_csv(rows / f"{name}.csv"), [term for term in model if ":" not in term]
    found = mixed_model(table, response, factors, block=block, random=random, model=model)
    sd = {c.source: c.sd for c in found.components}
    for ours, theirs in sds.items():
        assert sd[ours] == pytest.approx(FIGURES[name, theirs, "sd"], rel=1e-6)
    test = next(t for t in found.terms if t.term == term)
    assert test.f == pytest.approx(FIGURES[name, term, "f"], rel=1e-6)
    assert test.df_error == pytest.approx(FIGURES[name, term, "df_error"], rel=1e-6)


@pytest.mark.parametrize(
    ("name", "response", "random"),
    [
        ("Pastes", "strength", ["batch", "batch:cask"]),
        ("Dyestuff", "Yield", ["Batch"]),
    ],
)
def test_studies_of_precision(rows, name, response, random):
    found = mixed_model(pd.read_csv(rows / f"{name}.csv"), response, [], random=random)
    theirs = {"within": "Residual", "batch:cask": "cask:batch"}
    for component in found.components:
        figure = FIGURES[name, theirs.get(component.source, component.source), "sd"]
        assert component.sd == pytest.approx(figure, rel=1e-6)


def test_scatter_of_oats_is_that_of_its_mean_squares(rows):
    """Complete, so REML is the classical analysis; lme4 ends its search at 1e-5 of it."""
    table = pd.read_csv(rows / "oats.csv")
    found = mixed_model(table, "Y", ["N", "V"], block="B", random=["V"])
    strata = study.analyze(table, "Y ~ N * V + Error(B/V)").anova
    ms = {row.term: row.ms for row in strata.rows}
    exact = [(ms["B"] - ms["B:V"]) / 12, (ms["B:V"] - ms["residual"]) / 4, ms["residual"]]
    assert [c.sd**2 for c in found.components] == pytest.approx(exact, rel=1e-9)
