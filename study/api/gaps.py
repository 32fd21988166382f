"""Levels that failed in some of their cells, and what can still be compared without them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from study.record import answered_often

if TYPE_CHECKING:
    import pandas as pd

    from study.design import Design

#: levels that a factor needs to be one
_FEWEST = 2

Cell = tuple[str, ...]


def without_gaps(
    design: Design,
    table: pd.DataFrame,
    response: str,
    factors: Sequence[str],
    block: str | None,
    model: Any,
) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """Rows of the levels between which every effect of the model can be estimated.

    A combination of levels that the model needs and that has no answer anywhere (an energy that
    is stretched beyond its ellipticity on every fine mesh) would leave not only its own effect
    but every other one without an estimate: an average over cells one of which is empty. The
    level with the largest share of its cells unanswered is then left out, and that is said,
    until nothing is missing or a factor would be down to one level.

    Parameters
    ----------
    table : DataFrame
        One row a case, as the analysis takes it.
    block : str or None
        Column of the blocks: a cell counts as answered where more than half of them answer.

    Returns
    -------
    table : DataFrame
    notes : tuple of str
        One sentence for every level left out.
    """
    from study.analysis.matrix import terms_of

    designed = _designed(design, factors)
    answered = _answered(table, response, factors, block)
    terms = [[factors.index(name) for name in term] for term in terms_of(factors, model)]
    notes = []
    while (worst := _worst(designed, answered, terms)) is not None:
        place, level = worst
        own = [cell for cell in designed if cell[place] == level]
        has = sum(cell in answered for cell in own)
        notes.append(
            f"{level} ({factors[place]}) has an answer in {has} of {len(own)} cells: it is left "
            "out of this analysis, whose effects need every combination of levels"
        )
        designed = [cell for cell in designed if cell[place] != level]
        table = table[table[factors[place]].astype(str) != level]
    return table, tuple(notes)


def _designed(design: Design, factors: Sequence[str]) -> list[Cell]:
    from study.design import treatments

    found = (tuple(str(t.levels[name]) for name in factors) for t in treatments(design))
    return list(dict.fromkeys(found))


def _answered(
    table: pd.DataFrame, response: str, factors: Sequence[str], block: str | None
) -> set[Cell]:
    known = table.dropna(subset=[response])
    if block is not None and len(known):
        known = known[answered_often(known, factors, block, table[block].nunique())]
    return {tuple(map(str, row)) for row in known[list(factors)].to_numpy()}


def _worst(
    designed: Sequence[Cell], answered: set[Cell], terms: Sequence[Sequence[int]]
) -> tuple[int, str] | None:
    """Level with most of its cells unanswered, of those that leave a combination empty."""
    known = [cell for cell in designed if cell in answered]
    shares: dict[tuple[int, str], float] = {}
    for term in terms:
        has = {tuple(cell[i] for i in term) for cell in known}
        for empty in {tuple(cell[i] for i in term) for cell in designed} - has:
            for place, level in zip(term, empty, strict=True):
                if len({cell[place] for cell in designed}) > _FEWEST:
                    own = [cell in answered for cell in designed if cell[place] == level]
                    shares[place, level] = 1 - sum(own) / len(own)
    return max(sorted(shares), key=lambda key: shares[key], default=None)
