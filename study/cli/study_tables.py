"""A plan as the terminal shows it: cells, costs, further cells."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from study.cli import output
from study.reporting.content import analysis_content, comparison_content, tables, verdicts
from study.reporting.content.content_table import Table
from study.reporting.content.numbers import MISSING
from study.reporting.content.report_facts import facts
from study.reporting.content.text import count
from study.reporting.results.study_answers import Beside
from study.reporting.results.study_result import ReportData
from study.statistics.analysis.analysis_result import AnalysisResult
from study.statistics.analysis.anova_table import Effect
from study.statistics.analysis.simple_effects import CANNOT_TELL, NOT_RESOLVED, claim

if TYPE_CHECKING:
    from study.api.augmenting import Augmentation
    from study.api.planning import Plan
    from study.harness.design.overview import Overview
    from study.harness.design.spec import Scheme


#: levels of a factor beyond which a plan lists the ends only
MANY = 6
#: rows of a matrix that are looked at on a terminal; of a longer one the first stand for the rest
ROWS = 100
FIRST_ROWS = 20


def _print_scheme(scheme: Scheme) -> None:
    """Say what the choice of cells can and cannot tell."""
    if not scheme.summary:
        return
    print(scheme.summary)
    if scheme.defining_relation:
        print(f"defining relation: {scheme.defining_relation}")
    for sentence in scheme.aliases:
        print(f"  {sentence}")
    print()


def _print_overview(told: Overview) -> None:
    print(f"{told.design.name}: {told.design.question}\n")
    rows = [["cell", "computation", "calibration"]]
    rows += [
        [row.label, str(row.group), "-" if row.calibration is None else str(row.calibration)]
        for row in told.matrix
    ]
    title = f"{len(told.matrix)} cells, {told.distinct} distinct computations"
    if told.design.is_alone:  # a title is wrapped to a narrow table
        rows = [row[:2] for row in rows]
        print(title)
    more = len(told.matrix) - FIRST_ROWS if len(told.matrix) > ROWS else 0
    shown = rows[: 1 + FIRST_ROWS] if more else rows
    output.table(shown, "" if told.design.is_alone else title)
    if more:
        print(f"and {more:,} more cells: --json lists all of them")
    if told.distinct < len(told.matrix):
        print("cells with the same number of a computation must agree: they are controls")
    for one, why in told.excluded:
        print(f"excluded: {one.label}: {why}")
    print()
    _print_scheme(told.design.scheme)
    for factor in told.factors:
        levels = factor.levels
        if len(levels) > MANY:
            levels = (levels[0], f"{len(levels) - 2} more", levels[-1])
        print(f"{factor.name} ({', '.join(levels)}): {factor.note or 'varies'}")


def print_plan(found: Plan) -> None:
    """Print cells, costs and what is left to be done."""
    _print_overview(found.overview)
    print()
    if found.blocks:
        print(f"{len(found.blocks)} blocks: {', '.join(found.blocks)}")
    if found.overview.replicates is not None:
        print(f"replicates: {found.overview.replicates.sentence}")
    cells = len(found.overview.matrix)
    if len(found.blocks) > 1 and cells * len(found.blocks) == found.total:
        print(f"{cells} cells in {len(found.blocks)} blocks: a case is a cell in a block")
    print(output.counts(found.counts))
    if found.missing and found.fits:
        calibrations = count(found.fits, "calibration")
        print(f"{calibrations} to be made; each is shared by all cells that can")
    if found.controls:
        solutions = count(found.controls, "solution")
        print(f"{solutions} to be made of one cylinder in both spaces, a control")
    if found.commands:
        calls = count(found.program_calls, "call")
        print(f"{calls} of other programs, gradients by differences included:")
        print("\n".join(f"  {line}" for line in found.commands))
        print(f"  to allow exactly these: study run --allow-digest {found.digest}")
    if found.predicted_seconds is not None:
        time = output.seconds(found.predicted_seconds)
        workers, memory = count(found.jobs, "worker"), f"{found.memory_MB:.0f} MB of memory"
        print(f"predicted: {time} of computing on {workers}, {memory}")
    if found.most_seconds is not None:
        print(f"with all cells that may be added: {output.seconds(found.most_seconds)}")
    output.warn(found.warnings)


def print_further(found: Augmentation) -> None:
    """Print further cells, what they gain, and the table that runs them."""
    names = list(found.cells[0])
    rows = [names, *([cell[name] for name in names] for cell in found.cells)]
    print()
    output.table(rows, "Further cells")
    gain = f"{100 * found.before:.0f} % before, {100 * found.after:.0f} % after"
    output.paragraph(
        f"\nTold apart with them: {', '.join(found.terms)}. Precision, of that of an orthogonal "
        f"design of as many cells: {gain}. Put this in place of [design] (what is computed stays):"
    )
    print(f"\n{found.table()}")


# Tables of a report as plain rows for the terminal.

Rows = list[list[str]]


def verdict_rows(data: ReportData) -> Rows:
    """Verdict table; the first row is the header."""
    return _rows(tables.verdicts(facts(data), data))


def verdict_tables(data: ReportData) -> list[tuple[str, Rows]]:
    """Title and verdict table of each response, narrow enough for a terminal."""
    header, *rows = verdict_rows(data)
    shown = [i for i, name in enumerate(header) if name != "response"]
    found: dict[str, Rows] = {}
    for row in rows:
        table = found.setdefault(row[0], [[header[i] for i in shown]])
        table.append([row[i] for i in shown])
    return list(found.items())


def unresolved_lines(data: ReportData) -> list[str]:
    """Say of every factor that its interval does not leave open what does, and where."""
    said = [
        verdicts.verdict(effect, found, data.labels)
        for found in facts(data)
        for effect in found.effects
        if effect.is_main and (effect.verdict == NOT_RESOLVED or refused(effect))
    ]
    return [line.replace("\N{NO-BREAK SPACE}", " ") for line in said]


def refused(effect: Effect) -> bool:
    """Whether the interval of a difference makes a claim that its verdict does not."""
    ends = (effect.low, effect.high, effect.practical)
    if effect.verdict != CANNOT_TELL or None in ends:
        return False
    low, high, practical = (math.log(x) if effect.is_ratio else x for x in ends if x is not None)
    return bool(claim(low, high, practical))


def contrast_tables(data: ReportData) -> list[tuple[str, Rows]]:
    """Title and table of the differences that the design asks for, of each response."""
    found = [(item.title, analysis_content.contrasts(item)) for item in facts(data)]
    return [(f"{title}: asked for", _rows(table)) for title, table in found if table is not None]


def contrast_rows(found: AnalysisResult) -> Rows:
    """Differences of an analysis that were asked for; the first row is the header."""
    return _rows(analysis_content.contrast_table(found, found.request.response))


def answer_lines(data: ReportData) -> list[str]:
    """Return the sentences of the answer box, which cases fail, and what would change them."""
    from study.reporting.content import recommendation, sentences, tables

    found = facts(data)
    where = data.failure_pattern
    said = () if where is None else tables.failure_sentences(where, data.labels)
    change = f"What would change this? {recommendation.would_change(data, found)}"
    lines = [*sentences.answer(data, found), *said, change]
    return [line.replace("\N{NO-BREAK SPACE}", " ") for line in lines]


def changes_rows(beside: Beside) -> Rows:
    """Return the inputs in which two studies differ; the first row is the header."""
    return _rows(comparison_content.changes(beside))


def beside_lines(beside: Beside) -> list[str]:
    """Return what holds in both studies, and what only one of them has."""
    lines = [*comparison_content.summary(beside), *comparison_content.only_lines(beside)]
    return [line.replace("\N{NO-BREAK SPACE}", " ") for line in lines]


def beside_tables(beside: Beside) -> list[tuple[str, Rows, str]]:
    """Title, table and note of each response; a term is named in the first of its two rows."""
    header, *rows = _rows(comparison_content.table(beside))
    found: dict[str, Rows] = {}
    for row in rows:
        table = found.setdefault(row[0], [header[1:]])
        second = len(table) % 2 == 0
        table.append(["", "", *row[3:]] if second else row[1:])
    notes = dict(comparison_content.quiet_lines(beside))
    return [(title, _filled(table), notes.get(title, "")) for title, table in found.items()]


def _filled(rows: Rows) -> Rows:
    """Rows without the columns that hold dashes alone: a terminal is narrow."""
    kept = [i for i in range(len(rows[0])) if any(row[i] != MISSING for row in rows[1:])]
    return [[row[i] for i in kept] for row in rows]


def _rows(table: Table) -> Rows:
    # a terminal may not know the space that does not break
    rows = [list(table.columns), *(list(row) for row in table.rows)]
    return [[cell.replace("\N{NO-BREAK SPACE}", " ") for cell in row] for row in rows]
