"""A strict reader of CSV tables: either every cell means what it says, or an error says where.

The usual readers are too kind for measurements: ``float()`` takes ``"1_0"``, ``"nan"`` and
Arabic digits, ``numpy.genfromtxt`` turns a decimal comma into a column of NaN. Here a number
must match :data:`NUMBER` and be finite, and a file that looks as if it used a decimal comma
without declaring it is refused.
"""

from __future__ import annotations

import csv
import hashlib
import io
import math
import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from study.ground.arrays import Array
from study.ground.errors import Fault, InputError, nearest
from study.ground.files import read_bytes, table_text
from study.ground.units import is_unit

if TYPE_CHECKING:
    import pandas as pd


MAX_ROWS = 2_000_000
MAX_COLUMNS = 1_000
MAX_LINE = 100_000
MAX_FAULTS = 20
MAX_LABEL = 200
DELIMITERS = ",;\t|"
NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,4})?", re.ASCII)
#: 12,5, and 1.250,61 with points between groups of three digits
_DECIMAL_COMMA = re.compile(
    r"[+-]?(?:\d*|[1-9]\d{0,2}(?:\.\d{3})+),\d+(?:[eE][+-]?\d{1,4})?", re.ASCII
)
_THOUSANDS = "'\u2019 \u00a0\u2009\u202f"
#: a number in groups of three digits: the mark between them is the first group
_GROUPS = {
    mark: re.compile(
        rf"[+-]?[1-9]\d{{0,2}}([{other}{_THOUSANDS}])\d{{3}}(?:\1\d{{3}})*(?:{sign}\d*)?",
        re.ASCII,
    )
    for mark, other, sign in ((".", ",", r"\."), (",", ".", ","))
}
_DIGIT = re.compile(r"\d", re.ASCII)
#: a unit in brackets or without
UNIT_CELL = re.compile(r"[\[(]?\s*([^\d\s\[\]()][^\[\]()]{0,15}|1)\s*[\])]?")
_FORMULA = re.compile(r"[=+\-@\t\r\n\uff1d\uff0b\uff0d\uff20]")
#: How a measured file declares its decimal comma.
MEASURED_COMMA = 'decimal = "," in [measurements]'
#: How the decimal comma of a table is declared that a verb is given.
TYPED_COMMA = "--decimal ,"


_NUMBER_ALONE = "write the number alone, or delete the row"
#: of a response, whose table without the row would claim more than was measured
_LEFT_EMPTY = (
    "write the number alone, or leave the cell empty: its row then counts as missing, and the "
    "answer says what it could change. Without the row, or with the limit of a reading such as "
    "'<0.5' in its place, the mean of its cell is another"
)


