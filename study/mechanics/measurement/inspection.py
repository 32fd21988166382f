"""What a recorded file holds (``study inspect``), and the table that reads it."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import zip_longest
from pathlib import Path
from typing import TypedDict

import numpy as np

from study.ground.arrays import Array
from study.ground.canonical import plain
from study.ground.declaration import keys_of, toml_value
from study.ground.errors import Fault, InputError
from study.ground.files import is_workbook, read_bytes, sheets_of, table_text, unzipped
from study.ground.tabular import MAX_ROWS, UNIT_CELL, is_number, parsed_numbers
from study.ground.units import INTERNAL, unit_factor
from study.mechanics.measurement.conditioning import OFFSET_SHARE, slack_end, slope_with_error
from study.mechanics.measurement.measurement_section import (
    DELIMITERS,
    KINEMATIC,
    KINETIC,
    MeasurementSpec,
)
from study.mechanics.measurement.phases import NO_FORCE, TURN, Phase, phases_of
from study.mechanics.measurement.written_units import (
    DIMENSIONS,
    WORDS,
    units_above,
    word_of_unit,
    written_unit,
)

_IS_RECORDING = "is it a table of a recording?"
#: rows in a row that a block of numbers has at least
_BLOCK = 3
#: rows whose middle force is that of the unloaded specimen
_FIRST = 5
#: a file shows a bar by itself
_DELIMITERS = {**DELIMITERS, "bar": "|"}
#: lines from which delimiter and decimal mark are found
_LOOKED_AT = 3000
#: columns that are named by a symbol alone, in lower case
_SYMBOLS = {
    "f": "force", "p": "force", "d": "displacement", "x": "displacement", "u": "displacement",
    "z": "displacement", "pos": "displacement", "t": "time", "eps": "strain", "epsilon": "strain",
    "\u03b5": "strain", "\u03bb": "stretch", "sigma": "stress", "\u03c3": "stress",
}  # fmt: skip
#: strain up to which a column without a unit is a ratio
_NOT_PERCENT = 1.0
#: strain beyond which it is in per cent; in between either may be meant
_PERCENT = 5.0
_RATES = re.compile(r"rate|speed|velocity")
#: digits in groups of three with points between them
_GROUPED = re.compile(r"[+-]?[1-9]\d{0,2}(\.\d{3})+")
#: a cell of a number with its unit, or with an exponent as Fortran writes it
_ODD_NUMBER = re.compile(
    r"(?:^|[,;\t|\"])\s*([+-]?\d[\d.,]*(?:[dD][+-]?\d+|\s?([A-Za-zµμ%][\w/^%]{0,7})))\"?(?=\s*(?:[,;\t|]|$))",
    re.MULTILINE,
)
#: share of the largest force at both ends of a test that runs through zero at another place
_BOTH_WAYS = 0.3
_COMMENTS = ("#", "%", "//", ";", "!", "*")
#: columns of labels that tell tests apart, and those of repeats on one specimen
_BLOCKS = re.compile(r"specimen|sample|probe|animal|donor|batch", re.IGNORECASE)
#: columns of labels that part one test
_WITHIN = re.compile(r"cycle|phase|set|segment|step|stage|status", re.IGNORECASE)
_REPEATS = re.compile(r"repeat|rep|run|test|trial|curve|site|point", re.IGNORECASE)


@dataclass(frozen=True)
class InspectedColumn:
    """One column of a file, and what it is taken for."""

    name: str
    #: As the program calls it; empty where the file names none.
    unit: str
    #: One of :data:`DIMENSIONS`; empty where nothing says it.
    quantity: str
    #: Range of its numbers; None for a column of labels.
    low: float | None
    high: float | None
    #: Labels of a column of text, the first few.
    labels: tuple[str, ...] = ()


#: a phase in words, its first and last line, and the kinematic and kinetic quantity at either end
InspectedPhase = TypedDict(
    "InspectedPhase",
    {"phase": str, "cycle": int, "lines": list[int], "from": list[float], "to": list[float]},
)


@dataclass(frozen=True)
class Inspection:
    """What a file holds, how it is written, and how it is read."""

    file: str
    #: How its characters or its sheet were read.
    encoding: str
    sheets: tuple[str, ...]
    delimiter: str
    decimal: str
    #: Lines before the names, the first few.
    preamble: tuple[str, ...]
    #: Lines of the names and of the units; None where there is none.
    header_line: int | None
    unit_line: int | None
    #: Of the rows, and their number.
    first_line: int
    last_line: int
    rows: int
    columns: tuple[InspectedColumn, ...]
    #: Phases of the recording in words, the lines of each, and how far and hard at either end.
    phases: tuple[InspectedPhase, ...]
    #: Table ``[measurements]``.
    measurements: Mapping[str, object]
    #: What is assumed, and what to look at.
    notes: tuple[str, ...]

    @property
    def toml(self) -> str:
        """Table to paste into a file; comments say what it leaves open."""
        values = dict(self.measurements)
        open_units = [f"# {note}" for note in self.notes if ": write units." in note]
        if open_units:  # a line for each, beside which the missing ones can be written
            units = values.pop("units")
            named = units if isinstance(units, Mapping) else {}
            values |= {f"units.{quantity}": unit for quantity, unit in named.items()}
        lines = [f"{key} = {toml_value(value)}" for key, value in values.items()]
        return "\n".join(["[measurements]", *open_units, *lines])

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the columns that are read; a question mark where one is open."""
        columns, units = self.measurements["columns"], self.measurements["units"]
        if not isinstance(columns, Mapping) or not isinstance(units, Mapping):
            return ()
        return tuple(str(units.get(quantity, "?")) for quantity in columns)

    def to_json(self) -> dict[str, object]:
        """Document of ``study inspect --json``."""
        cycles = max((phase["cycle"] for phase in self.phases), default=0)
        return dict(plain({**vars(self), "cycles": cycles, "toml": self.toml}))


