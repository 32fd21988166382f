"""Tests of terms and of lack of fit: against blocks, or against measured replicates."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations
from typing import Literal

import numpy as np

from study.ground.arrays import Array, Flags, Ints
from study.ground.canonical import Keyed
from study.ground.errors import Fault, RefusedError
from study.statistics.analysis.comparisons import all_contrasts, t_quantile, two_sided
from study.statistics.analysis.data import DISTINCT_ROWS
from study.statistics.analysis.linear_model import Factorization, complement, factorize_columns
from study.statistics.analysis.sums_of_squares import (
    FRatioTest,
    extra_sum,
    fitted,
    influence,
    over_blocks,
)
from study.statistics.surfaces.emulator import EffectRange, effect_ranges
from study.statistics.surfaces.surface_factors import Runs, box_points, change_together, some_runs

# A polynomial of second order in coded factors.


#: one column of the model: a product of at most two factors, given by their positions
Term = tuple[int, ...]


def label_of(term: Term, names: Sequence[str]) -> str:
    """Name of a term as it is printed: ``1``, ``time``, ``time^2`` or ``time:temp``."""
    square = len(term) > len(set(term))
    return f"{names[term[0]]}^2" if square else ":".join(names[j] for j in term) or "1"


def second_order(levels: Sequence[int]) -> tuple[Term, ...]:
    """Terms 1, x_j, x_j x_k and x_j^2; no square of a factor with two levels."""
    k = range(len(levels))
    return ((), *((j,) for j in k), *combinations(k, 2), *((j, j) for j in k if levels[j] > 2))


def model_matrix(terms: Sequence[Term], coded: Array) -> Array:
    """Columns of the terms, shape (n, terms), at coded points of shape (n, k)."""
    return np.column_stack([np.prod(coded[:, list(term)], axis=1) for term in terms])


@dataclass(frozen=True)
class QuadraticPolynomial:
    """Terms with their coefficients."""

    terms: tuple[Term, ...]
    #: shape (terms,); in the response's unit, for coded factors.
    coefficients: Array
    k: int

    def value(self, coded: Array) -> Array:
        """Values, shape (n,), at coded points of shape (n, k)."""
        return np.asarray(model_matrix(self.terms, coded) @ self.coefficients)

    def linear(self) -> Array:
        """Coefficients b of the linear terms, shape (k,)."""
        b = np.zeros(self.k)
        for term, c in zip(self.terms, self.coefficients, strict=True):
            if len(term) == 1:
                b[term] = c
        return b

    def quadratic(self) -> Array:
        """Symmetric matrix B, shape (k, k), of the second-order terms x'Bx."""
        matrix = np.zeros((self.k, self.k))
        for term, c in zip(self.terms, self.coefficients, strict=True):
            if len(term) == 2:
                matrix[term] += 0.5 * c
                matrix[term[::-1]] += 0.5 * c
        return matrix

    def gradient(self, coded: Array) -> Array:
        """Slopes b + 2Bx, shape (n, k), at coded points of shape (n, k)."""
        return np.asarray(self.linear() + 2.0 * coded @ self.quadratic())


# Least squares by QR, with the terms that the runs cannot tell apart, and leave-one-out errors.

#: share of the largest singular value below which a column adds nothing to those before it, and
#: coefficient below which a term is no part of an alias
ALIASED = 1e-8
#: a run with a leverage above this decides its own prediction and cannot be left out
SATURATED = 1.0 - 1e-9
#: part of the largest response within which responses are equal
AGREE = 1e-12