@dataclass(frozen=True)
class CsvTable:
    """Text cells of one file, by column."""

    #: Name of the file, for messages.
    source: str
    #: Cells of every column, in the file's order, spaces around them removed.
    columns: dict[str, tuple[str, ...]]
    #: Line of the file on which each row stands (the header is line 1).
    lines: tuple[int, ...]
    decimal: str = "."
    #: Hash of the file as it lies on the disk.
    sha256: str = ""
    #: What was changed or skipped, counted.
    notes: tuple[str, ...] = ()
    #: Cells as they stand in the file, of every column with spaces around some.
    padded: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    #: What a user writes to declare a decimal comma.
    declared_by: str = MEASURED_COMMA
    #: Unit of every column, as a row below the header says; empty without such a row.
    units: Mapping[str, str] = field(default_factory=dict)
    #: Unit of every dimension, as lines above the names say.
    units_above: Mapping[str, str] = field(default_factory=dict)
    #: Sizes of the specimen that the same lines say, mm and mm^2.
    sizes_above: Mapping[str, float] = field(default_factory=dict)
    #: Mark between groups of three digits that was declared; found where it is empty.
    thousands: str = ""

    def of_file(self, raw: bytes, encoding: str) -> CsvTable:
        """Copy with the hash of the file, and a note of an encoding that is not UTF-8."""
        notes = () if encoding == "UTF-8" else (f"{self.source}: read as {encoding}",)
        digest = hashlib.sha256(raw).hexdigest()
        return replace(self, sha256=digest, notes=(*notes, *self.notes))

    def without_units(self, required: Sequence[str], declared: bool | None = None) -> CsvTable:
        """Copy without the row of units below the header, if there is one, or it is declared.

        It is one where every required column of numbers holds a unit or nothing in its first row.
        """
        if len(self.lines) < 2 or declared is False:
            return self
        first = {name: self.columns[name][0] for name in required if name in self.columns}
        measured = [name for name in first if _DIGIT.search(self.columns[name][1])]
        units = {name: UNIT_CELL.fullmatch(cell) for name, cell in first.items()}
        shown = {name: unit[1] for name, unit in units.items() if unit and name in measured}
        if not declared:
            if not measured or not all(units[name] or not first[name] for name in measured):
                return self
            if not any(unit != "1" and is_unit(unit) for unit in shown.values()):
                return self
        return replace(
            self,
            columns={name: cells[1:] for name, cells in self.columns.items()},
            lines=self.lines[1:],
            padded={name: cells[1:] for name, cells in self.padded.items()},
            notes=(*self.notes, f"{self.source}:{self.lines[0]}: row of units"),
            units=shown,
        )

    def rows(self, chosen: Sequence[int]) -> CsvTable:
        """Copy with some of the rows."""
        columns, padded = (
            {name: tuple(cells[k] for k in chosen) for name, cells in each.items()}
            for each in (self.columns, self.padded)
        )
        lines = tuple(self.lines[k] for k in chosen)
        return replace(self, columns=columns, padded=padded, lines=lines)

    def text(self, name: str) -> tuple[str, ...]:
        """Cells of a column as text."""
        if name not in self.columns:
            raise InputError(_no_column(f"{self.source}:1", name, self.columns))
        return self.columns[name]

    def cell_name(self, row: int, name: str) -> str:
        """Name a cell in a message: file, line and column."""
        return f"{self.source}:{self.lines[row]}: column {name!r}"

    def numbers(self, name: str, missing: Collection[str] = ()) -> NDArray[np.float64]:
        """Cells of a column as finite numbers, shape (rows,)."""
        cells = self.text(name)
        absent = {k for k, cell in enumerate(cells) if missing and cell.lower() in missing}
        marked = ["0" if k in absent else cell for k, cell in enumerate(cells)] if absent else cells
        values = parsed_numbers(marked, self.decimal, self.thousands)
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            mend = _LEFT_EMPTY if missing else _NUMBER_ALONE
            raise InputError(self._cell_faults(name, cells, bad.tolist(), mend))
        values[list(absent)] = math.nan
        return values

    def _cell_faults(
        self, name: str, cells: Sequence[str], rows: Sequence[int], mend: str
    ) -> list[Fault]:
        faults = [
            Fault(
                self.cell_name(k, name),
                f"must be a finite number, got {_short(cells[k])}",
                _number_mend(cells[k], self.decimal, self.declared_by) or mend,
            )
            for k in rows[:MAX_FAULTS]
        ]
        if len(rows) > MAX_FAULTS:
            faults.append(Fault(self.source, f"{len(rows) - MAX_FAULTS} more cells like these"))
        return faults


def read_csv(
    path: Path,
    *,
    required: Sequence[str] = (),
    numbers: Sequence[str] | None = None,
    decimal: str = ".",
    source: str | None = None,
    declared_by: str = MEASURED_COMMA,
    sheet: str = "",
) -> CsvTable:
    """Read a CSV file (plain or gzip), or a sheet of a workbook, with a header row."""
    name = source or str(path)
    if decimal not in (".", ","):
        rule = f"must be '.' or ',', got {decimal!r}"
        raise InputError(Fault("decimal", rule))
    raw = read_bytes(path, name)
    text, encoding = table_text(raw, name, sheet=sheet, decimal=decimal)
    table = parse_csv(
        text, required=required, numbers=numbers, decimal=decimal, source=name,
        declared_by=declared_by,
    )  # fmt: skip
    return table.of_file(raw, encoding)


