"""SECURITY.md: every claim that names a test names one that is there."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_the_tests_that_claims_name_are_there() -> None:
    text = (ROOT / "SECURITY.md").read_text(encoding="utf-8")
    named = re.findall(r"\((tests/[\w/]+\.py)::(\w+)\)", text)
    assert len(named) >= 17
    for path, name in named:
        tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
        defined = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
        assert name in defined, f"{path}::{name}"


def test_every_claim_of_what_is_read_and_run_names_its_test() -> None:
    text = (ROOT / "SECURITY.md").read_text(encoding="utf-8")
    for title in ("Files that are read", "Programs"):
        section = re.search(rf"^## {title}\n(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL)
        assert section is not None, title
        claims = re.findall(r"^- .*$", section[1], re.MULTILINE)
        assert len(claims) >= 8
        assert [line for line in claims if "(tests/" not in line] == []
