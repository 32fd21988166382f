"""Repeated measures on groups of blocks: own interactions where some factors vary between blocks.

A block (specimen) belongs to one group (its mix, say) and is scored in every cell of the other
factors. An effect within blocks, and its interaction with the groups, is tested against its own
interaction with the blocks of a group; an effect between blocks against the blocks themselves.
Each group has a covariance of its own (Welch-Box) from three blocks a group on; with two, one
covariance serves all groups.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtrc

from study.analysis.anova_table import Anova, Effect, ErrorTerm, Row
from study.analysis.data import Crossed, crossed
from study.analysis.effects.estimates import (
    TermEstimate,
    pooled_estimate,
    settings_of,
    t_quantile,
    term_rows,
)
from study.analysis.effects.samples import group_errors, over_groups
from study.analysis.effects.sizes import size
from study.analysis.error import ledger, residuals
from study.analysis.error.split_plot import Plots
from study.analysis.error.welch_box import LEAST_OWN, welch_box
from study.analysis.gate import judge_factors, rivals_over_groups
from study.analysis.linear_model.design_matrix import (
    Layout,
    Term,
    model_matrix,
    term_name,
    terms_of,
)
from study.analysis.linear_model.factorization import complement
from study.analysis.linear_model.sphericity import SphericityResult, epsilon_gg, sphericity
from study.analysis.linear_model.sums_of_squares import (
    Factored,
    factor,
    term_sums,
    with_shares,
)
from study.analysis.outcome import Outcome, kind_of
from study.analysis.pseudoreplication import ulp_floor
from study.arrays import Array, Ints


@dataclass(frozen=True)
class _Part:
    """One within-block term: its contrasts in every block and their error."""

    name: str
    values: Array
    residual: Array
    df: int


def own_groups(out: Outcome, plots: Plots) -> Outcome | None:
    """E1 with own interactions, blocks nested in groups; None where groups have no replicates.

    Parameters
    ----------
    out : Outcome
        With y and scale.
    plots : Plots
        Its blocks are the whole plots, and the levels of ``between`` make the groups.

    Returns
    -------
    Outcome or None
        With error term, table and effects.
    """
    block = str(out.data.block)
    within = tuple(f for f in out.data.factors if f not in plots.between)
    table, groups = _table(out, within, plots)
    between = model_matrix(groups, terms_of(plots.between))
    fit = factor(between, np.arange(float(groups.n)))
    if fit.df_residual < 1:
        return None
    code = groups.cell(plots.between)
    members = [np.flatnonzero(code == g) for g in np.unique(code)]
    kind, out = kind_of(out, len({len(m) for m in members}) == 1)
    out = out.warn(*table.warnings)
    shifted = table.y - table.y[0, 0]
    total = float(np.sum((shifted - shifted.mean()) ** 2))
    floor = max(out.working_tolerance(), ulp_floor(table.y))
    apart = members if min(len(m) for m in members) >= LEAST_OWN else []
    rows: dict[Term, Row] = {}
    errors, spheres = [], {}
    for part_term, part in _parts(out, table, within, block, fit).items():
        if part.values.shape[0] > 1:
            spheres[term_name(part_term)] = _sphere(part, fit)
        errors.append(_error_row(part))
        for group_term, direction in _directions(fit, kind, part_term):
            term = tuple(f for f in out.data.factors if f in (*part_term, *group_term))
            if term in out.terms:
                rows[term] = _row(term, part, direction, apart, total, floor)
    choice = ledger.strata_choice(
        block, plots.name, plots.between, ledger.OWN, "own" if apart else "pooled"
    )
    if out.request.error == "own":
        choice = replace(choice, reason="asked for")
    effects = _welch_effects(out, rows, table, apart) if apart else _effects(out, rows, errors)
    listed = [rows[t] for t in out.terms if t in rows]
    return replace(
        out,
        error=ErrorTerm(
            choice.source,
            choice.question,
            {r.term: float(r.df_error or 0) for r in listed},
            choice.reason,
        ),
        anova=Anova(kind, with_shares([*listed, *errors], total), out.y.size - 1, total),
        effects=effects,
        sphericity=spheres,
        fit=residuals.within_fit(out.data, out.y, plots=plots.code),
        plots=plots.code,
    )


def _table(out: Outcome, within: tuple[str, ...], plots: Plots) -> tuple[Crossed, Layout]:
    """Cells of the factors within blocks against blocks, and the group of each block kept."""
    data = out.data
    block = str(data.block)
    table = crossed(replace(data, factors=within), out.y)
    index = {name: i for i, name in enumerate(data.layout.levels[block])}
    kept = [index[name] for name in table.blocks]
    first = np.array([int(np.flatnonzero(data.layout.codes[block] == k)[0]) for k in kept])
    codes = {f: data.layout.codes[f][first] for f in plots.between}
    return table, Layout({f: data.layout.levels[f] for f in plots.between}, codes)


def _parts(
    out: Outcome, table: Crossed, within: tuple[str, ...], block: str, fit: Factored
) -> dict[Term, _Part]:
    cells = table.y.shape[0]
    bases: dict[Term, Array] = {(): np.ones((cells, 1)) / np.sqrt(cells)}
    terms = dict.fromkeys(tuple(f for f in t if f in within) for t in out.terms)
    inner = [t for t in terms if t]
    if inner:
        cell_model = factor(model_matrix(table.layout, inner), table.y.mean(axis=1))
        for s in term_sums(cell_model, "III"):
            bases[s.term] = cell_model.q @ s.basis
    parts = {}
    for term, basis in bases.items():
        values = basis.T @ (table.y - table.y[0, 0])
        residual = values - (values @ fit.q) @ fit.q.T
        name = f"{block}:{term_name(term)}" if term else block
        parts[term] = _Part(name, values, residual, values.shape[0] * fit.df_residual)
    return parts


def _directions(fit: Factored, kind: str, part: Term) -> list[tuple[Term, Array]]:
    """Orthonormal directions over blocks of the mean and of every term between blocks."""
    found: list[tuple[Term, Array]] = []
    if part:
        n = fit.q.shape[0]
        mean = np.ones((n, 1)) / np.sqrt(n)
        if kind == "III":
            mean = fit.q @ complement(fit.r[:, 1:], fit.r[:, :1])
        found.append(((), mean))
    return found + [(s.term, fit.q @ s.basis) for s in term_sums(fit, kind)]


def _row(
    term: Term,
    part: _Part,
    direction: Array,
    groups: Sequence[Ints],
    total: float,
    floor: float,
) -> Row:
    effect = part.values @ direction
    df, ss = effect.size, float(np.sum(effect**2))
    ss_error = float(np.sum(part.residual**2))
    name = term_name(term)
    if df == 0:
        return Row(name, 0, 0.0)
    if float(np.abs(part.residual).max(initial=0.0)) <= floor:
        return Row(name, df, ss, ss / df)
    ms_error = ss_error / part.df
    f, epsilon, df_error = _f(part, direction, groups, ss / df / ms_error)
    return Row(
        name,
        df,
        ss,
        ss / df,
        f,
        float(fdtrc(df, df_error, f)),
        part.name,
        df_error,
        epsilon,
        float(fdtrc(df * epsilon, df_error * epsilon, f)),
        max(0.0, (ss - df * ms_error) / (total + ms_error)),
        ss / (ss + ss_error),
    )


def _f(
    part: _Part, direction: Array, groups: Sequence[Ints], pooled: float
) -> tuple[float, float, float]:
    """F, epsilon and the degrees of freedom of the error before their correction by epsilon."""
    if groups:
        weights = np.array([direction[group].sum(axis=0) for group in groups]).T
        found = welch_box([part.values[:, group] for group in groups], weights)
        if found.f is not None and found.df1 is not None and found.df2 is not None:
            epsilon = found.df1 / (part.values.shape[0] * direction.shape[1])
            return found.f, epsilon, found.df2 / epsilon
    return pooled, epsilon_gg(part.residual @ part.residual.T), part.df


def _error_row(part: _Part) -> Row:
    ss = float(np.sum(part.residual**2))
    return Row(part.name, part.df, ss, ss / part.df)


def _sphere(part: _Part, fit: Factored) -> SphericityResult:
    """Sphericity of the residual contrasts: as many free columns as residual df, plus one."""
    left, s, _ = np.linalg.svd(part.residual, full_matrices=False)
    free = fit.df_residual
    scores = (left * s)[:, :free]
    # as deviations of free + 1 columns, which is what the test of one group expects
    helmert = np.linalg.qr(np.column_stack([np.ones(free + 1), np.eye(free + 1, free, -1)]))[0]
    return sphericity(scores @ helmert[:, 1 : scores.shape[1] + 1].T)


def _welch_effects(
    out: Outcome, rows: dict[Term, Row], table: Crossed, groups: Sequence[Ints]
) -> tuple[Effect, ...]:
    """Effects with variances of their own in each group of blocks, and simple effects."""
    data, asked = out.data, out.request
    index = {name: i for i, name in enumerate(table.blocks)}
    names = data.layout.levels[str(data.block)]
    of_row = np.array([index.get(names[c], -1) for c in data.layout.codes[str(data.block)]])
    kept = of_row >= 0
    layout = Layout(data.layout.levels, {f: c[kept] for f, c in data.layout.codes.items()})
    fit = factor(model_matrix(layout, out.terms), out.y[kept])
    per_row = (fit.model.inverse @ fit.q.T) * (out.y[kept] - fit.shift)
    added = per_row @ np.eye(len(table.blocks))[of_row[kept]]
    sample = over_groups(fit, added, groups, asked.alpha, asked.interval_seed)
    rivals = rivals_over_groups(out, fit, added, groups, sample)
    simple = judge_factors(out, layout, fit, sample, rivals)
    return tuple(
        size(_welch_estimate(out, fit, term, rows, added, groups), out.scale, simple)
        for term in out.terms
    )


def _welch_estimate(
    out: Outcome,
    fit: Factored,
    term: Term,
    rows: dict[Term, Row],
    added: Array,
    groups: Sequence[Ints],
) -> TermEstimate:
    """Estimate of a term; each difference has Welch's degrees of freedom."""
    levels, component_rows, mean_rows = term_rows(out.data.layout, fit, term)
    alpha, k = out.request.alpha, len(levels)
    component, mean = component_rows @ added, mean_rows @ added
    if not fit.estimable(component_rows).all():
        component = np.full_like(component, np.nan)
    first, second = (index.ravel() for index in np.indices((k, k)))
    df = group_errors(component[first] - component[second], groups)[1].reshape(k, k)
    error, df_mean = group_errors(mean, groups)
    centre = fit.shift + mean.sum(axis=1)
    centre[np.logical_not(fit.estimable(mean_rows))] = np.nan
    return TermEstimate(
        term,
        levels,
        component.sum(axis=1),
        centre,
        sum_of_covariances(component, groups),
        t_quantile(alpha / max(2, k * (k - 1)), df),
        t_quantile(alpha / 2, df_mean) * error,
        rows[term].p_deciding if term in rows else None,
        settings_of(out.data.layout, term),
    )


