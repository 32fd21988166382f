"""A plan as the terminal shows it: cells, costs, further cells."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from study.cli import output
from study.cli.output import cells
from study.reporting.content import analysis_content, comparison_content, tables, verdicts
from study.reporting.content.numbers import MISSING
from study.reporting.content.report_facts import facts
from study.reporting.content.text import count
from study.reporting.results.study_answers import Beside
from study.reporting.results.study_result import ReportData
from study.statistics.analysis.anova_table import Effect
from study.statistics.analysis.simple_effects import CANNOT_TELL, NOT_RESOLVED, claim

if TYPE_CHECKING:
    from study.api.augmenting import Augmentation
    from study.api.comparison import StudyComparison
    from study.api.opened_study import Study
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


def _print_overview(overview: Overview) -> None:
    print(f"{overview.design.name}: {overview.design.question}\n")
    rows = [["cell", "computation", "calibration"]]
    rows += [
        [row.label, str(row.group), "-" if row.calibration is None else str(row.calibration)]
        for row in overview.matrix
    ]
    title = f"{len(overview.matrix)} cells, {overview.distinct} distinct computations"
    if overview.design.is_alone:  # a title is wrapped to a narrow table
        rows = [row[:2] for row in rows]
        print(title)
    more = len(overview.matrix) - FIRST_ROWS if len(overview.matrix) > ROWS else 0
    shown = rows[: 1 + FIRST_ROWS] if more else rows
    output.table(shown, "" if overview.design.is_alone else title)
    if more:
        print(f"and {more:,} more cells: --json lists all of them")
    if overview.distinct < len(overview.matrix):
        print("cells with the same number of a computation must agree: they are controls")
    for cell, why in overview.excluded:
        print(f"excluded: {cell.label}: {why}")
    print()
    _print_scheme(overview.design.scheme)
    for factor in overview.factors:
        levels = factor.levels
        if len(levels) > MANY:
            levels = (levels[0], f"{len(levels) - 2} more", levels[-1])
        print(f"{factor.name} ({', '.join(levels)}): {factor.note or 'varies'}")


def print_plan(planned: Plan) -> None:
    """Print cells, costs and what is left to be done."""
    _print_overview(planned.overview)
    print()
    if planned.blocks:
        print(f"{len(planned.blocks)} blocks: {', '.join(planned.blocks)}")
    if planned.overview.replicates is not None:
        print(f"replicates: {planned.overview.replicates.sentence}")
    cells = len(planned.overview.matrix)
    if len(planned.blocks) > 1 and cells * len(planned.blocks) == planned.total:
        print(f"{cells} cells in {len(planned.blocks)} blocks: a case is a cell in a block")
    print(output.counts(planned.counts))
    if planned.missing and planned.fits:
        calibrations = count(planned.fits, "calibration")
        print(f"{calibrations} to be made; each is shared by all cells that can")
    if planned.controls:
        solutions = count(planned.controls, "solution")
        print(f"{solutions} to be made of one cylinder in both spaces, a control")
    if planned.commands:
        calls = count(planned.program_calls, "call")
        print(f"{calls} of other programs, gradients by differences included:")
        print("\n".join(f"  {line}" for line in planned.commands))
        print(f"  to allow exactly these: study run --allow-digest {planned.digest}")
    if planned.predicted_seconds is not None:
        time = output.seconds(planned.predicted_seconds)
        workers, memory = count(planned.jobs, "worker"), f"{planned.memory_MB:.0f} MB of memory"
        print(f"predicted: {time} of computing on {workers}, {memory}")
    if planned.most_seconds is not None:
        print(f"with all cells that may be added: {output.seconds(planned.most_seconds)}")
    output.warn(planned.warnings)


def print_further(augmentation: Augmentation) -> None:
    """Print further cells, what they gain, and the table that runs them."""
    names = list(augmentation.cells[0])
    rows = [names, *([cell[name] for name in names] for cell in augmentation.cells)]
    print()
    output.table(rows, "Further cells")
    gain = f"{100 * augmentation.before:.0f} % before, {100 * augmentation.after:.0f} % after"
    output.paragraph(
        f"\nTold apart with them: {', '.join(augmentation.terms)}. Precision, of that of an "
        "orthogonal "
        f"design of as many cells: {gain}. Put this in place of [design] (what is computed stays):"
    )
    print(f"\n{augmentation.table()}")


# Tables of a report, narrow enough for a terminal.

Rows = list[list[str]]


def print_study(study: Study) -> None:
    """Print answer, verdicts and differences that the design asks for, then surfaces."""
    from study.api.assemble import report_data
    from study.cli import surface_tables

    data = report_data(study, study.manifest.get("timings", {}))
    print(f"\n{study.design.name}: {output.counts(study.cases)}")
    try:
        _print_answers(study, data)
    except (KeyError, ValueError, TypeError, AttributeError) as error:
        # the numbers are stored and the report is separate: a table must not end the run
        output.warn([f"the verdict table could not be printed: {error}"])
    if study.surfaces:
        surface_tables.print_surfaces(data)
    if study.beside is not None:
        print()
        output.paragraphs(beside_lines(study.beside))
    if study.report is not None:
        print(f"\nreport: {study.report}")


def _print_answers(study: Study, data: ReportData) -> None:
    output.paragraphs(study.answers)
    for title, rows in verdict_tables(data):
        print()
        output.table(rows, title)
    for item in facts(data):
        for effect in item.effects:
            if effect.verdict == NOT_RESOLVED or refused(effect):
                output.paragraph(verdicts.verdict(effect, item, data.labels))
        if (table := analysis_content.contrasts(item)) is not None:
            print()
            output.table(cells(table), f"{item.title}: asked for")


def verdict_tables(data: ReportData) -> list[tuple[str, Rows]]:
    """Title and verdict table of each response."""
    header, *rows = cells(tables.verdicts(facts(data), data))
    shown = [i for i, name in enumerate(header) if name != "response"]
    by_response: dict[str, Rows] = {}
    for row in rows:
        table = by_response.setdefault(row[0], [[header[i] for i in shown]])
        table.append([row[i] for i in shown])
    return list(by_response.items())


def refused(effect: Effect) -> bool:
    """Whether the interval of a difference makes a claim that its verdict does not."""
    ends = (effect.low, effect.high, effect.practical)
    if effect.verdict != CANNOT_TELL or None in ends:
        return False
    low, high, practical = (math.log(x) if effect.is_ratio else x for x in ends if x is not None)
    return bool(claim(low, high, practical))


def beside_lines(comparison: Beside) -> list[str]:
    """Return what holds in both studies, and what only one of them has."""
    return [*comparison_content.summary(comparison), *comparison_content.only_lines(comparison)]


def print_comparison(compared: StudyComparison) -> None:
    """Print what was changed, what holds, then the numbers of both studies."""
    comparison = compared.beside
    changed = comparison_content.changes(comparison)
    if changed.rows:
        output.table(cells(changed), "what was changed")
    else:
        print("nothing was changed: design, measurements and code are the same")
    print()
    output.paragraphs(beside_lines(comparison))
    for title, rows, note in beside_tables(comparison):
        print()
        output.table(rows, title)
        if note:
            output.paragraph(note)


def beside_tables(comparison: Beside) -> list[tuple[str, Rows, str]]:
    """Title, table and note of each response; a term is named in the first of its two rows."""
    header, *rows = cells(comparison_content.table(comparison))
    by_response: dict[str, Rows] = {}
    for row in rows:
        table = by_response.setdefault(row[0], [header[1:]])
        second = len(table) % 2 == 0
        table.append(["", "", *row[3:]] if second else row[1:])
    notes = dict(comparison_content.quiet_lines(comparison))
    titled: list[tuple[str, Rows, str]] = []
    for title, table in by_response.items():
        # columns that hold dashes alone are left out: a terminal is narrow
        filled = [i for i in range(len(table[0])) if any(row[i] != MISSING for row in table[1:])]
        titled.append((title, [[row[i] for i in filled] for row in table], notes.get(title, "")))
    return titled