def inspect(path: Path, sheet: str = "") -> Inspection:
    """Look at a recorded file; its numbers are read as ``[measurements]`` would read them."""
    source = path.name
    raw = read_bytes(path, source)
    data = unzipped(raw, source)
    sheets = sheets_of(data, source) if is_workbook(data) else {}
    if sheet or len(sheets) < 2:
        inspection = _inspected(*table_text(raw, source, sheet=sheet), source, sheet)
        return replace(inspection, sheets=tuple(sheets))
    inspections: dict[str, Inspection] = {}
    for name, text in sheets.items():
        with suppress(InputError):  # a sheet of remarks or of results
            inspections[name] = _inspected(text, f"workbook, sheet {name!r}", source, name)
    if not inspections:
        raise InputError(Fault(source, "holds no sheet with rows of numbers", _IS_RECORDING))
    tests = [name for name, inspection in inspections.items() if len(inspection.units) > 1]
    longest = max(tests or inspections, key=lambda name: inspections[name].rows)
    inspection = replace(inspections[longest], sheets=tuple(sheets))
    others = [repr(name) for name in tests if name != longest]
    if not others:
        return inspection
    note = (
        f"sheet {longest!r} is shown since it has most rows; {', '.join(others[:6])} "
        f"{'hold tests' if len(others) > 1 else 'holds a test'} too: study inspect --sheet shows "
        "it, and each sheet is a [[tests]] table of its own"
    )
    return replace(inspection, notes=(note, *inspection.notes))