def parse_csv(
    text: str,
    *,
    required: Sequence[str] = (),
    numbers: Sequence[str] | None = None,
    decimal: str = ".",
    source: str = "<text>",
    declared_by: str = MEASURED_COMMA,
    numbered: Sequence[int] | None = None,
    delimiter: str = "",
) -> CsvTable:
    """Parse the text of a CSV file; see :func:`read_csv`.

    ``numbered`` holds the number that each line has in its file, where some were left out; the
    delimiter is found where it is not given.
    """
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    lines = text.split("\n")
    numbered = numbered or range(1, len(lines) + 1)
    _check_shape(lines, source)
    delimiter = delimiter or _delimiter(lines[0], required, decimal)
    rows, at, blank = _rows(text, lines, delimiter, source, numbered)
    if not rows:
        raise InputError(Fault(source, "the file is empty", "it needs a header line and rows"))
    header = [cell.strip() for cell in rows[0]]
    while len(header) > 1 and not header[-1]:
        del header[-1]
    _check_header(header, required, f"{source}:{at[0]}", rows, at)
    trailing = _even(rows, len(header))
    _check_widths(rows, at, len(header), delimiter, source)
    if len(rows) == 1:
        rule = "there is a header line but no row of data"
        raise InputError(Fault(source, rule, "give one row a sample"))
    cells = dict(zip(header, zip(*rows[1:], strict=True), strict=True))
    columns = {name: tuple(map(str.strip, column)) for name, column in cells.items()}
    if decimal == ".":
        needed = numbers if numbers is not None else required or header
        _check_decimal_comma({n: columns[n] for n in header if n in needed}, source, declared_by)
    padded = {name: column for name, column in cells.items() if column != columns[name]}
    changed = sum(sum(map(str.__ne__, column, columns[name])) for name, column in padded.items())
    notes = [f"{source}: spaces around {changed} cells removed"] if changed else []
    notes += [f"{source}: {blank} blank lines skipped"] if blank else []
    notes += [f"{source}: empty cells at the ends of {trailing} rows removed"] if trailing else []
    return CsvTable(source, columns, tuple(at[1:]), decimal, "", tuple(notes), padded, declared_by)


