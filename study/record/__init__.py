"""Measured tests, records of finished cases, the crash-safe store and the tidy table."""

from __future__ import annotations

from study.record.conditioning import SORTED
from study.record.measurements import read_measurements
from study.record.record import STATUSES, Record
from study.record.selection import MeasuredTest, Measurements
from study.record.store import Store, Survey
from study.record.table import answered_often, cell_names, is_repeat, table, write_csv

__all__ = [
    "SORTED",
    "STATUSES",
    "MeasuredTest",
    "Measurements",
    "Record",
    "Store",
    "Survey",
    "answered_often",
    "cell_names",
    "is_repeat",
    "read_measurements",
    "table",
    "write_csv",
]
