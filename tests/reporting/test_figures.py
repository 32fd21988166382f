"""What figures compute: numbers without pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from study.reporting import figures_curves, figures_effects, figures_residuals, style
from study.reporting.data import ReportData
from study.reporting.facts import cells, facts
from study.reporting.front import cost_front


def test_level_means_are_the_means_of_the_cells(data: ReportData):
    error = facts(data)[0]
    frame = figures_effects.level_means(error)
    expected = data.table.groupby("material")["relative_rms_force_error"].mean()
    for row in frame[frame["factor"] == "material"].itertuples():
        assert row.mean == pytest.approx(expected[row.level], rel=1e-12)  # same sums, other order


def test_log_cells_are_geometric_means(data: ReportData):
    first = cells(data, "mu0").iloc[0]
    match = (data.table[list(data.factors)].astype(str) == first[list(data.factors)]).all(axis=1)
    assert first["mean"] == pytest.approx(stats.gmean(data.table.loc[match, "mu0"]), rel=1e-12)


def test_cells_are_ranked_best_first(data: ReportData):
    frame = figures_effects.cell_points(data, facts(data)[0])
    means = frame.drop_duplicates("rank")["cell_mean"].to_numpy()
    assert np.all(np.diff(means) >= 0)
    assert len(frame) == 288


def test_scores_are_those_of_ryan_joiner(data: ReportData):
    frame = figures_residuals.residual_points(facts(data)[1])
    n = len(frame)
    assert n == 72  # 8 distinct computations, 9 blocks
    assert frame["score"].iloc[-1] == pytest.approx(stats.norm.ppf((n - 0.375) / (n + 0.25)))


def test_envelope_covers_what_it_says():
    low, high = figures_residuals.envelope(30, 2.0, 1)
    rng = np.random.default_rng(0)
    draws = np.sort(rng.standard_normal((2000, 30)), axis=1)
    draws = 2.0 * (draws - draws.mean(1, keepdims=True)) / draws.std(1, ddof=1, keepdims=True)
    inside = ((draws >= low) & (draws <= high)).mean()
    # 1000 simulations fix a 2.5 % quantile to about 0.5 %
    assert inside == pytest.approx(0.95, abs=0.01)


def test_interval_of_a_standard_deviation(data: ReportData):
    frame = figures_residuals.spread_of_cells(facts(data)[1], 0.05)
    row = frame.iloc[0]
    tail = 0.05 / 2 / len(frame)
    # textbook: s sqrt(df / chi2)
    assert row["low"] == pytest.approx(row["sd"] * np.sqrt(8 / stats.chi2.isf(tail, 8)))
    assert row["high"] == pytest.approx(row["sd"] * np.sqrt(8 / stats.chi2.ppf(tail, 8)))


def test_front_holds_what_no_other_cell_dominates(data: ReportData):
    frame = cost_front(data, facts(data)[0])
    for row in frame.itertuples():
        better = (frame["seconds"] <= row.seconds) & (frame["mean"] <= row.mean)
        better &= (frame["seconds"] < row.seconds) | (frame["mean"] < row.mean)
        assert row.front == (not better.any())


def test_curves_split_by_what_differs_most(data: ReportData):
    found = figures_curves.curve_panels(data)
    assert found.line == "material"
    assert found.left_out == 0
    assert set(found.frame["block"]) == set(data.blocks)


def test_many_blocks_are_thinned_and_counted(data: ReportData):
    pairs = tuple(replace(pair, block=f"b{i}") for i in range(40) for pair in data.curves[:8])
    found = figures_curves.curve_panels(replace(data, curves=pairs))
    assert len(found.panels) <= 24
    assert found.left_out > 0


def test_mathematics_in_a_name_stays_text():
    def draw():
        figure = style.canvas(3, 2)
        figure.subplots().set_title(r"$\frac{a}$ & <b>")
        return figure

    svg = style.render(draw, "n", "t")
    assert r"$\frac{a}$ &amp; &lt;b&gt;" in svg
    assert "font-family" not in svg
    assert svg == style.render(draw, "n", "t")
