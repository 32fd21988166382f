"""Tidy tables of responses, read strictly: one row a case, one column a factor."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from study.errors import Fault, InputError, nearest

if TYPE_CHECKING:
    import pandas as pd

_NUMBER = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?", re.ASCII)
_DECIMAL_COMMA = re.compile(r"[+-]?[0-9]+,[0-9]+", re.ASCII)
_MISSING = {"", "na", "n/a", "nan", "null", "*", "."}
_MAX_BYTES = 200_000_000
_MAX_ROWS = 1_000_000
_MAX_FAULTS = 20


def names_of(block: str | Sequence[str] | None) -> tuple[str, ...]:
    """Names of the blocks: none, one or several."""
    if block is None:
        return ()
    return (block,) if isinstance(block, str) else tuple(str(name) for name in block)


def read_csv(
    path: str | Path,
    response: str,
    factors: Sequence[str],
    block: str | Sequence[str] | None = None,
    unit: str | None = None,
    decimal: str = ".",
) -> pd.DataFrame:
    """Read the named columns of a tidy CSV strictly.

    Parameters
    ----------
    path : str or Path
        CSV with a header; comma, semicolon or tab.
    response : str
        Column of the response; an empty cell, NA, NaN or * is a missing response.
    factors : sequence of str
        Columns of the factors, kept as text.
    block : str or sequence of str, optional
        Column of the blocks, or several that cross.
    unit : str, optional
        Column of the unit on which rows are repeated.
    decimal : {".", ","}
        Decimal mark of the response; with a comma the columns are apart by semicolons or tabs.

    Raises
    ------
    InputError
        Naming file, row and column, all faults at once.
    """
    import pandas as pd

    source = Path(path)
    if decimal not in (".", ","):
        raise InputError(Fault("--decimal", f"must be . or , and not {decimal!r}"))
    header, rows = _read_rows(source, ";\t" if decimal == "," else ",;\t")
    others = [*names_of(block), *([unit] if unit else [])]
    names = [response, *factors, *others]
    _check_names(source.name, header, response, factors, others)
    faults: list[Fault] = []
    if decimal == "," and response in header:
        at = header.index(response)
        rows = [[*row[:at], row[at].replace(",", "."), *row[at + 1 :]] for row in rows]
    columns = {
        name: _column(source.name, rows, header.index(name), name, name == response, faults)
        for name in dict.fromkeys(names)
    }
    if faults:
        raise InputError(faults[:_MAX_FAULTS])
    for name in columns:
        if name != response:
            _check_clash(source.name, name, columns[name])
    frame = pd.DataFrame(columns)
    for name in names[1:]:
        frame[name] = frame[name].str.strip()
    return frame


def _read_rows(path: Path, delimiters: str) -> tuple[list[str], list[list[str]]]:
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise InputError(Fault(str(path), f"larger than {_MAX_BYTES // 10**6} MB"))
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(Fault(str(path), f"cannot be read: {error.strerror}")) from error
    except UnicodeDecodeError as error:
        raise InputError(Fault(str(path), "is not UTF-8 text", "save it as CSV UTF-8")) from error
    first = text.split("\n", 1)[0]
    delimiter = max(delimiters, key=first.count) if first.strip() else delimiters[0]
    try:
        rows = [row for row in csv.reader(text.splitlines(), delimiter=delimiter) if any(row)]
    except csv.Error as error:
        raise InputError(Fault(str(path), f"is no CSV: {error}")) from error
    if len(rows) < 2:
        raise InputError(Fault(str(path), "has no data: a header and rows are needed"))
    if len(rows) > _MAX_ROWS:
        raise InputError(Fault(str(path), f"has more than {_MAX_ROWS} rows"))
    header = [name.strip() for name in rows[0]]
    if len(set(header)) < len(header):
        double = next(name for name in header if header.count(name) > 1)
        raise InputError(Fault(f"{path}: header", f"the column {double!r} occurs twice"))
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(header):
            raise InputError(
                Fault(
                    f"{path}: row {number}",
                    f"has {len(row)} cells, expected {len(header)}",
                    "a decimal comma? write decimal points, or say --decimal ,",
                )
            )
    return header, rows[1:]


def _check_names(
    where: str,
    valid: Sequence[str],
    response: str,
    factors: Sequence[str],
    blocks: Sequence[str] = (),
) -> None:
    faults = [
        Fault(f"{where}: column {name!r}", "no such column", nearest(name, valid))
        for name in dict.fromkeys([response, *factors, *blocks])
        if name not in valid
    ]
    if not factors:
        faults.append(Fault("factors", "at least one factor is needed"))
    if len(set(factors)) < len(factors):
        faults.append(Fault("factors", f"a factor is named twice: {list(factors)}"))
    if response in factors or response in blocks:
        faults.append(Fault("response", f"{response!r} cannot also be a factor or the block"))
    for name in blocks:
        if name in factors or list(blocks).count(name) > 1:
            faults.append(Fault("block", f"{name!r} cannot also be a factor or another block"))
    if faults:
        raise InputError(faults)


def _column(
    where: str, rows: list[list[str]], at: int, name: str, number: bool, faults: list[Fault]
) -> list[Any]:
    out: list[Any] = []
    for line, row in enumerate(rows, start=2):
        place = f"{where}: row {line}, column {name!r}"
        text = row[at]
        if number:
            out.append(_number(text, place, faults))
        else:
            if not text.strip():
                faults.append(Fault(place, "the level is empty"))
            out.append(text)
    return out


def _number(text: str, place: str, faults: list[Fault]) -> float:
    text = text.strip()
    if text.lower() in _MISSING:
        return math.nan
    value = float(text) if _NUMBER.fullmatch(text) else math.inf
    if not math.isfinite(value):
        comma = bool(_DECIMAL_COMMA.fullmatch(text))
        mend = (
            "write a decimal point, or say --decimal ,"
            if comma
            else "write a number, or leave it empty"
        )
        faults.append(Fault(place, f"{text!r} is not a finite number", mend))
        return math.nan
    return value


def _check_clash(where: str, name: str, labels: Iterable[str]) -> None:
    """Refuse labels that differ in blanks alone: they would be two levels by accident."""
    seen: dict[str, tuple[str, int]] = {}
    for line, label in enumerate(labels, start=2):
        first, at = seen.setdefault(label.strip(), (label, line))
        if first != label:
            raise InputError(
                Fault(
                    f"{where}: row {line}, column {name!r}",
                    f"the level {label!r} and the level {first!r} of row {at} differ in "
                    "blanks alone",
                    "write both the same way",
                )
            )
