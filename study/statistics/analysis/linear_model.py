"""Model matrices from structured terms: a formula is read, never evaluated.

A term is a tuple of factor names. Every factor enters with sum-to-zero contrasts, so that
Type III means what its definition says; a factor whose margin is missing from the model
(a nested factor) enters with one column per level, the rule of Chambers and Hastie,
*Statistical Models in S* (1992), section 2.4.1.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations

import numpy as np
import scipy

from study.ground.arrays import Array, Flags, Ints
from study.ground.errors import Fault, InputError, nearest

Term = tuple[str, ...]
#: What a model is asked as: ``"full"``, the highest order of its terms, or its terms.
Model = str | int | Sequence[str | Sequence[str]]


@dataclass(frozen=True)
class CellLayout:
    """Which level of every factor each row has."""

    #: Labels of the levels of each factor, in order.
    levels: Mapping[str, tuple[str, ...]]
    #: shape (n,); index of the level in each row.
    codes: Mapping[str, Ints]

    @property
    def n(self) -> int:
        """Number of rows."""
        return int(next(iter(self.codes.values())).size)

    def take(self, rows: Ints) -> CellLayout:
        """Return the same layout for some of the rows."""
        return CellLayout(self.levels, {name: codes[rows] for name, codes in self.codes.items()})

    def labels(self, name: str) -> list[str]:
        """Level of a factor in each row."""
        return [self.levels[name][code] for code in self.codes[name]]

    def cell(self, names: Sequence[str]) -> Ints:
        """Index of the combination of levels of ``names`` in each row (row-major)."""
        index = np.zeros(self.n, dtype=np.int64)
        for name in names:
            index = index * len(self.levels[name]) + self.codes[name]
        return index


@dataclass(frozen=True)
class ModelMatrix:
    """Columns of a linear model, with the term that each belongs to."""

    #: shape (n, p); the first column is the intercept.
    columns: Array
    #: Terms in order; the intercept is ``()``.
    terms: tuple[Term, ...]
    blocks: tuple[slice, ...]
    #: Levels of the rows; none of columns without factors.
    layout: CellLayout = field(default_factory=lambda: CellLayout({}, {}))

    def of(self, term: Term) -> slice:
        """Columns of one term."""
        return self.blocks[self.terms.index(term)]


def term_name(term: Term) -> str:
    """Return the printed name of a term.

    Examples
    --------
    >>> term_name(("A", "B"))
    'A:B'
    """
    return ":".join(term)


def terms_of(factors: Sequence[str], model: Model = "full") -> tuple[Term, ...]:
    """Terms of a model, main effects first.

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


@dataclass(frozen=True)
class Formula:
    """A model as R writes it: ``log(len) ~ supp * dose + Error(subject)``."""

    response: str
    transform: str
    #: In the order in which they are named, and the terms of the model.
    factors: tuple[str, ...]
    terms: tuple[Term, ...]
    blocks: tuple[str, ...]
    #: Factors that are set once for a whole plot of a block: ``Error(block/variety)``.
    whole_plot: tuple[str, ...]

    @property
    def model(self) -> tuple[str, ...]:
        """Names of the terms; ``full`` alone where they are all that the factors allow."""
        every = {frozenset(term) for term in terms_of(self.factors)}
        full = {frozenset(term) for term in self.terms} == every
        return ("full",) if full else tuple(map(term_name, self.terms))


_STRATUM = re.compile(r"\+?\s*(?:Error\s*\(([^()]*)\)|\(\s*1\s*\|([^()]*)\))")
_NAME = re.compile(r"[^\W\d][\w.]*")
_POWER = re.compile(r"(?:\*\*|\^)\s*(\d+)")


