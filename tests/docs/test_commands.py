"""Commands in the documentation name files that ship, or that the page itself makes."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
#: files of this repository, as a command or a sentence names them
SHIPPED = re.compile(r"(?<![\w/.-])(?:designs|validation|scripts|benchmarks)/[\w/.-]*\w")


def named(page: Path) -> set[str]:
    """Files of the repository that a page names; a folder of results below one is none."""
    return set(SHIPPED.findall(page.read_text(encoding="utf-8")))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_file_that_a_page_names_ships(page: Path) -> None:
    assert [name for name in sorted(named(page)) if not (ROOT / name).exists()] == []


def test_some_page_names_files() -> None:
    assert len(set().union(*map(named, PAGES))) > 15
