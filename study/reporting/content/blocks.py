"""What a result says of itself before any medium: headings, sentences, tables and figures.

A page, a terminal, a notebook, LaTeX and CSV render blocks and know no result.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    import pandas as pd

T = TypeVar("T")
#: a result as ``--json`` prints it
Document = Mapping[str, Any]

#: rows that are shown of a long table; the CSV beside it has all
MOST_ROWS = 40


@dataclass(frozen=True)
class Heading:
    """Title of what follows."""

    words: str


@dataclass(frozen=True)
class Sentence:
    """One sentence or more, folded to the width of the medium."""

    words: str


@dataclass(frozen=True)
class Verbatim:
    """Text that keeps its lines: a key and its value, a path, a command, a file."""

    words: str


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

    @classmethod
    def of(
        cls,
        name: str,
        items: Iterable[T],
        columns: Mapping[str, Callable[[T], str]],
        *,
        left: int = 1,
        tail: int = 0,
        note: str = "",
        raw: Callable[[T], Mapping[str, object]] | None = None,
        most: int | None = None,
    ) -> Table:
        """Make a table with a row for each item: heads with the text of their cells."""
        every = list(items)
        if most is not None and len(every) > most:
            note += f" The first {most} of {len(every):,} are shown; the CSV has all."
        return cls(
            name,
            tuple(columns),
            tuple(tuple(cell(item) for cell in columns.values()) for item in every[:most]),
            left,
            tail,
            note.strip(),
            () if raw is None else tuple(map(raw, every)),
        )


@dataclass(frozen=True)
class Figure:
    """A finished figure: ``svg`` is markup, all else plain text; ``missing`` says why not."""

    name: str
    title: str
    caption: str = ""
    svg: str = ""
    data: pd.DataFrame | None = None
    missing: str = ""


Block = Heading | Sentence | Verbatim | Table | Figure
