"""A table of a report, before it is drawn in any format."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Table:
    """Plain text in rows.

    ``left`` and ``tail`` count the leading and the last columns that hold words, not numbers;
    ``raw`` has the unrounded values for the CSV; with ``grouped`` the first column names
    groups of rows. ``anchors`` name rows of the page; ``follow`` is the start of the names that
    the first number of each row leads to, counted from 1.
    """

    name: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    left: int = 1
    tail: int = 0
    note: str = ""
    raw: tuple[Mapping[str, object], ...] = field(default=(), repr=False)
    grouped: bool = False
    anchors: tuple[str, ...] = ()
    follow: str = ""
