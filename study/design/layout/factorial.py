"""Full factorials, also with factors that change together or are nested; and listed cells."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Annotated, Literal

from study.design.diagnostics import is_known, noted
from study.design.factors import known_level
from study.design.layout.request import MAX_CELLS, Made, Request
from study.design.spec import Factor, Scheme
from study.design.toml_document import flatten
from study.errors import nearest
from study.setup.quantity import shown
from study.setup.section import AsWritten, Bad, Rows, as_written, section
from study.setup.text import name

#: parent of a nested factor, and the labels that exist within each of its levels
Nests = Mapping[str, tuple[str, Mapping[str, tuple[str, ...]]]]

_Name = Annotated[object, as_written("name a factor")]
_Within = Annotated[object, as_written("{ LEVEL = [..], LEVEL = [..] }")]
_Cells = Annotated[object, as_written("list the cells: treatments = [{ A = .., B = .. }]")]


@section
class Nested:
    """One ``[[design.nested]]``: levels that exist only within a level of another factor."""

    factor: _Name
    within: _Name
    levels: _Within


@section
class Full:
    """Every combination of the levels that the factors have.

    Parameters
    ----------
    zip
        List of lists of factors whose levels change together.
    nested : tuple of Nested
        Factors whose levels exist only within a level of another one.
    """

    kind: Literal["full"] = "full"
    zip: AsWritten = None
    nested: Annotated[tuple[Nested, ...], Rows()] = ()

    def make(self, request: Request) -> Made:
        """Leave out the combinations that zipped or nested factors do not have."""
        factors = request.factors
        zipped: tuple[tuple[str, ...], ...] | None = ()
        if self.zip is not None:
            zipped = noted(partial(_zipped, factors), self.zip, "design.zip", request.faults)
        nests = _nests(self.nested, request)
        if zipped is None or nests is None:
            return request.nothing
        followers = {n for group in zipped for n in group[1:]}
        count = math.prod(len(f.levels) for f in factors if f.name not in followers)
        if count > MAX_CELLS:
            rule = f"give {count} cells, the limit is {MAX_CELLS}"
            request.faults.add("factors", rule, "use fewer levels, or several studies")
            return (), Scheme()
        if not zipped and not nests:
            return request.nothing
        rows = tuple(row for row in _product(factors, zipped) if _allowed(row, factors, nests))
        summary = f"{len(rows)} of {math.prod(len(f.levels) for f in factors)} combinations"
        return factors, Scheme("full", rows, summary, _told(zipped, nests))


def _told(zipped: Sequence[tuple[str, ...]], nests: Nests) -> tuple[str, ...]:
    """Say what zipped and nested factors cannot tell."""
    together = [
        f"{' and '.join(group)} change together: nothing tells their effects apart"
        for group in zipped
    ]
    within = [
        f"{child} is nested in {parent}: its levels are compared within one level of {parent}"
        for child, (parent, _) in nests.items()
    ]
    return (*together, *within)


def _product(factors: Sequence[Factor], zipped: Sequence[tuple[str, ...]]) -> list[tuple[int, ...]]:
    leader = {n: group[0] for group in zipped for n in group}
    free = [f for f in factors if leader.get(f.name, f.name) == f.name]
    rows = []
    for combination in itertools.product(*(range(len(f.levels)) for f in free)):
        index = dict(zip((f.name for f in free), combination, strict=True))
        rows.append(tuple(index[leader.get(f.name, f.name)] for f in factors))
    return rows


def _allowed(row: Sequence[int], factors: Sequence[Factor], nests: Nests) -> bool:
    labels = {f.name: f.labels[i] for f, i in zip(factors, row, strict=True)}
    return all(labels[child] in within[labels[parent]] for child, (parent, within) in nests.items())


def _zipped(factors: Sequence[Factor], value: object) -> tuple[tuple[str, ...], ...]:
    lists = isinstance(value, list) and bool(value) and isinstance(value[0], list)
    groups: list[tuple[str, ...]] = []
    by_name = {factor.name: factor for factor in factors}
    seen: set[str] = set()
    for group in value if isinstance(value, list) and lists else [value]:
        if not isinstance(group, list) or len(group) < 2:
            raise Bad(f"must list two or more factors, got {shown(group)}", 'zip = [["A", "B"]]')
        for key in group:
            if not isinstance(key, str) or key not in by_name:
                raise Bad(f"no factor {shown(key)}", nearest(str(key)[:80], by_name))
            if key in seen:
                raise Bad(f"{key!r} stands twice", "a factor is zipped once")
            seen.add(key)
        counts = {key: len(by_name[key].levels) for key in group}
        if len(set(counts.values())) > 1:
            words = ", ".join(f"{key} has {count}" for key, count in counts.items())
            raise Bad(f"needs equal numbers of levels: {words}", "level k goes with level k")
        groups.append(tuple(group))
    return tuple(groups)


def _nests(tables: Sequence[Nested], request: Request) -> Nests | None:
    """Nested factors; None where one is faulty."""
    faults = request.faults
    found: dict[str, tuple[str, Mapping[str, tuple[str, ...]]]] = {}
    sound = not request.is_faulty("nested")
    by_name = {factor.name: factor for factor in request.factors}
    for i, table in enumerate(tables):
        where, before = f"design.nested[{i}]", len(faults)
        known = partial(_known, by_name)
        child = (
            noted(known, table.factor, f"{where}.factor", faults)
            if is_known(table.factor)
            else None
        )
        parent = (
            noted(known, table.within, f"{where}.within", faults)
            if is_known(table.within)
            else None
        )
        if child is None or parent is None or not is_known(table.levels):
            sound = False
            continue
        if child == parent or child in found or parent in found:
            faults.add(f"{where}.within", f"{child!r} in {parent!r} is no single nesting")
        else:
            read = partial(_levels_within, by_name[child], by_name[parent])
            levels = noted(read, table.levels, f"{where}.levels", faults)
            found[child] = (parent, levels or {})
        sound = sound and len(faults) == before
    return found if sound else None


def _known(by_name: Mapping[str, Factor], value: object) -> str:
    label = name(value)
    if label not in by_name:
        raise Bad(f"no factor {shown(value)}", nearest(label, by_name))
    return label


def _levels_within(child: Factor, parent: Factor, value: object) -> Mapping[str, tuple[str, ...]]:
    """Labels of the child within each level of the parent: every one in exactly one."""
    if not isinstance(value, Mapping):
        raise Bad(f"must be a table, got {shown(value)}", "{ LEVEL = [..], LEVEL = [..] }")
    found: dict[str, tuple[str, ...]] = {}
    for label, items in value.items():
        if label not in parent.labels:
            raise Bad(f"no level {label!r} of {parent.name!r}", nearest(label, parent.labels))
        listed = items if isinstance(items, list) else [items]
        found[label] = tuple(known_level(item, child) for item in listed)
    flat = [label for labels in found.values() for label in labels]
    if sorted(flat) != sorted(child.labels) or set(found) != set(parent.labels):
        rule = f"each level of {child.name!r} must stand in one level of {parent.name!r}"
        raise Bad(rule, f"levels: {', '.join(child.labels)}")
    return found


@section
class Listed:
    """Exactly the treatments of a list, in its order.

    Parameters
    ----------
    treatments
        List of tables, each with one level of every factor.
    """

    treatments: _Cells
    kind: Literal["listed"] = "listed"

    def make(self, request: Request) -> Made:
        """Look up the levels of every treatment."""
        if self.treatments is None:
            return request.nothing
        factors = request.factors
        read = partial(_treatments, factors)
        rows = noted(read, self.treatments, "design.treatments", request.faults)
        if rows is None:
            return request.nothing
        count = math.prod(len(factor.levels) for factor in factors)
        note = (
            "only the listed cells are run: terms that they do not separate are named by the "
            "analysis"
        )
        summary = f"{len(rows)} listed of {count} combinations"
        return factors, Scheme(self.kind, rows, summary, (note,))


def _treatments(factors: Sequence[Factor], value: object) -> tuple[tuple[int, ...], ...]:
    if not isinstance(value, list) or not 2 <= len(value) <= MAX_CELLS:
        raise Bad(f"must list 2 to {MAX_CELLS} treatments, got {shown(value)}")
    rows = [_row(factors, item, i) for i, item in enumerate(value)]
    twice = next((row for i, row in enumerate(rows) if row in rows[:i]), None)
    if twice is not None:
        again = rows.index(twice) + 1
        raise Bad(f"treatment {again} stands twice", "the same simulation is no replicate")
    for f, column in zip(factors, zip(*rows, strict=True), strict=True):
        if len(set(column)) < len(f.levels):
            unused = next(lv for i, lv in enumerate(f.labels) if i not in column)
            raise Bad(f"no treatment has {f.name} = {unused!r}", "leave the level out")
    return tuple(rows)


def _row(factors: Sequence[Factor], item: object, index: int) -> tuple[int, ...]:
    given = flatten(item) if isinstance(item, Mapping) else {}
    missing = [f.name for f in factors if f.name not in given]
    extra = [key for key in given if key not in {f.name for f in factors}]
    if missing or extra:
        what = f"has no {missing[0]!r}" if missing else f"names no factor with {extra[0]!r}"
        rule = f"treatment {index + 1} {what}"
        raise Bad(rule, "each treatment gives one level of every factor")
    return tuple(f.labels.index(known_level(given[f.name], f)) for f in factors)