def _inspected(text: str, encoding: str, source: str, sheet: str) -> Inspection:
    """Look at the text of a file, or of a sheet."""
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    if len(lines) > MAX_ROWS + 1000:
        rule = f"has {len(lines)} lines, at most {MAX_ROWS} rows are read"
        raise InputError(Fault(source, rule, "thin the recording out or split it"))
    block = _block_of(lines, source)
    notes: list[str] = []
    columns, numbers_of, words = _columns(block, units_above(lines[: block.skip]), notes)
    table: dict[str, object] = {"file": source}
    if sheet:
        table["sheet"] = sheet
    table |= _layout(block, notes)
    chosen = _pair(columns, notes)
    notes += _sizes_assumed(columns, chosen, numbers_of)
    units = {q: _unit_for(columns[k], q, numbers_of[k], words[k], notes) for q, k in chosen.items()}
    is_twice = max(Counter(filter(None, block.names)).values(), default=0) > 1
    if is_twice or len(block.names) > max(map(len, block.rows)):
        columns = _numbered(columns, chosen, block, table, notes)
    table["columns"] = {q: columns[k].name for q, k in chosen.items()}
    table["units"] = {quantity: unit for quantity, unit in units.items() if unit}
    groups = _groups(columns, block, table)
    kinematic = next((q for q in KINEMATIC if q in chosen), None)
    kinetic = next((q for q in KINETIC if q in chosen), None)
    placed: list[InspectedPhase] = []
    if "stretch_1" in chosen:
        notes.append("two stretches and two stresses: one biaxial test, first direction first")
    elif kinematic and kinetic:
        d, f = numbers_of[chosen[kinematic]], numbers_of[chosen[kinetic]]
        keys = list(zip(*(block.column(k) for k in groups), strict=True)) or [()] * len(block.at)
        first = [row for row, key in enumerate(keys) if key == keys[0]]
        d, f, at = d[first], f[first], [block.at[k] for k in first]
        phases = _place(kinematic, d, f, table, notes)
        placed = [
            {"phase": p.words, "cycle": p.cycle, "lines": [at[p.first], at[p.last]],
             "from": [float(d[p.first]), float(f[p.first])],
             "to": [float(d[p.last]), float(f[p.last])]}
            for p in phases
        ]  # fmt: skip
    else:
        missing = "displacement or strain" if not kinematic else "force or stress"
        notes.append(f"no column is known to hold {missing}: name it in columns and units")
    return Inspection(
        source, encoding, (), block.delimiter, block.decimal,
        tuple(line.strip()[:120] for line in lines[: block.skip] if line.strip())[:8],
        block.header, block.units, block.at[0], block.at[-1], len(block.at),
        tuple(columns), tuple(placed), table, tuple(notes),
    )  # fmt: skip


# How the text is written: the longest block of lines whose cells are numbers.


@dataclass(frozen=True)
class _Block:
    """Rows of numbers of a text, and what stands around them."""

    delimiter: str
    decimal: str
    #: Cells of every row, and the line on which it stands, from 1.
    rows: list[list[str]]
    at: list[int]
    #: Lines of names and units, from 1.
    header: int | None
    units: int | None
    names: list[str]
    unit_cells: list[str]
    #: Lines before the names.
    skip: int
    comment: str
    #: Lines between the rows that are none.
    others: list[int]

    def column(self, k: int) -> tuple[str, ...]:
        """Cells of a column, from 0; empty where a row ends before it."""
        return tuple(row[k] if k < len(row) else "" for row in self.rows)


def _split(line: str, delimiter: str) -> list[str]:
    sign = _DELIMITERS[delimiter]
    if sign is None:
        return line.split()
    if '"' in line:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=sign), [])]
    return [cell.strip() for cell in line.split(sign)]


def _trimmed(cells: list[str]) -> list[str]:
    while cells and not cells[-1]:
        cells = cells[:-1]
    return cells


