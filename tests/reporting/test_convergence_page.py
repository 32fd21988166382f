"""The page of a convergence study: complete, safe, and with its numbers beside it."""

from dataclasses import replace

import numpy as np
import pytest

from study.reporting.content import tables
from study.reporting.content.text import MISSING, THIN
from study.reporting.figures import axes
from study.reporting.figures import convergence_figures as convergence
from study.reporting.figures.axes import make
from study.reporting.output.convergence_page import (
    convergence_plots,
    series_warnings,
    sources_tables,
    write_convergence,
)
from study.statistics.convergence.grid_convergence import (
    NumericalUncertainty,
    compare,
    grid_convergence,
)


def cell(order, label="quadratic / mixed", error=0.05):
    h = np.array([1.0, 1.5, 2.25, 3.4])
    found = grid_convergence(h, 9 + error * h**order, formal_order=1.19, qoi="peak_force", unit="N")
    row = {"source": "mesh", "quantity": "peak_force", "unit": "N", "u": 0.1, "relative": 0.01}
    return found.to_json() | {
        "levels": {"model.element_order": label},
        "quantities": {"peak_force": found.to_json(), "work": found.to_json()},
        "formal_reason": "a corner", "sources": [row], "warnings": ["beware"],
    }  # fmt: skip


def document():
    points = [
        {"cell": "P2", "mesh_size": h, "unknowns": 100, "seconds": 1 / h, "memory_MB": 10.0,
         "value": 9.0, "error": 0.02 * h}
        for h in (1.0, 0.5, 0.25)
    ]  # fmt: skip
    front = {
        "reference": 9.0, "reference_u": 0.01, "accuracy": 0.01, "points": points, "ranking": [],
        "answer": "P2 gives 1 % error for the least time",
    }  # fmt: skip
    return {"cells": [cell(1.2), cell(0.3, "linear")], "fronts": [front]}


TRIANGLE = ("fine", np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), np.array([[0, 1, 2]]))


def test_the_page_has_every_figure_and_its_data(tmp_path):
    page = write_convergence(
        "mesh study", "Which?", document(), tmp_path, [TRIANGLE], [[0, 0], [1, 1]]
    )
    text = page.read_text(encoding="utf-8")
    assert text.count("<svg") == 4
    assert "Figure missing" not in text
    for words in ("P2 gives 1 % error for the least time.", "beware", "limited by a corner",
                  "2 series: 2 monotone; observed orders 0.30 to 1.20."):  # fmt: skip
        assert words in text
    assert text.count("Formal order 1.19: a corner.") == 1  # once for all cells
    beside = {path.name for path in (tmp_path / "mesh-study-convergence-data").iterdir()}
    assert {"figure-convergence-values.csv", "table-series.csv", "table-errors-by-source.csv"} <= (
        beside
    )


def test_the_answer_names_its_quantity_and_the_unit_of_its_bound(tmp_path):
    single = cell(1.2) | {"levels": {}}
    page = write_convergence("mesh", "", single, tmp_path, [TRIANGLE], [[0, 0], [1, 1]])
    text = page.read_text(encoding="utf-8")
    assert "Peak force in N: " in text
    assert all(label in text for label in ("height (mm)", "distance from the axis (mm)"))


def test_names_from_outside_are_escaped(tmp_path):
    evil = document()
    evil["cells"][0]["levels"] = {"a": "<script>alert(1)</script>"}
    evil["fronts"][0]["points"][0]["cell"] = "<img src=x onerror=alert(1)>"
    page = write_convergence("<b>x</b>", "", evil, tmp_path)
    text = page.read_text(encoding="utf-8")
    assert "<script>alert" not in text
    assert text.count("<script") == 1  # the one that sorts tables
    assert "<img" not in text
    assert page.parent == tmp_path


def test_errors_are_distances_to_the_limit():
    frame = convergence.error_points([cell(1.2)])
    expected = 0.05 * frame["mesh_size"] ** 1.2 / 9
    np.testing.assert_allclose(frame["error"], expected, rtol=1e-3)


@pytest.mark.parametrize("order", [-1.0, 0.0])
def test_series_without_an_order_are_drawn_without_a_fit(order):
    ((name, plot),) = convergence_plots([cell(order)]).items()
    assert name == "convergence-values"
    assert not make(name, plot).missing


