"""Blocks as text on a terminal."""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Iterable
from typing import TextIO

from study.reporting.content.blocks import Block, Folded, Heading, Points, Sentence, Table, Verbatim


def say(blocks: Iterable[Block | None], file: TextIO | None = None) -> None:
    """Print blocks; figures have no place in a terminal, nor have tables without rows."""
    before: Block | None = None
    for block in blocks:
        match block:
            case Heading(words):
                print(f"\n{_plain(words)}", file=file)
            case Sentence():
                print(_folded_to_width(f"{block.lead} {block.words}".strip()), file=file)
            case Points(lines):
                for words in lines:
                    print(_folded_to_width(words), file=file)
            case Verbatim(words):
                print(_plain(words), file=file)
            case Folded(summary, inner):
                say((Heading(summary), *inner), file)
            case Table() if block.rows:
                _print_table(block, file, has_title=isinstance(before, Heading))
        before = block


def _plain(words: str) -> str:
    return words.replace("\N{NO-BREAK SPACE}", " ")


def _folded_to_width(words: str) -> str:
    """Text in lines of the width of the terminal, at most 100 columns."""
    return textwrap.fill(_plain(words), min(shutil.get_terminal_size((100, 24)).columns, 100))


def _print_table(block: Table, file: TextIO | None, *, has_title: bool) -> None:
    """Print a table between its name and its note, and an empty line; each group by itself."""
    import rich.table
    from rich.console import Console
    from rich.markup import escape

    console = Console(highlight=False, emoji=False, file=file)  # "s:a:b" is a term, not a picture
    if not console.is_terminal:
        console.width = 160  # a file has no width: lines must not be folded at 80
    first = 1 if block.grouped else 0
    *_, last = (group for group, _ in block.groups())
    for group, rows in block.groups():
        title = group if block.grouped else "" if has_title else block.name
        printed_table = rich.table.Table(
            title=escape(title) or None, title_justify="left", box=None, pad_edge=False
        )
        for name in block.columns[first:]:
            printed_table.add_column(escape(_plain(name)), overflow="fold")
        for row, *_ in rows:
            printed_table.add_row(*(escape(_plain(cell)) for cell in row[first:]))
        console.print(printed_table)
        if block.note and group == last:
            print(_folded_to_width(block.note), file=file)
        print(file=file)
