"""A quadratic surface fitted to runs, and what may be said of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from study.arrays import Array, Flags, Ints
from study.errors import Fault, RefusedError
from study.response_surface.extremes import Extreme, box_points, extremes
from study.response_surface.factors import Runs, change_together
from study.response_surface.quadratic.hypotheses import FTest, against_blocks, lack_of_fit
from study.response_surface.quadratic.least_squares import (
    LeaveOneOut,
    ModelColumns,
    factorize,
    leave_one_out,
)
from study.response_surface.quadratic.polynomial import Polynomial, Term, second_order
from study.response_surface.quadratic.stationary import (
    SEARCHED,
    StationaryPoint,
    region_of,
    stationary_point,
)

#: smallest Q2 at which effects are carried by a quadratic
CARRIED = 0.8

Error = Literal["none", "blocks", "replicates"]


@dataclass(frozen=True)
class TermEstimate:
    """A coefficient of a coded term; interval and p only where there is an error to judge by."""

    term: str
    coefficient: float
    interval: tuple[float, float] | None = None
    p: float | None = None


@dataclass(frozen=True)
class QuadraticSurface:
    """A fitted surface.

    Parameters
    ----------
    runs : Runs
        What it was fitted to.
    polynomial : Polynomial
        Coefficients; with blocks their mean.
    terms : tuple of TermEstimate
        The same with intervals and p.
    factor_tests : dict of str to FTest
        With blocks: all terms of a factor together.
    error : {"none", "blocks", "replicates"}
        What tests rest on: nothing (a deterministic surface), blocks or replicates.
    loo : LeaveOneOut or None
        Leave-one-out errors; None where no run can be left out.
    lack_of_fit : FTest or None
        What the model leaves open, against blocks or pure error.
    stationary : StationaryPoint or None
        None where the surface is level nowhere.
    smallest, largest : Extreme
        In the box, with twice the rms leave-one-out error around.
    aliases : tuple of str
        Terms that the settings cannot tell from others.
    notes : tuple of str
        What a reader must know.
    """

    runs: Runs
    polynomial: Polynomial
    terms: tuple[TermEstimate, ...]
    factor_tests: dict[str, FTest]
    error: Error
    loo: LeaveOneOut | None
    lack_of_fit: FTest | None
    stationary: StationaryPoint | None
    smallest: Extreme
    largest: Extreme
    aliases: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def half_width(self) -> float:
        """Twice the rms leave-one-out error, in the response's unit; NaN if it is not known."""
        return self.smallest.half_width

    def predict(self, coded: Array) -> tuple[Array, Array]:
        """Predictions and half widths of their intervals, shape (n,) each, at coded points."""
        values = self.polynomial.value(coded)
        return values, np.full(values.shape, self.half_width)


def fit_quadratic(runs: Runs, alpha: float = 0.05) -> QuadraticSurface:
    """Fit a quadratic surface.

    Parameters
    ----------
    runs : Runs
        At least two; with blocks, every block at every setting.
    alpha : float
        Size of the tests; intervals of coefficients have the level 1 - alpha.

    Raises
    ------
    RefusedError
        If no block was run at every setting.
    """
    if len(set(runs.blocks)) > 1:
        return _with_blocks(runs, alpha)
    settings, which = runs.distinct()
    means = np.bincount(which, weights=runs.response) / np.bincount(which)
    scatter = float(np.abs(runs.response - means[which]).max())
    if scatter > 1e-12 * float(np.abs(runs.response).max()):
        return _with_replicates(runs, which, alpha)
    # copies of a deterministic run are one run: counted twice, they would only weigh more
    single = replace(runs, coded=settings, response=means, blocks=(), u_num=None)
    columns = factorize(second_order(single.levels()), settings)
    b = columns.coefficients(means)
    terms = [
        TermEstimate(label, float(c)) for label, c in zip(_labels(runs, columns), b, strict=True)
    ]
    notes = ["no p: a deterministic surface has misfit, not noise"]
    copies = runs.response.size - means.size
    notes += [f"{copies} copies of deterministic runs count once"] if copies else []
    return _surface(runs, columns, means, tuple(terms), "none", notes=notes)


def _with_replicates(runs: Runs, which: Ints, alpha: float) -> QuadraticSurface:
    columns = factorize(second_order(runs.levels()), runs.coded)
    b = columns.coefficients(runs.response)
    df = runs.response.size - b.size
    residual = float((columns.residuals(runs.response) ** 2).sum())
    errors = np.sqrt(np.diag(columns.inverse()) * residual / max(df, 1))
    terms = _estimates(_labels(runs, columns), b, errors, df, alpha)
    fit = lack_of_fit(columns, runs.response, which)
    notes = []
    if fit is not None and fit.p < alpha:
        notes.append(
            "lack of fit: p and intervals of the terms rest on a surface that does not fit"
        )
    return _surface(runs, columns, runs.response, terms, "replicates", lack=fit, notes=notes)