def _block_of(lines: Sequence[str], source: str) -> _Block:
    """Rows of numbers under the delimiter and decimal mark that show the most of them."""
    best: tuple[tuple[int, float, int], str, str] | None = None
    for delimiter in _DELIMITERS:
        is_quoted = delimiter == "comma" and any('"' in line for line in lines[:_LOOKED_AT])
        for decimal in (m for m in (".", ",") if is_quoted or m != _DELIMITERS[delimiter]):
            split = [_split(line, delimiter) for line in lines[:_LOOKED_AT]]
            pairs = [(len(_places_of_numbers(x, decimal)), sum(map(bool, x))) for x in split]
            width, start = _width_and_start([n for n, _ in pairs])
            if not width:
                continue
            shares = [n / cells for n, cells in pairs[start:] if n == width]
            # what splits the same rows into more numbers and fewer other cells is meant
            score = (len(shares), round(float(np.mean(shares)), 2), width)
            if best is None or score > best[0]:
                best = (score, delimiter, decimal)
    if best is None:
        rule = f"holds no block of {_BLOCK} lines with two numbers or more"
        mend = _IS_RECORDING
        if (odd := Counter(_ODD_NUMBER.findall("\n".join(lines[:_LOOKED_AT])))).total() >= _BLOCK:
            (cell, unit), _ = odd.most_common(1)[0]
            rule = f"{rule}: cells such as {cell!r} are none"
            mend = "write E for the D of the exponents"
            if unit:
                mend = f"take {unit!r} out of the cells, and name it in the header: NAME [{unit}]"
        raise InputError(Fault(source, rule, mend))
    _, delimiter, decimal = best
    split = [_split(line, delimiter) for line in lines]
    if _DELIMITERS[delimiter] != "," and decimal == "." and _are_grouped(split):
        decimal = ","
    places = [_places_of_numbers(cells, decimal) for cells in split]
    counts = [len(at) for at in places]
    width, start = _width_and_start(counts[:_LOOKED_AT])
    full = [k for k in range(start, len(lines)) if counts[k] == width]
    # a line of results below the rows has as many numbers, in other columns
    usual = Counter(places[k] for k in full).most_common(1)[0][0]
    rows = [k for k in full if places[k] == usual]
    return _with_names(lines, delimiter, decimal, rows, [_trimmed(split[k]) for k in rows])


def _are_grouped(split: Sequence[Sequence[str]]) -> bool:
    """Whether points part thousands in some column: 900, then 1.000.

    Numbers that are written as short as they can be end in no zero, and those that are written
    with three digits have a point in every row.
    """
    for column in zip_longest(*split[:_LOOKED_AT], fillvalue=""):
        cells = [cell for cell in column if is_number(cell, ".")]
        pointed = [cell for cell in cells if "." in cell]
        grouped = bool(pointed) and all(_GROUPED.fullmatch(cell) for cell in pointed)
        if grouped and len(pointed) < len(cells) and any(cell[-1] == "0" for cell in pointed):
            return True
    return False


def _width_and_start(counts: Sequence[int]) -> tuple[int, int]:
    """Numbers in the usual row, and the first of several such rows; zeros without any."""
    usual = Counter(n for n in counts if n > 1).most_common(1)
    if not usual:
        return 0, 0
    width = usual[0][0]
    starts = range(len(counts) - _BLOCK + 1)
    whole = (k for k in starts if set(counts[k : k + _BLOCK]) == {width})
    return next(((width, k) for k in whole), (0, 0))


def _places_of_numbers(cells: Sequence[str], decimal: str) -> tuple[int, ...]:
    mark = _thousands(decimal)
    return tuple(k for k, cell in enumerate(cells) if is_number(cell, decimal, mark))


def _with_names(
    lines: Sequence[str], delimiter: str, decimal: str, rows: list[int], cells: list[list[str]]
) -> _Block:
    """Add the lines of names and units above the rows."""
    width = max(map(len, cells))
    above = [k for k in range(rows[0] - 1, -1, -1) if lines[k].strip(" \t,;")][:2]
    split = {k: _trimmed(_split(lines[k], delimiter)) for k in above}
    # a last column of remarks may be empty in every row
    most = width if delimiter == "space" else width + 1
    named = [k for k in above if 2 <= len(split[k]) <= most]
    # below the names, as instruments write them, or above
    units = next((k for k in named if len(named) > 1 and _are_units(split[k], lines[k])), None)
    header = next((k for k in named if k != units), None)
    if header is None or (units is None and header != above[0]):
        header = units = None
    names = [str(k + 1) for k in range(width)]
    if header is not None:
        names = split[header] + [""] * (width - len(split[header]))
    heads = {"", *(lines[k].strip() for k in (header, units) if k is not None)}
    among = sorted(set(range(rows[0], len(lines))) - set(rows))
    others = [k for k in among if lines[k].strip() not in heads]
    marks = (m for m in _COMMENTS if all(lines[k].lstrip().startswith(m) for k in others))
    return _Block(
        delimiter, decimal, cells, [k + 1 for k in rows],
        None if header is None else header + 1, None if units is None else units + 1,
        names, [] if units is None else split[units], rows[0] if header is None else header,
        next(marks, "") if others else "", [k + 1 for k in others],
    )  # fmt: skip


