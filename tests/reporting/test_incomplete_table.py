"""The two pages of tables whose blocks do not hold every cell, and of tables that leave doubts."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from study import analyze
from tests.reporting.example import faults_of, words_of


def halves() -> pd.DataFrame:
    """A 2 x 2 x 2 factorial in six blocks of four, as field trials lay it: A x B x C is lost."""
    rng = np.random.default_rng(8)
    rows = [
        (f"b{plot}", a, b, c, 50 + 6 * a - 4 * c + rng.normal(0, 2))
        for plot in range(6)
        for a, b, c in product((0, 1), repeat=3)
        if (a + b + c) % 2 == plot % 2
    ]
    return pd.DataFrame(rows, columns=["field", "A", "B", "C", "yield"])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("halves")
    result = analyze(halves(), "yield", ["A", "B", "C"], block="field", practical="2")
    result.report(made)
    return made


def test_rows_that_no_block_was_to_hold_are_not_missing(folder: Path) -> None:
    pages = [path.read_text("utf-8") for path in sorted(folder.glob("*.html"))]
    assert [faults_of(page) for page in pages] == [[], []]
    first = words_of((folder / "table-yield.html").read_text("utf-8"))
    assert len(first.split()) <= 700
    assert "Unfinished study" not in first
    assert "How does yield depend on A, B and C?" in first


def test_every_figure_is_drawn_from_blocks_that_hold_half_of_the_cells(folder: Path) -> None:
    page = (folder / "table-yield-details.html").read_text("utf-8")
    assert "Figure missing" not in page
    means = pd.read_csv(folder / "table-yield-data" / "figure-yield-means.csv")
    assert (means["low"] < means["mean"]).all()
    assert (means["mean"] < means["high"]).all()
    rows = pd.read_csv(folder / "table-yield-data" / "figure-yield-cells.csv")
    assert len(rows) == 24


def test_the_methods_name_the_model_that_was_fitted(folder: Path) -> None:
    text = words_of((folder / "table-yield-details.html").read_text("utf-8"))
    methods = text.partition("Methods, to paste")[2].partition("Provenance")[0]
    assert "mixed model by REML (Kenward and Roger)" in methods
    assert "gave 8 cells, not all of them in each of 6 fields" in methods
    assert "Greenhouse" not in methods
    assert "No p of this page rests on them" not in text


def test_pairs_without_a_test_have_no_column_for_it(folder: Path) -> None:
    page = (folder / "table-yield-details.html").read_text("utf-8")
    pairs = words_of(page.partition('id="pairs"')[2].partition('id="residuals"')[0])
    assert "Intervals hold for all pairs of a factor together." in pairs
    assert "adjusted p" not in pairs


def test_more_rows_would_narrow_what_a_table_leaves_open(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    table = pd.DataFrame({"wool": list("AB") * 6, "breaks": rng.normal(30, 5, 12)})
    analyze(table, "breaks", ["wool"], practical="2").report(tmp_path)
    page = words_of((tmp_path / "table-breaks.html").read_text("utf-8"))
    assert "these data cannot show whether wool matters" in page
    assert "More rows would narrow the interval of wool." in page
