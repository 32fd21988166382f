"""[[expected]]: what may be expected of a study, and why something else is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from study.ground.errors import InputError
from study.harness.design import load

NEEDLE = (Path(__file__).parents[2] / "designs" / "conical-indentation.toml").read_text()
PLAIN = NEEDLE[: NEEDLE.index("[[expected]]")]


def test_the_pattern_of_the_needle_is_read_and_kept_by_a_dump() -> None:
    study = load.loads(NEEDLE)
    kinds = [(one.kind, one.factors) for one in study.expected]
    both = ("material", "model.space")
    assert kinds == [("larger", both), ("interact", both), ("best", ()), ("close", ())]
    first, second = study.expected[3].cells
    assert first == {"material": "reduced-polynomial-2", "model.space": "3d"}
    assert second["model.space"] == "axisymmetric"
    assert {one.response for one in study.expected} == {"relative_rms_force_error"}
    assert load.loads(load.dump(study)).expected == study.expected
    assert load.loads(PLAIN).expected == ()


@pytest.mark.parametrize(
    ("table", "where", "says"),
    [
        ('matters = "materials"', "expected[0].matters", "material"),
        ('best = { material = "ogden" }', "expected[0].best", "ogden-1"),
        ("best = {}", "expected[0].best", "must name levels"),
        ('matters = "material"\nwhy = "I say so"', "expected[0].why", "unknown key"),
    ],
)
def test_what_cannot_be_expected_is_refused(table: str, where: str, says: str) -> None:
    with pytest.raises(InputError) as caught:
        load.loads(f"{PLAIN}\n[[expected]]\n{table}\n", "x.toml")
    told = {f.where.removeprefix("x.toml: "): f"{f.rule} | {f.mend}" for f in caught.value.faults}
    assert says in told[where]
