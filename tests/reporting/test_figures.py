"""What figures compute and draw: numbers without pixels."""

import math
import re
import warnings
from dataclasses import replace
from itertools import product
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from matplotlib.collections import PathCollection
from scipy import stats

from study import fit_surfaces
from study.ground.curve import Curve
from study.reporting.content.report_facts import cells, facts
from study.reporting.content.sentences import cost_front
from study.reporting.figures import (
    axes,
    convergence_figures,
    curve_figures,
    effect_figures,
    residual_figures,
    study_figures,
    surface_figures,
)
from study.reporting.results.study_result import CurvePair, ReportData, ResponseAnalysis
from study.statistics.analysis.unreplicated import pseudo_standard_error
from tests.reporting.example import build, unreplicated


def test_log_cells_are_geometric_means(data):
    first = cells(data, "mu0").iloc[0]
    match = (data.table[list(data.factors)].astype(str) == first[list(data.factors)]).all(axis=1)
    assert first["mean"] == pytest.approx(stats.gmean(data.table.loc[match, "mu0"]), rel=1e-12)


def test_scores_are_those_of_ryan_joiner(data):
    frame = residual_figures.diagnostic_residual_points(facts(data)[1], data)
    n = len(frame)
    assert n == 72  # 8 distinct computations, 9 blocks
    assert frame["score"].iloc[-1] == pytest.approx(stats.norm.ppf((n - 0.375) / (n + 0.25)))


def test_envelope_covers_what_it_says():
    low, high = residual_figures.envelope(30, 2.0, 1)
    rng = np.random.default_rng(0)
    draws = np.sort(rng.standard_normal((2000, 30)), axis=1)
    draws = 2.0 * (draws - draws.mean(1, keepdims=True)) / draws.std(1, ddof=1, keepdims=True)
    inside = ((draws >= low) & (draws <= high)).mean()
    # 1000 simulations fix a 2.5 % quantile to about 0.5 %
    assert inside == pytest.approx(0.95, abs=0.01)


def test_interval_of_a_standard_deviation(data):
    frame = residual_figures.spread_of_cells(facts(data)[1], data)
    row = frame.iloc[0]
    tail = 0.05 / 2 / len(frame)
    # textbook: s sqrt(df / chi2)
    assert row["low"] == pytest.approx(row["sd"] * np.sqrt(8 / stats.chi2.isf(tail, 8)))
    assert row["high"] == pytest.approx(row["sd"] * np.sqrt(8 / stats.chi2.ppf(tail, 8)))


def test_front_holds_what_no_other_cell_dominates(data):
    frame = cost_front(facts(data)[0], data)
    for row in frame.itertuples():
        # 0.5 pp matters, so a gain below 0.0005 pp is none
        earlier = (frame["seconds"] <= row.seconds) & (frame.index < row.Index)
        better = earlier & (frame["mean"] <= row.mean + 0.0005)
        assert row.front == (not better.any())


def test_contrasts_beyond_the_margin_are_the_real_ones():
    data = unreplicated()
    frame = residual_figures.contrasts(facts(data)[0], data)
    assert set(frame.loc[frame["active"], "contrast"]) == {"material", "plates", "material:plates"}
    # the effect of the material: 2 + 1.5 / 2, noise 0.2 * 2 / sqrt(16) = 0.1
    assert frame["size"].iloc[0] == pytest.approx(2.75, abs=0.3)
    assert (frame["low"] <= frame["high"]).all()
    passive = frame[~frame["active"]]
    assert (passive["size"] <= passive["high"] * 1.05).all()


def test_half_normal_envelope_holds_null_contrasts():
    low, high = residual_figures._envelope(15, 1.0, 4)
    z = np.abs(np.random.default_rng(8).standard_normal((2000, 15)))
    z = np.sort(z / pseudo_standard_error(z)[:, None], axis=1)[:, ::-1]
    # 2000 simulations fix a 2.5 % quantile to about 0.35 %
    assert ((z >= low) & (z <= high)).mean() == pytest.approx(0.95, abs=0.01)


