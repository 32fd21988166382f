"""Claims held against the loss of one block: one that falls with it is fragile.

Blocks are left out one at a time, as in the jackknife (Efron and Tibshirani 1993, chapter 11).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from study.analysis.anova_table import Effect
from study.analysis.effects.verdict import MATTERS, NO_DIFFERENCE
from study.errors import StudyError

if TYPE_CHECKING:
    import pandas as pd

#: effects of some rows
Analysis = Callable[["pd.DataFrame"], Sequence[Effect]]

#: analyses that are made again at most
MOST_BLOCKS = 40
#: rows of a table whose analysis may be made that often
MOST_ROWS = 5000
#: two blocks are the least that an analysis needs, so that three are needed to leave one out
FEWEST_BLOCKS = 3


def without_each(
    table: pd.DataFrame,
    block: str,
    effects: Sequence[Effect],
    analyses: Sequence[Analysis],
) -> tuple[Effect, ...]:
    """Name the blocks without which a claim is not made.

    Parameters
    ----------
    table : DataFrame
        The rows that were analyzed.
    block : str
        Column of the blocks.
    effects : sequence of Effect
        Of all rows.
    analyses : sequence of callable
        Effects of other rows, by the same request: one that is made at once and claims no more
        than the next, which is asked only where that loses a claim; or the last alone.

    Returns
    -------
    tuple of Effect
        With ``lost_without``, which stays None for what claims nothing, and everywhere where
        blocks or rows are too few or too many.
    """
    labels = table[block].astype(str)
    names = list(dict.fromkeys(labels))
    claims = {e.term: e.verdict for e in effects if e.verdict in (MATTERS, NO_DIFFERENCE)}
    if not (claims and FEWEST_BLOCKS <= len(names) <= MOST_BLOCKS and len(table) <= MOST_ROWS):
        return tuple(effects)
    lost: dict[str, list[str]] = {term: [] for term in claims}
    for name in names:
        try:
            gone = _lost(claims, table[labels != name], analyses)
        except StudyError:
            return tuple(effects)  # the rest makes no analysis, so nothing is known
        for term in gone:
            lost[term].append(name)
    return tuple(
        replace(e, lost_without=tuple(lost[e.term])) if e.term in lost else e for e in effects
    )


def _lost(claims: Mapping[str, str], rows: pd.DataFrame, analyses: Sequence[Analysis]) -> list[str]:
    """Terms of which some rows do not make the claim, by the last analysis that has to be asked."""
    gone = list(claims)
    for analyze in analyses:
        found = {e.term: e.verdict for e in analyze(rows)}
        gone = [term for term in gone if found.get(term) != claims[term]]
        if not gone:
            break
    return gone