def _are_units(cells: Sequence[str], line: str) -> bool:
    """Whether a line holds units of columns, and not one that it names (``Force Units,g``)."""
    if units_above([line]):
        return False
    shown = [UNIT_CELL.fullmatch(cell) for cell in cells if cell]
    units = [cell for cell in shown if cell and written_unit(cell[1])]
    return bool(units) and all(shown) and len(units) >= len(shown) / 2


# What the columns hold.


def _columns(
    block: _Block, above: Mapping[str, str], notes: list[str]
) -> tuple[list[InspectedColumn], list[Array], list[str]]:
    """Columns, their numbers (empty for labels), and the words that stand for their units.

    A column that names no unit has the one that a line above the names says of its dimension.
    """
    columns: list[InspectedColumn] = []
    numbers: list[Array] = []
    words: list[str] = []
    for k, name in enumerate(block.names):
        cells = block.column(k)
        values = parsed_numbers(cells, block.decimal, _thousands(block.decimal))
        is_number = bool(np.isfinite(values).all())
        in_row = UNIT_CELL.fullmatch(block.unit_cells[k]) if k < len(block.unit_cells) else None
        rest, in_name, is_marked = word_of_unit(name)
        # brackets in the name go before a row, which may be none of units (``Y_Unit_Label  lbf``)
        is_named = is_marked and written_unit(in_name) is not None
        word = in_name if is_named or not in_row else in_row[1]
        unit = written_unit(word) if word else None
        words.append("" if unit or not (in_row or is_marked) else word)
        plain = name if unit is None or (in_row and not is_named) else rest
        shown, dimension = unit or ("", "")
        quantity = _quantity(plain, dimension) if is_number else ""
        if not (shown or words[-1]) and (shown := above.get(DIMENSIONS.get(quantity, ""), "")):
            notes.append(f"{name!r} is in {shown}: a line above the names says so")
        low, high = (float(values.min()), float(values.max())) if is_number else (None, None)
        labels = () if is_number else tuple(dict.fromkeys(cells))[:6]
        columns.append(InspectedColumn(name, shown, quantity, low, high, labels))
        numbers.append(values if is_number else np.empty(0))
    return columns, numbers, words


def _thousands(decimal: str) -> str:
    return "," if decimal == "." else "."


def _quantity(name: str, dimension: str) -> str:
    """Quantity that a name speaks for, if the unit does not gainsay it."""
    plain = re.sub(r"[_\s]+", " ", name).strip().lower()
    for quantity, words in WORDS.items():
        named = any(word in plain for word in words) and not _RATES.search(plain)
        named = named or _SYMBOLS.get(plain) == quantity
        if named and (not dimension or DIMENSIONS[quantity] == dimension):
            return quantity
    usual = {"length": "displacement", "force": "force", "pressure": "stress", "time": "time"}
    return usual.get(dimension, "")


def _pair(columns: Sequence[InspectedColumn], notes: list[str]) -> dict[str, int]:
    """Column of how far and of how hard, the surest of each; displacement and force go first."""
    two = [
        (quantity, [k for k, column in enumerate(columns) if column.quantity == quantity])
        for quantity in ("stretch", "stress")
    ]
    if all(len(places) == 2 for _, places in two):
        return {f"{what}_{n}": k for what, places in two for n, k in enumerate(places, 1)}
    chosen: dict[str, int] = {}
    for quantities in (KINEMATIC, KINETIC):
        for quantity in quantities:
            fitting = [
                k for k, column in enumerate(columns)
                if column.quantity == quantity and column.name and column.low != column.high
            ]  # fmt: skip
            if not fitting:
                continue
            lower = {k: columns[k].name.lower() for k in fitting}
            ranks = {
                k: [*(word in lower[k] for word in WORDS[quantity]), True].index(True)
                for k in fitting
            }
            best = chosen[quantity] = min(fitting, key=ranks.__getitem__)
            others = ", ".join([repr(columns[k].name) for k in fitting if k != best][:4])
            if others:
                taken = f"{quantity}: {columns[best].name!r} is taken"
                notes.append(f"{taken}; there are also {others}")
            break
    return chosen