def test_the_caption_says_how_many_converge():
    text = convergence.value_caption([cell(1.2), cell(-1.0, error=1.0)], None)
    assert text.startswith("1 of 2 series have an interval")
    assert "line and diamond" in text
    without = convergence.value_caption([cell(-1.0, error=1.0)], None)
    assert (
        without == "0 of 1 series have an interval. Points: sizes that were solved."
    )  # nothing else is drawn
    assert convergence.error_caption([cell(-1.0)], None) == "No series has an order."


def comparison(label, error):
    d = np.linspace(0.5, 5, 6)
    u = {"numerics": 0.02 * d, "inputs": 0.01 * d, "data": None}
    facts = {"levels": {"material": label}, "block": "M1", "label": "A", "role": "score"}
    return facts | compare(d, d * (1 + error), d, u)


def test_validation_is_drawn_and_tabled():
    rows = [comparison("neo-hookean", 0.1), comparison("<b>ogden</b>", 0.001)]
    frame = convergence.validation_error_points(rows)
    assert len(frame) == 12
    np.testing.assert_allclose(frame["u_val_N"], frame["displacement_mm"] * np.hypot(0.02, 0.01))
    unknown = {**rows[0], "u_val_N": [0.0] * len(rows[0]["u_val_N"])}
    beside = convergence.validation_caption([*rows, unknown], None)
    assert "; 1 cell without a known one" in beside  # nothing is judged by an uncertainty of zero
    text = convergence.validation_caption(rows, None)
    assert beside.split(" cells")[0] == text.split(" cells")[0]
    assert "in 1 of 2 cells (block M1)" in text
    assert "Not known, and so left out: data." in text
    table = tables.validation(rows, "mix")
    assert table.rows[0][2] == "0.500"
    assert table.rows[0][-1].startswith("the model is off by E = 0.5 N +- 0.11 N")
    assert "within u_val" in table.rows[1][-1]
    svg = axes.render(lambda: convergence.draw_validation_errors([], frame), "v", "v")
    assert "<b>" not in svg


def test_parts_of_a_value_are_percentages():
    sources = [
        {"quantity": "curve_rms", "source": "mesh", "u": 0.2, "unit": "N", "relative": share}
        for share in (8.8e-3, 5.3e-10, 0.0, None)
    ]
    (table,) = sources_tables([cell(2.0) | {"sources": sources}])
    shown = [row[-1].replace(THIN, " ") for row in table.rows]
    assert shown == ["0.88 %", "< 0.001 %", "0 %", MISSING]
    assert table.columns[0] == "quantity"  # a single cell has no name to be told
    assert table.rows[0][0] == "RMS force"
    (both,) = sources_tables([cell(2.0) | {"sources": sources}] * 2)
    assert both.columns[0] == "cell"


def test_series_of_a_sample_are_named_by_the_level_that_tells_them_apart():
    names = ["bonded", "frictionless"]
    sampled = [
        cell(1.2) | {"levels": {"C10": f"{k}.5 kPa", "interface": name}}
        for k, name in enumerate(names)
    ]
    assert convergence.value_points(sampled)["panel"].unique().tolist() == names
    crossed = [cell(1.2) | {"levels": {"m": m, "i": i}} for m in "ab" for i in "xy"]
    assert convergence.value_points(crossed)["panel"].unique().tolist()[0] == "a / x"


def test_a_row_does_not_repeat_its_levels_beside_its_meshes(data):
    levels, how = {"material": "neo-hookean"}, "neo-hookean / 7; 3 meshes of ratio 1.5"
    known = NumericalUncertainty(levels, "mu0", 20.4, 0.1, "kPa", "monotone", how)
    table = tables.numerical([known], replace(data, block="batch", blocks=("7",)))
    assert table.rows[0][-1] == "batch 7; 3 meshes of ratio 1.5"


def test_a_warning_names_its_series_where_there_are_several():
    cells = [cell(1.2, "quadratic"), cell(1.1, "linear")]
    assert series_warnings(cells) == ["quadratic: beware", "linear: beware"]
    assert series_warnings(cells[:1]) == ["beware"]


def test_no_two_of_nine_series_look_alike():
    cells = [cell(1.2, f"element {k}") for k in range(9)]
    figure = convergence.draw_errors(cells, convergence.error_points(cells))
    looks = [
        (line.get_color(), line.get_marker())
        for line in figure.axes[0].lines
        if line.get_marker() not in ("None", "")
    ]
    assert len(looks) == len(set(looks)) == 9
