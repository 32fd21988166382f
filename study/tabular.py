"""A strict reader of CSV tables: either every cell means what it says, or an error says where.

The usual readers are too kind for measurements: ``float()`` takes ``"1_0"``, ``"nan"`` and
Arabic digits, ``numpy.genfromtxt`` turns a decimal comma into a column of NaN. Here a number
must match :data:`NUMBER` and be finite, and a file that looks as if it used a decimal comma
without declaring it is refused.
"""

from __future__ import annotations

import csv
import gzip
import hashlib
import io
import re
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from study.errors import Fault, InputError, nearest

MAX_BYTES = 256_000_000
MAX_ROWS = 2_000_000
MAX_COLUMNS = 1_000
MAX_LINE = 100_000
MAX_FAULTS = 20
MAX_LABEL = 200
DELIMITERS = ",;\t|"
NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,4})?", re.ASCII)
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d{1,4})?", re.ASCII)
_FORMULA = re.compile(r"[=+\-@\t\r\n\uff1d\uff0b\uff0d\uff20]")


@dataclass(frozen=True)
class CsvTable:
    """Text cells of one file, by column.

    Parameters
    ----------
    source : str
        Name of the file, for messages.
    columns : dict of str to tuple of str
        Cells of every column, in the file's order, spaces around them removed.
    lines : tuple of int
        Line of the file on which each row stands (the header is line 1).
    decimal : str
        Decimal mark, ``"."`` or ``","``.
    sha256 : str
        Hash of the file as it lies on the disk.
    notes : tuple of str
        What was changed or skipped, counted.
    """

    source: str
    columns: dict[str, tuple[str, ...]]
    lines: tuple[int, ...]
    decimal: str = "."
    sha256: str = ""
    notes: tuple[str, ...] = field(default=())

    def text(self, name: str) -> tuple[str, ...]:
        """Cells of a column as text.

        Raises
        ------
        InputError
            If there is no such column (the nearest name is given).
        """
        if name not in self.columns:
            raise InputError(_no_column(self.source, name, self.columns))
        return self.columns[name]

    def numbers(self, name: str) -> NDArray[np.float64]:
        """Cells of a column as finite numbers, shape (rows,).

        Raises
        ------
        InputError
            One fault for each cell that is not a finite decimal number, with its line.
        """
        cells = self.text(name)
        if self.decimal == ",":
            plain = [c.replace(",", ".") if "." not in c else "?" for c in cells]
        else:
            plain = list(cells)
        bad = [k for k, cell in enumerate(plain) if NUMBER.fullmatch(cell) is None]
        if bad:
            raise InputError(self._cell_faults(name, cells, bad))
        values = np.array(plain, dtype=float)
        if not np.isfinite(values).all():
            raise InputError(self._cell_faults(name, cells, np.flatnonzero(~np.isfinite(values))))
        return values

    def _cell_faults(
        self, name: str, cells: Sequence[str], bad: Iterable[int] | NDArray[np.intp]
    ) -> list[Fault]:
        rows = list(bad)
        faults = [
            Fault(
                f"{self.source}:{self.lines[k]}: column {name!r}",
                f"must be a finite number, got {_short(cells[k])}",
                _number_mend(cells[k], self.decimal),
            )
            for k in rows[:MAX_FAULTS]
        ]
        if len(rows) > MAX_FAULTS:
            faults.append(Fault(self.source, f"{len(rows) - MAX_FAULTS} more cells like these"))
        return faults


def read_csv(
    path: Path, *, required: Sequence[str] = (), decimal: str = ".", source: str | None = None
) -> CsvTable:
    """Read a CSV file (plain or gzip) with a header row.

    Parameters
    ----------
    path : Path
        File to read.
    required : sequence of str
        Columns that must be there; they also decide between possible delimiters.
    decimal : {".", ","}
        Declared decimal mark.
    source : str, optional
        Name of the file in messages; its path if left out.

    Raises
    ------
    InputError
        If the file cannot be read, is too large, is no rectangular table, lacks a column or
        uses a decimal comma that was not declared.
    """
    name = source or str(path)
    if decimal not in (".", ","):
        raise InputError(Fault("measurements.decimal", f"must be '.' or ',', got {decimal!r}"))
    raw = _read_bytes(path, name)
    text = _decode(_unzip(raw, name), name)
    table = parse_csv(text, required=required, decimal=decimal, source=name)
    return CsvTable(
        name, table.columns, table.lines, decimal, hashlib.sha256(raw).hexdigest(), table.notes
    )


