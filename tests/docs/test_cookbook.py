"""The cookbook: a valid notebook whose cells run from top to bottom."""

import json
import re
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
COOKBOOK = json.loads((DOCS / "cookbook.ipynb").read_text(encoding="utf-8"))


sys.path.insert(0, str(DOCS))
try:
    from reference import outputs_of, run_cell
finally:
    sys.path.remove(str(DOCS))


def shown_words(output):
    """Words of an output without its numbers, which differ in their last digits and in seconds."""
    lines = output["text"] if "text" in output else output["data"].get("text/plain", ["drawn"])
    return re.sub(r"[\d.\W]+", " ", "".join(lines)).split()


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
    kinds = []
    cells = [cell for cell in COOKBOOK["cells"] if cell["cell_type"] == "code"]
    for number, cell in enumerate(cells, 1):
        outputs = outputs_of(cell, number, names)
        # the notebook holds what its cells show: docs/reference.py keeps it
        assert [*map(shown_words, outputs)] == [*map(shown_words, cell["outputs"])]
        kinds += [kind for output in outputs for kind in output.get("data", ["stdout"])]
    assert (kinds.count("image/svg+xml"), kinds.count("text/plain")) == (3, 6)
    assert (tmp_path / "reports" / "cookbook" / "cookbook.html").is_file()


def test_a_cell_that_fails_is_seen():
    with pytest.raises(AssertionError):
        run_cell("x = 1\nassert x == 2", {})
    assert run_cell("x = 1\nx + 1", {}) == 2