def test_a_report_without_replicates_shows_its_contrasts_and_no_residuals():
    page = build(unreplicated())
    assert 'id="f-y-contrasts"' in page
    assert "y-residuals" not in page
    assert "Figure missing" not in page
    assert "p (Lenth)" in page


def test_constants_keep_their_intervals_and_the_order_of_the_design(data):
    frame = study_figures.constant_points(data)
    assert len(frame) == len(data.fits)
    first = frame[frame["place"] == 0]
    assert first["row"].unique().tolist() == ["neo-hookean \N{MIDDLE DOT} frictionless"]
    assert (frame["low"] < frame["value"]).all()
    assert not frame.loc[frame["row"].str.startswith("mooney"), "identifiable"].any()


def test_many_blocks_are_thinned_and_counted(data):
    pairs = tuple(replace(pair, block=f"b{i}") for i in range(40) for pair in data.curves[:8])
    found = curve_figures.curve_panels(replace(data, curves=pairs))
    assert len(found.panels) <= 24
    assert found.left_out > 0


def two_ranges(data):
    """Two materials compared with the first 5 mm and with all 10 mm of one measured curve."""
    d = np.linspace(0, 10, 101)
    force = 0.2 * d + 0.05 * d**2
    curves = tuple(
        CurvePair(
            {"material": material, "range": share},
            "b",
            Curve(d[:end], force[:end]),
            Curve(d[:end], factor * force[:end]),
        )
        for share, end in (("half", 51), ("whole", 101))
        for material, factor in (("soft", 0.9), ("hard", 1.1))
    )
    factors = {"range": ("half", "whole"), "material": ("soft", "hard")}
    return replace(data, factors=factors, blocks=("b",), curves=curves)


def test_every_panel_shows_its_own_measurement_to_its_end(data):
    found = curve_figures.curve_panels(two_ranges(data))
    assert (found.line, found.panel) == ("material", "range")
    for (block, level), end in zip(found.panels, (5.0, 10.0), strict=True):
        rows = found.frame[(found.frame["block"] == block) & (found.frame["panel"] == level)]
        assert rows["displacement_mm"].max() == end
        # 0.2 d + 0.05 d^2, and the two materials are 10 % beside it
        assert rows["measured_N"].max() == pytest.approx(0.2 * end + 0.05 * end**2)
        assert (rows["predicted_N"] / rows["measured_N"]).dropna().round(6).isin([0.9, 1.1]).all()
    # 2.25 N and 7 N: more than a factor of three, so both axes are in percent of their own
    assert found.is_relative


def test_a_prediction_that_stopped_leaves_its_measurement_whole(data):
    whole = two_ranges(data).curves[2]
    short = replace(whole, predicted=Curve(np.array([0.0, 4.0]), np.array([0.0, 1.5])))
    alone = replace(two_ranges(data), curves=(short,), factors={"material": ("soft",)})
    found = curve_figures.curve_panels(alone)
    assert found.frame["displacement_mm"].max() == 10.0
    assert found.frame.dropna(subset=["predicted_N"])["displacement_mm"].max() == 4.0
    assert found.frame["measured_N"].notna().all()
    words = curve_figures.curves_caption(found, data, found.frame)
    assert "stopped" in words
    # a curve without a block has the name of its line alone
    of_none = curve_figures.curves_caption(found, data, found.frame.assign(block=""))
    assert "N (soft)." in of_none


def test_no_two_panels_have_the_same_title(data):
    names = tuple(f"{'reduced-polynomial-' * 6}{order}" for order in (2, 3))
    renamed = dict(zip(("half", "whole"), names, strict=True))
    both = two_ranges(data)
    pairs = tuple(
        replace(pair, levels={**pair.levels, "range": renamed[pair.levels["range"]]})
        for pair in both.curves
    )
    factors = {"range": names, "material": both.factors["material"]}
    found = curve_figures.curve_panels(replace(both, curves=pairs, factors=factors))
    assert len(set(curve_figures.panel_titles(found, 2.0, both))) == 2