@dataclass(frozen=True)
class ModelColumns:
    """Columns of a model that the settings can tell, factorized once for every response.

    Columns of blocks, where there are any, stand behind those of the terms.
    """

    terms: tuple[Term, ...]
    #: Each term left out, and the sum of kept terms that it equals at these settings.
    aliases: tuple[tuple[Term, tuple[tuple[Term, float], ...]], ...]
    model: Factorization

    def coefficients(self, response: Array) -> Array:
        """Coefficients, shape (p,) or (p, m), of responses of shape (n,) or (n, m)."""
        return np.asarray(self.model.inverse @ (self.model.q.T @ response))

    def complement(self) -> Array:
        """Orthonormal columns, shape (n, n - p), of all that the model leaves open."""
        full = np.linalg.qr(self.model.q, mode="complete")[0]
        return np.asarray(full[:, self.model.rank :])

    def alone(self, which: Sequence[int]) -> Array:
        """Orthonormal columns, shape (n, len(which)), of terms beside all the other terms."""
        columns = self.model.columns
        return complement(np.delete(columns, which, axis=1), columns[:, list(which)])


def factorize(terms: Sequence[Term], coded: Array) -> ModelColumns:
    """Keep, in their order, the terms that the settings can tell. Shapes: coded (n, k)."""
    estimated: list[Term] = []
    left_out: list[Term] = []
    for term in terms:
        rank = np.linalg.matrix_rank(model_matrix([*estimated, term], coded), rtol=ALIASED)
        (estimated if rank > len(estimated) else left_out).append(term)
    columns = ModelColumns(tuple(estimated), (), factorize_columns(model_matrix(estimated, coded)))
    aliases = []
    for term in left_out:
        weights = columns.coefficients(model_matrix([term], coded)[:, 0])
        sums = ((t, float(w)) for t, w in zip(estimated, weights, strict=True) if abs(w) > ALIASED)
        aliases.append((term, tuple(sums)))
    return replace(columns, aliases=tuple(aliases))


@dataclass(frozen=True)
class LeaveOneOut:
    """Errors of predicting each run from all the others."""

    #: Root mean square and largest absolute error, in the response's unit.
    rms: float
    largest: float
    #: 1 - PRESS/SS about the mean: 1 is perfect, 0 no better than the mean.
    q2: float
    #: shape (n,); responses, and responses minus predictions; NaN where a run is saturated.
    observed: Array = field(compare=False, repr=False)
    errors: Array = field(compare=False, repr=False)


def leave_one_out(columns: ModelColumns, response: Array) -> LeaveOneOut | None:
    """Leave-one-out errors e/(1 - h) of a response of shape (n,); None if none can be told."""
    of_rows = influence(fitted(columns.model, response))
    free = of_rows.leverage < SATURATED
    if not free.any():
        return None
    every = np.where(free, of_rows.press, np.nan)
    errors = every[free]
    spread = float(((response[free] - response.mean()) ** 2).sum())
    q2 = 1.0 - float((errors**2).sum()) / spread if spread > 0 else float("nan")
    rms = float(np.sqrt(np.mean(errors**2)))
    largest = float(np.abs(errors).max())
    return LeaveOneOut(rms, largest, q2, response, every)


#: part of the response's size below which a spread between blocks is rounding
ROUNDING = 1e-12


def against_blocks(columns: Array, response: Array) -> FRatioTest | None:
    """Test columns against their own interaction with the blocks (Greenhouse and Geisser 1959)."""
    # Shapes: columns (n, k); response (n, b).
    parts = columns.T @ response  # (k, b): what every block says of each column
    if min(parts.shape[0], parts.shape[1] - 1) < 1:
        return None
    return over_blocks(parts, (ROUNDING * float(np.abs(response).max())) ** 2)


def lack_of_fit(columns: ModelColumns, response: Array, which: Ints) -> FRatioTest | None:
    """Classical test of the model against pure error (Montgomery 2017, section 11.2)."""
    # Shapes: response (n,); which (n,).
    counts = np.bincount(which)
    means = np.bincount(which, weights=response) / counts
    pure = float(((response - means[which]) ** 2).sum())
    residual = fitted(columns.model, response).rss
    df, df_pure = counts.size - columns.model.rank, response.size - counts.size
    return extra_sum(residual - pure, df, pure, df_pure)


# Where the surface is level, and what it is there (canonical analysis).

#: an eigenvalue below this part of the largest makes a ridge: the point slides along it
RIDGE = 0.05
#: points of the box at which the confidence region is asked for
SEARCHED = 4096

Kind = Literal["maximum", "minimum", "saddle", "ridge"]
Error = Literal["none", "blocks", "replicates"]


