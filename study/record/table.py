"""The tidy table of a study: one row per case, failed cases included."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from study.errors import Fault, InputError, StoreError
from study.record.atomic_files import FileSystem, write_atomic
from study.record.record import Record
from study.tabular import is_formula

if TYPE_CHECKING:
    from pandas import DataFrame, Series

FIXED = ("case_id", "block", "status", "seconds", "dofs")

#: columns that number the replicates of a cell, and the number of the case that they repeat
REPLICATES = {"mesh_seed": 1, "noise_seed": 0}


def is_repeat(extra: Mapping[str, object]) -> bool:
    """Whether a case repeats another one for an error term.

    Parameters
    ----------
    extra : mapping
        ``extra`` of its record.

    Examples
    --------
    >>> is_repeat({}), is_repeat({"mesh_seed": 1}), is_repeat({"noise_seed": 1})
    (False, False, True)
    """
    return any(replicate(extra, name) != first for name, first in REPLICATES.items())


def replicate(extra: Mapping[str, object], name: str) -> int:
    """Read the number that a case has among its repeats.

    Parameters
    ----------
    extra : mapping
        ``extra`` of its record; without the key, the case is the one that others repeat.
    name : {"mesh_seed", "noise_seed"}
        Key of :data:`REPLICATES`.
    """
    number = extra.get(name)
    return number if isinstance(number, int) and number else REPLICATES[name]


def table(records: Sequence[Record]) -> DataFrame:
    """Tidy table of records, in the order given.

    Parameters
    ----------
    records : sequence of Record
        Records of one study.

    Returns
    -------
    DataFrame
        ``case_id``, ``block``, a column of labels for each factor, ``status``, a column of
        numbers for each response (missing unless the case converged), ``seconds``, ``dofs``.
        Between them ``mesh_seed`` or ``noise_seed`` number the replicates of a cell, where there
        are any. ``attrs["units"]`` maps each response to its unit.

    Raises
    ------
    StoreError
        If records of different studies are mixed: other factors, units, or the same case twice.
    """
    import pandas as pd

    factors = list(records[0].levels) if records else []
    _check_same_study(records, factors)
    units = _units(records)
    numbered = [n for n in REPLICATES if any(n in r.extra for r in records)]
    clash = [n for n in factors if n in FIXED or n in units or n in numbered]
    if clash:
        raise StoreError(f"factor {clash[0]!r} has the name of another column; rename it")
    columns: dict[str, list[object]] = {
        "case_id": [r.case_id for r in records],
        "block": [r.block for r in records],
        **{name: [r.levels[name] for r in records] for name in factors},
        **{n: [replicate(r.extra, n) for r in records] for n in numbered},
        "status": [r.status for r in records],
    }
    numbers = {name: [r.response(name) for r in records] for name in units}
    numbers.setdefault("seconds", [_number(r.timings.get("total")) for r in records])
    numbers.setdefault("dofs", [_number(r.mesh.get("dofs")) for r in records])
    frame = pd.DataFrame(
        {name: pd.Series(values, dtype=object) for name, values in columns.items()}
        | {name: pd.Series(values, dtype=float) for name, values in numbers.items()}
    )
    frame.attrs["units"] = units
    return frame


def cell_names(frame: DataFrame, factors: Sequence[str]) -> Series[str]:
    """Name the cell of every row: its levels joined by ``:``.

    Parameters
    ----------
    frame : DataFrame
        One row a case.
    factors : sequence of str
        Columns that hold the levels.

    Returns
    -------
    Series of str
        With the index of the table.
    """
    import pandas as pd

    columns = [frame[name].astype(str) for name in factors]
    joined = [":".join(levels) for levels in zip(*columns, strict=True)]
    return pd.Series(joined, index=frame.index, dtype=str)


def answered_often(
    known: DataFrame, factors: Sequence[str], block: str, blocks: int
) -> Series[bool]:
    """Tell which rows belong to a cell with an answer in more than half of so many blocks.

    Parameters
    ----------
    known : DataFrame
        The rows with an answer.
    factors : sequence of str
        Columns that hold the levels.
    block : str
        Column that holds the block.
    blocks : int
        Number of blocks of the study.

    Returns
    -------
    Series of bool
        With the index of ``known``.
    """
    cell = cell_names(known, factors)
    return 2 * known[block].groupby(cell).transform("nunique") > blocks


def write_csv(frame: DataFrame, path: Path, system: FileSystem | None = None) -> None:
    """Write a table as CSV, whole or not at all.

    Parameters
    ----------
    frame : DataFrame
        Written without its index.
    path : Path
        File to write; an old one is replaced.
    system : FileSystem, optional
        Operations that change the disk.

    Raises
    ------
    InputError
        If a name or label would be run as a formula by a spreadsheet (CWE-1236): quoting does
        not survive the next save there, so such names are refused.
    StoreError
        If the file cannot be written.
    """
    faults = [
        Fault(
            f"{path.name}: {place}",
            f"a spreadsheet would run {text[:40]!r} as a formula",
            "rename it so that it does not begin with = + - @ or a control character",
        )
        for place, text in _texts(frame)
        if is_formula(text)
    ]
    if faults:
        raise InputError(list(dict.fromkeys(faults))[:20])
    text = frame.to_csv(index=False, lineterminator="\n")
    try:
        data = text.encode()
    except UnicodeEncodeError as error:
        raise InputError(Fault(path.name, f"a name is not valid text ({error.reason})")) from error
    write_atomic(path, data, system)


def _texts(frame: DataFrame) -> list[tuple[str, str]]:
    found = [("header", str(name)) for name in frame.columns]
    for name in frame.columns:
        values = dict.fromkeys(v for v in frame[name].tolist() if isinstance(v, str))
        found += [(f"column {name}", value) for value in values]
    return found


def _check_same_study(records: Sequence[Record], factors: list[str]) -> None:
    seen: set[str] = set()
    for record in records:
        if set(record.levels) != set(factors):
            raise StoreError(
                f"case {record.case_id}: its factors are {sorted(record.levels)}, those of the "
                f"first record {sorted(factors)}; records of different studies are not mixed"
            )
        if record.case_id in seen:
            raise StoreError(f"case {record.case_id} stands twice among the records")
        seen.add(record.case_id)


def _units(records: Sequence[Record]) -> dict[str, str]:
    units: dict[str, str] = {}
    for record in records:
        for name, response in record.responses.items():
            unit = str(response.get("unit", ""))
            if units.setdefault(name, unit) != unit:
                raise StoreError(
                    f"case {record.case_id}: {name} is in {unit!r}, elsewhere in {units[name]!r}"
                )
    return units


def _number(value: object) -> float:
    return float(value) if isinstance(value, (int, float)) else float("nan")