def test_no_place_in_a_drawing_is_finer_than_a_hundredth():
    """The solver of layouts leaves other digits from one process to the next."""

    def draw():
        figure = axes.canvas(2, 3)
        figure.subplots().plot([0, 1 / 3], [0, 1 / 7])
        figure.axes[0].set_ylabel("force (N)")
        return figure

    svg = axes.render(draw, "n", "t")
    places = re.findall(r'(?<= )(?:d|x|y|width|height)="[^"]*"|rotate\([^)]*\)', svg)
    assert {place.partition("=")[0] for place in places if "=" in place} >= {"d", "x", "width"}
    assert any(place.startswith("rotate(-90 ") for place in places)
    assert [place for place in places if re.search(r"\.\d{3}", place)] == []


def test_mathematics_in_a_name_stays_text():
    def draw():
        figure = axes.canvas(2, 3)
        figure.subplots().set_title(r"$\frac{a}$ & <b>")
        return figure

    svg = axes.render(draw, "n", "t")
    assert r"$\frac{a}$ &amp; &lt;b&gt;" in svg
    assert svg.count("font-family") == 1  # of the whole drawing, which a page overrules
    assert svg == axes.render(draw, "n", "t")


def luminance(color):
    """Relative luminance of a hexadecimal color (WCAG 2.1)."""
    parts = (int(color[i : i + 2], 16) / 255 for i in (1, 3, 5))
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    return float(np.dot((0.2126, 0.7152, 0.0722), linear))


@pytest.mark.parametrize("color", [*axes.WORDS, axes.INK, axes.MUTED])
def test_words_can_be_read(color):
    for ground in ("#ffffff", axes.BAND):
        contrast = (luminance(ground) + 0.05) / (luminance(color) + 0.05)
        # words of a figure are small: level AA asks for 4.5; on the band for large ones, 3
        assert contrast >= (4.5 if ground == "#ffffff" else 3.0)


# Figures show what stands in their frames.


@pytest.fixture(scope="module")
def error(data):
    return facts(data)[0]


def points(ax):
    """Places of the points of every scatter that has any, each of shape (n, 2)."""
    scatters = (found for found in ax.collections if isinstance(found, PathCollection))
    return [np.asarray(found.get_offsets()) for found in scatters if len(found.get_offsets())]


def heights(ax):
    """Finite heights of the lines that have markers."""
    lines = [line for line in ax.lines if line.get_marker() not in ("None", "", None)]
    return [y for line in lines for y in line.get_ydata() if np.isfinite(y)]


def test_main_effects(data, error):
    frame = effect_figures.level_means(error, data)
    panels = effect_figures.draw_level_means(error, data, frame).axes
    assert [y for ax in panels for y in heights(ax)] == frame["mean"].tolist()


def test_effects_stand_at_their_multiples_of_what_matters(data):
    both = facts(data)
    frame = effect_figures.against_limits(both, data.labels)
    (ax,) = effect_figures.draw_against_limits(frame, both).axes
    drawn = [float(line.get_xdata()[0]) for line in ax.lines if line.get_marker() in ("o", "s")]
    assert drawn == frame["difference"].tolist()
    first, last = (of.effects[0] for of in both)
    assert first.range
    assert first.practical
    assert frame["difference"][0] == pytest.approx(first.range / first.practical)
    assert last.range  # of a log response: a ratio
    assert last.practical
    of_last = (frame["response"] == both[1].name) & (frame["term"] == last.term)
    row = next(frame[of_last].itertuples())  # what follows is its deciding setting
    assert row.difference == pytest.approx(math.log(last.range) / math.log(last.practical))