def _with_blocks(runs: Runs, alpha: float) -> QuadraticSurface:
    settings, which = runs.distinct()
    names = tuple(dict.fromkeys(runs.blocks))
    rows = np.array([names.index(b) for b in runs.blocks])
    counts = np.zeros((len(settings), len(names)))
    sums = np.zeros_like(counts)
    np.add.at(counts, (which, rows), 1.0)
    np.add.at(sums, (which, rows), runs.response)
    whole: Flags = np.asarray((counts > 0).all(axis=0))
    if whole.sum() < 2:
        rule = "fewer than two blocks have a run at every setting"
        mend = "complete the blocks, or leave --block out"
        raise RefusedError(str(Fault("blocks", rule, mend)))
    table = sums[:, whole] / counts[:, whole]
    columns = factorize(second_order(runs.levels()), settings)
    each = columns.coefficients(table)
    b, blocks = each.mean(axis=1), each.shape[1]
    terms = _estimates(
        _labels(runs, columns), b, each.std(axis=1, ddof=1) / np.sqrt(blocks), blocks - 1, alpha
    )
    lost = [name for name, kept in zip(names, whole, strict=True) if not kept]
    notes = [f"left out, with settings that lack a run: {', '.join(lost)}"] if lost else []
    if blocks <= len(runs.factors):
        notes.append("no region of the stationary point: it needs more blocks than factors")
    found = _surface(
        runs, columns, table.mean(axis=1), terms, "blocks",
        lack=against_blocks(columns.complement(), table), notes=notes,
    )  # fmt: skip
    surfaces = [Polynomial(columns.terms, c, len(runs.factors)) for c in each.T]
    return replace(
        found,
        factor_tests=_factor_tests(runs, columns, table),
        stationary=_with_region(found.stationary, surfaces),
    )


def _with_region(
    point: StationaryPoint | None, surfaces: list[Polynomial]
) -> StationaryPoint | None:
    if point is None:
        return None
    points = np.vstack([box_points(surfaces[0].k, SEARCHED), np.clip(point.at, -1, 1)])
    return replace(point, region=region_of(surfaces, points))


def _factor_tests(runs: Runs, columns: ModelColumns, table: Array) -> dict[str, FTest]:
    found = {}
    for j, name in enumerate(runs.names):
        own = [i for i, term in enumerate(columns.terms) if j in term.factors]
        test = against_blocks(columns.alone(own), table)
        if test is not None:
            found[name] = test
    return found


def _labels(runs: Runs, columns: ModelColumns) -> list[str]:
    return [term.label(runs.names) for term in columns.terms]


def _estimates(
    labels: list[str], b: Array, errors: Array, df: int, alpha: float
) -> tuple[TermEstimate, ...]:
    from scipy import stats

    if df < 1:
        return tuple(TermEstimate(label, float(c)) for label, c in zip(labels, b, strict=True))
    t = float(stats.t.ppf(1.0 - alpha / 2.0, df))
    return tuple(
        TermEstimate(
            label,
            float(c),
            (float(c - t * se), float(c + t * se)),
            float(2.0 * stats.t.sf(abs(c) / se, df)) if se > 0 else None,
        )
        for label, c, se in zip(labels, b, errors, strict=True)
    )


def _surface(
    runs: Runs,
    columns: ModelColumns,
    response: Array,
    terms: tuple[TermEstimate, ...],
    error: Error,
    *,
    lack: FTest | None = None,
    notes: list[str],
) -> QuadraticSurface:
    polynomial = Polynomial(columns.terms, columns.coefficients(response), len(runs.factors))
    loo = leave_one_out(columns, response)
    half_width = float("nan") if loo is None else 2.0 * loo.rms
    smallest, largest = extremes(polynomial.value, polynomial.k, half_width)
    linear = [n for n, count in zip(runs.names, runs.levels(), strict=True) if count == 2]
    said = [f"{name} has two settings: linear only" for name in linear]
    together = change_together(runs)
    if together:
        said.append(
            f"{', '.join(together[:-1])} and {together[-1]} change together in every run: what one "
            "does is not told from the others, and nothing is known where they change alone"
        )
    if loo is None:
        said.append("as many coefficients as runs: no error of the surface can be told; add runs")
    elif not loo.q2 >= CARRIED:
        said.append(f"Q2 {loo.q2:.2f} is below .8: effects are not carried by a quadratic")
    # a stationary point needs every square
    squares = sum(len(t.factors) == 2 and t.factors[0] == t.factors[1] for t in columns.terms)
    point = stationary_point(polynomial) if squares == polynomial.k else None
    return QuadraticSurface(
        runs, polynomial, terms, {}, error, loo, lack, point, smallest, largest,
        _alias_list(runs, columns), (*notes, *said),
    )  # fmt: skip


def _alias_list(runs: Runs, columns: ModelColumns) -> tuple[str, ...]:
    def summed(parts: tuple[tuple[Term, float], ...]) -> str:
        labels = [(term.label(runs.names), weight) for term, weight in parts]
        return " + ".join(label if abs(w - 1) < 1e-9 else f"{w:.3g} {label}" for label, w in labels)

    return tuple(f"{term.label(runs.names)} = {summed(parts)}" for term, parts in columns.aliases)
