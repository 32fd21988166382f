"""Tidy tables of responses, read strictly: one row a case, one column a factor."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from study import tabular
from study.arrays import Array
from study.errors import Fault, InputError, nearest
from study.tabular import MAX_FAULTS, NUMBER, CsvTable

if TYPE_CHECKING:
    import pandas as pd

_NUMBER = NUMBER

#: Cells that stand for a missing response, in small letters.
MISSING = frozenset({"", "na", "n/a", "nan", "null", "*", "."})


def names_of(block: str | Sequence[str] | None) -> tuple[str, ...]:
    """Names of the blocks: none, one or several.

    Parameters
    ----------
    block : str, sequence of str or None
        Column or columns of the blocks; None for none.
    """
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
    covariates: Sequence[str] = (),
) -> pd.DataFrame:
    """Read the named columns of a tidy CSV strictly.

    Parameters
    ----------
    path : str or Path
        CSV with a header, plain or gzip; see :func:`study.tabular.read_csv`.
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
    covariates : sequence of str
        Columns of numbers that are kept as such; an empty cell becomes NaN.

    Raises
    ------
    InputError
        Naming file, row and column, all faults at once.
    """
    import pandas as pd

    others = [*names_of(block), *([unit] if unit else [])]
    table = tabular.read_csv(
        Path(path), numbers=[response, *covariates], decimal=decimal, declared_by="--decimal ,"
    )
    _check_names(table.source, list(table.columns), response, factors, others, covariates)
    labels = list(dict.fromkeys([*factors, *others]))
    faults = [fault for name in labels for fault in _empty_labels(table, name)]
    values: dict[str, Array] = {}
    for name in (response, *covariates):
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
            faults.append(Fault("block", f"{name!r} cannot also be a factor or another block"))
    if faults:
        raise InputError(faults)


def _empty_labels(table: CsvTable, name: str) -> list[Fault]:
    cells = table.text(name)
    return [Fault(table.place(k, name), "the level is empty") for k, c in enumerate(cells) if not c]


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
            raise InputError(Fault(table.place(row, name), rule, "write both the same way"))