def test_effects_without_an_interval_are_drawn_with_their_mesh_error(data):
    both = facts(data)
    frame = effect_figures.against_limits(both, data.labels).assign(low=np.nan, high=np.nan)
    (ax,) = effect_figures.draw_against_limits(frame, both).axes
    assert np.isfinite(ax.get_xlim()).all()
    (left, _), (right, _) = ax.collections[0].get_segments()[0]
    assert right - left == pytest.approx(2 * frame["bound"][0])


def test_cells(data, error):
    frame = effect_figures.cell_points(error, data)
    (ax,) = effect_figures.draw_cells(error, data, frame).axes
    *strips, means = points(ax)
    assert np.vstack(strips).tolist() == frame[["value", "rank"]].to_numpy(float).tolist()
    first = frame.drop_duplicates("rank")
    assert means.tolist() == first[["cell_mean", "rank"]].to_numpy(float).tolist()
    assert len(ax.lines) == frame["block"].nunique()
    assert np.all(np.diff(first["cell_mean"].to_numpy()) >= 0)
    assert (len(first), len(frame)) == (32, 9 * 32)
    assert first["label"].is_unique


def test_cells_of_a_design_without_blocks_have_no_lines(data, error):
    """A column of blocks that holds none: parameters alone, each cell computed once."""
    frame = effect_figures.cell_points(error, data).drop_duplicates("rank").assign(block=None)
    (ax,) = effect_figures.draw_cells(error, data, frame).axes
    assert not ax.lines
    *strips, _ = points(ax)
    assert len(np.vstack(strips)) == len(frame)


def test_interactions(data, error):
    frame = effect_figures.pair_means(error, data)
    gap = frame.index[0]
    panels = effect_figures.draw_interactions(error, data, frame.drop(gap)).axes
    first, level, other, other_level, _ = frame.loc[gap]
    pairs = frame.groupby(["factor", "other"], sort=False)
    for ax, ((a, b), pair) in zip(panels, pairs, strict=True):
        means = pair.set_index(["level", "other_level"])["mean"]
        for line, name in zip(ax.lines, data.factors[a], strict=True):
            expected = [means[name, across] for across in data.factors[b]]
            if (a, b, name) == (first, other, level):  # the line breaks where the mean is missing
                expected[data.factors[b].index(other_level)] = np.nan
            np.testing.assert_array_equal(line.get_ydata(), expected)


def test_residuals(data, error):
    frame = residual_figures.diagnostic_residual_points(error, data)
    figure = residual_figures.draw_residuals(error, data, frame)
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


# Logarithmic axes and legends.


def seen(ax, axis):
    low, high = sorted(ax.get_xlim() if axis == "x" else ax.get_ylim())
    target = ax.xaxis if axis == "x" else ax.yaxis
    ax.figure.canvas.draw()
    labels = zip(target.get_majorticklocs(), target.get_majorticklabels(), strict=True)
    return [label.get_text() for place, label in labels if low <= place <= high]


@pytest.mark.parametrize("low", [1e-9, 0.0031, 0.97, 9.9, 12345.0])
@pytest.mark.parametrize("ratio", [1.001, 1.05, 1.7, 3.3, 9.0, 11.0, 1e3, 1e12])
def test_a_logarithmic_axis_shows_two_different_labels(low, ratio):
    ax = axes.canvas(3, 6).subplots()
    ax.loglog([low, low * ratio], [0.07, 0.07 * ratio])
    axes.log_ticks(ax)
    for axis in "xy":
        labels = seen(ax, axis)
        assert 2 <= len(set(labels)) == len(labels) <= 10
        assert all(labels)


