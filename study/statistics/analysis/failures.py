"""Which cases fail, and whether their settings have to do with it.

Cases that fail are not missing at random where a setting makes them fail. Every factor is tested
for it, and a short list of rules says which settings they share.

The test is Fisher's exact test of a table of levels against failed and not failed, for more
than two levels as Freeman and Halton (1951, Biometrika 38, 141) extended it: p is the probability,
all margins given, of a table that is no more probable than the one found. It takes every case for
a draw of its own. The cases of a cell differ in their specimen or mesh alone, and mostly fail
together; where a cell has several, whole cells are therefore permuted among the levels (for
blocks: the failures within each cell), with the same statistic.

The rules are a decision list (Rivest 1987, Machine Learning 2, 229): each is the conjunction of at
most three settings, found by looking at all of them, that explains most of the failures that the
rules before it leave. A rule is taken if it saves more of the log-likelihood than it costs to name
it among all conjunctions as long, and to tell its share (minimum description length, Quinlan and
Rivest 1989, Information and Computation 80, 227).
"""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from study.ground.arrays import Array, Ints, chunks
from study.ground.errors import StudyError
from study.statistics.analysis.analysis_request import AnalysisRequest
from study.statistics.analysis.anova_table import Effect, FailureBound
from study.statistics.analysis.comparisons import holm
from study.statistics.analysis.simple_effects import CANNOT_TELL

if TYPE_CHECKING:
    import pandas as pd

    from study.ground.arrays import Flags


#: permutations, or random tables, of a p that is not computed exactly: its standard error at
#: 0.05 is 0.002
SAMPLES = 9_999
#: tables with the same margins that are listed for an exact p
MOST_TABLES = 500_000
#: entries of the permutations that are held at once
ENTRIES = 2_000_000
#: probabilities that differ by less are equal
TIE = 1e-7
#: settings that a rule may join, and rules that a reader can hold
LONGEST_RULE = 3
MOST_RULES = 4
#: a rule names where most cases fail, and more than one
LEAST_SHARE = 0.5
LEAST_FAILED = 2
#: letters of a message that name a cause
LONGEST_CAUSE = 120
_NUMBER = re.compile(r"(?<![A-Za-z])[-+]?\d[\d.]*(?:e[-+]?\d+)?")


@dataclass(frozen=True)
class CaseFate:
    """Settings of a case, and whether it failed."""

    levels: Mapping[str, str]
    #: Label of its block; empty without blocks.
    block: str
    failed: bool
    #: Word of how it failed; empty if it did not.
    cause: str = ""


@dataclass(frozen=True)
class FailureTest:
    """Whether failing has to do with one factor."""

    factor: str
    #: Failed cases and all cases of every level.
    counts: Mapping[str, tuple[int, int]]
    #: Raw, and adjusted for the number of factors.
    p: float
    p_holm: float
    method: str


@dataclass(frozen=True)
class FailureRule:
    """Settings under which most cases fail."""

    #: Level by factor; all of them together.
    settings: Mapping[str, str]
    #: Cases with these settings that no earlier rule holds for.
    failed: int
    total: int


@dataclass(frozen=True)
class FailurePattern:
    """What the failed cases of a study share."""

    failed: int
    total: int
    #: Failed cases by how they failed, the most frequent first.
    causes: Mapping[str, int]
    #: One a factor, the smallest p first; empty where all cases failed or none.
    tests: tuple[FailureTest, ...]
    #: In the order in which they are asked.
    rules: tuple[FailureRule, ...]
    #: Failed cases and all cases that no rule holds for.
    elsewhere: tuple[int, int]


def cause(status: str, message: str) -> str:
    """Name what many cases may have failed of: what was said first, with dots for its numbers.

    Examples
    --------
    >>> cause("not-converged", "stopped at 1.25 mm of 6 mm: no step was found; press less deep")
    'not-converged: stopped at … mm of … mm: no step was found'
    """
    first_words = _NUMBER.sub("…", re.split(r"\n|; ", message)[0]).strip()
    if len(first_words) > LONGEST_CAUSE:  # cut between words, and say that it is cut
        first_words = first_words[:LONGEST_CAUSE].rpartition(" ")[0].rstrip(" ,;:") + " …"
    return f"{status}: {first_words}" if first_words else status