def sum_of_covariances(value: Array, groups: Sequence[Ints]) -> Array:
    """Covariance of sums over blocks, from the scatter in each group, shape (m, m).

    Parameters
    ----------
    value : ndarray, shape (m, b)
        What each block adds to m sums.
    groups : sequence of ndarray of int
        Indices of the blocks of each group, two or more.
    """
    parts = [len(group) * np.atleast_2d(np.cov(value[:, group])) for group in groups]
    return np.asarray(np.sum(parts, axis=0))


def _effects(out: Outcome, rows: dict[Term, Row], errors: list[Row]) -> tuple[Effect, ...]:
    """Effects with the pooled error of their stratum."""
    whole = factor(model_matrix(out.data.layout, out.terms), out.y)
    by_error = {row.term: row for row in errors}
    effects = []
    for term in out.terms:
        row = rows.get(term, Row(term_name(term), 0, 0.0))
        against = by_error.get(row.error or "")
        df = 0.0 if against is None else against.df * (row.epsilon_gg or 1.0)
        rss = 0.0 if against is None else (against.ms or 0.0) * df
        estimate = pooled_estimate(
            out.data.layout, whole, term, df, row.p_deciding, out.request.alpha, rss
        )
        effects.append(size(replace(estimate, mean_half=None), out.scale))
    return tuple(effects)