#: two measures in one file, the size of the specimen by which they differ, and what else may differ
_SECOND = (
    ("displacement", "strain", "length", "mm",
     "in which frame, load cell and grips give way: name the strain in columns if it was measured "
     "on the specimen"),
    ("force", "stress", "area", "mm^2", "as a true stress is not: which is it?"),
)  # fmt: skip
#: share of its range by which a column may be off a straight line of another one
_STRAIGHT = 2e-3


def _sizes_assumed(
    columns: Sequence[InspectedColumn], chosen: Mapping[str, int], numbers: Sequence[Array]
) -> list[str]:
    """Say by which length the strain of a file is its displacement, and by which area its stress.

    A strain that is in no proportion to the way of the machine was measured on the specimen.
    """
    notes: list[str] = []
    for first, second, size, unit, otherwise in _SECOND:
        taken = columns[chosen[first]] if first in chosen else None
        if taken is None or not taken.unit:
            continue
        y = numbers[chosen[first]] * unit_factor(taken.unit, DIMENSIONS[first])
        for column, values in zip(columns, numbers, strict=True):
            if column.quantity != second or not column.unit or column.low == column.high:
                continue
            x = values * unit_factor(column.unit, DIMENSIONS[second])
            slope, start = np.polyfit(x, y, 1)
            is_straight = np.abs(y - start - slope * x).max() <= _STRAIGHT * np.ptp(y)
            notes.append(
                f"{column.name!r} is {taken.name!r} over {abs(slope):.4g} {unit}: is that the "
                f"{size} of the specimen?"
                if is_straight
                else f"{column.name!r} is in no proportion to {taken.name!r}, {otherwise}"
            )
    return notes


def _numbered(
    columns: Sequence[InspectedColumn], chosen: Mapping[str, int], block: _Block,
    table: dict[str, object], notes: list[str],
) -> list[InspectedColumn]:  # fmt: skip
    """Columns by their number: tests side by side have names twice, or rows lack the last one."""
    table |= {"header": False, "skip_lines": block.at[0] - 1}
    table.pop("unit_row", None)
    taken = " and ".join(str(k + 1) for k in chosen.values())
    same = (k for k, column in enumerate(columns) if column.quantity in chosen)
    others = ", ".join(str(k + 1) for k in same if k not in chosen.values()) or "no others"
    why, more = "gives a name twice", f"; {others} hold the same of other tests"
    if len(block.names) > max(map(len, block.rows)):
        why, more = f"names {len(block.names)} columns where rows have {len(block.names) - 1}", ""
    notes.append(
        f"the header {why}, so that columns are named by their number: {taken} are taken{more}"
    )
    return [replace(column, name=str(k + 1)) for k, column in enumerate(columns)]


def _unit_for(
    column: InspectedColumn, quantity: str, values: Array, word: str, notes: list[str]
) -> str:
    """Give the unit of a column, or the usual one; empty where the file leaves it open."""
    if column.unit:
        return column.unit
    dimension, key, unit = DIMENSIONS[quantity], f"units.{quantity}", ""
    usual, none = INTERNAL[dimension], f"the file names no unit of {column.name!r}"
    largest = float(np.abs(values).max()) if quantity in ("strain", "true_strain") else 0.0
    if word:
        note = f"{word!r} of {column.name!r} is no unit of {dimension}: write {key}"
    elif _NOT_PERCENT < largest <= _PERCENT:
        note = (
            f"{column.name!r} goes to {largest:.4g} and names no unit: a ratio (a stretch of "
            f"{1 + largest:.4g}) or per cent (a stretch of {1 + largest / 100:.4g}): write "
            f'{key} = "1" or "%"'
        )
    elif dimension != "ratio":
        note = (
            f"{none}, {values.min():.4g} to {values.max():.4g}; {usual} is the guess: write "
            f'{key} = "{usual}", or the unit of the instrument'
        )
    else:
        unit = "%" if largest > _PERCENT else usual
        note = f"{none}: {unit} is assumed"
    notes.append(note)
    return unit