def failure_pattern(
    cases: Sequence[CaseFate], block: str = "block", seed: int = 0
) -> FailurePattern:
    """Find what the failed cases of a study share.

    Examples
    --------
    >>> cases = [CaseFate({"plates": p}, str(k), p == "bonded") for p in ("bonded", "free")
    ...          for k in range(4)]
    >>> found = failure_pattern(cases)
    >>> dict(found.rules[0].settings), found.rules[0].failed, found.elsewhere
    ({'plates': 'bonded'}, 4, (0, 4))
    """
    failed = sum(case.failed for case in cases)
    causes = Counter(case.cause for case in cases if case.failed)
    rules, elsewhere = _rules(cases, block)
    tests = _tests(cases, block, seed) if 0 < failed < len(cases) else ()
    return FailurePattern(failed, len(cases), dict(causes.most_common()), tests, rules, elsewhere)


def _settings(case: CaseFate, block: str) -> dict[str, str]:
    """Levels of a case, its block among them."""
    return {**case.levels, **({block: case.block} if case.block else {})}


def _tests(cases: Sequence[CaseFate], block: str, seed: int) -> tuple[FailureTest, ...]:
    rng = np.random.default_rng(seed)
    settings = [_settings(case, block) for case in cases]
    failed = np.array([case.failed for case in cases], dtype=float)
    cells = _codes([tuple(sorted(case.levels.items())) for case in cases])
    tests = []
    for factor in settings[0]:
        labels = [levels.get(factor, "") for levels in settings]
        if len(set(labels)) > 1:
            is_block = factor not in cases[0].levels
            p, method = _p(failed, _codes(labels), cells, is_block, rng)
            total, bad = Counter(labels), Counter(itertools.compress(labels, failed))
            counts = {label: (bad[label], total[label]) for label in total}
            tests.append(FailureTest(factor, counts, p, p, method))
    adjusted = holm([test.p for test in tests])
    tests = [replace(test, p_holm=float(p)) for test, p in zip(tests, adjusted, strict=True)]
    return tuple(sorted(tests, key=lambda test: test.p))


def _codes(labels: Sequence[object]) -> Ints:
    """Give every label a number, in the order of first appearance."""
    number = {label: k for k, label in enumerate(dict.fromkeys(labels))}
    return np.array([number[label] for label in labels])


