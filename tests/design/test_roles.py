"""Roles of factors as a design file declares them."""

from __future__ import annotations

import pytest

from study.ground.errors import InputError
from study.harness.design.load import load
from tests.conftest import ROOT

DEMO = str(ROOT / "designs" / "demo.toml")


def test_what_nobody_measured_is_unknown_unless_said_otherwise() -> None:
    plain = load(DEMO).roles
    assert plain == {"material": "choice", "plates": "unknown", "model.space": "choice"}
    said = load(DEMO, overrides=['analysis.roles={ plates = "condition" }'])
    assert said.roles["plates"] == "condition"


@pytest.mark.parametrize(
    ("value", "rule"),
    [
        ('{ plats = "unknown" }', "no factor 'plats'"),
        ('{ plates = "guess" }', "'guess'"),
        ('"unknown"', "must be a table of factors"),
    ],
)
def test_a_wrong_role_is_named(value: str, rule: str) -> None:
    with pytest.raises(InputError, match=rule):
        load(DEMO, overrides=[f"analysis.roles={value}"])