@dataclass(frozen=True)
class StationaryPoint:
    """Point with gradient zero."""

    #: {"maximum", "minimum", "saddle", "ridge"}: by the signs of the eigenvalues; a ridge if one is
    #: below 5 % of the largest.
    kind: Kind
    #: shape (k,); coded settings.
    at: Array
    value: float
    #: shape (k,); of B, in the response's unit, in ascending order.
    eigenvalues: Array
    #: shape (k, k); one column an eigenvalue, in coded factors.
    eigenvectors: Array
    #: Whether it lies in the box.
    inside: bool
    #: Where it may be; None without enough blocks.
    region: Region | None = None

    @property
    def established(self) -> bool:
        """Whether it is known to lie in the box: its region is bounded by it."""
        return self.inside and self.region is not None and not self.region.leaves


@dataclass(frozen=True)
class Region:
    """95 % confidence region of the stationary point, as far as it lies in the box."""

    #: shape (k,); its extent in coded factors; NaN if no point of the box belongs to it.
    low: Array
    high: Array
    #: Whether it reaches the boundary of the box, and may go on beyond it.
    leaves: bool


def stationary_point(surface: QuadraticPolynomial) -> StationaryPoint | None:
    """Canonical analysis of a surface (Box and Wilson 1951)."""
    matrix = surface.quadratic()
    eigenvalues, vectors = np.linalg.eigh(matrix)
    smallest, largest = (float(end) for end in np.sort(np.abs(eigenvalues))[[0, -1]])
    if largest == 0 or smallest < 1e-12 * largest:
        return None
    kind: Kind = "maximum" if eigenvalues.max() < 0 else "minimum"
    if eigenvalues.min() < 0 < eigenvalues.max():
        kind = "saddle"
    kind = "ridge" if smallest < RIDGE * largest else kind
    at: Array = np.asarray(-0.5 * np.linalg.solve(matrix, surface.linear()), dtype=np.float64)
    inside = bool(np.abs(at).max() <= 1.0)
    value = float(surface.value(at[None, :])[0])
    return StationaryPoint(kind, at, value, eigenvalues, vectors, inside)


def level_at(surface: QuadraticPolynomial, covariance: Array, limit: float, coded: Array) -> Flags:
    """Whether the gradient may be zero at coded points: those whose T is below a limit.

    With the error of the residual it is that of Box and Hunter (1954, Biometrika 41, 190-199), of
    the gradients of blocks Hotelling's.

    Shapes: covariance (p, p) of the coefficients of the terms; coded (n, k); returns (n,).
    """
    units = [replace(surface, coefficients=row) for row in np.eye(len(surface.terms))]
    slopes = np.stack([unit.gradient(coded) for unit in units], axis=-1)  # (n, k, p)
    gradient = slopes @ surface.coefficients
    spread = slopes @ covariance @ slopes.transpose(0, 2, 1)
    t2 = np.einsum("ni,nij,nj->n", gradient, np.linalg.pinv(spread), gradient)
    return np.asarray(t2 <= limit**2)


# A quadratic surface fitted to runs, and what may be said of it.

#: smallest Q2 at which effects are carried by a quadratic
CARRIED = 0.8
#: fewest runs beside those that the coefficients take: with one, 7 to 10 % of pure noise has a Q2
#: of .8 and more, with two 1 to 3 %
SPARE = 2
#: p of the lack of fit below which a quadratic carries none
UNFIT = 0.05
#: coded distance beyond which a stationary point is not given in units: a logarithm overflows
FAR = 100.0
#: share of the settings that blocks may have in common where each holds a part of the design:
#: blocks that share more are crossed with the settings, and differ in more than a constant
SHARED = 0.5


@dataclass(frozen=True)
class SurfaceTerm(Keyed):
    """A coefficient of a coded term; interval and p only where there is an error to judge by."""

    KEYS = "term coefficient ci95=interval p"

    term: str
    coefficient: float
    interval: tuple[float, float] | None = None
    p: float | None = None