def _p(
    failed: Array, levels: Ints, cells: Ints, is_block: bool, rng: np.random.Generator
) -> tuple[float, str]:
    """Probability of a table as extreme as that of levels against failures, and its method."""
    if is_block:
        return _by_order(failed, levels, cells, rng), "permuted within cells"
    first = np.unique(cells, return_index=True)[1]
    independent = first.size == cells.size
    rows = levels if independent else cells
    bad, total = np.bincount(rows, failed).astype(float), np.bincount(rows).astype(float)
    if not independent:
        member, drawn_weights = np.eye(int(levels.max()) + 1)[levels[first]], []
        for count in chunks(SAMPLES, ENTRIES // first.size):  # as many as fit into memory
            order = rng.permuted(np.tile(np.arange(first.size), (count, 1)), axis=1)
            drawn_weights.append(_weight(bad[order] @ member, total[order] @ member))
        observed = _weight(bad @ member, total @ member)
        return _tail(observed, np.concatenate(drawn_weights)), "whole cells permuted"
    # exact wherever the tables can be listed
    if math.prod(int(n) + 1 for n in total[:-1]) <= MOST_TABLES:
        name = "Fisher" if total.size == 2 else "Freeman and Halton"
        return _freeman_halton(bad, total), f"{name}'s exact test"
    drawn = rng.multivariate_hypergeometric(total.astype(int), int(bad.sum()), size=SAMPLES)
    p = _tail(_weight(bad, total), _weight(drawn.astype(float), total))
    return p, f"Fisher's test by {SAMPLES:,} random tables"


def _freeman_halton(bad: Array, total: Array) -> float:
    """Probability of all tables with these margins that are no more probable than the one found."""
    inner = np.meshgrid(*(np.arange(int(n) + 1) for n in total[:-1]), indexing="ij")
    tables = np.stack([part.ravel() for part in inner], axis=1)
    last = bad.sum() - tables.sum(axis=1)
    possible = (last >= 0) & (last <= total[-1])
    listed = np.column_stack([tables[possible], last[possible]]).astype(np.float64)
    weight = _weight(listed, total)
    size = np.exp(weight - weight.max())
    return float(size[weight <= _weight(bad, total) + TIE].sum() / size.sum())


def _by_order(failed: Array, levels: Ints, cells: Ints, rng: np.random.Generator) -> float:
    """Permute the failures among the cases of each cell."""
    member = np.eye(int(levels.max()) + 1)[levels]
    total = member.sum(axis=0)
    drawn = np.zeros((SAMPLES, total.size))
    for cell in np.unique(cells[failed > 0]):  # where none failed there is nothing to permute
        of_cell = cells == cell
        shuffled = rng.permuted(np.tile(failed[of_cell], (SAMPLES, 1)), axis=1)
        drawn += shuffled @ member[of_cell]
    return _tail(_weight(failed @ member, total), _weight(drawn, total))


def _weight(bad: Array, total: Array) -> Array:
    """Logarithm of the probability of a table, but for a constant: sum of ln C(total, bad)."""
    from scipy.special import gammaln

    logs = gammaln(total + 1) - gammaln(bad + 1) - gammaln(total - bad + 1)
    return np.asarray(np.sum(logs, axis=-1))


def _tail(observed: Array, drawn: Array) -> float:
    """Share of tables no more probable than the one found, which counts itself."""
    return float((1 + np.sum(drawn <= observed + TIE)) / (1 + drawn.size))


def _rules(
    cases: Sequence[CaseFate], block: str
) -> tuple[tuple[FailureRule, ...], tuple[int, int]]:
    """Decision list of the failures, and what it leaves."""
    left = [(_settings(case, block), case.failed) for case in cases]
    rules: list[FailureRule] = []
    while len(rules) < MOST_RULES and any(f for _, f in left) and not all(f for _, f in left):
        best = max(_candidates(left), key=lambda candidate: candidate[0], default=None)
        if best is None or best[0] <= 0:
            break
        rules.append(best[1])
        settings = best[1].settings.items()
        left = [(levels, failed) for levels, failed in left if not settings <= levels.items()]
    return tuple(rules), (sum(f for _, f in left), len(left))


def _candidates(
    left: Sequence[tuple[Mapping[str, str], bool]],
) -> Iterator[tuple[float, FailureRule]]:
    """Every rule that could come next, with what it saves."""
    bad, total = sum(failed for _, failed in left), len(left)
    failures = Counter(rule for levels, failed in left if failed for rule in _conjunctions(levels))
    every = Counter(
        rule for levels, _ in left for rule in _conjunctions(levels) if rule in failures
    )
    names = _names([levels for levels, _ in left])
    whole = _information(bad, total)
    for rule, n in every.items():
        f = failures[rule]
        if f < LEAST_FAILED or f < LEAST_SHARE * n or f * total <= bad * n:
            continue
        saved = whole - _information(f, n) - _information(bad - f, total - n)
        # its name, and one more share to be told with the precision that so many cases give
        cost = math.log(names[len(rule)]) + math.log(total) / 2
        yield saved - cost, FailureRule(dict(rule), f, n)


def _conjunctions(settings: Mapping[str, str]) -> Iterator[tuple[tuple[str, str], ...]]:
    for size in range(1, LONGEST_RULE + 1):
        yield from itertools.combinations(settings.items(), size)


def _names(settings: Sequence[Mapping[str, str]]) -> dict[int, int]:
    """Count the conjunctions of every length that could be named."""
    levels = [len({case.get(factor) for case in settings}) for factor in settings[0]]
    lengths = range(1, LONGEST_RULE + 1)
    return {k: sum(map(math.prod, itertools.combinations(levels, k))) for k in lengths}


def _information(bad: int, total: int) -> float:
    """Negative log-likelihood of so many failures at the share that is most likely."""
    parts = [n * math.log(n / total) for n in (bad, total - bad) if n]
    return -sum(parts)


# -------------------------------------------------------------------------------------------------
# What missing responses could do to the conclusion: worst and best values in their place.
#
# Failed cells are not missing at random: a model that does not converge may be the one that
# would differ most. Every missing response is let vary between the lowest and the highest
# observed one. A difference of two level means is linear in the missing values, so its extremes
# lie where one level takes the highest and all others the lowest, and these are all tried.

_MOST_ROWS = 5000
_MOST_LEVELS = 60


def bounds(
    table: pd.DataFrame,
    request: AnalysisRequest,
    effects: Sequence[Effect],
    analyze: Callable[[pd.DataFrame], Sequence[Effect]],
) -> tuple[FailureBound, ...]:
    """Bounds of every effect over the values that the missing responses may take."""
    response, factors = request.response, request.factors
    y = table[response].to_numpy(dtype=float, na_value=np.nan)
    missing = ~np.isfinite(y)
    levels = sum(table[f].nunique() for f in factors)
    if not missing.any() or missing.all() or len(table) > _MOST_ROWS or levels > _MOST_LEVELS:
        return ()
    low, high = float(y[~missing].min()), float(y[~missing].max())
    filled_effects: list[Sequence[Effect]] = []
    for filled in _fillings(table, factors, missing, low, high):
        completed = table.copy()
        completed[response] = np.where(missing, filled, y)
        try:
            filled_effects.append(analyze(completed))
        except StudyError:
            # a filling that makes copies of cells is no possible outcome
            continue
    if not filled_effects:
        return ()
    analyzed = {e.term for e in effects}
    return tuple(
        _bound(e.term, effects, filled_effects, request.alpha)
        for e in filled_effects[0]
        if e.term in analyzed
    )


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
    term: str, now: Sequence[Effect], filled_effects: Sequence[Sequence[Effect]], alpha: float
) -> FailureBound:
    filled = [effect for effects in filled_effects for effect in effects if effect.term == term]
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


