"""The golden answers see a changed digit, and only what changed."""

import importlib.util
import sys
from pathlib import Path

import pytest


@pytest.fixture(scope="module")
def golden():
    path = Path(__file__).parents[1] / "scripts" / "golden.py"
    spec = importlib.util.spec_from_file_location("golden", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["golden"] = module
    spec.loader.exec_module(module)
    return module


OLD = {"a": [1.0, 2.0], "b": {"text": "x", "seconds": 3.0}}


@pytest.mark.parametrize(
    ("new", "rtol", "differing"),
    [
        (OLD, 0.0, []),
        ({**OLD, "b": {"text": "x", "seconds": 9.0}}, 0.0, []),
        ({**OLD, "a": [1.0, 2.0 + 5e-16]}, 0.0, [".a[1]"]),
        ({**OLD, "a": [1.0, 2.0 + 5e-16]}, 1e-12, []),
        ({**OLD, "a": [1.0]}, 1e-12, [".a"]),
        ({**OLD, "b": {"text": "y", "seconds": 3.0}}, 1e-12, [".b.text"]),
        ({"a": [1.0, 2.0]}, 0.0, [".b"]),
    ],
)
def test_a_change_is_found_where_it_is(golden, new, rtol, differing):
    before, after = (golden.still(answers, Path("/tmp/work")) for answers in (OLD, new))
    places = [line.split(": ")[0] for line in golden.differences(before, after, "", rtol)]
    assert places == differing


def test_texts_lose_times_places_and_hashes_and_no_figure(golden):
    folder = Path("/tmp/work")
    text = f"/tmp/work/results: 3.2 s on 2026-03-04, 4 cells,  F = 3.21\n\n{64 * 'a'}"
    lines = ["<folder>/results: <time> on <date>, 4 cells, F = 3.21", "<hash>"]
    assert golden.plain(text, folder) == lines


def test_an_unknown_part_is_bad_input(golden, tmp_path):
    assert golden.main(["write", str(tmp_path / "a.json"), "--part", "nothing"]) == 2


def test_all_energies_and_tables_are_covered(golden):
    tables = {path.stem for path in golden.TABLES.glob("*.csv")} - golden.REFERENCES
    assert set(golden.ANALYSES) == tables
    refusal = golden.command("solve " + str(golden.ROOT / "tests" / "nothing.toml"))
    assert refusal[0] == 2


def test_a_file_that_is_not_there_is_bad_input(golden, tmp_path):
    assert golden.main(["compare", str(tmp_path / "none.json")]) == 2