def csv_text(
    columns: Sequence[object], rows: Iterable[Sequence[object]], delimiter: str = ","
) -> str:
    """Text of a CSV file: a header, and each value of each row as it stands."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n", delimiter=delimiter)
    writer.writerow(columns)
    writer.writerows(rows)
    return stream.getvalue()


def is_formula(text: str) -> bool:
    """Whether a spreadsheet would run this text as a formula (CWE-1236); numbers are safe."""
    return _FORMULA.match(text.lstrip(" ")) is not None and NUMBER.fullmatch(text.strip()) is None


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


def _check_shape(lines: list[str], source: str) -> None:
    if len(lines) > MAX_ROWS + 2:
        rule = f"has {len(lines)} rows, at most {MAX_ROWS} are read"
        mend = "thin the recording out or split it into several files"
        raise InputError(Fault(source, rule, mend))
    longest = max(range(len(lines)), key=lambda k: len(lines[k]))
    if len(lines[longest]) > MAX_LINE:
        rule = f"the line has {len(lines[longest])} characters, at most {MAX_LINE} are read"
        raise InputError(Fault(f"{source}:{longest + 1}", rule))


def _delimiter(header: str, required: Sequence[str], decimal: str) -> str:
    """Delimiter whose split of the header finds most required columns, then most cells."""
    candidates = [d for d in DELIMITERS if not (decimal == "," and d == ",")]

    def score(delimiter: str) -> tuple[int, int]:
        cells = [cell.strip(' "') for cell in header.split(delimiter)]
        return sum(name in cells for name in required), len(cells)

    return max(candidates, key=score)


def _rows(
    text: str, lines: list[str], delimiter: str, source: str, at: Sequence[int]
) -> tuple[list[list[str]], list[int], int]:
    """Cells of every row, the line each stands on, and the number of blank lines inside."""
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
    rows: list[list[str]] = []
    numbers: list[int] = []
    start = 1
    try:
        for row in reader:
            if any(map(str.strip, row)):
                rows.append(row)
                numbers.append(start)
            start = reader.line_num + 1
    except csv.Error as error:
        line = at[min(reader.line_num, len(at)) - 1]
        mend = 'quotes must enclose a whole cell and be doubled inside: "a ""b"" c"'
        rule = f"is not well-formed CSV ({error})"
        raise InputError(Fault(f"{source}:{line}", rule, mend)) from error
    held = lines[: numbers[-1] if numbers else 0]
    blank = sum(not line.strip(f"{delimiter} \t") for line in held)
    return rows, [at[k - 1] for k in numbers], blank


def _even(rows: list[list[str]], width: int) -> int:
    """Remove empty cells beyond the header in place; count the rows that had more than it."""
    count = 0
    usual = len(rows[0])
    for row in rows:
        if len(row) > width and not any(cell.strip() for cell in row[width:]):
            count += len(row) != usual
            del row[width:]
    return count


def _check_header(
    header: list[str], required: Sequence[str], source: str, rows: list[list[str]], at: list[int]
) -> None:
    if len(header) > MAX_COLUMNS:
        raise InputError(Fault(source, f"has {len(header)} columns, at most {MAX_COLUMNS}"))
    rule, mend = "column {!r} stands {} times in the header", "every column needs its own name"
    faults = [
        Fault(source, rule.format(name, count), mend)
        for name, count in Counter(header).items()
        if name and count > 1
    ]
    faults += [_no_column(source, name, header) for name in required if name not in header]
    if not faults:
        return
    stripped = ({cell.strip() for cell in row} for row in rows)
    line = next((n for n, row in zip(at, stripped, strict=True) if set(required) <= row), at[0])
    if required and line > at[0]:
        mend = f"line {line} names the columns: write skip_lines = {line - 1}"
        faults = [replace(fault, mend=mend) for fault in faults]
    raise InputError(faults)


def _check_widths(
    rows: list[list[str]], numbers: list[int], width: int, delimiter: str, source: str
) -> None:
    bad = [k for k, row in enumerate(rows) if len(row) != width]
    if not bad:
        return
    k = bad[0]
    usual, count = Counter(map(len, rows)).most_common(1)[0]
    mend = f"columns are separated by {delimiter!r}; every row needs {width} cells"
    if delimiter == "," and len(rows[k]) == 2 * width > 2:
        mend = (
            "this looks like a decimal comma in a comma-separated file, which cannot be told "
            "apart: save it with ';' between columns and write decimal = \",\""
        )
    first = next(k for k, row in enumerate(rows) if len(row) == usual)
    if first > 1 or (first == 1 and width == 1):
        line = numbers[first]
        mend = (
            f"{count} lines have {usual} cells, the first is line {line}: if it names the columns, "
            f"delete the lines above it, or write skip_lines = {line - 1} in [measurements]"
        )
    more = f" (and {len(bad) - 1} more rows)" if len(bad) > 1 else ""
    rule = f"has {len(rows[k])} cells where the header has {width}{more}"
    raise InputError(Fault(f"{source}:{numbers[k]}", rule, mend))


def _check_decimal_comma(
    columns: Mapping[str, Sequence[str]], source: str, declared_by: str
) -> None:
    for name, column in columns.items():
        cell = next((cell for cell in column[:2] if _DIGIT.search(cell)), "")  # below its unit
        if _DECIMAL_COMMA.fullmatch(cell) and "?" in _plain(column, "."):
            rule = f"holds a decimal comma ({cell!r}) but none is declared"
            raise InputError(Fault(f"{source}: column {name!r}", rule, f"write {declared_by}"))


def _no_column(source: str, name: str, columns: Iterable[str]) -> Fault:
    names = [column for column in columns if column]
    cells = [cell for column in names for cell in column.split()]
    if cells and all(NUMBER.fullmatch(cell) for cell in cells):
        mend = 'the first line holds numbers: write header = false, and columns = { ... = "1" }'
        return Fault(source, f"there is no column {name!r}", mend)
    return Fault(source, f"there is no column {name!r}", nearest(name, names[:50]))


def _short(cell: str) -> str:
    return repr(cell if len(cell) <= 40 else cell[:37] + "...")


#: Cells that have no mark to look at but a decimal point.
_PLAIN = re.compile(r"[-+0-9.eE\n]*")


def _plain(cells: Sequence[str], decimal: str, thousands: str = "") -> list[str]:
    """Numbers with a decimal point and without marks of thousands; ``?`` for what is neither.

    A space or an apostrophe between groups of three digits parts thousands. So does the mark that
    is not the decimal one, where a cell of the column shows the decimal one: ``1,200`` beside
    ``0.5`` is 1200, and alone it may be 1.2, unless it was declared.
    """
    other = "." if decimal == "," else ","
    if decimal == "." and _PLAIN.fullmatch("\n".join(cells)):
        return list(cells)
    shown = thousands == other or any(decimal in cell for cell in cells)
    groups = _GROUPS[decimal]
    plain = []
    for cell in cells:
        cell = cell.replace("\u2212", "-")
        match = groups.fullmatch(cell)
        if match and (match[1] != other or shown or cell.count(other) > 1):
            cell = cell.replace(match[1], "")
        plain.append("?" if other in cell else cell.replace(decimal, "."))
    return plain


def is_number(cell: str, decimal: str, thousands: str = "") -> bool:
    """Whether a cell holds a number."""
    return NUMBER.fullmatch(_plain((cell,), decimal, thousands)[0]) is not None


def parsed_numbers(cells: Sequence[str], decimal: str, thousands: str = "") -> NDArray[np.float64]:
    """Numbers of some cells, infinite where a cell is none. Shapes: returns (cells,)."""
    plain = _plain(cells, decimal, thousands)
    return np.array([float(c) if NUMBER.fullmatch(c) else math.inf for c in plain])


def _number_mend(cell: str, decimal: str, declared_by: str) -> str:
    if not cell:
        return "the cell is empty: delete the row or give the value"
    if decimal == "." and _DECIMAL_COMMA.fullmatch(cell):
        if _GROUPS["."].fullmatch(cell):
            value = float(cell.replace(",", ""))
            return (
                f"{value:g} if the comma parts thousands: remove it; a decimal comma must be "
                f"declared: {declared_by}"
            )
        return f"a decimal comma must be declared: {declared_by}"
    if decimal == "," and "." in cell:
        return "a decimal comma was declared, so a point has no place here"
    if cell.lower().lstrip("+-") in {"nan", "inf", "infinity", "na", "n/a", "null", "none"}:
        return "a missing value must be left out, with its row"
    if not cell.isascii() or "_" in cell:
        return "only the digits 0 to 9, one decimal mark and an exponent are read"
    return ""


# Tidy tables of responses, read strictly: one row a case, one column a factor.

#: Cells that stand for a missing response, in small letters.
MISSING = frozenset(
    {"", "na", "n/a", "#n/a", "nan", "null", "none", "*", ".", "-", "--"}
    | {"\N{EN DASH}", "\N{EM DASH}"}
)


def names_of(block: str | Sequence[str] | None) -> tuple[str, ...]:
    """Names of the blocks: none, one or several."""
    if block is None:
        return ()
    return (block,) if isinstance(block, str) else tuple(str(name) for name in block)


def read_tidy_csv(
    path: str | Path,
    response: str,
    factors: Sequence[str],
    block: str | Sequence[str] | None = None,
    unit: str | None = None,
    decimal: str = ".",
    covariates: Sequence[str] = (),
    sheet: str = "",
) -> pd.DataFrame:
    """Read the named columns of a tidy CSV, or of a sheet of a workbook, strictly."""
    import pandas as pd

    others = [*names_of(block), *([unit] if unit else [])]
    measured = [response, *covariates]
    table = read_csv(
        Path(path), numbers=measured, decimal=decimal, declared_by=TYPED_COMMA, sheet=sheet
    )
    _check_names(table.source, list(table.columns), response, factors, others, covariates)
    table = table.without_units(measured)
    labels = list(dict.fromkeys([*factors, *others]))
    faults = [
        Fault(table.cell_name(k, name), "the level is empty")
        for name in labels
        for k, cell in enumerate(table.text(name))
        if not cell
    ]
    values: dict[str, Array] = {}
    for name in measured:
        try:
            values[name] = table.numbers(name, missing=MISSING)
        except InputError as error:
            faults = [*error.faults, *faults]
    if faults:
        raise InputError(faults[:MAX_FAULTS])
    for name in labels:
        _check_clash(table, name)
    return pd.DataFrame({**values, **{name: table.text(name) for name in labels}})


def _check_names(
    where: str,
    valid: Sequence[str],
    response: str,
    factors: Sequence[str],
    blocks: Sequence[str] = (),
    covariates: Sequence[str] = (),
) -> None:
    faults = [
        Fault(f"{where}: column {name!r}", "no such column", nearest(name, valid))
        for name in dict.fromkeys([response, *factors, *blocks, *covariates])
        if name not in valid
    ]
    if not factors:
        faults.append(Fault("factors", "at least one factor is needed"))
    if len(set(factors)) < len(factors):
        faults.append(Fault("factors", f"a factor is named twice: {list(factors)}"))
    for name in (*factors, *blocks):
        if ":" in name:
            rule = "a ':' joins the factors of an interaction, so no factor may hold one"
            faults.append(Fault(f"{where}: column {name!r}", rule, "rename the column"))
    faults += [
        Fault("covariates", f"{name!r} is the response, a factor or the block", "name it once")
        for name in covariates
        if name in {response, *factors, *blocks}
    ]
    if response in factors or response in blocks:
        faults.append(Fault("response", f"{response!r} cannot also be a factor or the block"))
    for name in blocks:
        if name in factors or list(blocks).count(name) > 1:
            rule = f"{name!r} cannot also be a factor or another block"
            faults.append(Fault("block", rule, "leave it out of the factors, or of the formula"))
    if faults:
        raise InputError(faults)


def _check_clash(table: CsvTable, name: str) -> None:
    """Refuse labels that differ in blanks alone: they would be two levels by accident."""
    seen: dict[str, tuple[str, int]] = {}
    for row, label in enumerate(table.padded.get(name, ())):
        first, at = seen.setdefault(label.strip(), (label, row))
        if first != label:
            rule = (
                f"the level {label!r} and the level {first!r} of line {table.lines[at]} differ in "
                "blanks alone"
            )
            raise InputError(Fault(table.cell_name(row, name), rule, "write both the same way"))


def is_table(source: str | Path) -> bool:
    """Whether a table is named, not a study: a file of runs, there or not."""
    path = Path(source)
    if path.suffix == ".toml" or path.is_dir():
        return False
    return path.is_file() or path.suffix in (".csv", ".gz", ".txt", ".tsv")