def _groups(
    columns: Sequence[InspectedColumn], block: _Block, table: dict[str, object]
) -> list[int]:
    """Columns whose labels tell tests apart; ``block`` and ``average`` go into the table."""
    counted = [Counter(block.column(k)) for k in range(len(columns))]
    several = [
        k for k, column in enumerate(columns)
        if column.name and not _WITHIN.search(column.name)
        and (column.labels or not column.quantity)
        and (_BLOCKS.search(column.name) or _REPEATS.search(column.name) or column.labels)
        and len(counted[k]) > 1 and "" not in counted[k] and min(counted[k].values()) >= _BLOCK
    ]  # fmt: skip
    blocks = [k for k in several if _BLOCKS.search(columns[k].name)] or several[:1]
    if blocks:
        table["block"] = columns[blocks[0]].name
    repeats = [k for k in several if k not in blocks[:1]]
    if repeats:
        table["average"] = [columns[k].name for k in repeats]
    return several


def _layout(block: _Block, notes: list[str]) -> dict[str, object]:
    """Keys that say how the text is written, where it is no plain CSV."""
    is_odd = block.delimiter == "space" or _DELIMITERS[block.delimiter] == block.decimal
    keys: dict[str, object] = {
        "skip_lines": block.skip,
        "header": block.header is not None,
        "unit_row": (block.units or 0) > (block.header or 0) or None,
        "decimal": block.decimal,
        "delimiter": block.delimiter if is_odd else "",
        "comment": block.comment,
    }
    usual = {key.name: key.default for key in keys_of(MeasurementSpec)}
    layout = {key: value for key, value in keys.items() if value != usual[key]}
    if block.others and not block.comment:
        shown = ", ".join(map(str, block.others[:6]))
        notes.append(f"lines among or below the rows that are no rows: {shown}: delete them")
    cells = [cell for row in block.rows for cell in row]
    other = _thousands(block.decimal)
    if any(other in cell for cell in cells) and not any(block.decimal in cell for cell in cells):
        notes.append(f"{other!r} may part thousands or be the decimal mark: thousands are assumed")
        layout["thousands"] = other
    return layout


# Where the specimen begins, which way it is loaded, and its branches.