def parse_csv(
    text: str, *, required: Sequence[str] = (), decimal: str = ".", source: str = "<text>"
) -> CsvTable:
    """Parse the text of a CSV file; see :func:`read_csv`."""
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    lines = text.split("\n")
    _check_shape(lines, source)
    delimiter = _delimiter(lines[0], required, decimal)
    rows, numbers, blank = _rows(text, lines, delimiter, source)
    if not rows:
        raise InputError(Fault(source, "the file is empty", "it needs a header line and rows"))
    header = [cell.strip() for cell in rows[0]]
    _check_header(header, required, source)
    _check_widths(rows, numbers, len(header), delimiter, decimal, source)
    if len(rows) == 1:
        raise InputError(
            Fault(source, "there is a header line but no row of data", "give one row a sample")
        )
    cells = list(zip(*rows[1:], strict=True))
    if decimal == ".":
        _check_decimal_comma(header, cells, required, source)
    stripped = [tuple(map(str.strip, column)) for column in cells]
    padded = sum(_changes(old, new) for old, new in zip(cells, stripped, strict=True))
    notes = []
    if padded:
        notes.append(f"{source}: spaces around {padded} cells removed")
    if blank:
        notes.append(f"{source}: {blank} blank lines skipped")
    columns = dict(zip(header, stripped, strict=True))
    return CsvTable(source, columns, tuple(numbers[1:]), decimal, "", tuple(notes))


def _changes(old: Sequence[str], new: Sequence[str]) -> int:
    return 0 if old == new else sum(a != b for a, b in zip(old, new, strict=True))


def is_formula(text: str) -> bool:
    """Whether a spreadsheet would run this text as a formula (CWE-1236); numbers are safe."""
    return _FORMULA.match(text.lstrip(" ")) is not None and NUMBER.fullmatch(text) is None


def label_fault(label: str) -> str:
    """Rule that a label of a test breaks; empty if it may stand in tables and reports."""
    if not label:
        return "the label is empty"
    if len(label) > MAX_LABEL:
        return f"the label has {len(label)} characters, at most {MAX_LABEL}"
    if not label.isprintable():
        return f"the label {label!r} holds a control character"
    if is_formula(label):
        return f"a spreadsheet would run the label {label!r} as a formula"
    return ""


def _read_bytes(path: Path, source: str) -> bytes:
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise InputError(_too_large(source, size))
        return path.read_bytes()
    except OSError as error:
        raise InputError(Fault(source, f"cannot be read: {error.strerror or error}")) from error


