"""Levels that failed in part of their cells leave the others comparable."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from study.api.records import without_gaps
from study.harness.design.load import loads
from study.harness.design.spec import Design

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


def test_nothing_is_left_out_of_a_complete_study(design: Design) -> None:
    table = rows(design, lambda *_: False)
    kept, notes = whole(design, table)
    assert kept is table
    assert notes == ()


def test_a_level_that_leaves_a_combination_empty_goes(design: Design) -> None:
    kept, notes = whole(design, rows(design, quadratic_ogden))
    assert "ogden-1" not in set(kept["material"])
    assert kept["material"].nunique() == 3
    assert kept["y"].notna().all()
    assert len(notes) == 1
    assert notes[0].startswith("ogden-1 (material) has an answer in 6 of 12 cells")


def test_main_effects_alone_need_no_combinations(design: Design) -> None:
    table = rows(design, quadratic_ogden)
    kept, notes = whole(design, table, 1)
    assert kept is table
    assert notes == ()


@pytest.mark.parametrize(("failed", "left_out"), [(1, 0), (2, 1)])
def test_a_cell_counts_that_most_specimens_answer(
    design: Design, failed: int, left_out: int
) -> None:
    table = rows(design, lambda levels, b: levels["material"] == "ogden-1" and b < failed)
    assert len(whole(design, table)[1]) == left_out


def test_a_factor_keeps_two_levels(design: Design) -> None:
    def lost(levels: dict[str, str], _: int) -> bool:
        return levels["model.space"] == "3d" and levels["model.element_order"] == "quadratic"

    kept, notes = whole(design, rows(design, lost))
    assert kept["model.space"].nunique() == 2
    assert kept["model.element_order"].nunique() == 2
    assert notes == ()