@pytest.mark.parametrize("spread", [1.001, 1.3, 50.0])
def test_figures_of_convergence_label_both_axes(spread):
    error = 0.03 * np.geomspace(1, spread, 3)
    frame = pd.DataFrame(
        {"cell": "a", "mesh_size": [1.0, 1.5, 2.25], "error": error, "formal_order": np.nan}
    )
    (ax,) = convergence_figures.draw_errors([], frame).axes
    assert len(seen(ax, "y")) >= 2
    front = pd.DataFrame({"cell": "a", "seconds": 2.0 * np.geomspace(1, spread, 3), "error": error})
    (ax,) = convergence_figures.draw_front({"accuracy": 0.029}, front).axes
    assert len(seen(ax, "x")) >= 2
    assert len(seen(ax, "y")) >= 2


@pytest.mark.parametrize("levels", [2, 14, 40])
def test_cost_against_accuracy_of_many_levels(levels):
    ranges = [f"{k} %" for k in range(levels)]
    factors = {"material": ["neo-hookean", "reduced-polynomial-3"], "range": ranges}
    frame = pd.DataFrame(product(*factors.values()), columns=list(factors))
    seconds, mean = np.geomspace(0.05, 0.2, len(frame)), np.linspace(6.0, 3.0, len(frame))
    cell = frame["material"] + frame["range"]
    frame = frame.assign(cell=cell, seconds=seconds, mean=mean, front=True)
    facts = SimpleNamespace(better="lower", title="error", unit="%", practical=0.5, relative=False)
    data = SimpleNamespace(factors=factors, labels={})
    found = []

    def draw():
        found.append(study_figures.draw_front(facts, data, frame))
        return found[0]

    with warnings.catch_warnings():
        warnings.simplefilter("error")  # matplotlib gives up a layout with a warning
        axes.render(draw, "front", "Cost against accuracy")
    (ax,) = found[0].axes
    legend = ax.get_legend().get_window_extent()
    assert legend.x1 <= found[0].bbox.x1
    assert ax.get_position().height * found[0].get_figheight() > 1.5


def test_profiles_of_all_responses_go_through_the_best_setting(tmp_path):
    a, b = (part.ravel() for part in np.meshgrid(np.linspace(0, 1, 5), np.linspace(-1, 1, 5)))
    table = {"a": a, "b": b, "y": (a - 0.3) ** 2 + 0.2 * b, "z": 5 * b + 0.01 * a}
    noise = np.random.default_rng(1).normal(size=a.size)
    table |= {"v": 2 * b + 0.05 * noise, "w": noise}  # the band of v is wider than what matters
    both = [pd.DataFrame(table | {"m": m, "y": k * table["y"]}) for m, k in (("p", 1), ("q", 2))]
    pd.concat(both).to_csv(tmp_path / "runs.csv", index=False)
    surfaces = tuple(
        fitted
        for name in ("y", "z", "v", "w")
        for fitted in fit_surfaces(tmp_path / "runs.csv", name, ["a", "b"], ["m"], practical="0.1")
    )
    goal = ResponseAnalysis("y", "", better="lower")
    report = ReportData("s", "", {}, pd.DataFrame(), analyses=(goal,), surfaces=surfaces)
    figure, other = surface_figures.profilers(report)
    assert (figure.name, other.name) == ("profiler-m-p", "profiler-m-q")
    assert not figure.missing
    assert figure.data is not None
    for name, at in {"a": 0.3, "b": -1.0}.items():
        part = figure.data[figure.data["factor"] == name]
        assert part["reference"].to_numpy() == pytest.approx(at, abs=1e-4), name
    for words in (
        "with the others where y at m p is lowest (lines: a 0.300 and b \N{MINUS SIGN}1.00)",
        "y lies between \N{MINUS SIGN}0.200 and 0.290 along a",
        "z rises with b from \N{MINUS SIGN}5.00 to 5.00",
        "changes by less than what matters (0.100) with a. v rises",
        "and may change by more or less than what matters (0.100) with a",
        "The runs do not carry the surface of w, so its row says nothing",
    ):
        assert words in figure.caption, figure.caption
    figure, _ = surface_figures.profilers(replace(report, analyses=()))
    assert "in the middle of their ranges (lines: a 0.500 and b 0)" in figure.caption
