"""Tidy tables in: strict reading of a CSV, and checks that every analysis relies on."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from study.analysis.matrix import Array, Codes, Layout
from study.errors import Fault, InputError, nearest

if TYPE_CHECKING:
    import pandas as pd

_NUMBER = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?", re.ASCII)
_DECIMAL_COMMA = re.compile(r"[+-]?[0-9]+,[0-9]+", re.ASCII)
_MISSING = {"", "na", "n/a", "nan", "null", "*", "."}
_MAX_BYTES = 200_000_000
_MAX_ROWS = 1_000_000
_MAX_FAULTS = 20


@dataclass(frozen=True)
class Data:
    """One checked response: rows without a response are counted, never lost silently."""

    y: Array
    layout: Layout
    factors: tuple[str, ...]
    block: str | None
    rows: Codes
    missing: int
    warnings: tuple[str, ...]
    also: tuple[str, ...] = ()

    @property
    def blocks(self) -> tuple[str, ...]:
        """Columns of all blocks: the first, and those that cross it (a Latin square)."""
        return (*((self.block,) if self.block else ()), *self.also)

    @property
    def cell(self) -> Codes:
        """Index of the cell of each row in the full grid of the factors."""
        return self.layout.cell(self.factors)

    def cell_names(self) -> list[str]:
        """Names of all cells of the full grid, in the order of their index."""
        from itertools import product

        return [" ".join(c) for c in product(*(self.layout.levels[f] for f in self.factors))]


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

    Raises
    ------
    InputError
        Naming file, row and column, all faults at once.
    """
    import pandas as pd

    source = Path(path)
    header, rows = _read_rows(source)
    others = [*names_of(block), *([unit] if unit else [])]
    names = [response, *factors, *others]
    _check_names(source.name, header, response, factors, others)
    faults: list[Fault] = []
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


def _read_rows(path: Path) -> tuple[list[str], list[list[str]]]:
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise InputError(Fault(str(path), f"larger than {_MAX_BYTES // 10**6} MB"))
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(Fault(str(path), f"cannot be read: {error.strerror}")) from error
    except UnicodeDecodeError as error:
        raise InputError(Fault(str(path), "is not UTF-8 text", "save it as CSV UTF-8")) from error
    first = text.split("\n", 1)[0]
    delimiter = max(",;\t", key=first.count) if first.strip() else ","
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
                    "a decimal comma? write decimal points",
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
        mend = "write a decimal point" if comma else "write a number, or leave it empty"
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


def prepare(
    table: pd.DataFrame,
    response: str,
    factors: Sequence[str],
    block: str | Sequence[str] | None = None,
) -> Data:
    """Check a table and code its factors.

    Raises
    ------
    InputError
        For unknown columns, a factor with one level, text responses, labels that clash.
    """
    factors, blocks = [str(name) for name in factors], names_of(block)
    _check_names("table", [str(c) for c in table.columns], response, factors, blocks)
    raw = _response(table, response)
    labels = {n: _labels(table[n], n) for n in [*factors, *blocks]}
    keep = np.isfinite(raw)
    warnings = _missing_warning(keep, response)
    if keep.sum() < 2:
        raise InputError(Fault(f"response {response!r}", f"has {int(keep.sum())} values"))
    faults, levels, codes = [], {}, {}
    for name, text in labels.items():
        order = _level_order(table[name], text)
        present = set(text[keep])
        lost = [level for level in order if level not in present]
        if lost:
            warnings.append(f"{name}: no response at level {', '.join(lost)}")
        order = [level for level in order if level in present]
        if len(order) < 2:
            kind = "block" if name in blocks else "factor"
            faults.append(Fault(f"{kind} {name!r}", f"needs at least two levels, got {order}"))
        index = {level: i for i, level in enumerate(order)}
        levels[name] = tuple(order)
        codes[name] = np.array([index[t] for t in text[keep]], dtype=np.int64)
    if faults:
        raise InputError(faults)
    return Data(
        raw[keep],
        Layout(levels, codes),
        tuple(factors),
        blocks[0] if blocks else None,
        np.flatnonzero(keep),
        int((~keep).sum()),
        tuple(warnings),
        blocks[1:],
    )


def _response(table: pd.DataFrame, response: str) -> Array:
    import pandas as pd

    column = table[response]
    if not (pd.api.types.is_numeric_dtype(column) or column.isna().all()):
        bad = pd.to_numeric(column, errors="coerce").isna() & column.notna()
        if bad.any():
            row = column.index[bad.to_numpy()][0]
            raise InputError(
                Fault(f"row {row}, column {response!r}", f"{column[row]!r} is not a number")
            )
        column = pd.to_numeric(column)
    return np.asarray(column.to_numpy(dtype=float, na_value=math.nan), dtype=float)


def _missing_warning(keep: Any, response: str) -> list[str]:
    lost = np.flatnonzero(~keep)
    if not lost.size:
        return []
    listed = ", ".join(str(i + 1) for i in lost[:10]) + (", ..." if lost.size > 10 else "")
    return [f"{response} is missing in {lost.size} of {keep.size} rows (rows {listed})"]


def _labels(column: pd.Series, name: str) -> Any:
    if column.isna().any():
        row = int(np.flatnonzero(column.isna().to_numpy())[0]) + 1
        raise InputError(Fault(f"row {row}, column {name!r}", "the level is empty"))
    # 1, 1.0 and True are equal keys, so the type goes along
    keys = [(type(value), value) for value in column.tolist()]
    label = {key: _label(key[1]) for key in dict.fromkeys(keys)}
    seen: dict[str, Any] = {}
    for (_, value), text in label.items():
        first = seen.setdefault(text.strip(), value)
        if isinstance(first, str) != isinstance(value, str) or _label(first) != text:
            raise InputError(
                Fault(
                    f"column {name!r}",
                    f"the levels {first!r} and {value!r} look the same",
                    "write both the same way",
                )
            )
    return np.array([label[key] for key in keys], dtype=object)


def _label(value: Any) -> str:
    if isinstance(value, float | np.floating) and float(value).is_integer():
        return str(int(value))
    return str(value)


def _level_order(column: pd.Series, labels: Any) -> list[str]:
    """Order of the levels: of the categories, numeric where all are numbers, else as met."""
    if hasattr(column, "cat"):
        found = set(labels)
        return [_label(c) for c in column.cat.categories if _label(c) in found]
    unique = list(dict.fromkeys(labels))
    if all(_NUMBER.fullmatch(label) for label in unique):
        return sorted(unique, key=float)
    return unique
