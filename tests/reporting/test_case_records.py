"""From a mean to the records behind it: the matrix leads to the cases of a cell."""

from __future__ import annotations

from dataclasses import replace

import pytest

from study.reporting.content import tables
from study.reporting.content.report_facts import facts
from study.reporting.output.page import Pages
from study.reporting.results.study_result import ReportData


def test_every_cell_leads_to_its_own_cases(data: ReportData, contents: Pages) -> None:
    cells, records = contents.tables["cells"], contents.tables["records"]
    factors = len(data.factors)
    assert len(records.rows) == len(data.table)
    firsts = {name: k for k, name in enumerate(records.anchors) if name}
    for row, link in zip(cells.rows, cells.links, strict=True):
        start = firsts[link]
        count = int(row[factors].split(" of ")[1])
        mine = records.rows[start : start + count]
        assert {one[:factors] for one in mine} == {row[:factors]}
        # and no other case is of this cell
        assert sum(one[:factors] == row[:factors] for one in records.rows) == count


def test_cells_stand_in_the_order_of_the_design(data: ReportData) -> None:
    shuffled = replace(data, table=data.table.sample(frac=1.0, random_state=1))
    order = [
        [levels.index(label) for label, levels in zip(cell, data.factors.values(), strict=True)]
        for cell, _ in tables.by_cell(shuffled)
    ]
    assert order == sorted(order)
    plain, mixed = (tables.case_records(d, facts(d)) for d in (data, shuffled))
    assert plain is not None
    assert mixed is not None
    assert plain.rows == mixed.rows


def test_a_page_lists_no_more_than_it_can_hold(
    data: ReportData, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tables, "MOST", len(data.table) - 1)
    assert tables.case_records(data, facts(data)) is None