def read_formula(text: str) -> Formula:
    """Read a formula: ``+ - : * / ^``, parentheses, ``log(response)``, ``Error(block)``, ``(1|b)``.

    Examples
    --------
    >>> read_formula("len ~ supp * dose").terms
    (('supp',), ('dose',), ('supp', 'dose'))
    >>> read_formula("log(y) ~ (a + b + c)^2 - b:c + Error(s/a)").whole_plot
    ('a',)
    """
    left, tilde, right = text.partition("~")
    response = left.strip().strip("`")
    transform = "none"
    if (logged := re.fullmatch(r"log\s*\((.*)\)", response)) is not None:
        response, transform = logged[1].strip().strip("`"), "log"
    if not tilde or not response:
        mend = "write 'response ~ factor * factor'"
        raise InputError(Fault("formula", f"cannot read {text!r}", mend))
    strata = [a or b for a, b in _STRATUM.findall(right)]
    outer = [part.split("/") for text in strata for part in text.replace(":", "/").split("+")]
    names = [[name.strip().strip("`") for name in part] for part in outer]
    terms = _terms_of_formula(_STRATUM.sub(" ", right).strip())
    factors = tuple(dict.fromkeys(name for term in terms for name in term))
    plots = tuple(name for part in names for name in part[1:] if name in factors)
    blocks = tuple(dict.fromkeys(part[0] for part in names))
    ordered = tuple(sorted(terms, key=len))
    return Formula(response, transform, factors, ordered, blocks, plots)


def _terms_of_formula(text: str) -> list[Term]:
    """List the terms of the right side of a formula: patsy reads it, nobody evaluates it."""
    from patsy import ModelDesc, PatsyError

    quoted: dict[str, str] = {}

    def placeholder(match: re.Match[str]) -> str:
        name = f"quoted_name_{len(quoted)}"
        quoted[name] = match[1]
        return name

    bare = re.sub(r"`([^`]+)`", placeholder, text)
    try:
        read = ModelDesc.from_formula(f"~ {bare.replace('^', '**')}").rhs_termlist
    except PatsyError as error:
        raise _unreadable(text) from error
    terms = [tuple(factor.name() for factor in term.factors) for term in read]
    names = {name for term in terms for name in term}
    if strange := [name for name in names if not _NAME.fullmatch(name)]:
        raise _unreadable(strange[0])
    if not names or any(not 1 <= int(order) <= len(names) for order in _POWER.findall(bare)):
        raise _unreadable(text)
    if () not in terms:
        rule = f"{text!r} leaves out the mean, which every model here has"
        mend = "leave '- 1' out: means and differences of the levels are the same without it"
        raise InputError(Fault("formula", rule, mend))
    return [tuple(quoted.get(name, name) for name in term) for term in terms if term]


def _unreadable(at: str) -> InputError:
    mend = "names, numbers and + - : * / ^ ( ) can be read; names with spaces in `backticks`"
    return InputError(Fault("formula", f"cannot read {at.strip()[:20] or '~'!r}", mend))


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
    layout: CellLayout, terms: Sequence[Term], *, extra: Sequence[Term] = ()
) -> ModelMatrix:
    """Build the model matrix (n, p) of an intercept, ``extra`` terms (blocks) and ``terms``."""
    order: list[Term] = [(), *extra, *terms]
    if layout.n >= _MANY_ROWS:  # each combination once, and then the rows that hold it
        names = list(dict.fromkeys(name for term in order for name in term))
        _, first, index = np.unique(layout.cell(names), return_index=True, return_inverse=True)
        if first.size < _MANY_ROWS:
            each = model_matrix(layout.take(first), terms, extra=extra)
            return replace(each, columns=each.columns[index], layout=layout)
    present = {frozenset(t) for t in order}
    parts = []
    for term in order:
        sizes = {name: len(layout.levels[name]) for name in term}
        coded = {name: _contrasts(k) if frozenset(term) - {name} in present else np.eye(k)
                 for name, k in sizes.items()}  # fmt: skip
        parts.append(products(layout, coded))
    edges = np.cumsum([0, *(part.shape[1] for part in parts)])
    blocks = tuple(slice(int(a), int(b)) for a, b in zip(edges[:-1], edges[1:], strict=True))
    return ModelMatrix(np.hstack(parts), tuple(order), blocks, layout)


