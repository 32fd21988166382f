"""Designs without replicates: one-df contrasts, Lenth, half-normal, Tukey's one degree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from study.ground.arrays import Array, Ints, chunks
from study.ground.errors import RefusedError
from study.statistics.analysis.data import Data
from study.statistics.analysis.linear_model import (
    CellLayout,
    Factorization,
    Term,
    balanced,
    factorize,
    model_matrix,
    products,
    term_name,
    terms_of,
)
from study.statistics.analysis.sums_of_squares import Factored, TwoWayFit

if TYPE_CHECKING:
    import pandas as pd


def lenth_of(data: Data, y: Array, terms: Sequence[Term], seed: int) -> LenthResult:
    """Lenth's method on the one-df contrasts of an unreplicated factorial.

    In an orthogonal two-level design the values are the classical effects.

    Shapes: y (n,).
    """
    names, contrasts, is_orthogonal = saturated_contrasts(data, terms)
    is_orthogonal = is_orthogonal or balanced(data.layout, data.factors)
    values = contrasts.T @ (y - y[0])
    # what a deterministic model leaves of a contrast is rounding, and no scatter to judge by
    values[np.abs(values) <= ulp_floor(y) * np.sqrt(y.size)] = 0.0
    if is_orthogonal and all(len(data.layout.levels[f]) == 2 for f in data.factors):
        values = 2 * values / np.sqrt(y.size)
    return lenth(values, names, seed=seed)


def saturated_contrasts(data: Data, terms: Sequence[Term]) -> tuple[list[str], Array, bool]:
    """One-df orthonormal contrasts (n, m) that fill the space of the rows, one row a cell.

    A full grid gives the contrasts of all terms, a saturated orthogonal fraction those of the
    model. Of other rows (a lost run, blocks) they are what each term adds to the blocks and to the
    terms before it. The last value tells whether the terms are orthogonal.
    """
    is_full = balanced(data.layout, data.factors)
    every = terms_of(data.factors) if is_full else tuple(terms)
    if is_full and not data.blocks:
        return *orthonormal_contrasts(data.layout, every), True
    blocks: list[Term] = [(name,) for name in data.blocks]
    fit = factorize(model_matrix(data.layout, every, extra=blocks))
    if not data.blocks and fit.is_orthogonal():
        return *orthonormal_contrasts(data.layout, every), True
    return *added_contrasts(fit, every), False


def added_contrasts(fit: Factorization, terms: Sequence[Term]) -> tuple[list[str], Array]:
    """Orthonormal contrasts (n, m) of what each of some terms adds to those before it in a fit."""
    bases = {t: fit.space(i, "I").basis for i, t in enumerate(fit.matrix.terms) if t in terms}
    names = [
        f"{term_name(t)}[{i + 1}]" if basis.shape[1] > 1 else term_name(t)
        for t, basis in bases.items()
        for i in range(basis.shape[1])
    ]
    return names, fit.q @ np.hstack([*bases.values()])


@dataclass(frozen=True)
class LenthResult:
    """Lenth's pseudo standard error with simulated limits.

    ``values`` are the contrasts; ``p`` compares each with the simulated null distribution of
    contrast / PSE; ``me`` bounds one contrast, ``sme`` all of them together.
    """

    names: tuple[str, ...]
    values: tuple[float, ...]
    pse: float
    me: float
    sme: float
    p: tuple[float, ...]
    half_normal: tuple[float, ...]
    simulations: int
    seed: int

    @property
    def active(self) -> tuple[str, ...]:
        """Contrasts beyond the margin of error."""
        return tuple(n for n, v in zip(self.names, self.values, strict=True) if abs(v) > self.me)


@dataclass(frozen=True)
class NonAdditivityResult:
    """Tukey's one degree of freedom for non-additivity."""

    f: float | None
    df: tuple[int, int] | None
    p: float | None
    reason: str = ""


def pseudo_standard_error(contrasts: ArrayLike) -> Array:
    """Lenth's PSE along the last axis (Lenth 1989, Technometrics 31, 469-473, eq. 3).

    Shapes: contrasts (..., m); returns (...).
    """
    size = np.abs(np.asarray(contrasts, dtype=float))
    s0 = 1.5 * np.median(size, axis=-1, keepdims=True)
    inert = np.where(size < 2.5 * s0, size, np.nan)
    # a contrast vector of zeros keeps nothing: its PSE is zero
    empty = np.all(np.isnan(inert), axis=-1)
    inert[empty] = 0.0
    return np.asarray(1.5 * np.nanmedian(inert, axis=-1))


#: simulated studies without effects behind the limits
NULL_STUDIES = 20_000


