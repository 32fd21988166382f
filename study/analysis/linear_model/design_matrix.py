"""Model matrices from structured terms: no formula, so a column name is never code.

A term is a tuple of factor names. Every factor enters with sum-to-zero contrasts, so that
Type III means what its definition says; a factor whose margin is missing from the model
(a nested factor) enters with one column per level, the rule of Chambers and Hastie,
*Statistical Models in S* (1992), section 2.4.1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from study.arrays import Array, Ints
from study.errors import Fault, InputError, nearest

Term = tuple[str, ...]
#: What a model is asked as: ``"full"``, the highest order of its terms, or its terms.
Model = str | int | Sequence[str | Sequence[str]]


@dataclass(frozen=True)
class Layout:
    """Which level of every factor each row has.

    Parameters
    ----------
    levels : mapping of str to tuple of str
        Labels of the levels of each factor, in order.
    codes : mapping of str to ndarray, shape (n,)
        Index of the level in each row.
    """

    levels: Mapping[str, tuple[str, ...]]
    codes: Mapping[str, Ints]

    @property
    def n(self) -> int:
        """Number of rows."""
        return int(next(iter(self.codes.values())).size)

    def take(self, rows: Ints) -> Layout:
        """Return the same layout for some of the rows."""
        return Layout(self.levels, {name: codes[rows] for name, codes in self.codes.items()})

    def cell(self, names: Sequence[str]) -> Ints:
        """Index of the combination of levels of ``names`` in each row (row-major)."""
        index = np.zeros(self.n, dtype=np.int64)
        for name in names:
            index = index * len(self.levels[name]) + self.codes[name]
        return index


@dataclass(frozen=True)
class ModelMatrix:
    """Columns of a linear model, with the term that each belongs to.

    Parameters
    ----------
    columns : ndarray, shape (n, p)
        The first column is the intercept.
    terms : tuple of Term
        Terms in order; the intercept is ``()``.
    blocks : tuple of slice
        Columns of each term.
    """

    columns: Array
    terms: tuple[Term, ...]
    blocks: tuple[slice, ...]

    def of(self, term: Term) -> slice:
        """Columns of one term."""
        return self.blocks[self.terms.index(term)]


def term_name(term: Term) -> str:
    """Return the printed name of a term.

    Parameters
    ----------
    term : tuple of str
        Names of its factors; empty for the intercept, whose name is empty too.

    Examples
    --------
    >>> term_name(("A", "B"))
    'A:B'
    """
    return ":".join(term)


def sum_contrasts(k: int) -> Array:
    """Sum-to-zero contrasts of ``k`` levels, shape (k, k-1): the last level is minus the rest.

    Parameters
    ----------
    k : int
        Number of levels, at least 2.
    """
    return np.vstack([np.eye(k - 1), -np.ones((1, k - 1))])


def terms_of(factors: Sequence[str], model: Model = "full") -> tuple[Term, ...]:
    """Terms of a model, main effects first.

    Parameters
    ----------
    factors : sequence of str
        Factor names.
    model : "full", int or sequence
        All terms, all up to k-way, or listed: ``"A"``, ``"A:B"`` or ``["A", "B"]``.

    Raises
    ------
    InputError
        For a term that names no factor.

    Examples
    --------
    >>> terms_of(["A", "B", "C"], 2)
    (('A',), ('B',), ('C',), ('A', 'B'), ('A', 'C'), ('B', 'C'))
    """
    if isinstance(model, str) and model == "full":
        model = len(factors)
    if isinstance(model, bool) or not isinstance(model, int | list | tuple):
        raise InputError(
            Fault("model", f"must be 'full', a whole number or a list of terms, got {model!r}")
        )
    if isinstance(model, int):
        if model < 1:
            raise InputError(Fault("model", f"the order of the terms must be >= 1, got {model}"))
        top = min(model, len(factors))
        return tuple(t for k in range(1, top + 1) for t in combinations(factors, k))
    terms = [_parse_term(item, factors) for item in model]
    return tuple(sorted(dict.fromkeys(terms), key=len))


def _parse_term(item: str | Sequence[str], factors: Sequence[str]) -> Term:
    if isinstance(item, str):
        names = [item] if item in factors else [part.strip() for part in item.split(":")]
    else:
        names = [str(part) for part in item]
    for name in names:
        if name not in factors:
            raise InputError(
                Fault(f"model term {item!r}", f"{name!r} is no factor", nearest(name, factors))
            )
    return tuple(name for name in factors if name in names)


def model_matrix(
    layout: Layout, terms: Sequence[Term], *, extra: Sequence[Term] = ()
) -> ModelMatrix:
    """Build the model matrix of an intercept, ``extra`` terms (blocks) and ``terms``.

    Parameters
    ----------
    layout : Layout
        Levels of the n rows.
    terms : sequence of Term
        Terms of the model, without the intercept.
    extra : sequence of Term, optional
        Terms that stand between the intercept and ``terms``.

    Returns
    -------
    ModelMatrix
        Columns of shape (n, p); they need not be independent.
    """
    order: list[Term] = [(), *extra, *terms]
    present = {frozenset(t) for t in order}
    parts = [_term_columns(layout, term, present) for term in order]
    edges = np.cumsum([0, *(part.shape[1] for part in parts)])
    blocks = tuple(slice(int(a), int(b)) for a, b in zip(edges[:-1], edges[1:], strict=True))
    return ModelMatrix(np.hstack(parts), tuple(order), blocks)


def nested_in(terms: Sequence[Term]) -> dict[str, tuple[str, ...]]:
    """Factors whose own margin is missing from the model, and the factors they are nested in.

    Parameters
    ----------
    terms : sequence of Term
        Terms of the model, without the intercept.

    Returns
    -------
    dict of str to tuple of str
        By the nested factor; factors whose parents are nested themselves are left out.

    Examples
    --------
    >>> nested_in([("mix",), ("mix", "specimen")])
    {'specimen': ('mix',)}
    """
    present = {frozenset(t) for t in terms}
    found: dict[str, tuple[str, ...]] = {}
    for term in sorted(terms, key=len):
        for name in term:
            parents = tuple(other for other in term if other != name)
            alone = any(name in t and not set(parents) & set(t) for t in present)
            if parents and frozenset(parents) in present and not alone:
                found.setdefault(name, parents)
    return {name: parents for name, parents in found.items() if not set(parents) & set(found)}


def number_within(layout: Layout, nested: Mapping[str, tuple[str, ...]]) -> Layout:
    """Return the layout with nested levels numbered within each combination of their parents.

    Labels that are unique over all parents (``s1`` to ``s12``) would leave most combinations
    empty, although each parent has its own full set.

    Parameters
    ----------
    layout : Layout
        Levels of all rows.
    nested : mapping of str to tuple of str
        Parents of each nested factor, as :func:`nested_in` gives them.
    """
    levels, codes = dict(layout.levels), dict(layout.codes)
    for name, parents in nested.items():
        parent = layout.cell(parents)
        code = np.zeros(layout.n, dtype=np.int64)
        for value in np.unique(parent):
            here = parent == value
            code[here] = np.unique(layout.codes[name][here], return_inverse=True)[1]
        if int(code.max()) + 1 < len(levels[name]):
            levels[name] = tuple(str(i + 1) for i in range(int(code.max()) + 1))
            codes[name] = code
    return Layout(levels, codes)


def _term_columns(layout: Layout, term: Term, present: set[frozenset[str]]) -> Array:
    columns = np.ones((layout.n, 1))
    for name in term:
        k = len(layout.levels[name])
        margin_present = frozenset(term) - {name} in present
        code = sum_contrasts(k) if margin_present else np.eye(k)
        coded = code[layout.codes[name]]
        columns = (columns[:, :, None] * coded[:, None, :]).reshape(layout.n, -1)
    return columns


def grid(layout: Layout, names: Sequence[str]) -> Layout:
    """Every combination of the levels of ``names`` once (row-major).

    Parameters
    ----------
    layout : Layout
        Its levels count, not its rows.
    names : sequence of str
        Factors; the levels of the last one change fastest.

    Returns
    -------
    Layout
        With one row a combination, and these factors alone.
    """
    combos = np.array(
        list(product(*(range(len(layout.levels[name])) for name in names))), dtype=np.int64
    ).reshape(-1, len(names))
    codes = {name: combos[:, i] for i, name in enumerate(names)}
    return Layout({name: layout.levels[name] for name in names}, codes)


def balanced(layout: Layout, names: Sequence[str]) -> bool:
    """Whether every combination of levels occurs, equally often.

    Parameters
    ----------
    layout : Layout
        Levels of all rows.
    names : sequence of str
        Factors, or blocks, whose levels are combined.
    """
    size = int(np.prod([len(layout.levels[name]) for name in names]))
    counts = np.bincount(layout.cell(names), minlength=size)
    return bool(counts.min() == counts.max())
