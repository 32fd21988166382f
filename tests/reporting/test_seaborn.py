"""The statistical figures show what stands in their frames."""

from __future__ import annotations

import math

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection

from study.reporting.content.report_facts import Facts, facts
from study.reporting.figures import effect_figures, residual_figures
from study.reporting.results.study_result import ReportData
from tests.reporting.example import unreplicated


@pytest.fixture(scope="module")
def error(data: ReportData) -> Facts:
    return facts(data)[0]


def points(ax: Axes) -> list[np.ndarray]:
    """Places of the points of every scatter that has any, each of shape (n, 2)."""
    scatters = (found for found in ax.collections if isinstance(found, PathCollection))
    return [np.asarray(found.get_offsets()) for found in scatters if len(found.get_offsets())]


def heights(ax: Axes) -> list[float]:
    """Finite heights of the lines that have markers."""
    lines = [line for line in ax.lines if line.get_marker() not in ("None", "", None)]
    return [y for line in lines for y in line.get_ydata() if np.isfinite(y)]


def test_main_effects(data: ReportData, error: Facts):
    frame = effect_figures.level_means(error)
    (ax,) = effect_figures.draw_level_means(frame, error, data).axes
    assert heights(ax) == frame["mean"].tolist()
    assert ax.get_xlabel() == ""


def test_effects_stand_at_their_multiples_of_what_matters(data: ReportData):
    both = facts(data)
    frame = effect_figures.against_limits(both, data.labels)
    (ax,) = effect_figures.draw_against_limits(frame, both).axes
    drawn = [float(line.get_xdata()[0]) for line in ax.lines if line.get_marker() in ("o", "s")]
    assert drawn == frame["difference"].tolist()
    first = both[0].effects[0]
    assert first.range is not None
    assert first.practical is not None
    assert frame["difference"][0] == pytest.approx(first.range / first.practical)
    last = both[1].effects[0]  # of a log response: a ratio
    assert last.range is not None
    assert last.practical is not None
    of_last = (frame["response"] == both[1].name) & (frame["term"] == last.term)
    row = next(frame[of_last].itertuples())  # what follows is its deciding setting
    assert row.difference == pytest.approx(math.log(last.range) / math.log(last.practical))


def test_effects_without_an_interval_are_drawn_with_their_mesh_error(data: ReportData):
    both = facts(data)
    frame = effect_figures.against_limits(both, data.labels).assign(low=np.nan, high=np.nan)
    (ax,) = effect_figures.draw_against_limits(frame, both).axes
    assert np.isfinite(ax.get_xlim()).all()
    (left, _), (right, _) = ax.collections[0].get_segments()[0]
    assert right - left == pytest.approx(2 * frame["bound"][0])


def test_cells(data: ReportData, error: Facts):
    frame = effect_figures.cell_points(data, error)
    (ax,) = effect_figures.draw_cells(frame, error, 0.5).axes
    *strips, means = points(ax)
    assert np.vstack(strips).tolist() == frame[["value", "rank"]].to_numpy(float).tolist()
    first = frame.drop_duplicates("rank")
    assert means.tolist() == first[["cell_mean", "rank"]].to_numpy(float).tolist()
    assert len(ax.lines) == frame["block"].nunique()


def test_cells_of_a_design_without_blocks_have_no_lines(data: ReportData, error: Facts):
    """A column of blocks that holds none: parameters alone, each cell computed once."""
    frame = effect_figures.cell_points(data, error).drop_duplicates("rank").assign(block=None)
    (ax,) = effect_figures.draw_cells(frame, error, 0.5).axes
    assert not ax.lines
    *strips, _ = points(ax)
    assert len(np.vstack(strips)) == len(frame)


def test_interactions(data: ReportData, error: Facts):
    frame = effect_figures.pair_means(data, error)
    gap = frame.index[0]
    axes = effect_figures.draw_interactions(frame.drop(gap), error, data).axes
    first, level, other, other_level, _ = frame.loc[gap]
    for ax, ((a, b), pair) in zip(
        axes, frame.groupby(["factor", "other"], sort=False), strict=True
    ):
        means = pair.set_index(["level", "other_level"])["mean"]
        for line, name in zip(ax.lines, data.factors[a], strict=True):
            expected = [means[name, across] for across in data.factors[b]]
            if (a, b, name) == (first, other, level):  # the line breaks where the mean is missing
                expected[data.factors[b].index(other_level)] = np.nan
            np.testing.assert_array_equal(line.get_ydata(), expected)


def test_residuals(data: ReportData, error: Facts):
    frame = residual_figures.diagnostic_residual_points(error)
    figure = residual_figures.draw_residuals(frame, error, data)
    _, fitted, histogram, factors = figure.axes
    (line,) = [one for one in fitted.lines if one.get_marker() == "o"]
    assert line.get_xydata().tolist() == frame[["fitted", "residual"]].to_numpy(float).tolist()
    sturges = math.ceil(1 + math.log2(len(frame)))
    counts, edges = np.histogram(frame["residual"], bins=sturges)
    assert [bar.get_height() for bar in histogram.patches] == counts.tolist()
    assert [bar.get_x() for bar in histogram.patches] == pytest.approx(edges[:-1])
    drawn = np.vstack(points(factors))
    # every residual once for each factor
    expected = np.sort(np.tile(frame["residual"], len(data.factors)))
    assert np.sort(drawn[:, 1]).tolist() == expected.tolist()


def test_spread(data: ReportData, error: Facts):
    frame = residual_figures.spread_of_cells(error, 0.05)
    (ax,) = residual_figures.draw_spread(frame, error).axes
    (drawn,) = points(ax)
    assert drawn[:, 0].tolist() == frame["sd"].tolist()


def test_contrasts():
    once = unreplicated()
    found = facts(once)[0]
    frame = residual_figures.contrasts(found, once)
    pareto, half = residual_figures.draw_contrasts(frame, found).axes
    bars = sorted(pareto.patches, key=lambda bar: bar.get_y())
    assert [bar.get_width() for bar in bars] == frame["size"].tolist()
    (drawn,) = points(half)
    assert drawn.tolist() == frame[["score", "size"]].to_numpy(float).tolist()