@dataclass(frozen=True)
class QuadraticSurface(Keyed):
    """A fitted surface."""

    KEYS = (
        "error terms factor_tests aliases loo_rms=loo.rms loo_max=loo.largest q2 lack_of_fit "
        "stationary=where_level"
    )

    runs: Runs
    polynomial: QuadraticPolynomial
    #: The same with intervals and p.
    terms: tuple[SurfaceTerm, ...]
    #: With blocks: all terms of a factor together.
    factor_tests: dict[str, FRatioTest]
    #: {"none", "blocks", "replicates"}: what tests rest on: nothing (a deterministic surface),
    #: blocks or replicates.
    error: Error
    #: Leave-one-out errors; None where no run can be left out.
    loo: LeaveOneOut | None
    #: What the model leaves open, against blocks or pure error.
    lack_of_fit: FRatioTest | None
    #: None where the surface is level nowhere.
    stationary: StationaryPoint | None
    #: Terms that the settings cannot tell from others.
    aliases: tuple[str, ...]
    notes: tuple[str, ...]
    #: shape (terms, terms); of the coefficients, by the blocks or by the residual, with its degrees
    #: of freedom; None where nothing is left over.
    covariance: Array | None = None
    df: int = 0
    #: What the terms of each alias may add to the surface; zero at every run.
    mixed: tuple[QuadraticPolynomial, ...] = ()

    def ranges(self, practical: float | None, u: float = 0.0) -> tuple[EffectRange, ...] | None:
        """Range along every factor; None where the surface carries no effects.

        The bound is twice the largest leave-one-out error of a deterministic surface, else that of
        Scheffe over all differences along the factor (with few blocks: Bonferroni).
        """
        unfit = self.lack_of_fit is not None and self.lack_of_fit.p < UNFIT
        if self.covariance is None or self.loo is None or unfit:
            return None
        if self.error == "none" and not self.carries:
            return None
        bounds = [
            u + (2.0 * self.loo.largest if self.error == "none" else self._scatter(j))
            for j in range(self.polynomial.k)
        ]
        for added in self.mixed:
            along = effect_ranges(added.value, self.runs, [0.0] * added.k, None, 0.0)
            bounds = [bound + reach.value for bound, reach in zip(bounds, along, strict=True)]
        return effect_ranges(self.value, self.runs, bounds, practical, u)

    def _scatter(self, j: int) -> float:
        """Half width of every difference of two settings of one factor together."""
        covariance = np.asarray(self.covariance)
        of_factor = [i for i, term in enumerate(self.polynomial.terms) if j in term]
        p, spread = len(of_factor), covariance[np.ix_(of_factor, of_factor)]
        points = box_points(self.polynomial.k, 256)
        steps = np.linspace(-1.0, 1.0, 5)
        along = np.repeat(points[None], steps.size, axis=0)
        along[:, :, j] = steps[:, None]
        rows = np.stack(
            [model_matrix([self.polynomial.terms[i] for i in of_factor], x) for x in along]
        )
        largest = max(
            float(np.sqrt(np.einsum("ni,ij,nj->n", d, spread, d).max()))
            for a, b in combinations(range(steps.size), 2)
            for d in [rows[a] - rows[b]]
        )
        multiplier = all_contrasts(p, self.df, 0.05, by_block=self.error == "blocks")
        if multiplier is not None:
            return largest * multiplier
        # none of 3,000 ranges over 2 or 3 normal blocks went beyond: the largest error serves all
        return largest * t_quantile(0.025 / len(points), self.df)

    @property
    def where_level(self) -> dict[str, object] | None:
        """Where it is level and where that may be, in the units of the factors too."""
        point, settings = self.stationary, self.runs.settings
        if point is None:
            return None
        region = point.region
        if region is not None and not np.isfinite(region.low).all():
            region = None
        return {
            "kind": point.kind,
            "at": settings(point.at) if np.abs(point.at).max() < FAR else None,
            "coded": point.at, "value": point.value,
            "eigenvalues": point.eigenvalues, "eigenvectors": point.eigenvectors.T,
            "inside": point.inside, "established": point.established,
            "region": region and {
                "low": settings(region.low), "high": settings(region.high),
                "leaves_the_box": region.leaves,
            },
        }  # fmt: skip

    @property
    def q2(self) -> float:
        """Leave-one-out Q2; NaN where no run can be left out."""
        return float("nan") if self.loo is None else self.loo.q2

    @property
    def carries(self) -> bool:
        """Whether left-out runs are predicted well enough for effects and a best setting."""
        return self.q2 >= CARRIED and (self.error == "blocks" or self.df >= SPARE)

    @property
    def half_width(self) -> float:
        """Twice the rms leave-one-out error, in the response's unit; NaN if it is not known."""
        return float("nan") if self.loo is None else 2.0 * self.loo.rms

    def value(self, coded: Array) -> Array:
        """Predictions, shape (n,), at coded points of shape (n, k)."""
        return self.polynomial.value(coded)

    def predict(self, coded: Array) -> tuple[Array, Array]:
        """Predictions and half widths of their intervals, shape (n,) each, at coded points."""
        values = self.value(coded)
        mixed = sum((np.abs(added.value(coded)) for added in self.mixed), np.zeros(len(values)))
        return values, self.half_width + mixed


