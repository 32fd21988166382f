"""The terms of the analysis: those asked for, or those that a design can tell."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping, Sequence
from functools import partial

import numpy as np

from study.design.diagnostics import Faults, noted
from study.design.layout.aliases import clear_order
from study.design.layout.optimal import model_columns
from study.design.sections.analysis import Analysis
from study.design.spec import Factor, Scheme
from study.design.study_file import AnalysisTable
from study.errors import nearest
from study.setup.quantity import integer, shown
from study.setup.section import Bad

MAX_TERMS = 1000
#: kinds of a design whose cells do not tell every term
_FRACTIONS = ("fractional", "plackett-burman", "d-optimal", "listed")

Model = str | int | tuple[str, ...]


def analysis_from(
    table: AnalysisTable,
    factors: Sequence[Factor],
    declared: Sequence[str],
    scheme: Scheme,
    faults: Faults,
) -> Analysis:
    """Complete ``[analysis]``: terms are names of factors, never code.

    Parameters
    ----------
    table : AnalysisTable
        As read.
    factors : sequence of Factor
        Of the design.
    declared : sequence of str
        Names of all factors of the file, the faulty ones too.
    scheme : Scheme
        Which combinations are run.
    faults : Faults
        Where faults go.
    """
    model = default_model(scheme, factors)
    if table.model is not None:
        read = partial(_model, declared)
        model = noted(read, table.model, "analysis.model", faults) or model
        if not faults:
            _check_told_apart(model, factors, scheme, faults)
    for name, _ in table.roles or ():
        if name not in declared:
            faults.add("analysis.roles", f"no factor {shown(name)}", nearest(name[:80], declared))
    if table.surface in ("quadratic", "emulator") and all(f.span is None for f in factors):
        mend = 'write one as { low = "28 mm", high = "32 mm" }'
        faults.add("analysis.surface", "no factor is a range", mend)
    if scheme.sequential is not None and table.surface in ("quadratic", "none"):
        rule = "an adaptive design adds cells where an emulator is unsure"
        faults.add("analysis.surface", rule, 'write surface = "emulator", or leave it out')
    for term in table.primary or ():
        noted(partial(_term, factors=declared), term, "analysis.primary", faults)
    return Analysis(
        model, table.type, table.error, table.alpha, table.roles or (), table.family,
        table.primary or (), table.surface or "auto", table.contrasts or (),
    )  # fmt: skip


def default_model(scheme: Scheme, factors: Sequence[Factor]) -> Model:
    """Terms that a design can tell, where the file does not ask for others.

    Parameters
    ----------
    scheme : Scheme
        Which combinations are run.
    factors : sequence of Factor
        All of the design, in the order of the scheme.

    Returns
    -------
    "full", int or tuple of str
        All interactions, the highest order of them, or the terms.
    """
    if scheme.kind == "full":
        terms = terms_of(scheme, factors)
        return "full" if terms is None else terms
    if scheme.terms:
        return scheme.terms
    if scheme.kind == "fractional":
        order = clear_order(scheme.resolution)
        return "full" if order is None else min(order, len(factors))
    return 1


def _model(factors: Sequence[str], value: object) -> Model:
    if value == "full":
        return "full"
    if isinstance(value, list):
        if not value or len(value) > MAX_TERMS:
            raise Bad(f"must list 1 to {MAX_TERMS} terms")
        return tuple(dict.fromkeys(_term(term, factors) for term in value))
    if isinstance(value, int) and not isinstance(value, bool):
        return integer(1, max(1, len(factors)))(value)
    raise Bad(f'must be "full", a number or a list of terms, got {shown(value)}')


def _term(value: object, factors: Sequence[str]) -> str:
    parts = [p.strip() for p in value.split(":")] if isinstance(value, str) else [value]
    named = [part for part in parts if isinstance(part, str) and part in factors]
    for part in parts:
        if part not in factors:
            raise Bad(f"no factor {shown(part)}", nearest(str(part)[:80], factors))
    if len(set(named)) < len(named):
        raise Bad(f"a factor stands twice in {shown(value)}")
    return ":".join(sorted(named, key=list(factors).index))


def _check_told_apart(
    model: Model, factors: Sequence[Factor], scheme: Scheme, faults: Faults
) -> None:
    """Refuse terms that no analysis of a fraction can tell apart.

    Each would be judged by what the others leave of it, which is nothing.
    """
    if scheme.rows is None or scheme.kind not in _FRACTIONS:
        return
    names = [factor.name for factor in factors]
    words = _words(model, names)
    runs = np.array(scheme.rows)
    columns = model_columns(runs, [len(factor.levels) for factor in factors], words)
    told, asked = int(np.linalg.matrix_rank(columns)) - 1, columns.shape[1] - 1
    if told == asked:
        return
    what = "terms" if asked == len(words) else "numbers"
    rule = f"asks for {asked} {what}, of which {len(runs)} cells tell {told} apart"
    usual = default_model(scheme, factors)
    aliased = f": {scheme.aliases[0]}" if scheme.aliases else ""
    faults.add("analysis.model", rule + aliased, f"leave it out (model = {usual}), or list terms")


def _words(model: Model, names: Sequence[str]) -> list[tuple[int, ...]]:
    """Factors of every term, by their number."""
    if isinstance(model, tuple):
        return [tuple(names.index(name) for name in term.split(":")) for term in model]
    highest = model if isinstance(model, int) else len(names)
    orders = range(1, min(highest, len(names)) + 1)
    return [word for order in orders for word in itertools.combinations(range(len(names)), order)]


def terms_of(scheme: Scheme, factors: Sequence[Factor]) -> tuple[str, ...] | None:
    """Terms of zipped and nested factors; None for a full factorial.

    Of zipped factors the first stands for all; a nested factor stands only beside its parent.

    Parameters
    ----------
    scheme : Scheme
        Which combinations are run.
    factors : sequence of Factor
        All of the design, in the order of the scheme.
    """
    if scheme.rows is None:
        return None
    columns = {f.name: c for f, c in zip(factors, zip(*scheme.rows, strict=True), strict=True)}
    kept: list[str] = []
    for factor in factors:
        if not any(_same(columns[factor.name], columns[other]) for other in kept):
            kept.append(factor.name)
    parents = _parents(kept, columns)
    terms = [
        term
        for order in range(1, len(kept) + 1)
        for term in itertools.combinations(kept, order)
        if all(parents[n] in term for n in term if n in parents)
    ]
    return tuple(":".join(term) for term in terms)


def _parents(names: Collection[str], columns: Mapping[str, Sequence[int]]) -> Mapping[str, str]:
    """Nested factor -> the factor that its level says the level of."""
    return {
        child: parent
        for child in names
        for parent in names
        if child != parent and _determines(columns[child], columns[parent])
    }


def _determines(column: Sequence[int], other: Sequence[int]) -> bool:
    """Whether the level of one factor says the level of another."""
    pairs = set(zip(column, other, strict=True))
    return len(pairs) == len(set(column))


def _same(column: Sequence[int], other: Sequence[int]) -> bool:
    return _determines(column, other) and _determines(other, column)
