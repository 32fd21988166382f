"""What a result says of itself before any medium: headings, sentences, tables, figures.

A page, a terminal, a notebook, LaTeX and CSV render blocks and know no result.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby, repeat
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
    """Title of what follows: level 2 begins a section of a page, level 3 a part of one.

    ``anchor`` names a section for links; contents list it by ``short``, else by its words.
    """

    words: str
    level: int = 3
    anchor: str = ""
    unit: str = ""
    short: str = ""


@dataclass(frozen=True)
class Sentence:
    """One sentence or more, folded to the width of the medium.

    ``lead`` says in bold what it is about; ``kind`` is ``note``, ``lead``, ``missing`` or
    ``quote``; ``links`` are parts of the words with the addresses that a page gives them.
    """

    words: str
    lead: str = ""
    kind: str = ""
    links: Sequence[tuple[str, str]] = ()


@dataclass(frozen=True)
class Points:
    """Sentences that stand side by side, one a line."""

    lines: Sequence[str]


@dataclass(frozen=True)
class Definition:
    """A term, a flag such as *assumed*, and what it means."""

    term: str
    lines: Sequence[Sentence]
    flag: str = ""


@dataclass(frozen=True)
class Definitions:
    """Terms with what they mean; ``exact`` values, such as hashes, are read letter by letter."""

    items: Sequence[Definition]
    exact: bool = False

    @classmethod
    def of(cls, pairs: Iterable[tuple[str, str]], *, exact: bool = False) -> Definitions:
        """Make definitions of one sentence each."""
        return cls([Definition(term, (Sentence(words),)) for term, words in pairs], exact)


@dataclass(frozen=True)
class Card:
    """One line a check: its outcome, its name, and what it means for the answer."""

    lines: Sequence[tuple[str, str, str]]


@dataclass(frozen=True)
class Verbatim:
    """Text that keeps its lines: a key and its value, a path, a command, a file."""

    words: str


@dataclass(frozen=True)
class Table:
    """Plain text in rows; its data are a file of this name.

    ``left`` and ``tail`` count the leading and the last columns that hold words, not numbers;
    ``raw`` has the unrounded values for the CSV; with ``grouped`` the first column names
    groups of rows. ``anchors`` name rows of the page, and ``links`` what the first number of each
    row leads to. A table without rows is not shown, yet its CSV is written.
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
    links: tuple[str, ...] = ()

    def is_number(self, column: int) -> bool:
        """Whether a column holds numbers."""
        return self.left <= column < len(self.columns) - self.tail

    def groups(self) -> list[tuple[str, list[tuple[tuple[str, ...], str, str]]]]:
        """Rows with their anchor and link, by the first cell where rows are grouped."""
        names = (self.anchors or repeat(""), self.links or repeat(""))
        rows = zip(self.rows, *names, strict=False)
        by_title = groupby(rows, key=lambda row: row[0][0] if self.grouped else "")
        return [(title, list(members)) for title, members in by_title]

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
        grouped: bool = False,
        raw: Callable[[T], Mapping[str, object]] | None = None,
    ) -> Table:
        """Make a table with a row for each item: heads with the text of their cells."""
        every = list(items)
        return cls(
            name,
            tuple(columns),
            tuple(tuple(cell(item) for cell in columns.values()) for item in every),
            left,
            tail,
            note,
            () if raw is None else tuple(map(raw, every)),
            grouped,
        )

    def first(self, most: int = MOST_ROWS) -> Table:
        """Table whose first rows are shown; its CSV has all."""
        if len(self.rows) <= most:
            return self
        note = f"{self.note} The first {most} of {len(self.rows):,} are shown; the CSV has all."
        return replace(self, rows=self.rows[:most], note=note.strip())


@dataclass(frozen=True)
class Figure:
    """A finished figure: ``svg`` is markup, all else plain text; ``missing`` says why not."""

    name: str
    title: str
    caption: str = ""
    svg: str = ""
    data: pd.DataFrame | None = None
    missing: str = ""


@dataclass(frozen=True)
class Folded:
    """What a page opens on demand, under one line."""

    summary: str
    blocks: Sequence[Block]
    anchor: str = ""
    is_open: bool = False


Block = Heading | Sentence | Points | Definitions | Card | Verbatim | Table | Figure | Folded


Blocks = Iterator[Block | None]
Figures = Mapping[str, Figure]


def titled(table: Table | None, title: str = "") -> Iterator[Block]:
    """Table under its name or another title; nothing of None."""
    if table is not None:
        yield Heading(title or table.name)
        yield table


def flat(blocks: Iterable[Block]) -> Iterator[Block]:
    """Blocks with those that are folded away."""
    for block in blocks:
        yield block
        if isinstance(block, Folded):
            yield from flat(block.blocks)
