"""What missing responses could do to the conclusion: worst and best values in their place.

Failed cells are not missing at random: a model that does not converge may be the one that
would differ most. Every missing response is let vary between the lowest and the highest
observed one. A difference of two level means is linear in the missing values, so its extremes
lie where one level takes the highest and all others the lowest, and these are all tried.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from study.analysis.anova_table import Effect, FailureBound
from study.analysis.effects.verdict import CANNOT_TELL
from study.analysis.request import AnalysisRequest
from study.errors import StudyError

if TYPE_CHECKING:
    import pandas as pd

    from study.arrays import Array, Flags

_MOST_ROWS = 5000
_MOST_LEVELS = 60


def bounds(
    table: pd.DataFrame,
    request: AnalysisRequest,
    effects: Sequence[Effect],
    analyze: Callable[[pd.DataFrame], Sequence[Effect]],
) -> tuple[FailureBound, ...]:
    """Bounds of every effect over the values that the missing responses may take.

    Parameters
    ----------
    table : DataFrame
        Rows as given, the missing responses among them.
    request : AnalysisRequest
        Response, factors and size of the tests.
    effects : sequence of Effect
        Effects in the rows there are.
    analyze : callable
        The same analysis of a completed table.

    Returns
    -------
    tuple of FailureBound
        Empty where nothing is missing, or for tables too large to be analyzed many times.
    """
    response, factors = request.response, request.factors
    y = table[response].to_numpy(dtype=float, na_value=np.nan)
    missing = ~np.isfinite(y)
    levels = sum(table[f].nunique() for f in factors)
    if not missing.any() or missing.all() or len(table) > _MOST_ROWS or levels > _MOST_LEVELS:
        return ()
    low, high = float(y[~missing].min()), float(y[~missing].max())
    found: list[Sequence[Effect]] = []
    for filled in _fillings(table, factors, missing, low, high):
        completed = table.copy()
        completed[response] = np.where(missing, filled, y)
        try:
            found.append(analyze(completed))
        except StudyError:
            # a filling that makes copies of cells is no possible outcome
            continue
    if not found:
        return ()
    return tuple(_bound(e.term, [*effects], found, request.alpha) for e in found[0])


def _fillings(
    table: pd.DataFrame, factors: Sequence[str], missing: Flags, low: float, high: float
) -> Iterator[Array]:
    """Yield all highest, all lowest, and each level against the others, without repeats."""
    seen: set[bytes] = set()
    marks = [np.ones(len(table), dtype=bool)]
    for factor in factors:
        labels = table[factor].astype(str).to_numpy()
        marks += [labels == level for level in dict.fromkeys(labels[missing])]
    for mark in marks:
        for up in (mark, ~mark):
            key = up[missing].tobytes()
            if key not in seen:
                seen.add(key)
                yield np.where(up, high, low)


def _bound(
    term: str, now: Sequence[Effect], found: Sequence[Sequence[Effect]], alpha: float
) -> FailureBound:
    filled = [effect for effects in found for effect in effects if effect.term == term]
    every = [*(e for e in now if e.term == term), *filled]
    verdicts = tuple(dict.fromkeys(e.strength for e in every))
    sizes = [e.range for e in every if e.range is not None]
    p = [e.p for e in every if e.p is not None]
    significant = {value < alpha for value in p}
    # p never decides alone: where a verdict is given, it is the conclusion
    steady = verdicts != (CANNOT_TELL,) or (len(significant) < 2 and len(p) in (0, len(every)))
    return FailureBound(
        term,
        _lowest(filled, min(sizes, default=None)),
        max(sizes, default=None),
        verdicts,
        (min(p), max(p)) if p else None,
        len(verdicts) == 1 and steady,
    )


def _lowest(filled: Sequence[Effect], smallest: float | None) -> float | None:
    """Bound of the largest difference from below: that of the pair that can shrink least.

    Within a pair the difference may pass zero between two fillings; the smallest largest
    difference that was met would then promise too much.
    """
    if ":" in filled[0].term or any(m is None for e in filled for m in e.mean):
        return smallest
    ratio = filled[0].scale == "ratio"
    mean = np.array([e.mean for e in filled], dtype=float)
    mean = np.log(mean) if ratio else mean
    gaps = mean[:, :, None] - mean[:, None, :]
    least = np.maximum(gaps.min(axis=0), -gaps.max(axis=0)).max()
    least = max(0.0, float(least))
    return float(np.exp(least)) if ratio else least


def sentences(found: Sequence[FailureBound], missing: int) -> list[str]:
    """Give one sentence per conclusion that the missing responses could overturn.

    Parameters
    ----------
    found : sequence of FailureBound
        Bounds of every term, as :func:`bounds` gives them.
    missing : int
        Number of rows without a response.

    Returns
    -------
    list of str
        Where some conclusions cannot be overturned, a last sentence names their terms.
    """
    if not found:
        return []
    runs = f"{missing} missing response" + ("s" if missing > 1 else "")
    kept = [b.term for b in found if b.holds]
    # interactions have no verdict; one sentence serves them all
    open_ones = [b.term for b in found if not b.holds and ":" in b.term]
    out = [
        f"{b.term}: with the {runs} anywhere between the worst and the best observed value, its "
        f"largest difference lies between {b.low:.3g} and {b.high:.3g}{_why(b)}"
        for b in found
        if not b.holds and b.low is not None and b.high is not None and ":" not in b.term
    ]
    if open_ones:
        out.append(f"the {runs} could change what is seen of {', '.join(open_ones)}")
    if kept:
        out.append(f"the {runs} cannot overturn what is said of {', '.join(kept)}")
    return out


def _why(bound: FailureBound) -> str:
    firm = [v for v in bound.verdicts if v != CANNOT_TELL]
    parts = []
    if len(bound.verdicts) > 1:
        parts.append(f"the verdict '{firm[0]}' is not certain")
    if bound.p is not None:
        parts.append(f"p between {bound.p[0]:.2g} and {bound.p[1]:.2g}")
    return f" ({'; '.join(parts)})" if parts else ""
