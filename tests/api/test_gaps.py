"""Levels that failed in part of their cells leave the others comparable."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from study import api
from study.harness.design.load import loads
from study.harness.design.spec import Design
from study.harness.runner.record_analysis import without_gaps

DESIGN = Path(__file__).parents[2] / "designs" / "conical-indentation.toml"
Lost = Callable[[dict[str, str], int], bool]


@pytest.fixture(scope="module")
def design() -> Design:
    return loads(DESIGN.read_text(encoding="utf-8"), "cone.toml")


def rows(design: Design, lost: Lost, blocks: int = 3) -> pd.DataFrame:
    """One row a case; the response is missing where it is ``lost``."""
    names = [f.name for f in design.factors]
    found = []
    for labels in product(*([level.label for level in f.levels] for f in design.factors)):
        levels = dict(zip(names, labels, strict=True))
        for block in range(blocks):
            y = np.nan if lost(levels, block) else 1.0 + block
            found.append({**levels, "block": str(block), "y": y})
    return pd.DataFrame(found)


def whole(
    design: Design, table: pd.DataFrame, model: object = 2
) -> tuple[pd.DataFrame, tuple[str, ...]]:
    return without_gaps(design, table, "y", [f.name for f in design.factors], "block", model)


def quadratic_ogden(levels: dict[str, str], _: int) -> bool:
    return levels["material"] == "ogden-1" and levels["model.element_order"] == "quadratic"


def nothing(_: dict[str, str], __: int) -> bool:
    return False


def quadratic_3d(levels: dict[str, str], _: int) -> bool:
    return levels["model.space"] == "3d" and levels["model.element_order"] == "quadratic"


@pytest.mark.parametrize(
    ("lost", "model"),
    [
        (nothing, 2),
        (quadratic_ogden, 1),  # main effects alone need no combinations
        (quadratic_3d, 2),  # a factor keeps two levels
    ],
)
def test_nothing_is_left_out(design: Design, lost: Lost, model: int) -> None:
    table = rows(design, lost)
    kept, notes = whole(design, table, model)
    assert kept is table
    assert notes == ()


def test_a_level_that_leaves_a_combination_empty_goes(design: Design) -> None:
    kept, notes = whole(design, rows(design, quadratic_ogden))
    assert "ogden-1" not in set(kept["material"])
    assert kept["material"].nunique() == 3
    assert kept["y"].notna().all()
    assert len(notes) == 1
    assert notes[0].startswith("ogden-1 (material) has an answer in 6 of 12 cells")


@pytest.mark.parametrize(("failed", "left_out"), [(1, 0), (2, 1)])
def test_a_cell_counts_that_most_specimens_answer(
    design: Design, failed: int, left_out: int
) -> None:
    table = rows(design, lambda levels, b: levels["material"] == "ogden-1" and b < failed)
    assert len(whole(design, table)[1]) == left_out


def test_the_verb_analyze_leaves_out_what_the_report_leaves_out(tmp_path: Path) -> None:
    """No run with level c has an answer."""
    cells = product(("a", "b", "c"), ("flat", "full"), range(3))
    lines = [
        f"{m},{s},{'' if m == 'c' else ord(m) - 90 + 0.1 * n + (s == 'full')}" for m, s, n in cells
    ]
    (tmp_path / "t.csv").write_text("\n".join(["gel,plates,y", *lines]))
    study = api.import_runs(
        tmp_path / "t.csv", "gel,plates", "y=N", practical="y=1 N", results=tmp_path / "results"
    )
    reported = study.analyses[0].result
    assert reported is not None, study.analyses[0].refused
    found = api.analyze(study.folder, "y")
    assert "c (gel) has an answer in 0 of 2 cells: it is left out of this analysis" in found.notes
    assert found.effects == reported.effects
    assert found.effect("gel").range == pytest.approx(1.0)


def test_a_study_of_imported_runs_says_with_which_option_a_size_is_given(tmp_path: Path) -> None:
    lines = [f"{m},{n},{ord(m) + 0.1 * n}" for m in "ab" for n in range(3)]
    (tmp_path / "t.csv").write_text("\n".join(["gel,run,y", *lines]))
    study = api.import_runs(tmp_path / "t.csv", ["gel"], ["y=N"], results=tmp_path / "results")
    (sentence,) = (line for line in study.answers if "No smallest difference" in line)
    assert sentence.endswith("Give one with --practical.")
