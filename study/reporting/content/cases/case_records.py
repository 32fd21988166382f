"""Every case beside its record: where the mean of a cell comes from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from study.reporting.content.cases.fit_tables import fit_rank
from study.reporting.content.table import Table
from study.reporting.numbers import MISSING, duration, quantity
from study.reporting.report import Facts
from study.reporting.text import clean, name_of
from study.study_result.report_data import ReportData

if TYPE_CHECKING:
    import pandas as pd

#: cases that a page lists: a row takes 400 bytes, and beyond these the CSV is quicker to search
MOST = 2000

#: start of the names that rows of a cell have in the page
CELL = "cell-"


def by_cell(data: ReportData) -> list[tuple[tuple[str, ...], pd.DataFrame]]:
    """Levels and rows of every cell, cells in the order of the design, rows in that of blocks.

    Parameters
    ----------
    data : ReportData
        Its table has one row a case, failed cases included; without rows there are no cells.

    Returns
    -------
    list of (tuple of str, DataFrame)
        The levels stand in the order of ``data.factors``.
    """
    if data.table.empty:  # nothing is computed yet, or what was is lost
        return []
    groups = [
        (tuple(str(level) for level in levels), _in_order(group, data.blocks))
        for levels, group in data.table.groupby(list(data.factors), sort=False)
    ]
    return sorted(
        groups, key=lambda cell: fit_rank(dict(zip(data.factors, cell[0], strict=True)), data)
    )


def _in_order(group: pd.DataFrame, blocks: Sequence[str]) -> pd.DataFrame:
    if "block" not in group:
        return group
    order = {block: k for k, block in enumerate(blocks)}
    place = group["block"].map(lambda block: order.get(str(block), len(order)))
    return group.loc[place.sort_values(kind="stable").index]


def case_records(data: ReportData, found: Sequence[Facts]) -> Table | None:
    """Every case with its responses and the name of its record, cell by cell.

    Parameters
    ----------
    data : ReportData
        Of a study.
    found : sequence of Facts
        What is shown of its responses.

    Returns
    -------
    Table or None
        None of a table, which has no records, and of more than ``MOST`` cases.
    """
    if data.is_table or "case_id" not in data.table or not 0 < len(data.table) <= MOST:
        return None
    known = [facts for facts in found if facts.name in data.table]
    blocked = bool(data.block) and "block" in data.table
    rows: list[tuple[str, ...]] = []
    anchors: list[str] = []
    for number, (levels, group) in enumerate(by_cell(data), 1):
        cell = tuple(clean(level) for level in levels)
        for record in group.to_dict("records"):
            block = (clean(str(record["block"])) or MISSING,) if blocked else ()
            shown = (quantity(record[f.name], f.unit) for f in known)
            seconds = duration(record.get("seconds"))
            name = clean(str(record["case_id"]), 16)
            rows.append((*cell, *block, clean(str(record["status"])), *shown, seconds, name))
        anchors += [f"{CELL}{number}", *[""] * (len(group) - 1)]
    words = [name_of(factor, data.labels) for factor in data.factors]
    if blocked:
        words.append(name_of("block", {"block": data.block, **data.labels}))
    columns = (*words, "status", *(facts.title for facts in known), "time", "record")
    return Table("records", columns, tuple(rows), len(words) + 1, 1, _NOTE, anchors=tuple(anchors))


_NOTE = (
    "The record of a case is cases/RECORD/record.json in the results folder of the study: inputs, "
    "constants, curve, responses, energy balance, versions."
)