@lru_cache(maxsize=32)
def _null(m: int, seed: int) -> tuple[Array, Array]:
    """Sorted null |contrast| / PSE, of one contrast and of the largest of ``m``."""
    rng = np.random.default_rng(seed)
    singles, largest = [], []
    for studies in chunks(NULL_STUDIES, 1e6 // m):
        z = rng.standard_normal((studies, m))
        ratio = np.abs(z) / pseudo_standard_error(z)[:, None]
        # contrasts of a row are exchangeable: all of them serve as draws of one
        singles.append(ratio.ravel())
        largest.append(ratio.max(axis=1))
    return np.sort(np.concatenate(singles)), np.sort(np.concatenate(largest))


def lenth(
    contrasts: ArrayLike, names: Sequence[str] | None = None, *, seed: int = 2011
) -> LenthResult:
    """Lenth's method with simulated critical values.

    Shapes: contrasts (m,).

    Notes
    -----
    The rule t(m/3) of the paper gives 2.0 % instead of 5 % at m = 7; here the limits are
    quantiles of simulated null contrasts.
    """
    from scipy.special import ndtri
    from scipy.stats import rankdata

    values = np.asarray(contrasts, dtype=float)
    m = values.size
    labels = tuple(names) if names is not None else tuple(str(i + 1) for i in range(m))
    pse = float(pseudo_standard_error(values))
    single, largest = _null(m, seed)
    if pse > 0:
        above = single.size - np.searchsorted(single, np.abs(values) / pse)
        p = (1 + above) / (single.size + 1)
    else:
        p = np.where(values == 0, 1.0, 1 / (single.size + 1))
    return LenthResult(
        labels,
        tuple(values.tolist()),
        pse,
        pse * float(np.quantile(single, 0.95)),
        pse * float(np.quantile(largest, 0.95)),
        tuple(np.asarray(p).tolist()),
        # half-normal scores Phi^-1(0.5 + 0.5 (r - 0.5)/m) of the absolute values (Daniel 1959)
        tuple(ndtri(0.5 + 0.5 * (rankdata(np.abs(values)) - 0.5) / m).tolist()),
        NULL_STUDIES,
        seed,
    )


def orthonormal_contrasts(layout: CellLayout, terms: Sequence[Term]) -> tuple[list[str], Array]:
    """One-df orthonormal contrasts of the terms of a full factorial with one row a cell.

    Shapes: returns (n, m).
    """
    names: list[str] = []
    for term in terms:
        parts = [range(1, len(layout.levels[factor])) for factor in term]
        tags = ([f"{f}[{i}]" if len(part) > 1 else f for i in part]
                for f, part in zip(term, parts, strict=True))  # fmt: skip
        names += map(term_name, product(*tags))
    factors = {name for term in terms for name in term}
    coded = {name: _one_df_contrasts(layout.levels[name]) for name in factors}
    columns = np.hstack([products(layout, {f: coded[f] for f in term}) for term in terms])
    return names, columns / np.linalg.norm(columns, axis=0)


def _one_df_contrasts(levels: Sequence[str]) -> Array:
    k = len(levels)
    try:
        x = np.array([float(level) for level in levels])
        powers = np.vander((x - x.mean()) / np.ptp(x), k, increasing=True)
    except ValueError:
        powers = np.tril(np.ones((k, k)))
    q, r = np.linalg.qr(powers)
    return np.asarray((q * np.sign(np.diag(r)))[:, 1:])


def non_additivity(fit: Factored | TwoWayFit) -> NonAdditivityResult:
    """Tukey's one-degree test (Tukey 1949, Biometrics 5, 232-242) of any additive fit."""
    if fit.df_residual < 2:
        return NonAdditivityResult(None, None, None, "needs two residual degrees of freedom")
    centered = fit.fitted - fit.fitted.mean()
    scale = float(np.abs(centered).max())
    if scale == 0:
        return NonAdditivityResult(None, None, None, "the fit is constant")
    square = (centered / scale) ** 2
    square = square - fit.projected(square)
    length = float(square @ square)
    if length < 1e-18 * square.size or fit.rss == 0:
        return NonAdditivityResult(None, None, None, "the model leaves no room for curvature")
    ss = float(square @ fit.residual) ** 2 / length
    df = fit.df_residual - 1
    rest = fit.rss - ss
    if rest <= 1e-14 * fit.rss:
        return NonAdditivityResult(None, None, None, "nothing is left beside the curvature")
    from scipy.special import fdtrc

    f = ss / (rest / df)
    return NonAdditivityResult(f, (1, df), float(fdtrc(1, df, f)))


def functional_shares(layout: CellLayout, factors: Sequence[str], y: Array) -> dict[str, float]:
    """Exact functional-ANOVA shares of a full factorial (Hooker 2007); they sum to one.

    Shapes: y (cells,).
    """
    shape = [len(layout.levels[name]) for name in factors]
    cube = (y - y[0]).reshape(shape)
    total = float(((cube - cube.mean()) ** 2).mean())
    components: dict[Term, Array] = {(): np.asarray(cube.mean()).reshape([1] * len(shape))}
    shares = {}
    for term in terms_of(factors):
        averaged = tuple(i for i, name in enumerate(factors) if name not in term)
        part = cube.mean(axis=averaged, keepdims=True)
        for lower, component in components.items():
            if set(lower) < set(term):
                part = part - component
        components[term] = part
        shares[term_name(term)] = float((part**2).mean()) / total if total > 0 else 0.0
    return shares


# -------------------------------------------------------------------------------------------------
# Copies that pose as replicates (refused) and cells that are one computation (grouped).

_ULPS = 16
_INSTEAD = (
    "A deterministic run repeated is the same run: it has no pure error, and a test against it "
    "would call everything significant. Instead: keep one run a cell and read the shares and "
    "effects (error source E7); or name measured specimens as blocks (--block, E1); or repeat "
    "with new meshes or new measured noise (E3, E2); or give the numerical uncertainty (E4)."
)

_LIKE_BLOCKS = (
    "in each cell every level of {!r} gives the same value, so nothing tells how much results "
    "vary from one to the next. Measurements that are copies or multiples of one another do that: "
    "keep one of them, and read the differences between cells beside their numerical uncertainty."
)


#: Groups of cells that agree in every block; the first of each group represents it.
Copies = tuple[tuple[int, ...], ...]


def ulp_floor(y: Array) -> float:
    """Spread below which doubles of this size are equal: 16 units in the last place."""
    return _ULPS * float(np.spacing(np.abs(y).max()))


def refuse_fake_replicates(
    data: Data, table: pd.DataFrame, *, records: bool, tolerance: float
) -> list[str]:
    """Refuse copies that pose as replicates; ties in some cells are only noted."""
    unit = data.cell if data.block is None else data.layout.cell([*data.factors, data.block])
    floor = max(10 * tolerance if records else 0.0, ulp_floor(data.y))
    if records and "input_hash" in table.columns:
        hashes = map(str, table["input_hash"].to_numpy(dtype=object)[data.rows])
        if len(set(zip(unit.tolist(), hashes, strict=True))) < unit.size:
            raise RefusedError(f"fake replicates: two runs of a cell have equal input. {_INSTEAD}")
    notes = _refuse_copies(
        unit,
        data.y,
        floor,
        "every run of a cell with two or more rows repeats the same value. " + _INSTEAD,
    )
    if data.block is not None:
        _refuse_copies(data.cell, data.y, floor, _LIKE_BLOCKS.format(data.block))
    return notes


def _refuse_copies(unit: Ints, y: Array, floor: float, rule: str) -> list[str]:
    _, index, counts = np.unique(unit, return_inverse=True, return_counts=True)
    repeated = counts >= 2
    if not repeated.any():
        return []
    high, low = np.full(counts.size, -np.inf), np.full(counts.size, np.inf)
    np.maximum.at(high, index, y)
    np.minimum.at(low, index, y)
    still = (high - low)[repeated] <= floor
    if still.all():
        raise RefusedError(f"fake replicates: {rule}")
    if still.any():
        return [f"{int(still.sum())} of {still.size} replicated cells have zero spread (ties)"]
    return []


def group_cells(y: Array, within: float) -> Copies:
    """Group cells that agree with the group's first cell in every block.

    Shapes: y (cells, blocks).
    """
    groups: list[list[int]] = []
    heads = np.empty_like(y)
    for cell, values in enumerate(y):
        # NaN compares false, so a missing run never makes a copy
        near = np.flatnonzero(np.abs(heads[: len(groups), 0] - values[0]) <= within)
        for block in range(1, y.shape[1]):
            if not near.size:
                break
            near = near[np.abs(heads[near, block] - values[block]) <= within]
        if near.size:
            groups[near[0]].append(cell)
        else:
            heads[len(groups)] = values
            groups.append([cell])
    return tuple(map(tuple, groups))


def copies_of(data: Data, within: float, *, computed: bool) -> Copies:
    """Cells that are one computation, judged on the raw response."""
    cells = np.unique(data.cell)
    blocks = 1 if data.block is None else len(data.layout.levels[data.block])
    if not computed and (data.block is None or blocks < 3):
        return tuple((int(c),) for c in cells)
    table = np.full((cells.size, blocks), np.nan)
    column = 0 if data.block is None else data.layout.codes[data.block]
    table[np.searchsorted(cells, data.cell), column] = data.y
    copies = group_cells(table, max(within, ulp_floor(data.y)))
    return tuple(tuple(cells[list(group)].tolist()) for group in copies)