def fit_quadratic(runs: Runs) -> QuadraticSurface:
    """Fit a quadratic surface."""
    if np.ptp(runs.response) <= AGREE * float(np.abs(runs.response).max()):
        rule = f"the response {runs.name!r} is the same in every run"
        raise RefusedError(str(Fault("quadratic", rule, "there is nothing to explain")))
    settings, which = runs.distinct()
    names = list(dict.fromkeys(runs.blocks))
    block = [names.index(b) for b in runs.blocks] or [0] * runs.size
    cell = np.column_stack([which, block])
    rows = np.column_stack([cell, runs.response])
    _, first, times = np.unique(rows, axis=0, return_index=True, return_counts=True)
    copies = int(np.gcd.reduce(times))
    # without scatter in its cells, runs are counted once below
    if copies > 1 and DISTINCT_ROWS <= first.size > len(np.unique(cell, axis=0)):
        once = fit_quadratic(some_runs(runs, np.isin(np.arange(runs.size), first)))
        note = f"each run stands {copies} times ({first.size} distinct of {runs.size}): counts once"
        return replace(once, notes=(note, *once.notes))
    if len(names) > 1:
        return _with_blocks(runs)
    means = np.bincount(which, weights=runs.response) / np.bincount(which)
    scatter = float(np.abs(runs.response - means[which]).max())
    if scatter > AGREE * float(np.abs(runs.response).max()):
        return _with_replicates(runs, which)
    # copies of a deterministic run are one run: counted twice, they would only weigh more
    single = replace(runs, coded=settings, response=means, blocks=(), u_num=None)
    columns = factorize(second_order(single.levels()), settings)
    copies = runs.response.size - means.size
    notes = [
        "no p: repeats agree to rounding: a deterministic surface has misfit, not noise"
        if copies
        else "no p: each setting was run once, which tells no noise from misfit of the surface"
    ]
    notes += [f"{copies} copies of deterministic runs count once"] if copies else []
    return _surface(runs, columns, means, "none", notes=notes)


def _with_replicates(
    runs: Runs, which: Ints, columns: ModelColumns | None = None
) -> QuadraticSurface:
    columns = columns or factorize(second_order(runs.levels()), runs.coded)
    fit = lack_of_fit(columns, runs.response, which)
    notes = []
    if fit is not None and fit.p < UNFIT:
        notes.append(
            "lack of fit: p and intervals of the terms rest on a surface that does not fit"
        )
    return _surface(runs, columns, runs.response, "replicates", lack=fit, notes=notes)


