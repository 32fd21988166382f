"""The verb converge: of numbers, of a bonded problem, of a finished study."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.small import Finished, refusal, success

KEYS = {
    "qoi", "unit", "mesh_size", "value", "behaviour", "observed_order", "formal_order",
    "extrapolated", "gci_fine", "factor_of_safety", "u_num", "asymptotic_ratio", "verdict",
}  # fmt: skip
BONDED = (
    "-s", 'test.interface="bonded"', "-s", "test.steps=2", "-s", 'model.mesh_size="4 mm"',
)  # fmt: skip


def test_a_tolerance_that_leaves_the_order_open_is_said() -> None:
    answer = success(
        "converge", "--values", "1.0,1.1,1.5", "--sizes", "1,2,4", "--tolerance", "0.005"
    )
    assert "do not carry an order" in answer.out
    assert "order -" in answer.out


def test_small_ratios_are_allowed_with_their_consequence() -> None:
    answer = success("converge", "--values", "1.0,1.1,1.25", "--sizes", "1,1.1,1.2")
    assert "below 1.3" in answer.err


@pytest.mark.parametrize(
    ("values", "sizes", "words"),
    [
        ("1,2", "1,2", "at least three meshes"),
        ("1,2,3", "1,2,2", "must be distinct"),
    ],
)
def test_too_little_is_bad_input(values: str, sizes: str, words: str) -> None:
    answer = refusal("converge", "--values", values, "--sizes", sizes)
    assert words in answer.err


def test_a_bonded_problem_is_refined_and_kept(home: Path) -> None:
    found = success("converge", "problem.toml", *BONDED, "--json").json
    assert set(found) >= KEYS
    # 2 lambda of the bonded corner, nu close to 0.5 (Williams 1952)
    assert found["formal_order"] == pytest.approx(1.19, abs=0.02)
    assert set(found["quantities"]) == {"peak_force", "curve_rms", "work"}
    assert {row["source"] for row in found["sources"]} == {"mesh", "load steps", "solver tolerance"}
    assert [m["unknowns"] for m in found["meshes"]] == sorted(
        (m["unknowns"] for m in found["meshes"]), reverse=True
    )
    page = Path(found["report"]).read_text(encoding="utf-8")
    assert "Figure missing" not in page
    stored = sorted(Path("results/problem/solves").iterdir())
    again = success("converge", "problem.toml", *BONDED)
    assert sorted(Path("results/problem/solves").iterdir()) == stored
    for words in ("formal order 1.19", "error by source", "stopped: 3 meshes", "report: "):
        assert words in again.out


def test_a_study_without_series_says_why(finished: Finished) -> None:
    """All its plates are frictionless: exact on every mesh, so nothing was refined."""
    answer = refusal("converge", finished.folder / "results" / "small", "--json")
    assert "no refinement is stored" in answer.err
    assert "no mesh matters" in answer.err
