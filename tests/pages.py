"""The text of a report for tests that ask what it says, on whichever page."""

from __future__ import annotations

from pathlib import Path


def both_pages(report: Path) -> str:
    """Text of the first page of a report and of the second."""
    second = report.with_stem(f"{report.stem}-details")
    return report.read_text(encoding="utf-8") + second.read_text(encoding="utf-8")