def _with_blocks(runs: Runs) -> QuadraticSurface:
    settings, which = runs.distinct()
    names = tuple(dict.fromkeys(runs.blocks))
    rows = np.array([names.index(b) for b in runs.blocks])
    counts = np.zeros((len(settings), len(names)))
    sums = np.zeros_like(counts)
    np.add.at(counts, (which, rows), 1.0)
    np.add.at(sums, (which, rows), runs.response)
    whole: Flags = np.asarray((counts > 0).all(axis=0))
    if whole.sum() < 2:
        if float(((counts > 0).sum(axis=1) > 1).mean()) > SHARED:
            rule = "fewer than two blocks have a run at every setting"
            mend = "complete the blocks, or leave --block out"
            raise RefusedError(str(Fault("blocks", rule, mend)))
        cells = np.unique(which * len(names) + rows, return_inverse=True)[1]
        return _shifted_by_blocks(runs, rows, cells)
    complete = [name for name, is_whole in zip(names, whole, strict=True) if is_whole]
    lost = [name for name in names if name not in complete]
    notes = [f"left out, with settings that lack a run: {', '.join(lost)}"] if lost else []
    table = sums[:, whole] / counts[:, whole]
    columns = factorize(second_order(runs.levels()), settings)
    # a copy says nothing of how blocks scatter
    shape, near = table - table.mean(axis=0), AGREE * float(np.abs(table).max())
    apart = np.abs(shape[:, :, None] - shape[:, None, :]).max(axis=0)
    like = np.argmax(apart <= near, axis=1)
    if copied := [b for b, first in enumerate(like) if first < b]:
        listed = ", ".join(f"{complete[b]} is {complete[like[b]]}" for b in copied[:5])
        notes.append(f"blocks that are equal but for a shift count once: {listed}")
        table = table[:, np.unique(like)]
    if table.shape[1] < 2:
        notes.append("no p: blocks without scatter have misfit, not noise")
        single = replace(runs, coded=settings, response=table[:, 0], blocks=(), u_num=None)
        return _surface(single, columns, table[:, 0], "none", notes=notes)
    each = columns.coefficients(table)
    blocks = each.shape[1]
    if blocks <= len(runs.factors):
        notes.append("no region of the stationary point: it needs more blocks than factors")
    surface = _surface(
        runs, columns, table.mean(axis=1), "blocks",
        lack=against_blocks(columns.complement(), table), notes=notes,
        of_blocks=(np.atleast_2d(np.cov(each)) / blocks, blocks - 1),
    )  # fmt: skip
    tests: dict[str, FRatioTest] = {}
    for j, name in enumerate(runs.names):
        of_factor = [i for i, term in enumerate(columns.terms) if j in term]
        test = against_blocks(columns.alone(of_factor), table)
        tests |= {} if test is None else {name: test}
    return replace(surface, factor_tests=tests)


def _shifted_by_blocks(runs: Runs, block: Ints, which: Ints) -> QuadraticSurface:
    """Blocks with different settings shift the response (Box and Hunter 1957, section 8).

    Shapes: block, which (n,): block, and setting within the block, of each run.
    """
    terms = factorize(second_order(runs.levels()), runs.coded)
    shift = np.eye(int(block.max()) + 1)[block]
    model = factorize_columns(np.hstack([terms.model.columns, shift[:, :-1] - shift[:, -1:]]))
    if not model.is_full:
        rule = "no two have a run at every setting, and the settings do not tell their shifts"
        mend = "complete the blocks, or leave --block out"
        raise RefusedError(str(Fault("blocks", rule, mend)))
    surface = _with_replicates(runs, which, replace(terms, model=model))
    note = "blocks hold different settings: each shifts the response by a constant"
    return replace(surface, notes=(note, *surface.notes))


