"""Mixed models by REML: incomplete blocks, and how much blocks and rows within them scatter.

The response is y = X beta + sum_k Z_k b_k + e with independent normal b_k and e. Blocks that
lack some cells keep what they tell: between blocks as far as their scatter allows, within
blocks fully (recovery of interblock information, Yates 1940, Ann. Eugen. 10, 317-325).

References: Patterson and Thompson (1971), Biometrika 58, 545-554 (REML); Fai and Cornelius
(1996), J. Statist. Comput. Simul. 54, 363-378 (degrees of freedom of F); Bates, Maechler,
Bolker and Walker (2015), J. Statist. Softw. 67, 1 (intervals by the profile of the likelihood).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import brentq
from scipy.special import chdtri, fdtrc, stdtrit

from study.analysis.data import Data, prepare
from study.analysis.error.restricted_likelihood import Likelihood
from study.analysis.linear_model.design_matrix import (
    Model,
    ModelMatrix,
    model_matrix,
    term_name,
    terms_of,
)
from study.analysis.linear_model.sums_of_squares import Factored, factor, one_thread, term_sums
from study.analysis.request import alpha_faults
from study.arrays import Array
from study.errors import Fault, InputError, nearest
from study.tidy_csv import names_of

if TYPE_CHECKING:
    import pandas as pd

#: rows beyond which the dense covariance takes longer than a minute
MOST_ROWS = 1500
#: standard deviation over that of the rows within blocks at which a component counts as zero
_ZERO = 1e-6
#: standard deviation over that of all rows at which the search for an upper limit gives up
_FAR = 1e3


@dataclass(frozen=True)
class VarianceComponent:
    """Standard deviation of one source of scatter, in the unit of the response.

    Parameters
    ----------
    source : str
        Column of the blocks, an interaction with it, or ``"within"``.
    sd : float
        REML estimate; 0 at the boundary.
    low, high : float
        Interval by the profile of the likelihood.
    share : float
        Part of the total variance.
    """

    source: str
    sd: float
    low: float
    high: float
    share: float


@dataclass(frozen=True)
class MixedTerm:
    """F test of one term; the degrees of freedom of its error are those of Fai and Cornelius."""

    term: str
    df: int
    f: float
    df_error: float
    p: float


@dataclass(frozen=True)
class Slope:
    """Change of the response for each unit of a covariate, with its interval."""

    covariate: str
    value: float
    low: float
    high: float


@dataclass(frozen=True)
class MixedModel:
    """A fitted mixed model.

    Parameters
    ----------
    components : tuple of VarianceComponent
        Blocks, their interactions, rows within.
    terms : tuple of MixedTerm
        Type III tests of the factors and covariates.
    deviance : float
        -2 log likelihood, restricted.
    rows : int
        Rows that entered.
    slopes : tuple of Slope
        Of the covariates.
    """

    components: tuple[VarianceComponent, ...]
    terms: tuple[MixedTerm, ...]
    deviance: float
    rows: int
    slopes: tuple[Slope, ...] = ()


@one_thread
def mixed_model(  # noqa: PLR0913  # the public face: one keyword for each thing that may be asked
    table: pd.DataFrame,
    response: str,
    factors: Sequence[str],
    *,
    block: str,
    random: Sequence[str] = (),
    covariates: Sequence[str] = (),
    model: Model = "full",
    alpha: float = 0.05,
) -> MixedModel:
    """Fit a mixed model by REML.

    Parameters
    ----------
    table : DataFrame
        One row a run; blocks may lack cells.
    response : str
        Column of the response.
    factors : sequence of str
        Columns of the fixed factors.
    block : str
        Column of the blocks, which are random.
    random : sequence of str
        Factors whose interaction with the blocks is random too.
    covariates : sequence of str
        Numeric columns (a temperature, a mass) that the response follows in a straight line.
    model : "full", int or list
        Fixed terms; see :func:`study.analysis.linear_model.design_matrix.terms_of`.
    alpha : float
        One minus the level of the intervals.

    Returns
    -------
    MixedModel
        Variance components with intervals, tests of the fixed terms, slopes of the covariates.

    Raises
    ------
    InputError
        For fewer than three blocks, terms that the rows cannot tell, too many rows, or a
        covariate that is no number in some row.
    """
    if faults := alpha_faults(alpha):
        raise InputError(faults)
    if factors:
        data = prepare(table, response, list(factors), names_of(block))
    else:  # the mean is the only fixed effect
        data = prepare(table, response, [block])
    terms = terms_of(data.factors, model) if factors else []
    matrix = _with_covariates(model_matrix(data.layout, terms), table, covariates, data)
    fixed = factor(matrix, data.y)
    _check(data, block, fixed.q.shape[1], matrix.columns.shape[1], random)
    parts = [(block, np.asarray(data.layout.codes[block]))]
    parts += [(f"{block}:{name}", data.layout.cell([block, name])) for name in random]
    indicators = tuple(np.eye(int(code.max()) + 1)[code] for _, code in parts)
    shift = float(data.y.mean())
    likelihood = Likelihood(data.y - shift, fixed.q, indicators)
    names = [*(name for name, _ in parts), "within"]
    try:
        return _fitted(likelihood, fixed, names, covariates, alpha)
    except (np.linalg.LinAlgError, ValueError) as error:  # singular, or a profile without values
        rule = "these rows do not tell the scatter over blocks from that within them"
        mend = "use --error own or --error pooled, or leave --random out"
        raise InputError(Fault("mixed model", rule, mend)) from error


def _fitted(
    likelihood: Likelihood,
    fixed: Factored,
    names: Sequence[str],
    covariates: Sequence[str],
    alpha: float,
) -> MixedModel:
    """Model of the most likely components."""
    sd, deviance = likelihood.fit(restricted=True)
    tests = tuple(
        MixedTerm(term_name(s.term), s.df, *_f_test(likelihood, sd, s.basis))
        for s in term_sums(fixed, "III")
        if s.df
    )
    slopes = tuple(_slope(likelihood, sd, fixed, name, alpha) for name in covariates)
    components = _components(likelihood, names, sd, alpha)
    return MixedModel(components, tests, deviance, likelihood.y.size, slopes)


def _with_covariates(
    matrix: ModelMatrix, table: pd.DataFrame, covariates: Sequence[str], data: Data
) -> ModelMatrix:
    """Append a column for every covariate, each about its mean."""
    columns, terms, blocks = [matrix.columns], [*matrix.terms], [*matrix.blocks]
    for name in covariates:
        values = _numbers(table, name, data)
        at = matrix.columns.shape[1] + len(columns) - 1
        columns.append((values - values.mean())[:, None])
        terms.append((name,))
        blocks.append(slice(at, at + 1))
    return ModelMatrix(np.hstack(columns), tuple(terms), tuple(blocks))


def _numbers(table: pd.DataFrame, name: str, data: Data) -> Array:
    """Values of a covariate in the rows that entered."""
    place = f"covariate {name!r}"
    if name not in table.columns:
        known = [str(column) for column in table.columns]
        raise InputError(Fault(place, "no such column", nearest(name, known)))
    if name in {*data.factors, *data.blocks}:
        raise InputError(Fault(place, "is a factor or the block already", "name it once"))
    try:
        values = np.asarray(table[name].to_numpy()[data.rows], dtype=float)
    except (TypeError, ValueError):
        raise InputError(Fault(place, "holds text", "a covariate is a column of numbers")) from None
    if not np.isfinite(values).all():
        row = int(data.rows[np.flatnonzero(~np.isfinite(values))[0]]) + 1
        raise InputError(Fault(f"row {row}, {place}", "is missing", "leave such rows out"))
    if not np.ptp(values):
        raise InputError(Fault(place, "never changes", "leave it out"))
    return values


def _slope(likelihood: Likelihood, sd: Array, fixed: Factored, name: str, alpha: float) -> Slope:
    """Slope of a covariate with its interval; degrees of freedom as for its test."""
    at = fixed.matrix.of((name,)).start
    # the coefficient of column ``at`` is a weighted sum of those of the orthonormal columns
    weights = fixed.model.inverse[at]
    vx = np.linalg.solve(likelihood.covariance(sd), likelihood.x)
    c = np.linalg.inv(likelihood.x.T @ vx)
    value = float(weights @ c @ (vx.T @ likelihood.y))
    error = float(np.sqrt(weights @ c @ weights))
    _, df, _ = _f_test(likelihood, sd, weights[:, None])
    reach = float(stdtrit(df, 1 - alpha / 2)) * error
    return Slope(name, value, value - reach, value + reach)


def _check(data: Data, block: str, rank: int, columns: int, random: Sequence[str]) -> None:
    faults = []
    blocks = len(data.layout.levels[block])
    if blocks < 3:
        rule = f"has {blocks} levels: the scatter over blocks needs three"
        faults.append(Fault(f"column {block!r}", rule))
    if data.y.size > MOST_ROWS:
        rule = f"{data.y.size:,} rows, at most {MOST_ROWS:,}"
        faults.append(Fault("mixed model", rule, "average repeats within a block first"))
    if not np.ptp(data.y):
        faults.append(Fault("response", "is the same in every row", "there is nothing to explain"))
    if rank < columns:
        rule = "the rows cannot tell all terms apart"
        faults.append(Fault("model", rule, "leave interactions out: --model 1"))
    for name in random:
        if name not in data.factors:
            faults.append(Fault("random", f"{name!r} is no factor"))
    if faults:
        raise InputError(faults)


def _components(
    likelihood: Likelihood, names: Sequence[str], sd: Array, alpha: float
) -> tuple[VarianceComponent, ...]:
    at_most, least = likelihood.fit(restricted=False)
    limit = least + float(chdtri(1, alpha))
    sd = np.where(sd > _ZERO * sd[-1], sd, 0.0)
    total = float(np.sum(sd**2))
    found = []
    for i, name in enumerate(names):

        def excess(value: float, i: int = i) -> float:
            return likelihood.fit(restricted=False, held=(i, value))[1] - limit

        low, high = _limits(excess, float(at_most[i]), likelihood.scale, within=i == len(names) - 1)
        found.append(VarianceComponent(name, float(sd[i]), low, high, float(sd[i] ** 2) / total))
    return tuple(found)


def _limits(
    excess: Callable[[float], float], best: float, scale: float, *, within: bool
) -> tuple[float, float]:
    """Where the profile of the likelihood crosses its limit; 0 where it never does below."""
    tiny = 1e-4 * scale
    low = 0.0
    if best > tiny and (within or excess(0.0) > 0):
        low = float(brentq(excess, tiny if within else 0.0, best, xtol=1e-6 * scale))
    high = max(best, tiny)
    while excess(high) <= 0:
        high *= 2
        if high > _FAR * scale:
            return low, float("inf")
    return low, float(brentq(excess, max(best, 0.0), high, xtol=1e-6 * scale))


def _f_test(likelihood: Likelihood, sd: Array, basis: Array) -> tuple[float, float, float]:
    """F, its denominator degrees of freedom and p of the directions ``basis`` of a term."""
    kept = [i for i in range(sd.size) if sd[i] > _ZERO * sd[-1]]
    squares = [likelihood.random[i] @ likelihood.random[i].T for i in kept if i < sd.size - 1]
    squares.append(np.eye(likelihood.y.size))
    inverse = np.linalg.inv(likelihood.covariance(sd))
    vx = inverse @ likelihood.x
    c = np.linalg.inv(likelihood.x.T @ vx)
    beta = c @ (vx.T @ likelihood.y)
    projection = inverse - vx @ c @ vx.T
    moved = [projection @ s for s in squares]
    information = 0.5 * np.array([[np.sum(a * b.T) for b in moved] for a in moved])
    spread = np.linalg.inv(information)
    own = basis.T @ c @ basis
    values, vectors = np.linalg.eigh(own)
    directions = basis @ vectors
    t2 = (directions.T @ beta) ** 2 / values
    # d(variance)/d(component) of every direction: u' C X' V^-1 S V^-1 X C u
    lever = vx @ c @ directions
    slopes = np.array([np.einsum("ij,ik,kj->j", lever, s, lever) for s in squares])
    nu = 2 * values**2 / np.einsum("ij,ik,kj->j", slopes, spread, slopes)
    q = t2.size
    f = float(t2.sum() / q)
    df = float(nu[0]) if q == 1 else _joint(nu)
    return f, df, float(fdtrc(q, df, f))


def _joint(nu: Array) -> float:
    """Denominator degrees of freedom whose F has the mean of the sum of squared t."""
    if np.ptp(nu) < 1e-8 * nu.max():
        return float(nu.mean())
    large = nu[nu > 2]
    expected = float(np.sum(large / (large - 2)))
    return 2 * expected / (expected - nu.size) if expected > nu.size else 2.0