def setting_rows(matrix: ModelMatrix, codes: Mapping[str, Ints], terms: Sequence[Term]) -> Array:
    """Combine the coefficients of some terms of a model at settings of its factors, shape (m, p).

    Factors without ``codes`` (m,) stand at their first level.
    """
    first, levels = np.zeros_like(next(iter(codes.values()))), matrix.layout.levels
    settings = CellLayout(levels, {name: codes.get(name, first) for name in levels})
    # the full list of terms decides how each factor is coded, so it is coded as in the fit
    local = model_matrix(settings, matrix.terms[1:])
    rows = np.zeros((first.size, matrix.columns.shape[1]))
    for term in terms:
        rows[:, matrix.of(term)] = local.columns[:, local.of(term)]
    return rows


def nested_in(terms: Sequence[Term]) -> dict[str, tuple[str, ...]]:
    """Factors whose own margin is missing from the model, and the factors they are nested in.

    Examples
    --------
    >>> nested_in([("mix",), ("mix", "specimen")])
    {'specimen': ('mix',)}
    """
    present = {frozenset(t) for t in terms}
    outer: dict[str, tuple[str, ...]] = {}
    for term in sorted(terms, key=len):
        for name in term:
            parents = tuple(other for other in term if other != name)
            alone = any(name in t and not set(parents) & set(t) for t in present)
            if parents and frozenset(parents) in present and not alone:
                outer.setdefault(name, parents)
    return outer