def _region(point: StationaryPoint, level: Callable[[Array], Flags]) -> Region:
    """Part of the box in which points, shape (n, k), may be level."""
    k = point.at.size
    points = np.vstack([box_points(k, SEARCHED), np.clip(point.at, -1, 1)])
    inside = points[level(points)]
    nowhere = np.full(k, np.nan)
    low, high = (inside.min(axis=0), inside.max(axis=0)) if len(inside) else (nowhere, nowhere)
    faces = [np.array(points) for _ in range(2 * k)]
    for side, face in enumerate(faces):
        face[:, side // 2] = -1.0 if side % 2 else 1.0
    return Region(low, high, any(bool(level(face).any()) for face in faces))


def _surface(
    runs: Runs,
    columns: ModelColumns,
    response: Array,
    error: Error,
    *,
    lack: FRatioTest | None = None,
    notes: list[str],
    of_blocks: tuple[Array, int] | None = None,
) -> QuadraticSurface:
    """Surface of a response with the errors of its residual, or of blocks with their df."""
    count = len(columns.terms)
    polynomial = QuadraticPolynomial(
        columns.terms, columns.coefficients(response)[:count], len(runs.factors)
    )
    loo = leave_one_out(columns, response)
    linear = [n for n, count in zip(runs.names, runs.levels(), strict=True) if count == 2]
    lines = [f"{name} has two settings: linear only" for name in linear]
    together = change_together(runs)
    if together:
        lines.append(
            f"{', '.join(together[:-1])} and {together[-1]} change together in every run: what one "
            "does is not told from the others, and nothing is known where they change alone"
        )
    if loo is None:
        lines.append("as many coefficients as runs: no error of the surface can be told; add runs")
    elif not loo.q2 >= CARRIED:
        lines.append(f"Q2 {loo.q2:.2f} is below .8: effects are not carried by a quadratic")
    elif error != "blocks" and response.size - columns.model.rank < SPARE:
        lines.append(
            f"one run more than coefficients: a Q2 of {loo.q2:.2f} may be chance; add runs"
        )
    # a stationary point needs every square
    squares = sum(len(term) > len(set(term)) for term in columns.terms)
    point = stationary_point(polynomial) if squares == polynomial.k else None
    covariance, df = of_blocks or (None, response.size - columns.model.rank)
    if of_blocks is None and df > 0:
        # misfit below rounding moves nothing: what scatters least stands for it
        residual = max(
            fitted(columns.model, response).rss,
            df * (ROUNDING * float(np.abs(response).max())) ** 2,
        )
        covariance = columns.model.unscaled_covariance[:count, :count] * residual / df
    if point is not None and covariance is not None:
        limit = all_contrasts(polynomial.k, df, 0.05, by_block=error == "blocks")
        if limit is not None:
            level = partial(level_at, polynomial, covariance, limit)
            point = replace(point, region=_region(point, level))
    label = {term: label_of(term, runs.names) for term in second_order(runs.levels())}
    coefficients = polynomial.coefficients.tolist()
    terms = [SurfaceTerm(label[t], c) for t, c in zip(columns.terms, coefficients, strict=True)]
    if covariance is not None and error != "none":
        t = t_quantile(0.025, df)
        for i, se in enumerate(np.sqrt(np.diag(covariance)).tolist()):
            c = coefficients[i]
            p = two_sided(c / se, df) if se > 0 else None
            terms[i] = replace(terms[i], interval=(c - t * se, c + t * se), p=p)
    aliases, mixed = [], []
    for term, parts in columns.aliases:
        sums = [label[x] if abs(w - 1) < 1e-9 else f"{w:.3g} {label[x]}" for x, w in parts]
        aliases.append(f"{label[term]} = {' + '.join(sums)}")
        mixed.append(
            _mixed(term, parts, dict(zip(columns.terms, terms, strict=True)), polynomial.k)
        )
    return QuadraticSurface(
        runs, polynomial, tuple(terms), {}, error, loo, lack, point,
        tuple(aliases), (*notes, *lines), covariance, df, tuple(mixed),
    )  # fmt: skip


def _mixed(
    term: Term, parts: Sequence[tuple[Term, float]], estimates: Mapping[Term, SurfaceTerm], k: int
) -> QuadraticPolynomial:
    """Return what a term left out adds where it is as large as the largest term it is mixed with.

    The estimated terms lose what the term takes from them, so that nothing changes at the runs.
    """
    mixed = [estimates[t] for t, _ in parts if t]
    large = [max(map(abs, e.interval or (e.coefficient,))) for e in mixed]
    weights = np.array([1.0, *(-w for _, w in parts)])
    return QuadraticPolynomial((term, *(t for t, _ in parts)), max(large, default=0.0) * weights, k)