def _place(
    kinematic: str, d: Array, f: Array, table: dict[str, object], notes: list[str]
) -> tuple[Phase, ...]:
    """Zero, direction, sign and branch of a recording, into the table; its phases."""
    rest = 1.0 if kinematic in ("stretch", "volume_ratio") else 0.0
    rows = d
    largest = float(np.abs(f).max())
    is_return = abs(float(f[0])) > (1 - TURN) * largest and abs(float(f[-1])) < TURN * largest
    if is_return and abs(float(d[-1] - d[0])) > (1 - TURN) * float(np.ptp(d)):
        notes.append("the recording begins at the largest force: it is the way back alone")
        d, f = d[::-1], f[::-1]
    travel = float(np.ptp(d))
    far = int(np.argmax(np.abs(d - d[0])))
    if min(d.max() - d[0], d[0] - d.min()) > _BOTH_WAYS * travel:
        # it begins in the middle: loading goes where the force is larger
        far = max(int(np.argmin(d)), int(np.argmax(d)), key=lambda k: abs(float(f[k])))
    # of the first rows the middle one: a single row may be a trigger; a specimen that tore, or was
    # unloaded at the end of the travel, resisted before
    away = f - np.median(f[:_FIRST])
    most = int(np.argmax(np.abs(away)))
    falls, pushes = d[far] < d[0], float(away[far])
    if abs(pushes) < 2 * TURN * abs(float(away[most])):
        pushes = float(away[most])
    through = d.min() < rest - 2 * TURN * travel and d.max() > rest + 2 * TURN * travel
    ends = f[[int(np.argmin(d)), int(np.argmax(d))]]
    is_both_ways = ends[0] * ends[1] < 0 and float(np.abs(ends).min()) > NO_FORCE * largest
    through = through and is_both_ways
    way = -1.0 if falls and not through else 1.0
    is_position = kinematic == "displacement" and not d.min() < 0 < d.max()
    if is_position and ends[0] * ends[1] < 0:
        through = float(np.abs(ends).min()) > _BOTH_WAYS * float(np.abs(f).max())
    if not through and pushes < 0:
        table["sign"] = "negative"
        notes.append("the force falls while the specimen is loaded: sign = negative")
    elif through and is_position:
        k = int(np.flatnonzero(f[1:] * f[0] <= 0)[0])
        zero = d[k] - f[k] * (d[k + 1] - d[k]) / (f[k + 1] - f[k])
        table["displacement_zero"] = f"{zero:.6g} {_unit_of(table, 'displacement')}"
        notes.append(
            f"the force changes its sign at {zero:.6g}: displacement counts from there, and all "
            "rows are one signed test; if the load cell was not zeroed, write displacement_zero = "
            '"first row" and zero = "first"'
        )
    elif through:
        notes.append("the test runs through zero: all of its rows are one signed test")
    if kinematic == "displacement" and not through:
        _zero_of(way * d, f, float(d[0]), table, notes)
        if rows is not d and "displacement_zero" in table:
            table["displacement_zero"] = f"{d[0]:.6g} {_unit_of(table, 'displacement')}"
        if falls:
            table["direction"] = "falling"
    phases = phases_of(way * rows)
    if len(phases) > 1:
        table["branch"] = "loading"
        cycles = sum(phase.kind == "loading" for phase in phases)
        notes.append(
            f"{len(phases)} phases in {cycles} {'cycle' if cycles == 1 else 'cycles'}: the first "
            "loading is taken; branch may be unloading, all, or the number of a cycle"
        )
    return phases


def _unit_of(table: Mapping[str, object], quantity: str) -> str:
    units = table["units"]
    return str(units.get(quantity, "?")) if isinstance(units, Mapping) else "?"


def _zero_of(
    moved: Array, f: Array, begins: float, table: dict[str, object], notes: list[str]
) -> None:
    """Where displacement counts from, into the table. Shapes: moved, f (rows,), moved rising."""
    is_far = abs(begins) > 0.01 * float(np.ptp(moved))
    largest = float(np.abs(f).max())
    # the first tenth of the travel to the largest force, at least two rows
    peak = max(int(np.argmax(np.abs(f - f[0]))), _BLOCK)
    end = moved[0] + TURN * float(moved[:peak].max() - moved[0])
    rows = np.flatnonzero(moved[:peak] <= end)
    rows = rows if rows.size >= _BLOCK else np.arange(_BLOCK)
    slope, scatter = slope_with_error(moved[rows], f[rows])
    away = np.abs(f - f[0])
    # they carry none
    is_flat = away.argmax() >= _BLOCK and away[rows].max() < NO_FORCE * TURN * away.max()
    if slack_end(moved, f if f[away.argmax()] > 0 else -f) is not None or (
        is_flat and (is_far or abs(slope) <= 2.0 * scatter)
    ):
        table["displacement_zero"] = "contact"
        notes.append("the force is flat at first: displacement counts from contact")
        if abs(float(f[rows].mean())) > OFFSET_SHARE * largest:
            table["zero"] = "fit"
            notes.append(f"the load cell reads {f[rows].mean():.4g} before contact: subtracted")
    elif is_far and (
        abs(float(f[rows].mean()) - slope * float(moved[rows].mean())) < 0.5 * abs(float(f[0]))
    ) and abs(float(f[0])) > OFFSET_SHARE * largest:  # fmt: skip
        notes.append(
            f"the first row carries {f[0]:.4g} at {begins:.6g}, as a specimen does that is "
            "unloaded at 0: the recorded zero counts; if it is not, write displacement_zero = "
            '"first row"'
        )
    elif is_far:
        table["displacement_zero"] = "first row"
        notes.append(f"the unloaded specimen is at {begins:.6g}: displacement counts from there")
