"""CSV files that no spreadsheet runs as formulas."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from study.reporting.text import clean

if TYPE_CHECKING:
    import pandas as pd

# CWE-1236: a text cell that starts with one of these is a formula to a spreadsheet
_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n")


def safe_cell(value: Any) -> Any:
    """Cell for a CSV: numbers stay numbers, text that could be a formula gets a quote.

    Examples
    --------
    >>> safe_cell("=1+1"), safe_cell(-1.5), safe_cell("-1.5"), safe_cell(None)
    ("'=1+1", -1.5, "'-1.5", '')
    """
    if hasattr(value, "item"):
        value = value.item()
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ""
    if isinstance(value, bool | int | float):
        return value
    # the csv module quotes a line feed but not a lone carriage return
    text = clean(value).replace("\r\n", "\n").replace("\r", "\n")
    # leading spaces do not protect: some programs strip them
    return f"'{text}" if text.lstrip(" ").startswith(_FORMULA) or text[:1] in _FORMULA else text


def of_frame(frame: pd.DataFrame) -> str:
    """CSV text of a data frame, without its index."""
    return of_rows(list(frame.columns), frame.itertuples(index=False, name=None))


def of_records(records: Sequence[Mapping[str, Any]]) -> str:
    """CSV text of mappings; columns in the order of first appearance."""
    columns = list(dict.fromkeys(key for record in records for key in record))
    return of_rows(columns, ([record.get(key) for key in columns] for record in records))


def of_rows(columns: Iterable[Any], rows: Iterable[Iterable[Any]]) -> str:
    """CSV text: comma, quotes where needed, one newline a row."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow([safe_cell(column) for column in columns])
    writer.writerows([safe_cell(cell) for cell in row] for row in rows)
    return buffer.getvalue()