def number_within(layout: CellLayout, nested: Mapping[str, tuple[str, ...]]) -> CellLayout:
    """Return the layout with nested levels numbered within each combination of their parents.

    Labels that are unique over all parents (``s1`` to ``s12``) would leave most combinations
    empty, although each parent has its own full set.
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
    return CellLayout(levels, codes)


def _contrasts(levels: int) -> Array:
    """Sum-to-zero contrasts, shape (k, k - 1): the last level is minus the rest."""
    code = np.eye(levels)
    return code[:, :-1] - code[:, -1:]


def products(layout: CellLayout, coded: Mapping[str, Array]) -> Array:
    """Products of the columns of some factors, each coded by its levels, in every row."""
    columns = np.ones((layout.n, 1))
    for name, code in coded.items():
        here = code[layout.codes[name]]
        columns = (columns[:, :, None] * here[:, None, :]).reshape(layout.n, -1)
    return columns


def grid(layout: CellLayout, names: Sequence[str]) -> CellLayout:
    """Every combination of the levels of ``names`` once (row-major)."""
    levels = {name: layout.levels[name] for name in names}
    codes = np.indices([*map(len, levels.values())]).reshape(len(levels), -1)
    return CellLayout(levels, dict(zip(levels, codes, strict=True)))


def balanced(layout: CellLayout, names: Sequence[str]) -> bool:
    """Whether every combination of levels occurs, equally often."""
    size = int(np.prod([len(layout.levels[name]) for name in names]))
    counts = np.bincount(layout.cell(names), minlength=size)
    return bool(counts.min() == counts.max())


# -------------------------------------------------------------------------------------------------
# Orthogonal factorization of a model: decomposed once, whatever is asked of it afterwards.
#
# The columns are scaled to unit length and factored once, X = Q R; every later projection works
# on the small R. What a question needs beside it (the inverse, the space of a term) is kept.

# A unit column that keeps less than this length outside the others is aliased with them.
# Rounding leaves about 1e-15; an estimable column of a real design keeps more than 1e-4.
ALIAS_TOLERANCE = 1e-9
# entries of R below this are rounding of terms that are orthogonal
_ORTHOGONAL = 1e-13


@dataclass(frozen=True)
class TermSpace:
    """Orthonormal directions of one term given others, and what is lost to aliasing."""

    basis: Array
    nominal_df: int
    aliases: tuple[str, ...] = ()


@dataclass(frozen=True)
class Factorization:
    """Columns of a model as orthonormal columns times a small matrix."""

    matrix: ModelMatrix
    #: shape (n, r); orthonormal columns that span the model.
    q: Array
    #: shape (r, p); ``columns / scale = q @ r``.
    r: Array
    #: shape (p,); length of each column.
    scale: Array
    #: What is known of the terms by now.
    spaces: dict[tuple[str, int], TermSpace] = field(
        default_factory=dict, repr=False, compare=False, kw_only=True
    )

    @property
    def rank(self) -> int:
        """Rank of the model."""
        return int(self.r.shape[0])

    @property
    def df_residual(self) -> int:
        """Residual degrees of freedom."""
        return int(self.q.shape[0] - self.rank)

    @property
    def columns(self) -> Array:
        """Columns of the model, shape (n, p)."""
        return self.matrix.columns

    def projected(self, y: Array) -> Array:
        """Part of values that the model describes, shape (n,)."""
        return np.asarray(self.q @ (self.q.T @ y))

    @property
    def is_full(self) -> bool:
        """Whether no column depends on the others."""
        return self.rank == int(self.r.shape[1])

    @cached_property
    def is_triangular(self) -> bool:
        """Whether the first columns of ``q`` span the first columns of the model."""
        return self.is_full and bool(np.array_equal(self.r, np.triu(self.r)))

    @cached_property
    def leverage(self) -> Array:
        """Leverage of every row: the diagonal of the hat matrix, shape (n,)."""
        return np.asarray(np.einsum("ij,ij->i", self.q, self.q))

    @cached_property
    def inverse(self) -> Array:
        """Coefficients from coordinates along ``q``, of minimum norm, shape (p, r)."""
        exact = None
        if self.is_triangular and self.rank >= _MANY_COLUMNS and self._is_block_diagonal:
            exact = scipy.linalg.block_diag(*(_inverse(self.r[b, b]) for b in self.matrix.blocks))
        elif self.is_triangular:
            exact = _inverse(self.r)
        inverse = np.linalg.pinv(self.r, rcond=ALIAS_TOLERANCE) if exact is None else exact
        return np.asarray(inverse / self.scale[:, None])

    @cached_property
    def unscaled_covariance(self) -> Array:
        """(X'X)^+, shape (p, p)."""
        return np.asarray(self.inverse @ self.inverse.T)

    @cached_property
    def _estimable_basis(self) -> Array:
        _, s, vt = np.linalg.svd(self.r, full_matrices=False)
        return np.asarray(vt[s > ALIAS_TOLERANCE * s[0]])

    def estimable(self, rows: Array) -> Flags:
        """Whether each linear combination of coefficients can be estimated, shape (m,)."""
        if self.is_triangular:  # of full rank: every coefficient can
            return np.ones(len(rows), dtype=bool)
        scaled = rows / self.scale
        basis = self._estimable_basis
        outside = scaled - scaled @ basis.T @ basis
        size = np.maximum(np.linalg.norm(scaled, axis=1), 1e-300)
        return np.asarray(np.linalg.norm(outside, axis=1) <= 1e-8 * size)

    def space(self, i: int, kind: str) -> TermSpace:
        """Directions of term ``i`` given the terms that a type of sums of squares names."""
        if (kind, i) not in self.spaces:
            others = _others(self.matrix.terms, i, kind)
            basis = self._basis_of_full(i, others, kind) if self.is_triangular else None
            self.spaces[kind, i] = (
                self._space(i, others) if basis is None else TermSpace(basis, basis.shape[1])
            )
        return self.spaces[kind, i]

    @cached_property
    def _is_block_diagonal(self) -> bool:
        rest = np.abs(self.r)
        for block in self.matrix.blocks:
            rest[block, block] = 0.0
        return bool(rest.max(initial=0.0) < _ORTHOGONAL)

    def _basis_of_full(self, i: int, others: list[int], kind: str) -> Array:
        """Directions of a term where nothing is aliased, without factoring all columns again."""
        columns = self.matrix.blocks[i]
        if kind == "I" or self._is_block_diagonal:
            # no view of an identity, which would keep all of it for every term
            basis = np.zeros((self.rank, columns.stop - columns.start))
            basis[columns] = np.eye(basis.shape[1])
            return basis
        if kind == "III":
            # R^-1 R = 1: these rows of the inverse are orthogonal to the columns of all others
            rows = self.inverse[columns] * self.scale[columns, None]
            return np.asarray(np.linalg.qr((rows / np.linalg.norm(rows, axis=1)[:, None]).T)[0])
        blocks = [self.r[:, self.matrix.blocks[j]] for j in others]
        q = np.linalg.qr(np.hstack([*blocks, self.r[:, columns]]))[0]
        return np.asarray(q[:, q.shape[1] - (columns.stop - columns.start) :])

    def _space(self, i: int, others: list[int]) -> TermSpace:
        columns = self.r[:, self.matrix.blocks[i]]
        rest = np.hstack([self.r[:, self.matrix.blocks[j]] for j in others])
        basis = complement(rest, columns)
        nominal = int(span(columns).shape[1])
        aliases = self._aliases(i, others) if basis.shape[1] < nominal else ()
        return TermSpace(basis, nominal, aliases)

    def _aliases(self, i: int, others: list[int]) -> tuple[str, ...]:
        """Terms that hold, alone, a direction of term ``i``."""
        directions = span(self.r[:, self.matrix.blocks[i]])
        names = []
        for j in others:
            overlap = span(self.r[:, self.matrix.blocks[j]]).T @ directions
            if overlap.size and np.linalg.norm(overlap, 2) > 1 - 1e-9:
                names.append(term_name(self.matrix.terms[j]) or "mean")
        return tuple(names)

    def is_orthogonal(self) -> bool:
        """Whether the terms span orthogonal spaces, so that all types of sums agree."""
        gram = self.r.T @ self.r
        for block in self.matrix.blocks:
            gram[block, block] = 0.0
        return bool(np.abs(gram).max() < 1e-9)


def factorize(matrix: ModelMatrix) -> Factorization:
    """Factor the columns (n, p) of a model."""
    scale = np.linalg.norm(matrix.columns, axis=0)
    scale[scale == 0] = 1.0
    if (small := _factored_products(matrix)) is not None:
        return Factorization(matrix, small[0], small[1] / scale, scale)
    scaled = matrix.columns / scale
    cells = distinct_rows(scaled)
    q, r = np.linalg.qr(scaled if cells is None else cells.rows)
    inverse = _inverse(r) if r.shape[0] >= r.shape[1] else None
    # 1 / |R^-1| bounds the singular values: the norm of Frobenius is that of the largest or more
    if inverse is None or np.linalg.norm(inverse) * ALIAS_TOLERANCE * np.sqrt(r.shape[1]) >= 1:
        u, s, _ = np.linalg.svd(r)
        rank = int(np.count_nonzero(s > ALIAS_TOLERANCE * np.sqrt(r.shape[1])))
        if rank < r.shape[1]:
            q = q @ u[:, :rank]
            r = u[:, :rank].T @ r
    return Factorization(matrix, q if cells is None else cells.spread(q), r, scale)


# From this many columns on those of a complete layout are not factored together. A QR of 4,096
# runs of 8 x 8 x 8 x 8 takes 9 s, its products 0.3 s.
_MANY_COLUMNS = 200


def _factored_products(matrix: ModelMatrix) -> tuple[Array, Array] | None:
    """Factor many columns of a layout in which every combination is equally frequent.

    Its terms are orthogonal, and the columns of a term are products of those of its factors, whose
    small factors are multiplied; None of any other model.
    """
    layout, terms = matrix.layout, matrix.terms
    if not layout.codes or matrix.columns.shape[1] < _MANY_COLUMNS:
        return None
    present = {frozenset(term) for term in terms}
    names = list(dict.fromkeys(name for term in terms for name in term))
    nested = any(frozenset(term) - {name} not in present for term in terms for name in term)
    if nested or not balanced(layout, names):
        return None
    small = {name: np.linalg.qr(_contrasts(len(layout.levels[name]))) for name in names}
    q, r = np.empty(matrix.columns.shape), np.zeros(2 * matrix.columns.shape[1:])
    for term, block in zip(terms, matrix.blocks, strict=True):
        cells = math.prod(len(layout.levels[name]) for name in term)
        length = math.sqrt(layout.n / cells)
        q[:, block] = products(layout, {name: small[name][0] for name in term}) / length
        triangle = np.eye(1)
        for name in term:
            triangle = np.kron(triangle, small[name][1])
        r[block, block] = triangle * length
    return q, r


def factorize_columns(columns: Array) -> Factorization:
    """Factor columns without terms of factors, such as those of a polynomial; shape (n, p)."""
    return factorize(ModelMatrix(columns, ((),), (slice(0, columns.shape[1]),)))


def _inverse(r: Array) -> Array | None:
    """Inverse of an upper triangle; None where a number on its diagonal is zero."""
    inverse, info = scipy.linalg.lapack.dtrtri(r)
    return np.asarray(inverse) if info == 0 and np.isfinite(inverse).all() else None


def _others(terms: Sequence[Term], i: int, kind: str) -> list[int]:
    if kind == "I":
        return list(range(i))
    rest = [j for j in range(len(terms)) if j != i]
    if kind == "III":
        return rest
    return [j for j in rest if not set(terms[i]) < set(terms[j])]


def span(columns: Array) -> Array:
    """Orthonormal basis (r, rank) of columns (r, m)."""
    if columns.size == 0:
        return np.zeros((columns.shape[0], 0))
    cells = distinct_rows(columns)
    if cells is not None:
        return cells.spread(span(cells.rows))
    q, r, _ = scipy.linalg.qr(columns, mode="economic", pivoting=True)
    size = np.abs(np.diag(r))
    return np.asarray(q[:, : size.size][:, size > ALIAS_TOLERANCE * max(1.0, size[0])])


# From this many rows on a table is factored by its distinct rows. A QR of 100,000 x 100 takes
# 1.2 s, that of its 100 cells 1 ms; finding them takes 0.05 s.
_MANY_ROWS = 2000
# Fewest rows a cell, on average, for which that pays.
_FEWEST_A_CELL = 4


@dataclass(frozen=True)
class DistinctRows:
    """The distinct rows of a tall matrix, each weighted by the root of its number."""

    #: shape (cells, p); X'X of these is that of the whole matrix, so both have the same R.
    rows: Array
    #: shape (n,); distinct row of every row.
    index: Ints
    #: shape (cells,); root of the number of rows that are the same.
    weight: Array

    def spread(self, q: Array) -> Array:
        """Orthonormal columns of the whole matrix from those of the distinct rows."""
        return np.asarray((q / self.weight[:, None])[self.index])


def distinct_rows(columns: Array) -> DistinctRows | None:
    """Distinct rows of a tall matrix (n, p); None where there are few, or few that repeat."""
    n = columns.shape[0]
    if n < _MANY_ROWS:
        return None
    # rows that agree have the same product; that those of one product agree is checked
    product = columns @ np.random.default_rng(0).standard_normal(columns.shape[1])
    _, first, index, number = np.unique(
        product, return_index=True, return_inverse=True, return_counts=True
    )
    if first.size * _FEWEST_A_CELL > n or not np.array_equal(columns[first][index], columns):
        return None
    weight = np.sqrt(number.astype(float))
    return DistinctRows(columns[first] * weight[:, None], index, weight)


def complement(rest: Array, columns: Array) -> Array:
    """Orthonormal basis (r, df) of what columns (r, m) add to ``rest`` (r, k)."""
    base = span(rest)
    left = columns - base @ (base.T @ columns)
    left = left - base @ (base.T @ left)
    length = np.linalg.norm(columns, axis=0)
    length[length == 0] = 1.0
    return span(left / length)
