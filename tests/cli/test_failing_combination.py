"""A matrix of cases of which one combination of levels fails: what the good ones tell."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import study as public
from study.reporting.results.study_result import StudyResult
from tests.cli.test_confirming_runs import DESIGN
from tests.pages import both_pages

MATRIX = (
    DESIGN[: DESIGN.index("[factors]")].replace('name = "product"', 'name = "matrix"')
    + """[factors]
model.space = ["axisymmetric", "3d"]
model.element_order = ["linear", "quadratic"]
material.C10 = ["5 kPa", "9 kPa"]
specimen.height = ["18 mm", "20 mm", "22 mm"]
[[response]]
name = "peak_force"
practical = "0.2 N"
[report]
format = ["html", "csv"]
"""
)


def forward(problem: Any) -> list[float]:
    """Force that grows with stiffness and falls with height; quadratic solids never converge."""
    model = problem["model"]
    if (str(model["space"]).lower(), model["element_order"]) == ("3d", "quadratic"):
        raise RuntimeError("did not converge")
    force = (
        1e3 * problem["material"]["constants_MPa"]["C10"] * 20 / problem["specimen"]["height_mm"]
    )
    return [force * d for d in problem["displacement_mm"]]


@pytest.fixture(scope="module")
def matrix(tmp_path_factory: pytest.TempPathFactory) -> StudyResult:
    home: Path = tmp_path_factory.mktemp("matrix")
    (home / "matrix.toml").write_text(MATRIX)
    return public.run(
        home / "matrix.toml", jobs=1, results=home / "results", reports=home / "reports",
        forward=forward, version="1", refine=False,
    )  # fmt: skip


def test_good_cases_are_judged_and_no_sound_level_is_left_out(matrix: StudyResult) -> None:
    verdicts = {row["factor"]: row for row in matrix.verdicts}
    assert verdicts["material.C10"]["verdict"] == "matters"
    assert verdicts["specimen.height"]["verdict"] == "matters"
    assert verdicts["specimen.height"]["effect"] == pytest.approx(7 * 20 * (1 / 18 - 1 / 22))
    assert verdicts["model.space"]["verdict"] == "no practical difference"
    assert "have an empty cell" in verdicts["model.space"]["why"]
    (analysis,) = matrix.analyses
    assert analysis.result.data.n == 18
    assert not [note for note in analysis.result.notes if "degrees of freedom are" in note]


def test_the_combination_that_fails_is_named(matrix: StudyResult) -> None:
    assert matrix.report is not None, matrix.warnings
    page = both_pages(matrix.report)
    assert "What fails is the combination of element order quadratic and space 3d" in page
    assert "6 of 6; elsewhere 0 of 18" in page
    assert "levels differ in how often" not in page
    assert "would narrow" not in page
    assert "Left out" not in page
    assert "could not be drawn" not in page
