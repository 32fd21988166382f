"""Further cells for a fraction that leaves a doubt: those that tell more terms apart."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from study.design.layout.optimal import d_optimal, efficiency
from study.design.layout.optimal_section import words_of
from study.design.load import load
from study.design.spec import Design
from study.errors import Fault, InputError
from study.setup.section import Bad

#: kinds of a design whose factors are samples of ranges, not levels
_SAMPLED = ("central-composite", "box-behnken", "latin-hypercube", "sobol", "adaptive")


@dataclass(frozen=True)
class Augmentation:
    """Cells to be run besides those of a design.

    Parameters
    ----------
    cells : tuple of mapping
        Level of every factor, by its label.
    own : tuple of mapping
        Cells of the design itself.
    terms : tuple of str
        What all cells together tell apart.
    before, after : float
        D-efficiency for these terms, 0 where some of them are one another.
    """

    cells: tuple[Mapping[str, str], ...]
    own: tuple[Mapping[str, str], ...]
    terms: tuple[str, ...]
    before: float
    after: float

    def to_json(self) -> dict[str, object]:
        """Document of ``study plan --augment --json``."""
        return {
            "cells": [dict(cell) for cell in self.cells],
            "terms": list(self.terms),
            "efficiency": {"before": self.before, "after": self.after},
            "design": self.table(),
        }

    def table(self) -> str:
        """Write the table ``[design]`` with all cells: records of those that are done are kept."""
        lines = [
            "    { " + ", ".join(f"{_key(k)} = {json.dumps(v)}" for k, v in cell.items()) + " },"
            for cell in (*self.own, *self.cells)
        ]
        return "\n".join(["[design]", 'kind = "listed"', "treatments = [", *lines, "]"])


def _key(name: str) -> str:
    return name if name.replace("_", "").replace("-", "").isalnum() else json.dumps(name)


def augment(
    design: Design | str | Path, cells: int, *, terms: int | Sequence[str] = 2
) -> Augmentation:
    """Choose further cells of a fraction by D-optimality.

    Parameters
    ----------
    design : Design, str or Path
        A design that runs fewer cells than combinations.
    cells : int
        How many more.
    terms : int or sequence of str
        What shall be told apart: the highest order of interaction, or terms such as ``"a:b"``.

    Returns
    -------
    Augmentation
        The cells, and how precise the terms are before and after.

    Raises
    ------
    InputError
        For a design that runs every combination or samples ranges, or too few cells.
    """
    loaded = design if isinstance(design, Design) else load(design)
    rows = loaded.scheme.rows
    factors = loaded.factors
    sizes = [len(factor.levels) for factor in factors]
    every = math.prod(sizes)
    if rows is None or loaded.scheme.kind == "full":
        rule = "runs every combination: there is no further cell"
        raise InputError(Fault("design", rule, "add a level or a factor"))
    if loaded.scheme.kind in _SAMPLED:
        rule = f"a {loaded.scheme.kind} design samples ranges"
        raise InputError(Fault("design.kind", rule, "ask it for more runs"))
    names = [factor.name for factor in factors]
    try:
        words = words_of(names, terms if isinstance(terms, int) else list(terms))
    except Bad as error:
        raise InputError(Fault("terms", error.rule, error.mend)) from None
    wanted = 1 + sum(math.prod(sizes[k] - 1 for k in word) for word in words)
    least = max(1, wanted - len(rows))
    if not least <= cells <= every - len(rows):
        rule = f"{cells} further cells, of which there are {every - len(rows)}"
        mend = f"{least} to {every - len(rows)}: {len(rows)} cells run, {wanted} numbers are asked"
        raise InputError(Fault("augment", rule, mend))
    found = d_optimal(sizes, words, cells, loaded.seed, rows)
    return Augmentation(
        tuple(_labels(names, loaded, row) for row in found),
        tuple(_labels(names, loaded, row) for row in rows),
        tuple(":".join(names[k] for k in word) for word in words),
        efficiency(rows, sizes, words),
        efficiency((*rows, *found), sizes, words),
    )


def _labels(names: Sequence[str], design: Design, row: Sequence[int]) -> dict[str, str]:
    labels = (factor.labels[k] for factor, k in zip(design.factors, row, strict=True))
    return dict(zip(names, labels, strict=True))
