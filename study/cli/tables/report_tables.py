"""Tables of a report as plain rows for the terminal."""

from __future__ import annotations

import math

from study.analysis.anova_table import Effect
from study.analysis.effects.verdict import CANNOT_TELL, NOT_RESOLVED, claim
from study.analysis.result import AnalysisResult
from study.reporting.content import analysis_tables, comparison, tables, verdicts
from study.reporting.content.table import Table
from study.reporting.numbers import MISSING
from study.reporting.report import facts
from study.study_result.comparison import Beside
from study.study_result.report_data import ReportData

Rows = list[list[str]]


def verdict_rows(data: ReportData) -> Rows:
    """Verdict table; the first row is the header.

    Parameters
    ----------
    data : ReportData
        Of a study, with all its responses.
    """
    return _rows(tables.verdicts(facts(data), data))


def verdict_tables(data: ReportData) -> list[tuple[str, Rows]]:
    """Title and verdict table of each response, narrow enough for a terminal.

    Parameters
    ----------
    data : ReportData
        Of a study, with all its responses.
    """
    header, *rows = verdict_rows(data)
    shown = [i for i, name in enumerate(header) if name != "response"]
    found: dict[str, Rows] = {}
    for row in rows:
        table = found.setdefault(row[0], [[header[i] for i in shown]])
        table.append([row[i] for i in shown])
    return list(found.items())


def unresolved_lines(data: ReportData) -> list[str]:
    """Say of every factor that its interval does not leave open what does, and where.

    Parameters
    ----------
    data : ReportData
        Main effects are looked at whose verdict is not resolved, or :func:`refused`.

    Returns
    -------
    list of str
        One line for each of them.
    """
    said = [
        verdicts.verdict(effect, found, data.labels)
        for found in facts(data)
        for effect in found.effects
        if effect.is_main and (effect.verdict == NOT_RESOLVED or refused(effect))
    ]
    return [line.replace("\N{NO-BREAK SPACE}", " ") for line in said]


def refused(effect: Effect) -> bool:
    """Whether the interval of a difference makes a claim that its verdict does not.

    Parameters
    ----------
    effect : Effect
        One without an interval or without a practical difference makes no claim.
    """
    ends = (effect.low, effect.high, effect.practical)
    if effect.verdict != CANNOT_TELL or None in ends:
        return False
    low, high, practical = (math.log(x) if effect.is_ratio else x for x in ends if x is not None)
    return bool(claim(low, high, practical))


def contrast_tables(data: ReportData) -> list[tuple[str, Rows]]:
    """Title and table of the differences that the design asks for, of each response.

    Parameters
    ----------
    data : ReportData
        Responses without such differences are left out.
    """
    found = [(item.title, analysis_tables.contrasts(item)) for item in facts(data)]
    return [(f"{title}: asked for", _rows(table)) for title, table in found if table is not None]


def contrast_rows(found: AnalysisResult) -> Rows:
    """Differences of an analysis that were asked for; the first row is the header.

    Parameters
    ----------
    found : AnalysisResult
        With its contrasts.
    """
    return _rows(analysis_tables.contrast_table(found, found.request.response))


def answer_lines(data: ReportData) -> list[str]:
    """Return the sentences of the answer box, which cases fail, and what would change them.

    Parameters
    ----------
    data : ReportData
        Without failed cases nothing is said of failures.
    """
    from study.reporting.content import recommendation, sentences
    from study.reporting.content.cases import failed_cases

    found = facts(data)
    where = data.failure_pattern
    said = () if where is None else failed_cases.sentences(where, data.labels)
    change = f"What would change this? {recommendation.would_change(data, found)}"
    lines = [*sentences.answer(data, found), *said, change]
    return [line.replace("\N{NO-BREAK SPACE}", " ") for line in lines]


def changes_rows(beside: Beside) -> Rows:
    """Return the inputs in which two studies differ; the first row is the header.

    Parameters
    ----------
    beside : Beside
        Where nothing differs the header is alone.
    """
    return _rows(comparison.changes(beside))


def beside_lines(beside: Beside) -> list[str]:
    """Return what holds in both studies, and what only one of them has.

    Parameters
    ----------
    beside : Beside
        Two studies that were compared.
    """
    lines = [*comparison.summary(beside), *comparison.only_lines(beside)]
    return [line.replace("\N{NO-BREAK SPACE}", " ") for line in lines]


def beside_tables(beside: Beside) -> list[tuple[str, Rows, str]]:
    """Title, table and note of each response; a term is named in the first of its two rows.

    Parameters
    ----------
    beside : Beside
        Two studies that were compared.

    Returns
    -------
    list of tuple
        The note is empty where there is none; columns of dashes alone are left out of the table.
    """
    header, *rows = _rows(comparison.table(beside))
    found: dict[str, Rows] = {}
    for row in rows:
        table = found.setdefault(row[0], [header[1:]])
        second = len(table) % 2 == 0
        table.append(["", "", *row[3:]] if second else row[1:])
    notes = dict(comparison.quiet_lines(beside))
    return [(title, _filled(table), notes.get(title, "")) for title, table in found.items()]


def _filled(rows: Rows) -> Rows:
    """Rows without the columns that hold dashes alone: a terminal is narrow."""
    kept = [i for i in range(len(rows[0])) if any(row[i] != MISSING for row in rows[1:])]
    return [[row[i] for i in kept] for row in rows]


def _rows(table: Table) -> Rows:
    # a terminal may not know the space that does not break
    rows = [list(table.columns), *(list(row) for row in table.rows)]
    return [[cell.replace("\N{NO-BREAK SPACE}", " ") for cell in row] for row in rows]
