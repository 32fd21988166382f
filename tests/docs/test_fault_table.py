"""The table of provoked faults: a row for each, and tests that exist."""

from __future__ import annotations

import re
from pathlib import Path

TESTS = Path(__file__).parents[1]
PAGE = TESTS.parent / "docs" / "faults.md"
ROW = re.compile(r"^\| (F\d\d) .*\| (.*) \|$", re.MULTILINE)


def test_every_fault_has_a_test_that_exists() -> None:
    rows = dict(ROW.findall(PAGE.read_text(encoding="utf-8")))
    assert list(rows) == [f"F{number:02}" for number in range(1, 39)]
    for fault, cell in rows.items():
        named = re.findall(r"`([\w/]+\.py)::(\w+)`", cell)
        assert named, fault
        for file, test in named:
            text = (TESTS / file).read_text(encoding="utf-8")
            assert re.search(rf"^def {test}\(", text, re.MULTILINE), f"{fault}: {file}::{test}"
