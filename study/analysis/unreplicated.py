"""Designs without replicates: one-df contrasts, Lenth, half-normal, Tukey's one degree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from study.analysis.data import Data
from study.analysis.linear_model.design_matrix import Layout, Term, balanced, term_name, terms_of
from study.analysis.linear_model.sums_of_squares import Factored
from study.analysis.linear_model.two_way import TwoWayFit
from study.arrays import Array
from study.canonical import plain


def lenth_of(data: Data, y: Array, terms: Sequence[Term], seed: int) -> LenthResult:
    """Lenth's method on the one-df contrasts of an unreplicated factorial.

    In a two-level design the values are the classical effects. A full grid gives the contrasts
    of all terms; of a saturated fraction the terms of the model fill the space.

    Parameters
    ----------
    data : Data
        One row in every cell of the full grid, or of a saturated fraction.
    y : ndarray, shape (n,)
        Response on the working scale.
    terms : sequence of Term
        Terms of the model, which count for a fraction only.
    seed : int
        Seed of the simulated limits.
    """
    every = terms_of(data.factors) if balanced(data.layout, data.factors) else tuple(terms)
    names, contrasts = orthonormal_contrasts(data.layout, every)
    values = contrasts.T @ (y - y[0])
    if all(len(data.layout.levels[f]) == 2 for f in data.factors):
        values = 2 * values / np.sqrt(y.size)
    return lenth(values, names, seed=seed)


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

    def to_json(self) -> dict[str, object]:
        """JSON document."""
        return dict(plain(self))

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

    Parameters
    ----------
    contrasts : array_like, shape (..., m)
        Sets of m contrasts of equal variance.

    Returns
    -------
    ndarray, shape (...)
        In the unit of the contrasts; 0 where all of them are 0.
    """
    size = np.abs(np.asarray(contrasts, dtype=float))
    s0 = 1.5 * np.median(size, axis=-1, keepdims=True)
    kept = np.where(size < 2.5 * s0, size, np.nan)
    # a contrast vector of zeros keeps nothing: its PSE is zero
    empty = np.all(np.isnan(kept), axis=-1)
    kept[empty] = 0.0
    return np.asarray(1.5 * np.nanmedian(kept, axis=-1))


