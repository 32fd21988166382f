"""Cells that are one computation: copies are named together and counted once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from study.reporting.data import ReportData
from study.reporting.facts import Facts, cells
from study.reporting.text import clean, count, listing, name_of

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Group:
    """Cells that agree in every block, with the mean of the first; ``members`` are their rows."""

    mean: float
    members: tuple[Mapping[str, str], ...]

    def __len__(self) -> int:
        return len(self.members)


def groups(data: ReportData, facts: Facts) -> tuple[Group, ...]:
    """Distinct computations of a response, lowest mean first."""
    frame = cells(data, facts.name)
    place = _places(data, facts, frame)
    found: dict[int, list[int]] = {}
    for row, key in enumerate(place):
        found.setdefault(key, []).append(row)
    levels = frame[list(data.factors)].astype(str).to_dict("records")
    means = frame["mean"].tolist()
    return tuple(
        Group(float(means[rows[0]]), tuple({str(k): v for k, v in levels[i].items()} for i in rows))
        for rows in found.values()
    )


def _places(data: ReportData, facts: Facts, frame: pd.DataFrame) -> list[int]:
    """Index of the group of every cell; a cell that no group names stands alone."""
    analyzed = [name for name, levels in data.factors.items() if len(levels) > 1]
    names = frame[analyzed].astype(str).agg(" ".join, axis=1).tolist() if analyzed else []
    known = {name: i for i, group in enumerate(facts.copies) for name in group}
    alone = len(facts.copies)
    return [known.get(name, alone + i) for i, name in enumerate(names or [""] * len(frame))]


def describe(group: Group, data: ReportData) -> str:
    """Name a group by its levels: ``reduced-polynomial-2, frictionless, any space``.

    Levels that a group shares with all others of their factor are only said to be any; a
    group that is no full crossing is named by its first cell.
    """
    chosen = {name: _levels(group, name, data) for name in data.factors}
    total = 1
    for levels in chosen.values():
        total *= len(levels)
    if total != len(group):
        first = ", ".join(clean(level) for level in group.members[0].values())
        block = clean(data.block) or "block"
        others = len(group) - 1
        agree = f"{count(others, 'cell')} that agree{'s' * (others == 1)} with it in every {block}"
        return f"{first} (and {agree})"
    return ", ".join(_words(name, levels, data) for name, levels in chosen.items())


def _levels(group: Group, name: str, data: ReportData) -> Sequence[str]:
    present = {member[name] for member in group.members}
    return [level for level in data.factors[name] if level in present]


def _words(name: str, levels: Sequence[str], data: ReportData) -> str:
    if len(levels) == len(data.factors[name]) > 1:
        return f"any {name_of(name, data.labels)}"
    return listing([clean(level) for level in levels], "or")
