"""The tables of a report: shown text and, for the CSV beside the report, the raw values."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from study.analysis.anova_table import Row
from study.analysis.convergence.grid_convergence import NumericalUncertainty
from study.canonical import plain
from study.reporting.content import sentences
from study.reporting.content.cases.case_records import by_cell
from study.reporting.content.sizes import numerical as u_num_of
from study.reporting.content.sizes import practical, size, size_interval
from study.reporting.content.table import Table
from study.reporting.content.verdicts import told
from study.reporting.numbers import (
    MISSING,
    THIN,
    duration,
    f_value,
    interval,
    level,
    p_value,
    quantity,
    share,
    significant,
)
from study.reporting.report import Facts, cells, is_effect
from study.reporting.text import clean, name_of, plural_of, term_name
from study.study_result.report_data import ReportData

if TYPE_CHECKING:
    import pandas as pd


def verdicts(found: Sequence[Facts], data: ReportData) -> Table:
    """One row a factor and response, and interactions that are not negligible.

    Parameters
    ----------
    found : sequence of Facts
        Sizes in the unit of each response, or as ratios.
    data : ReportData
        Better names of the factors, and ``alpha`` for the level in the heading.
    """
    rows, raw = [], []
    for facts in found:
        strong = [e for e in facts.interactions if e.strength == "matters"]
        for effect in (*facts.effects, *strong):
            rows.append(
                (
                    facts.title,
                    term_name(effect.term, data.labels),
                    told(effect),
                    size(effect, facts),
                    size_interval(effect, facts),
                    practical(effect, facts),
                    u_num_of(effect, facts),
                    p_value(effect.p),
                    p_value(effect.p_holm),
                )
            )
            raw.append(
                {
                    "response": facts.name,
                    "factor": effect.term,
                    "verdict": told(effect),
                    "effect": effect.range,
                    "low": effect.low,
                    "high": effect.high,
                    "practical": effect.practical,
                    "u_num": effect.u_num,
                    "effect_over_u_num": effect.effect_over_u_num,
                    "p": effect.p,
                    "p_holm": effect.p_holm,
                    "scale": "ratio" if effect.is_ratio else "difference",
                }
            )
    columns = (
        "response",
        "factor",
        "verdict",
        "largest difference",
        f"{level(data.alpha)} interval".replace(THIN, " "),
        "matters from",
        "U",
        "p",
        "p (Holm)",
    )
    return Table("verdicts", columns, tuple(rows), 3, 0, sentences.numerical(found), tuple(raw))


def anova(facts: Facts, data: ReportData) -> Table:
    """Return the ANOVA table of the effects; error strata stand in :func:`strata`.

    Parameters
    ----------
    facts : Facts
        The response; without any F the table has sums of squares, and p of Lenth where known.
    data : ReportData
        Factors, which tell effects from strata, their better names, and what a block is.

    Returns
    -------
    Table
        ``raw`` has all rows of the analysis, strata too.
    """
    effects = [row for row in facts.rows if is_effect(row, list(data.factors))]
    corrected = any(row.epsilon_gg is not None for row in effects)
    tested = any(row.f is not None for row in effects)
    columns = ["term", "df"]
    if tested:
        columns += ["F", "p"] + (["GG epsilon", "p corrected"] if corrected else [])
        columns += ["omega squared", "partial eta squared"]
    else:
        columns += ["sum of squares"] + (["p (Lenth)"] if facts.lenth else [])
    columns.append("share")
    rows = []
    for row in effects:
        cell = [term_name(row.term, data.labels), _df(row)]
        if tested:
            cell += [f_value(row.f), p_value(row.p)]
            if corrected:
                cell += [_fixed(row.epsilon_gg), p_value(row.p_deciding)]
            cell += [_fixed(row.omega_sq, 3), _eta(row)]
        else:
            cell += [significant(row.ss)]
            cell += [p_value(row.p)] if facts.lenth else []
        rows.append((*cell, share(row.share) if row.df else MISSING))
    note = " ".join(_anova_notes(effects, data, tested))
    raw = tuple(plain(row) for row in facts.rows)
    return Table(f"{facts.name}-anova", tuple(columns), tuple(rows), 1, 0, note, raw)


def _anova_notes(effects: Sequence[Row], data: ReportData, tested: bool) -> Iterator[str]:
    """Say what a reader may stumble over: a huge F, a test that was not made, the share."""
    block = clean(data.block)
    if any((row.f or 0) > 1e4 for row in effects):
        where = f"in every {block}" if block else "in every run"
        yield (
            f"F > 10,000: the effect is nearly the same {where}, so the error below the line is "
            "nearly zero; read the size of the effect, not its F."
        )
    if any(not row.df for row in effects):
        yield "df 0: not estimable, because cells without any answer leave no such comparison."
    if block and tested and any(row.f is None and row.df for row in effects):
        yield (
            f"{MISSING}: the effect is the same in every {block} to the tolerance of the solver, "
            "so there is nothing to test it against."
        )
    if data.block:
        yield f"Share: part of the total sum of squares, the {plural_of(block)} included."


def strata(facts: Facts, data: ReportData) -> Table:
    """Rows of the ANOVA table that are blocks or error.

    Parameters
    ----------
    facts : Facts
        Sums of squares on the scale of the analysis.
    data : ReportData
        Factors, which tell effects from strata, and what a block is.
    """
    names = {**data.labels, "block": data.labels.get("block", data.block or "block")}
    rows = tuple(
        (
            term_name(row.term, names),
            f"{row.df:g}",
            significant(row.ss),
            significant(row.ms),
            share(row.share),
        )
        for row in facts.rows
        if not is_effect(row, list(data.factors))
    )
    columns = ("stratum", "df", "sum of squares", "mean square", "share")
    return Table(f"{facts.name}-strata", columns, rows)


def _df(row: Row) -> str:
    return f"{row.df:g}" + (f", {row.df_error:g}" if row.df_error is not None else "")


def _fixed(value: float | None, decimals: int = 2) -> str:
    if value is None:
        return MISSING
    least = 10.0**-decimals
    return f"< {least:g}" if 0 < value < least / 2 else f"{value:.{decimals}f}"


def _eta(row: Row) -> str:
    text = _fixed(row.partial_eta_sq, 3)
    ends = row.partial_eta_sq_ci95
    return f"{text} ({interval(ends[0], ends[1])})" if ends else text


def matrix(data: ReportData, found: Sequence[Facts]) -> Table:
    """Every cell: how many cases gave a response, its means, its cost.

    Parameters
    ----------
    data : ReportData
        Cases with their status, responses and, where known, seconds.
    found : sequence of Facts
        A response that is no column of the table is left out.

    Returns
    -------
    Table
        Cells in the order of the design. A mean is over the blocks that all cells share,
        geometric for a log response; the mean time is over all cases of the cell.
    """
    factors = list(data.factors)
    known = [facts for facts in found if facts.name in data.table]
    means = {
        facts.name: dict(zip(*_columns(cells(data, facts.name), "cell", "mean"), strict=True))
        for facts in known
    }
    rows, raw = [], []
    for labels, group in by_cell(data):
        values = [means[facts.name].get(":".join(labels)) for facts in known]
        done = int((group["status"] == "converged").sum())
        seconds = float(group["seconds"].mean()) if "seconds" in group else None
        shown = [quantity(v, f.unit) for v, f in zip(values, known, strict=True)]
        status = f"{done} of {len(group)}"
        rows.append((*(clean(level) for level in labels), status, *shown, duration(seconds)))
        raw.append(
            {
                **dict(zip(factors, labels, strict=True)),
                "converged": done,
                "cases": len(group),
                **dict(zip(means, values, strict=True)),
                "seconds": seconds,
            }
        )
    columns = (
        *(name_of(f, data.labels) for f in factors),
        "cases",
        *(facts.title for facts in known),
        "mean time",
    )
    return Table("cells", columns, tuple(rows), len(factors), raw=tuple(raw))


def _columns(frame: pd.DataFrame, *names: str) -> list[list[object]]:
    return [frame[name].tolist() for name in names]


def numerical(items: Sequence[NumericalUncertainty], data: ReportData) -> Table:
    """Numerical uncertainty of each kind of discretization.

    Parameters
    ----------
    items : sequence of NumericalUncertainty
        One row each, in the unit of its response; ``u_num`` of a response in percent is in pp.
    data : ReportData
        Better names of factors and responses.
    """
    names = list(dict.fromkeys(name for item in items for name in item.levels))
    rows = tuple(
        (
            *(clean(item.levels.get(name, MISSING)) for name in names),
            name_of(item.response, data.labels),
            quantity(item.value, item.unit),
            quantity(item.u_num, "pp" if item.unit == "%" else item.unit, 2),
            clean(item.behaviour) or MISSING,
            clean(item.note),
        )
        for item in items
    )
    raw = tuple(
        {
            **{name: item.levels.get(name) for name in names},
            "response": item.response,
            "value": item.value,
            "u_num": item.u_num,
            "unit": item.unit,
            "behaviour": item.behaviour,
            "note": item.note,
        }
        for item in items
    )
    columns = (
        *(name_of(name, data.labels) for name in names),
        "response",
        "value",
        "u_num",
        "behavior",
        "how",
    )
    return Table("numerical", columns, rows, len(names) + 1, 2, raw=raw)


def failures(data: ReportData) -> Table:
    """Every failed case with what was said.

    Parameters
    ----------
    data : ReportData
        Its failures, one row each; a message is cut to 400 letters.
    """
    rows = tuple(
        (
            clean(item.case_id, 16),
            " \N{MIDDLE DOT} ".join(clean(level) for level in item.levels.values()),
            clean(item.block) or MISSING,
            clean(item.status),
            clean(item.message, 400),
        )
        for item in data.failures
    )
    return Table("failures", ("case", "cell", data.block or "block", "status", "message"), rows, 5)