def shared_settings(table: pd.DataFrame, request: AnalysisRequest) -> list[str]:
    """Say in one sentence which settings the rows without a response share, if they do."""
    response, layout = request.response, request.layout
    names = [*request.factors, *layout.block, *([layout.unit] if layout.unit else [])]
    if len(table) > _MOST_ROWS:
        return []
    missing = ~np.isfinite(table[response].to_numpy(dtype=float, na_value=np.nan))
    labels = table[names].astype(str).to_numpy()
    rows = zip(labels, missing.tolist(), strict=True)
    fates = [CaseFate(dict(zip(names, levels, strict=True)), "", lost) for levels, lost in rows]
    rules, elsewhere = _rules(fates, "")
    places = [
        f"{' and '.join(f'{name} is {level}' for name, level in rule.settings.items())} "
        f"({rule.failed} of {rule.total} rows)"
        for rule in rules
        if len(rule.settings) > 1 or rule.failed < rule.total  # a lost level is named as such
    ]
    where = f"{response} is missing where {', or where '.join(places)}"
    return [f"{where}; elsewhere in {elsewhere[0]} of {elsewhere[1]} rows"] if places else []


def sentences(failure_bounds: Sequence[FailureBound], missing: int) -> list[str]:
    """Say in one sentence which conclusions the missing responses could overturn."""
    if not failure_bounds:
        return []
    runs = f"{missing} missing response" + ("s" if missing > 1 else "")
    # of a term without a p and a claim nothing is said that could be overturned
    certain = [b.term for b in failure_bounds if b.holds and (b.p or b.verdicts != (CANNOT_TELL,))]
    # interactions have no verdict; one sentence serves them all
    open_ones = [b.term for b in failure_bounds if not b.holds and ":" in b.term]
    out = [
        f"with the {runs} anywhere between the worst and the best observed value, the largest "
        f"difference of {b.term} lies between {b.low:.3g} and {b.high:.3g}{_why(b)}"
        for b in failure_bounds
        if not b.holds and b.low is not None and b.high is not None and ":" not in b.term
    ]
    if open_ones:
        out.append(f"the {runs} could change what is seen of {', '.join(open_ones)}")
    if certain:
        out.append(f"the {runs} cannot overturn what is said of {', '.join(certain)}")
    return ["; ".join(out)] if out else []


def _why(bound: FailureBound) -> str:
    firm = [v for v in bound.verdicts if v != CANNOT_TELL]
    parts = []
    if bound.can_change_verdict:
        printed = bound.verdicts[0] == firm[0]
        certain = "is not certain" if printed else "could be made"
        parts.append(f"the verdict '{firm[0]}' {certain}")
    if bound.p is not None:
        parts.append(f"p between {bound.p[0]:.2g} and {bound.p[1]:.2g}")
    return f" ({'; '.join(parts)})" if parts else ""
