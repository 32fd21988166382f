"""Variances of cells: tests that they are equal, and tests of means that let them differ."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from study.ground.arrays import Array, Ints, chunks
from study.statistics.analysis.data import Data
from study.statistics.analysis.linear_model import Term, model_matrix, term_name
from study.statistics.analysis.sums_of_squares import Factored, FRatioTest, factor, term_sums

Groups = Mapping[str, ArrayLike] | Sequence[ArrayLike]


#: Simulated samples of the p of Levene's test.
SIMULATIONS = 10_000
#: Values that its simulation draws at most, but for 1,000 samples: about a second.
SIMULATED_VALUES = 10_000_000
#: Values in the smallest group from which the F distribution has the size that it says.
ASYMPTOTIC = 100


@dataclass(frozen=True)
class SpreadTest:
    """Bartlett's or Levene's test; where it does not apply ``reason`` says why."""

    statistic: float | None
    #: Of chi-squared; a pair of F's.
    df: int | tuple[int, int] | None
    p: float | None
    reason: str = ""
    #: What deviations are taken from, "median" (Brown-Forsythe) or "mean"; empty of Bartlett's.
    center: str = ""
    p_monte_carlo: float | None = None
    approximate: bool = False

    @property
    def applicable(self) -> bool:
        """Whether there is no reason against the test."""
        return not self.reason

    def to_json(self) -> dict[str, object] | None:
        """JSON document; None where the test does not apply."""
        if not self.applicable:
            return None
        return {
            "statistic": self.statistic,
            "df": list(self.df) if isinstance(self.df, tuple) else self.df,
            **({"center": self.center} if self.center else {}),
            "p": self.p,
            "p_monte_carlo": self.p_monte_carlo,
            "approximate": self.approximate,
        }


def _inapplicable(reason: str, *, approximate: bool) -> SpreadTest:
    return SpreadTest(None, None, None, reason, approximate=approximate)


def _named(groups: Groups) -> dict[str, Array]:
    if isinstance(groups, Mapping):
        items = [(str(key), value) for key, value in groups.items()]
    else:
        items = [(str(i + 1), value) for i, value in enumerate(groups)]
    return {key: np.asarray(value, dtype=float) for key, value in items}


def _fault(named: Mapping[str, Array], least: int, design: ResidualDesign | None) -> str:
    """Why the groups cannot be compared; empty when they can."""
    if len(named) < 2:
        return "fewer than two groups"
    if design is not None and design.mirrored():
        return "the residuals of one group mirror those of the other"
    largest = max((float(np.abs(v).max()) for v in named.values() if v.size), default=0.0)
    floor = 16 * float(np.spacing(largest))
    for name, values in named.items():
        if values.size < least:
            if values.size == 1:
                return f"group {name} has one value"
            return f"group {name} has {values.size} values, {least} are needed"
        if not np.all(np.isfinite(values)):
            return f"group {name} has a missing value"
        if float(np.ptp(values)) <= floor:
            return f"group {name} has zero variance"
    return ""


@dataclass(frozen=True)
class ResidualDesign:
    """How grouped residuals of a fit come about, so that their null can be simulated."""

    #: shape (n, r); orthonormal basis of the model.
    basis: Array
    #: shape (n,); index of the group of each row.
    group: Ints

    def draws(self, count: int, seed: int) -> Iterator[list[Array]]:
        """Residuals of simulated normal data by group, each of shape (m, size)."""
        rng = np.random.default_rng(seed)
        n, groups = self.basis.shape[0], np.unique(self.group)
        for m in chunks(count, 2e6 // n):
            z = rng.standard_normal((m, n))
            z -= (z @ self.basis) @ self.basis.T
            yield [z[:, self.group == g] for g in groups]

    def mirrored(self) -> bool:
        """Whether every group spreads alike whatever the data, as two cells in blocks do."""
        drawn = next(self.draws(1, seed=0))
        spread = np.array([values.var() for values in drawn])
        return bool(np.ptp(spread) < 1e-9 * spread.max())


def bartlett(
    groups: Groups,
    *,
    simulations: int = 0,
    seed: int = 2011,
    approximate: bool = False,
    design: ResidualDesign | None = None,
) -> SpreadTest:
    """Bartlett's test of equal variances (Bartlett 1937; NIST e-Handbook 1.3.5.7).

    Parameters
    ----------
    groups : mapping of str to array_like, or sequence of array_like
        Values of each group; whole numbers are converted first.
    simulations : int
        Number of simulated normal samples for a Monte-Carlo p; 0 for none.
    seed : int
        Seed of the simulation.
    approximate : bool
        Whether the values are residuals, so that the chi-squared p is approximate.
    design : ResidualDesign, optional
        Fit whose residuals the values are: the Monte-Carlo p is then exact for it.

    Returns
    -------
    SpreadTest
        Statistic, degrees of freedom, p; or the reason why there is none.

    Examples
    --------
    >>> bartlett([[1, 2, 4], [3, 3, 3]]).reason
    'group 2 has zero variance'
    """
    named = _named(groups)
    reason = _fault(named, 2, design)
    if reason:
        return _inapplicable(reason, approximate=approximate)
    from scipy.special import chdtrc

    df = np.array([v.size - 1 for v in named.values()], dtype=float)
    variance = np.array([(v - v[0]).var(ddof=1) for v in named.values()])
    t = float(_bartlett_statistic(variance, df))
    k = len(named) - 1
    p_mc = None
    if simulations:
        if design is None:
            drawn = np.random.default_rng(seed).chisquare(df, size=(simulations, df.size)) / df
        else:
            parts = design.draws(simulations, seed)
            drawn = np.vstack([np.stack([g.var(axis=1, ddof=1) for g in p], axis=1) for p in parts])
        p_mc = _monte_carlo_p(_bartlett_statistic(drawn, df), t)
    return SpreadTest(t, k, float(chdtrc(k, t)), "", "", p_mc, approximate)


def _bartlett_statistic(variance: Array, df: Array) -> Array:
    total = df.sum()
    pooled = (variance * df).sum(axis=-1) / total
    top = total * np.log(pooled) - (df * np.log(variance)).sum(axis=-1)
    bottom = 1 + ((1 / df).sum() - 1 / total) / (3 * (df.size - 1))
    return np.asarray(np.maximum(top / bottom, 0.0))


def _monte_carlo_p(simulated: Array, observed: float) -> float:
    return float((1 + np.count_nonzero(simulated >= observed)) / (simulated.size + 1))


def levene(
    groups: Groups,
    *,
    center: str = "auto",
    simulations: int = 0,
    seed: int = 2011,
    approximate: bool = False,
    design: ResidualDesign | None = None,
) -> SpreadTest:
    """Levene's test of equal spreads (Levene 1960; Brown and Forsythe 1974)."""
    named = _named(groups)
    reason = _fault(named, 3, design)
    if reason:
        return _inapplicable(reason, approximate=approximate)
    smallest = min(v.size for v in named.values())
    if center == "auto":
        center = "median"
        if smallest < ASYMPTOTIC:
            total = sum(v.size for v in named.values())
            fewest = max(1_000, SIMULATED_VALUES // total)
            simulations = simulations or min(SIMULATIONS, fewest)
    sizes = np.array([v.size for v in named.values()])
    w, p = map(float, _levene([v - v[0] for v in named.values()], center))
    df = (len(named) - 1, int(sizes.sum()) - len(named))
    if not math.isfinite(w):
        reason = "every deviation within each group is equal"
        return _inapplicable(reason, approximate=approximate)
    p_mc = None
    if simulations:
        drawn = _normal_draws(sizes, simulations, seed)
        if design is not None:
            drawn = design.draws(simulations, seed)
        p_mc = _monte_carlo_p(np.concatenate([_levene(d, center)[0] for d in drawn]), w)
    return SpreadTest(w, df, p, "", center, p_mc, approximate)


def _levene(groups: Sequence[Array], center: str) -> tuple[Array, Array]:
    """W and p of groups that hold one sample along the last axis."""
    from scipy.stats import levene as of_samples

    with np.errstate(divide="ignore", invalid="ignore"):
        test = of_samples(*groups, center=center, axis=-1)
    return test.statistic, test.pvalue


def _normal_draws(sizes: Ints, count: int, seed: int) -> Iterator[list[Array]]:
    rng = np.random.default_rng(seed)
    for m in chunks(count, 2e6 // int(sizes.sum())):
        yield [rng.standard_normal((m, int(size))) for size in sizes]


def fligner(groups: Groups) -> tuple[float, float] | None:
    """Statistic and p of Fligner and Killeen's test about the medians (Conover et al. 1981).

    None where a group has fewer than two values, or all deviations are alike.
    """
    from scipy.stats import fligner as fligner_killeen

    values = list(_named(groups).values())
    if len(values) < 2 or min(v.size for v in values) < 2:
        return None
    if not np.ptp(np.concatenate([np.abs(v - np.median(v)) for v in values])):
        return None
    test = fligner_killeen(*values)
    return float(test.statistic), float(test.pvalue)


# -------------------------------------------------------------------------------------------------
# Means of cells that scatter unequally.

# Condition number beyond which the inverse of a covariance has no digit left (1 / 1e-16, less 2).
_WORST_CONDITION = 1e14


#: rows of a cell from which its own variance is known well enough to be asked always
ENOUGH_ROWS = 5
#: p of Bartlett's test below which cells of fewer rows are judged by their own variances alone
UNEVEN = 0.10
#: weight of the pooled variance beside the own one of a cell of three or four rows: the test has
#: too little power there. Simulated, 3 rows of 4 cells, one of which scatters 3.3 times as much:
#: false claims .057 in 1,000 data sets (with 1: .070; by the test alone, at .25: .07), of right
#: ones .95 stand (by their own variances alone: .81)
SHRUNK = 0.7


def own_variances(y: Array, cell: Ints, shrinkage: float = 0.0) -> tuple[Array, Array]:
    """Find the variance of each cell and its degrees of freedom; that of one row is infinite.

    With ``shrinkage`` every variance is drawn towards the pooled one, which counts as that many
    times the cell's own degrees of freedom (Smyth 2004, Stat. Appl. Genet. Mol. Biol. 3, 3); a
    cell with one row has the pooled one.

    Shapes: y (n,); cell (n,); returns (cells,).
    """
    count = np.bincount(cell)
    mean = np.bincount(cell, y - y[0]) / count
    ss = np.bincount(cell, (y - y[0] - mean[cell]) ** 2)
    df = np.maximum(count - 1.0, 1.0)
    if not shrinkage:
        return np.where(count > 1, ss / df, np.inf), df
    total = float((count - 1).sum())
    pooled = ss.sum() / total
    variance = np.where(count > 1, (ss / df + shrinkage * pooled) / (1 + shrinkage), pooled)
    return variance, np.where(count > 1, (1 + shrinkage) * df, total)


#: least variance of a cell estimated beside blocks, over the pooled variance
_LEAST_PART = 0.01
#: p below which a cell beside blocks is taken to scatter more than the others
VOLATILE = 0.10
#: degrees of freedom of the error from which that test finds what would make a claim false
ENOUGH_BESIDE = 12
#: weight of the pooled variance beside the own one of a cell where they are fewer. Simulated, Latin
#: squares of four, a level that scatters 7.5 times as much: false claims .035 (by the test alone
#: .107), of right ones .67 stand (weight 3: .07 in 300, and .86)
SHRUNK_BESIDE = 2.0


def variances_beside_blocks(fit: Factored, cell: Ints) -> tuple[Array, Array]:
    """Unbiased variance of each cell from residuals of a fit, and its degrees of freedom.

    MINQUE (Rao 1970, J. Amer. Statist. Assoc. 65, 161-172): sums of squared residuals by cell are
    solved for the variances. Without blocks they are the variances of the cells.

    Shapes: cell (n,); returns (cells,).
    """
    member = np.eye(int(cell.max()) + 1)[cell]
    gram = np.einsum("ni,nj,nc->cij", fit.q, fit.q, member, optimize=True)
    leverage = member.T @ fit.leverage
    expected = np.einsum("cij,dij->cd", gram, gram)
    expected += np.diag(member.sum(axis=0) - 2 * leverage)
    inverse = np.linalg.pinv(expected, rcond=1e-9)
    variance = inverse @ (member.T @ fit.residual**2)
    pooled = fit.rss / fit.df_residual
    return np.maximum(variance, _LEAST_PART * pooled), 1 / np.maximum(np.diag(inverse), 1e-9)


def volatile_beside_blocks(fit: Factored, cell: Ints) -> tuple[Array, Array] | None:
    """Variances of the cells beside blocks, where one scatters more than all others together.

    Each variance is tested against that of the rest (F, Bonferroni over the cells). Where the error
    has too few degrees of freedom for the test, every variance is drawn towards the pooled one.

    Shapes: cell (n,); returns (cells,).
    """
    from scipy.special import fdtrc

    variance, df = variances_beside_blocks(fit, cell)
    rest = np.maximum(fit.df_residual - df, 1.0)
    of_rest = np.maximum(fit.rss - df * variance, _LEAST_PART * fit.rss) / rest
    p = fdtrc(df, rest, variance / of_rest)
    if p.min() * p.size < VOLATILE:
        return variance, df
    if fit.df_residual >= ENOUGH_BESIDE:
        return None
    pooled = fit.rss / fit.df_residual
    return (variance + SHRUNK_BESIDE * pooled) / (1 + SHRUNK_BESIDE), (1 + SHRUNK_BESIDE) * df


def doubted_variances(y: Array, cell: Ints) -> tuple[Array, Array] | None:
    """Variances of cells by which a claim from a pooled one must be made as well, if any.

    Shapes: y (n,); cell (n,).
    """
    from scipy.special import chdtrc

    counts = np.bincount(cell)
    variance, df = own_variances(y, cell)
    if counts.max() >= ENOUGH_ROWS:
        return variance, df
    several = counts > 1
    if several.sum() >= 2:
        variances, free = variance[several], df[several]
        if (
            variances.min() <= 0
            or chdtrc(free.size - 1, _bartlett_statistic(variances, free)) < UNEVEN
        ):
            return variance, df
    return own_variances(y, cell, SHRUNK) if counts.max() > 2 else None


def _johansen(n: Array, mean: Array, variance: Array, contrast: Array) -> FRatioTest | None:
    """Test one contrast of cell means (Johansen 1980, Biometrika 67, 85-92).

    None where a cell has one value or no variance, or where the variances differ too much.

    Shapes: n, mean, variance (cells,); contrast (d, cells).
    """
    if n.min() < 2 or variance.min() <= 0:
        return None
    s = variance / n
    covariance = (contrast * s) @ contrast.T
    if np.linalg.cond(covariance) > _WORST_CONDITION:
        return None
    inner = np.linalg.inv(covariance)
    effect = contrast @ mean
    t = float(effect @ inner @ effect)
    weight = np.einsum("jk,jk->k", contrast, inner @ contrast) * s
    # tr(Q_j^2) = tr(Q_j)^2 because each cell enters with one variance
    a = float(np.sum(2 * weight**2 / (n - 1))) / 2
    d = contrast.shape[0]
    scale = d + 2 * a - 6 * a / (d + 2)
    return FRatioTest.of(t / scale, d, d * (d + 2) / (3 * a))


def welch_tests(data: Data, y: Array, terms: Sequence[Term]) -> dict[str, FRatioTest | None]:
    """Welch and James's test of every estimable term, with a variance of its own in each cell."""
    present, first, index = np.unique(data.cell, return_index=True, return_inverse=True)
    n = np.bincount(index).astype(float)
    mean = np.bincount(index, y - y[0]) / n
    variance, _ = own_variances(y, index)
    fit = factor(model_matrix(data.layout.take(first), terms), np.arange(float(present.size)))
    return {
        term_name(s.term): None
        if s.df < s.nominal_df
        else _johansen(n, mean, variance, (fit.q @ s.basis).T)
        for s in term_sums(fit, "III")
    }
