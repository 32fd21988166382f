"""The cookbook: a valid notebook whose cells run from top to bottom."""

import ast
import json
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
COOKBOOK = json.loads((DOCS / "cookbook.ipynb").read_text(encoding="utf-8"))


def run_cell(text, names):
    """Run a cell as a notebook does: the value of a last expression is what it shows."""
    *body, last = ast.parse(text).body
    if not isinstance(last, ast.Expr):
        exec(compile(text, "a cell", "exec"), names)
        return None
    exec(compile(ast.Module(body, []), "a cell", "exec"), names)
    return eval(compile(ast.Expression(last.value), "a cell", "eval"), names)


def test_it_is_a_notebook_of_format_four():
    assert (COOKBOOK["nbformat"], COOKBOOK["nbformat_minor"]) == (4, 5)
    assert {"cells", "metadata", "nbformat", "nbformat_minor"} == set(COOKBOOK)
    ids = [cell["id"] for cell in COOKBOOK["cells"]]
    assert len(set(ids)) == len(ids)
    for cell in COOKBOOK["cells"]:
        wanted = {"cell_type", "id", "metadata", "source"}
        if cell["cell_type"] == "code":
            wanted |= {"execution_count", "outputs"}
        assert set(cell) == wanted


@pytest.mark.slow
def test_every_cell_runs_and_shows_what_it_ends_with(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {}
    drawn = tables = 0
    for cell in COOKBOOK["cells"]:
        if cell["cell_type"] != "code":
            continue
        shown = run_cell("".join(cell["source"]), names)
        if hasattr(shown, "_repr_svg_"):
            drawn += shown._repr_svg_().startswith("<svg")
        elif hasattr(shown, "_repr_html_"):
            tables += "<table" in shown._repr_html_()
    assert (drawn, tables) == (3, 5)
    assert (tmp_path / "reports" / "cookbook" / "cookbook.html").is_file()


def test_a_cell_that_fails_is_seen():
    with pytest.raises(AssertionError):
        run_cell("x = 1\nassert x == 2", {})
    assert run_cell("x = 1\nx + 1", {}) == 2
