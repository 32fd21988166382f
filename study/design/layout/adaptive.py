"""Kind ``adaptive`` of ``[design]``: a Latin hypercube, and cells that are added while it runs."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Literal

import numpy as np

from study.arrays import Array
from study.design.factors import levels_at
from study.design.layout import generators
from study.design.layout.request import Made, Request
from study.design.layout.samples import MAX_RUNS
from study.design.spec import Factor, Level, Scheme
from study.design.study_file import Sequential
from study.setup.quantity import integer, number, shown
from study.setup.section import Bad, Reads, section
from study.setup.text import choice

#: fewest cells at the beginning for each range: an emulator needs three
FEWEST = 3

_UNTIL = ("q2", "verdict")


def _added(value: object) -> tuple[tuple[float, ...], ...]:
    """Read cells that a run has added, as shares of every range."""
    if not isinstance(value, list):
        raise Bad(f"must be a list of cells, got {shown(value)}", "leave it to `study run`")
    share = number(0.0, 1.0, closed=True)
    return tuple(tuple(share(x) for x in (c if isinstance(c, list) else [c])) for c in value)


_Count = Annotated[int, Reads(integer(2, MAX_RUNS), mend="say how many, for example 32")]


@section
class Adaptive:
    """Cells that are chosen by what those before them have shown.

    Parameters
    ----------
    start : int
        Cells of the Latin hypercube that it begins with, equally many at every combination of
        the factors that are no ranges.
    budget : int
        Most cells in all.
    batch : int
        Cells added at a time; it decides the result, the number of workers does not.
    until : {"q2", "verdict"}
        What ends it before the budget does: every response has this Q2, or every factor a verdict.
    q2 : float
        Leave-one-out Q2 that is enough.
    seed : int, optional
        Of the draw; that of ``[study]`` by default.
    added : tuple of tuple of float
        Cells that a run has added: the share of every factor's range, in the order of the factors.
    """

    start: _Count
    budget: _Count
    kind: Literal["adaptive"] = "adaptive"
    batch: Annotated[int, Reads(integer(1, 100))] = 4
    until: Annotated[str, Reads(choice(*_UNTIL))] = "q2"
    q2: Annotated[float, Reads(number(0.5, 1.0))] = 0.95
    seed: Annotated[int | None, Reads(integer(0, 2**32 - 1))] = None
    added: Annotated[tuple[tuple[float, ...], ...], Reads(_added)] = ()

    def make(self, request: Request) -> Made:
        """Draw the first cells, and place those that were added."""
        factors = request.factors
        ranges = [factor for factor in factors if factor.span is not None]
        others = [len(factor.levels) for factor in factors if factor.span is None]
        if not self._fits(request, len(ranges), math.prod(others)):
            return request.nothing
        own = request.seed if self.seed is None else self.seed
        shares = _start(factors, self.start // math.prod(others), own)
        made, rows = _placed(factors, np.vstack([shares, *(np.array([c]) for c in self.added)]))
        if len(set(rows)) < len(rows):
            request.fault("added", "two cells are the same", "leave it to `study run`")
        settings = Sequential(self.start, self.batch, self.budget, self.until, self.q2, own)
        note = "cells are added where an emulator is least sure: see the surface"
        return made, Scheme(
            self.kind, rows, self._summary(own), (note,), sequential=settings
        )  # fmt: skip

    def _summary(self, seed: int) -> str:
        goal = (
            f"the leave-one-out Q2 of every response is {self.q2:g}"
            if self.until == "q2"
            else "every factor has a verdict"
        )
        more = f", {len(self.added)} cells were added" if self.added else ""
        return (
            f"Adaptive: {self.start} cells of a Latin hypercube (seed {seed}){more}; {self.batch} "
            f"at a time are added where the emulator is least sure, until {goal}, at most "
            f"{self.budget} cells"
        )

    def _fits(self, request: Request, ranges: int, others: int) -> bool:
        """Check the numbers of cells against each other and against the factors."""
        before = len(request.faults)
        if not ranges:
            mend = 'write one as { low = "28 mm", high = "32 mm" }'
            request.fault("kind", "no factor is a range to be filled", mend)
        known = None not in (self.start, self.budget, self.batch, self.added, self.until, self.q2)
        if not known or request.is_faulty("seed") or not ranges:
            return False
        least = FEWEST * ranges * others
        if self.start < least or self.start % others:
            whole = others * math.ceil(max(self.start, least) / others)
            rule = f"{self.start} cells do not carry an emulator of {ranges} ranges"
            if self.start >= least:
                rule = f"{self.start} cells cannot be shared by {others} combinations of levels"
            request.fault("start", rule, f"for example {whole}")
        if self.budget < self.start + len(self.added):
            rule = f"{self.budget} is less than the {self.start + len(self.added)} cells there are"
            request.fault("budget", rule, f"for example {2 * self.start}")
        if any(len(cell) != len(request.factors) for cell in self.added):
            rule = f"every cell needs a share of each of the {len(request.factors)} factors"
            request.fault("added", rule, "leave it to `study run`")
        return len(request.faults) == before


def _start(factors: Sequence[Factor], runs: int, seed: int) -> Array:
    """Shares of a Latin hypercube of its own at every combination of the listed levels."""
    ranged = [j for j, factor in enumerate(factors) if factor.span is not None]
    listed = [j for j, factor in enumerate(factors) if factor.span is None]
    parts = []
    combinations = itertools.product(*(range(len(factors[j].levels)) for j in listed))
    for number_of, combination in enumerate(combinations):
        part = np.empty((runs, len(factors)))
        part[:, ranged] = generators.latin_hypercube(len(ranged), runs, seed + number_of)
        for j, index in zip(listed, combination, strict=True):
            part[:, j] = share_of(index, len(factors[j].levels))
        parts.append(part)
    return np.vstack(parts)


def share_of(index: int, count: int) -> float:
    """Share that stands for one of some listed levels.

    Parameters
    ----------
    index : int
        Of the level, from 0.
    count : int
        Number of levels.

    Returns
    -------
    float
        Middle of the level's equal part of 0 to 1.

    Examples
    --------
    >>> share_of(0, 2), share_of(1, 2)
    (0.25, 0.75)
    """
    return (index + 0.5) / count


def _placed(
    factors: Sequence[Factor], shares: Array
) -> tuple[tuple[Factor, ...], tuple[tuple[int, ...], ...]]:
    """Levels of every factor and the rows of the cells.

    A level is written by its own share alone, so that a cell stays what it is when more are added.
    """
    made, columns = [], []
    for factor, column in zip(factors, shares.T, strict=True):
        if factor.span is None:
            count = len(factor.levels)
            made.append(factor)
            columns.append([min(int(x * count), count - 1) for x in column])
            continue
        levels: dict[str, Level] = {}
        labels = []
        for share in np.sort(column):
            (level,) = levels_at(factor.name, factor.span, (float(share),))
            levels.setdefault(level.label, level)
        for share in column:
            (level,) = levels_at(factor.name, factor.span, (float(share),))
            labels.append(level.label)
        places = {label: index for index, label in enumerate(levels)}
        made.append(replace(factor, levels=tuple(levels.values())))
        columns.append([places[label] for label in labels])
    return tuple(made), tuple(zip(*columns, strict=True))
