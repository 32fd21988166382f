"""What a kind of ``[design]`` is given, and what it makes of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from study.arrays import Array
from study.design.diagnostics import Faults
from study.design.factors import levels_at
from study.design.spec import Factor, Scheme

#: factors with the levels that a design needs, and which combinations of them are run
Made = tuple[tuple[Factor, ...], Scheme]

MAX_CELLS = 4096


@dataclass(frozen=True)
class Request:
    """What a design is made of.

    Parameters
    ----------
    factors : tuple of Factor
        As listed; a range has its two ends as levels.
    seed : int
        Of the study, for designs that draw.
    faults : Faults
        Where faults go.
    """

    factors: tuple[Factor, ...]
    seed: int
    faults: Faults

    def fault(self, key: str, rule: str, mend: str = "") -> None:
        """Note a fault of a key of ``[design]``."""
        self.faults.add(f"design.{key}", rule, mend)

    def is_faulty(self, key: str) -> bool:
        """Whether a key of ``[design]`` has a fault, and is None for it."""
        return any(fault.where == f"design.{key}" for fault in self.faults)

    @property
    def nothing(self) -> Made:
        """What is made where a fault was found: the factors, for checks of their cells."""
        return self.factors, Scheme()


class Layout(Protocol):
    """One kind of ``[design]``: a section whose keys are those that the kind has."""

    def make(self, request: Request) -> Made:
        """Levels and combinations; anything where a fault is noted."""


def placed(request: Request, kind: str, shares: Array, summary: str, note: str) -> Made:
    """Levels and rows of a design given as shares of each range.

    Parameters
    ----------
    request : Request
        Factors; one with listed levels takes them in equal shares.
    kind : str
        Name of the design.
    shares : ndarray, shape (runs, factors)
        0 at the low and 1 at the high end.
    summary, note : str
        What it is, and what it cannot tell.
    """
    made, columns = [], []
    for factor, column in zip(request.factors, shares.T, strict=True):
        if factor.span is None:
            count = len(factor.levels)
            made.append(factor)
            columns.append([min(int(x * count), count - 1) for x in column])
            continue
        values, index = np.unique(np.round(column, 12), return_inverse=True)
        made.append(replace(factor, levels=levels_at(factor.name, factor.span, values.tolist())))
        columns.append(index.tolist())
    rows = tuple(zip(*columns, strict=True))
    if len(set(rows)) < len(rows):
        request.fault("runs", "two runs are the same cell", "use another seed or fewer")
    return tuple(made), Scheme(kind, rows, summary, (note,))