@lru_cache(maxsize=32)
def _null(m: int, simulations: int, seed: int) -> tuple[Array, Array]:
    """Sorted null |contrast| / PSE, of one contrast and of the largest of ``m``."""
    rng = np.random.default_rng(seed)
    chunk = max(1, int(1e6 // m))
    singles, largest = [], []
    for start in range(0, simulations, chunk):
        z = rng.standard_normal((min(chunk, simulations - start), m))
        ratio = np.abs(z) / pseudo_standard_error(z)[:, None]
        # contrasts of a row are exchangeable: all of them serve as draws of one
        singles.append(ratio.ravel())
        largest.append(ratio.max(axis=1))
    return np.sort(np.concatenate(singles)), np.sort(np.concatenate(largest))


def lenth(
    contrasts: ArrayLike,
    names: Sequence[str] | None = None,
    *,
    alpha: float = 0.05,
    seed: int = 2011,
    simulations: int = 20_000,
) -> LenthResult:
    """Lenth's method with simulated critical values.

    Parameters
    ----------
    contrasts : array_like, shape (m,)
        Contrasts of equal variance (orthonormal, or the effects of a two-level design).
    names : sequence of str, optional
        Their names; by default their numbers from 1.
    alpha : float
        Error probability of ``me`` for each contrast, and of ``sme`` for all m together.
    seed : int
        Seed of the simulation.
    simulations : int
        Number of simulated sets of m contrasts.

    Notes
    -----
    The rule t(m/3) of the paper gives 2.0 % instead of 5 % at m = 7; here the limits are
    quantiles of simulated null contrasts.
    """
    values = np.asarray(contrasts, dtype=float)
    m = values.size
    labels = tuple(names) if names is not None else tuple(str(i + 1) for i in range(m))
    pse = float(pseudo_standard_error(values))
    single, largest = _null(m, simulations, seed)
    if pse > 0:
        above = single.size - np.searchsorted(single, np.abs(values) / pse)
        p = (1 + above) / (single.size + 1)
    else:
        p = np.where(values == 0, 1.0, 1 / (single.size + 1))
    return LenthResult(
        labels,
        tuple(values.tolist()),
        pse,
        pse * float(np.quantile(single, 1 - alpha)),
        pse * float(np.quantile(largest, 1 - alpha)),
        tuple(np.asarray(p).tolist()),
        tuple(half_normal_scores(values).tolist()),
        simulations,
        seed,
    )


def half_normal_scores(values: ArrayLike) -> Array:
    """Half-normal scores Phi^-1(0.5 + 0.5 (r - 0.5)/m) of the absolute values (Daniel 1959).

    Parameters
    ----------
    values : array_like, shape (m,)
        Contrasts; r is the rank of the absolute value, and ties share their average rank.
    """
    from scipy.special import ndtri
    from scipy.stats import rankdata

    size = np.abs(np.asarray(values, dtype=float))
    return np.asarray(ndtri(0.5 + 0.5 * (rankdata(size) - 0.5) / size.size))


def orthonormal_contrasts(layout: Layout, terms: Sequence[Term]) -> tuple[list[str], Array]:
    """One-df orthonormal contrasts of the terms of a full factorial with one row a cell.

    Parameters
    ----------
    layout : Layout
        Every combination exactly once, in any order.
    terms : sequence of Term
        Terms to resolve.

    Returns
    -------
    names : list of str
        ``A``, or ``A[1]``, ``A[2]`` for a factor with more levels: polynomial contrasts for
        numeric levels, Helmert contrasts otherwise.
    contrasts : ndarray, shape (n, m)
        Orthonormal columns, so ``contrasts.T @ y`` have equal variance.
    """
    names: list[str] = []
    columns: list[Array] = []
    for term in terms:
        pieces = [("", np.ones(layout.n))]
        for factor in term:
            coded = _one_df_contrasts(layout.levels[factor])[layout.codes[factor]]
            tags = [f"[{i + 1}]" if coded.shape[1] > 1 else "" for i in range(coded.shape[1])]
            pieces = [
                (f"{name}:{factor}{tag}".lstrip(":"), column * coded[:, i])
                for name, column in pieces
                for i, tag in enumerate(tags)
            ]
        names += [name for name, _ in pieces]
        columns += [column / np.linalg.norm(column) for _, column in pieces]
    return names, np.column_stack(columns)


def _one_df_contrasts(levels: Sequence[str]) -> Array:
    k = len(levels)
    try:
        x = np.array([float(level) for level in levels])
        powers = np.vander((x - x.mean()) / np.ptp(x), k, increasing=True)
    except ValueError:
        powers = np.tril(np.ones((k, k)))
    q, r = np.linalg.qr(powers)
    return np.asarray((q * np.sign(np.diag(r)))[:, 1:])


def two_level_effects(layout: Layout, y: Array, terms: Sequence[Term]) -> dict[str, float]:
    """Classical effects (mean at high minus mean at low) of a two-level factorial.

    Parameters
    ----------
    layout : Layout
        Every combination of the two levels of each factor exactly once.
    y : ndarray, shape (n,)
        Response of these rows.
    terms : sequence of Term
        Terms that are estimated.

    Returns
    -------
    dict of str to float
        By name of the term, in the unit of the response.
    """
    names, contrasts = orthonormal_contrasts(layout, terms)
    scaled = 2 * (contrasts.T @ (y - y[0])) / np.sqrt(y.size)
    return dict(zip(names, scaled.tolist(), strict=True))


def non_additivity(fit: Factored | TwoWayFit) -> NonAdditivityResult:
    """Tukey's one-degree test (Tukey 1949, Biometrics 5, 232-242) of any additive fit.

    Parameters
    ----------
    fit : Factored or TwoWayFit
        With two residual degrees of freedom or more; one of them is that of the test.
    """
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


def functional_shares(
    layout: Layout, factors: Sequence[str], y: Array, terms: Sequence[Term]
) -> dict[str, float]:
    """Exact functional-ANOVA shares of a full factorial (Hooker 2007); they sum to one.

    Parameters
    ----------
    layout : Layout
        Full grid, row-major in ``factors``.
    factors : sequence of str
        All factors of the grid; the levels of the last one change fastest.
    y : ndarray, shape (cells,)
        Cell means.
    terms : sequence of Term
        All terms of the full model.
    """
    shape = [len(layout.levels[name]) for name in factors]
    cube = (y - y[0]).reshape(shape)
    total = float(((cube - cube.mean()) ** 2).mean())
    components: dict[Term, Array] = {(): np.asarray(cube.mean()).reshape([1] * len(shape))}
    shares = {}
    for term in sorted(terms, key=len):
        averaged = tuple(i for i, name in enumerate(factors) if name not in term)
        part = cube.mean(axis=averaged, keepdims=True)
        for lower, component in components.items():
            if set(lower) < set(term):
                part = part - component
        components[term] = part
        shares[term_name(term)] = float((part**2).mean()) / total if total > 0 else 0.0
    return shares