def _unzip(raw: bytes, source: str) -> bytes:
    if raw[:2] != b"\x1f\x8b":
        return raw
    try:
        with gzip.open(io.BytesIO(raw)) as stream:
            data = stream.read(MAX_BYTES + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(
            Fault(source, f"is a broken gzip file ({error})", "copy the file again from its source")
        ) from error
    if len(data) > MAX_BYTES:
        raise InputError(_too_large(source, len(data)))
    return data


def _decode(data: bytes, source: str) -> str:
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise InputError(Fault(source, "is in UTF-16", "save it as UTF-8"))
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(
            Fault(
                f"{source}:{line}",
                f"byte {data[error.start]:#04x} is not UTF-8",
                "save the file as UTF-8",
            )
        ) from error
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise InputError(Fault(f"{source}:{line}", "holds a NUL character: this is not a CSV file"))
    return text


def _check_shape(lines: list[str], source: str) -> None:
    if len(lines) > MAX_ROWS + 2:
        raise InputError(
            Fault(
                source,
                f"has {len(lines)} rows, at most {MAX_ROWS} are read",
                "thin the recording out or split it into several files",
            )
        )
    if not any(line.strip() for line in lines):
        raise InputError(Fault(source, "the file is empty", "it needs a header line and rows"))
    longest = max(range(len(lines)), key=lambda k: len(lines[k]))
    if len(lines[longest]) > MAX_LINE:
        raise InputError(
            Fault(
                f"{source}:{longest + 1}",
                f"the line has {len(lines[longest])} characters, at most {MAX_LINE} are read",
            )
        )


def _delimiter(header: str, required: Sequence[str], decimal: str) -> str:
    """Delimiter whose split of the header finds most required columns, then most cells."""
    candidates = [d for d in DELIMITERS if not (decimal == "," and d == ",")]

    def score(delimiter: str) -> tuple[int, int]:
        cells = [cell.strip(' "') for cell in header.split(delimiter)]
        return sum(name in cells for name in required), len(cells)

    return max(candidates, key=score)


def _rows(
    text: str, lines: list[str], delimiter: str, source: str
) -> tuple[list[list[str]], list[int], int]:
    """Cells of every row, the line each stands on, and the number of blank lines inside."""
    if '"' not in text:
        numbered = [(k, line) for k, line in enumerate(lines, 1) if line.strip()]
        rows = [line.split(delimiter) for _, line in numbered]
        numbers = [k for k, _ in numbered]
    else:
        rows, numbers = _quoted_rows(text, delimiter, source)
    blank = sum(not line.strip() for line in lines[: numbers[-1] if numbers else 0])
    return rows, numbers, blank


def _quoted_rows(text: str, delimiter: str, source: str) -> tuple[list[list[str]], list[int]]:
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
    rows: list[list[str]] = []
    numbers: list[int] = []
    start = 1
    try:
        for row in reader:
            if any(cell.strip() for cell in row):
                rows.append(row)
                numbers.append(start)
            start = reader.line_num + 1
    except csv.Error as error:
        raise InputError(
            Fault(
                f"{source}:{reader.line_num}",
                f"is not well-formed CSV ({error})",
                'quotes must enclose a whole cell and be doubled inside: "a ""b"" c"',
            )
        ) from error
    return rows, numbers


def _check_header(header: list[str], required: Sequence[str], source: str) -> None:
    if len(header) > MAX_COLUMNS:
        raise InputError(Fault(source, f"has {len(header)} columns, at most {MAX_COLUMNS}"))
    faults = [
        Fault(
            f"{source}:1",
            f"column {name!r} stands {header.count(name)} times in the header",
            "every column needs its own name",
        )
        for name in dict.fromkeys(header)
        if name and header.count(name) > 1
    ]
    faults += [_no_column(source, name, header) for name in required if name not in header]
    if faults:
        raise InputError(faults)


def _check_widths(
    rows: list[list[str]], numbers: list[int], width: int, delimiter: str, decimal: str, source: str
) -> None:
    bad = [k for k, row in enumerate(rows) if len(row) != width]
    if not bad:
        return
    k = bad[0]
    mend = f"columns are separated by {delimiter!r}; every row needs {width} cells"
    if delimiter == "," and len(rows[k]) == 2 * width:
        mend = (
            "this looks like a decimal comma in a comma-separated file, which cannot be told "
            "apart: save it with ';' between columns and write decimal = \",\""
        )
    more = f" (and {len(bad) - 1} more rows)" if len(bad) > 1 else ""
    raise InputError(
        Fault(
            f"{source}:{numbers[k]}",
            f"has {len(rows[k])} cells where the header has {width}{more}",
            mend,
        )
    )


def _check_decimal_comma(
    header: list[str], cells: Sequence[Sequence[str]], required: Sequence[str], source: str
) -> None:
    for name, column in zip(header, cells, strict=True):
        first = column[0].strip()
        if (name in required or not required) and _DECIMAL_COMMA.fullmatch(first):
            raise InputError(
                Fault(
                    f"{source}: column {name!r}",
                    f"holds a decimal comma ({first!r}) but none is declared",
                    'write decimal = "," in [measurements]',
                )
            )


def _no_column(source: str, name: str, columns: Iterable[str]) -> Fault:
    names = [column for column in columns if column]
    return Fault(f"{source}:1", f"there is no column {name!r}", nearest(name, names[:50]))


def _too_large(source: str, size: int) -> Fault:
    return Fault(
        source,
        f"holds more than {MAX_BYTES // 10**6} MB ({size} bytes)",
        "thin the recording out or split it into several files",
    )


def _short(cell: str) -> str:
    return repr(cell if len(cell) <= 40 else cell[:37] + "...")


def _number_mend(cell: str, decimal: str) -> str:
    if not cell:
        return "the cell is empty: delete the row or give the value"
    if decimal == "." and _DECIMAL_COMMA.fullmatch(cell):
        return 'a decimal comma must be declared: decimal = "," in [measurements]'
    if decimal == "," and "." in cell:
        return 'decimal = "," was declared, so a point has no place here'
    if cell.lower().lstrip("+-") in {"nan", "inf", "infinity", "na", "n/a", "null", "none"}:
        return "a missing value must be left out, with its row"
    if not cell.isascii() or "_" in cell:
        return "only the digits 0 to 9, one decimal mark and an exponent are read"
    return ""
