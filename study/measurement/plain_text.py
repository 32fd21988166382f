"""Texts that are nearly CSV: lines before the header, comments, and other delimiters."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from study.tabular import CsvTable, parse_csv
from study.text_file import decoded, read_bytes, unzipped

#: what may part the cells of a file, by its name in a study file; found out where it is not said
DELIMITERS: Mapping[str, str | None] = {
    "comma": ",",
    "semicolon": ";",
    "tab": "\t",
    "space": None,
}


@dataclass(frozen=True)
class Layout:
    """How a text differs from a plain CSV file.

    Parameters
    ----------
    skip_lines : int
        Lines before the header.
    comment : str
        Beginning of lines that hold no row; none if empty.
    delimiter : str
        One of :data:`DELIMITERS`; empty where the file shows it.
    header : bool
        Whether a line names the columns; without one their names are 1, 2 and so on.
    """

    skip_lines: int = 0
    comment: str = ""
    delimiter: str = ""
    header: bool = True

    def plain(self, text: str, decimal: str) -> str:
        r"""Text with a header line and delimiters that a CSV file has.

        Parameters
        ----------
        text : str
            Of the file.
        decimal : {".", ","}
            Decimal mark, which is no delimiter.

        Examples
        --------
        >>> Layout(1, "#", "space").plain("of 1944\nl  P\n# first row\n1.02   0.0255", ".")
        'l,P\n1.02,0.0255'
        >>> Layout(header=False).plain("1.02, 0.0255\n1.1, 0.12", ".")
        '1,2\n1.02,0.0255\n1.1,0.12'
        """
        if self == Layout():
            return text
        lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")[self.skip_lines :]
        if self.comment:
            lines = [line for line in lines if not line.lstrip().startswith(self.comment)]
        mark, own = ";" if decimal == "," else ",", self.delimiter
        if not self.header:
            own = own or _shown_by(next((line for line in lines if line.strip()), ""), mark)
        if own:
            rows = [_cells(line, own) for line in lines]
            if not self.header:
                widest = max(map(len, rows), default=0)
                rows.insert(0, [str(k + 1) for k in range(widest)])
            lines = [mark.join(row) for row in rows]
        return "\n".join(lines)


def _cells(line: str, delimiter: str) -> list[str]:
    cells = line.strip(" ").split(DELIMITERS[delimiter])
    return [cell.strip(" ") for cell in cells]


def _shown_by(line: str, mark: str) -> str:
    """Name of the delimiter that a line of numbers shows; spaces where it shows no other."""
    names = [name for name, sign in DELIMITERS.items() if sign in (mark, ";", "\t")]
    return next((name for name in names if (DELIMITERS[name] or "") in line), "space")


def read_table(
    path: Path, layout: Layout, required: Sequence[str], decimal: str, source: str
) -> CsvTable:
    """Read a measured file; see :func:`study.tabular.read_csv`.

    Parameters
    ----------
    path : Path
        File to read, plain or gzip.
    layout : Layout
        How it differs from CSV; lines are counted from the header where it does.
    required : sequence of str
        Columns that must be there.
    decimal : {".", ","}
        Declared decimal mark.
    source : str
        Name of the file in messages.

    Raises
    ------
    InputError
        If it cannot be read, is no rectangular table, or lacks a column.
    """
    raw = read_bytes(path, source)
    text = layout.plain(decoded(unzipped(raw, source), source), decimal)
    table = parse_csv(text, required=required, decimal=decimal, source=source)
    added = 0 if layout.header else 1  # a line that the file does not have
    lines = tuple(line - added for line in table.lines)
    return replace(table, lines=lines, sha256=hashlib.sha256(raw).hexdigest())
