"""A plan as the terminal shows it: cells, costs, further cells."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from study.cli import output
from study.reporting.content import (
    analysis_content,
    comparison_content,
    surface_content,
    tables,
    verdicts,
)
from study.reporting.content.blocks import Sentence, Table, Verbatim
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
    from study.harness.design.overview import CellOverview, Overview
    from study.harness.design.spec import Scheme
    from study.reporting.content.blocks import Block


#: levels of a factor beyond which a plan lists the ends only
MANY = 6
#: rows of a matrix that are looked at on a terminal; of a longer one the first stand for the rest
ROWS = 100
FIRST_ROWS = 20


def _scheme(scheme: Scheme) -> Iterator[Block]:
    """Say what the choice of cells can and cannot tell."""
    if not scheme.summary:
        return
    yield Verbatim(scheme.summary)
    if scheme.defining_relation:
        yield Verbatim(f"defining relation: {scheme.defining_relation}")
    yield from (Verbatim(f"  {sentence}") for sentence in scheme.aliases)
    yield Verbatim("")


def _overview(overview: Overview) -> Iterator[Block]:
    yield Verbatim(f"{overview.design.name}: {overview.design.question}\n")
    columns: dict[str, Callable[[CellOverview], str]] = {
        "cell": lambda row: row.label,
        "computation": lambda row: str(row.group),
    }
    title = f"{len(overview.matrix)} cells, {overview.distinct} distinct computations"
    if overview.design.is_alone:  # a title is wrapped to a narrow table
        yield Verbatim(title)
        title = ""
    else:
        columns["calibration"] = lambda row: (
            "-" if row.calibration is None else str(row.calibration)
        )
    more = len(overview.matrix) - FIRST_ROWS if len(overview.matrix) > ROWS else 0
    shown = overview.matrix[:FIRST_ROWS] if more else overview.matrix
    yield Table.of(title, shown, columns)
    if more:
        yield Verbatim(f"and {more:,} more cells: --json lists all of them")
    if overview.distinct < len(overview.matrix):
        yield Verbatim("cells with the same number of a computation must agree: they are controls")
    yield from (Verbatim(f"excluded: {cell.label}: {why}") for cell, why in overview.excluded)
    yield Verbatim("")
    yield from _scheme(overview.design.scheme)
    for factor in overview.factors:
        levels = factor.levels
        if len(levels) > MANY:
            levels = (levels[0], f"{len(levels) - 2} more", levels[-1])
        yield Verbatim(f"{factor.name} ({', '.join(levels)}): {factor.note or 'varies'}")


def plan_blocks(planned: Plan) -> Iterator[Block]:
    """Cells, costs and what is left to be done."""
    yield from _overview(planned.overview)
    yield Verbatim("")
    if planned.blocks:
        yield Verbatim(f"{len(planned.blocks)} blocks: {', '.join(planned.blocks)}")
    if planned.overview.replicates is not None:
        yield Verbatim(f"replicates: {planned.overview.replicates.sentence}")
    cells = len(planned.overview.matrix)
    if len(planned.blocks) > 1 and cells * len(planned.blocks) == planned.total:
        yield Verbatim(
            f"{cells} cells in {len(planned.blocks)} blocks: a case is a cell in a block"
        )
    yield Verbatim(output.counts(planned.counts))
    if planned.missing and planned.fits:
        calibrations = count(planned.fits, "calibration")
        yield Verbatim(f"{calibrations} to be made; each is shared by all cells that can")
    if planned.controls:
        solutions = count(planned.controls, "solution")
        yield Verbatim(f"{solutions} to be made of one cylinder in both spaces, a control")
    if planned.commands:
        calls = count(planned.program_calls, "call")
        yield Verbatim(f"{calls} of other programs, gradients by differences included:")
        yield from (Verbatim(f"  {line}") for line in planned.commands)
        yield Verbatim(f"  to allow exactly these: study run --allow-digest {planned.digest}")
    if planned.predicted_seconds is not None:
        time = output.seconds(planned.predicted_seconds)
        workers, memory = count(planned.jobs, "worker"), f"{planned.memory_MB:.0f} MB of memory"
        yield Verbatim(f"predicted: {time} of computing on {workers}, {memory}")
    if planned.most_seconds is not None:
        yield Verbatim(f"with all cells that may be added: {output.seconds(planned.most_seconds)}")


def further_blocks(augmentation: Augmentation) -> Iterator[Block]:
    """Further cells, what they gain, and the table that runs them."""
    names = tuple(augmentation.cells[0])
    rows = tuple(tuple(cell[name] for name in names) for cell in augmentation.cells)
    yield Table("Further cells", names, rows)
    gain = f"{100 * augmentation.before:.0f} % before, {100 * augmentation.after:.0f} % after"
    yield Sentence(
        f"Told apart with them: {', '.join(augmentation.terms)}. Precision, of that of an "
        f"orthogonal design of as many cells: {gain}. Put this in place of [design] (what is "
        "computed stays):"
    )
    yield Verbatim(f"\n{augmentation.table()}")


# Tables of a report, narrow enough for a terminal.


def study_blocks(study: Study) -> Iterator[Block | None]:
    """Answer, verdicts and differences that the design asks for, then surfaces."""
    from study.api.assemble import report_data

    data = report_data(study, study.manifest.get("timings", {}))
    yield Verbatim(f"\n{study.design.name}: {output.counts(study.cases)}")
    try:
        yield from list(_answers(study, data))
    except (KeyError, ValueError, TypeError, AttributeError) as error:
        # the numbers are stored and the report is separate: a table must not end the run
        output.warn([f"the verdict table could not be printed: {error}"])
    yield from surface_content.surface_blocks(data)
    if study.beside is not None:
        yield Verbatim("")
        yield from beside_lines(study.beside)
    if study.report is not None:
        yield Verbatim(f"\nreport: {study.report}")


def _answers(study: Study, data: ReportData) -> Iterator[Block]:
    yield from map(Sentence, study.answers)
    yield from verdict_tables(data)
    for item in facts(data):
        for effect in item.effects:
            if effect.verdict == NOT_RESOLVED or refused(effect):
                yield Sentence(verdicts.verdict(effect, item, data.labels))
        if (table := analysis_content.contrasts(item)) is not None:
            yield replace(table, name=f"{item.title}: asked for", note="")


def verdict_tables(data: ReportData) -> list[Table]:
    """Verdict table of each response, with its title in place of the column of responses."""
    whole = tables.verdicts(facts(data), data)
    return by_response(replace(whole, note=""))


def by_response(whole: Table) -> list[Table]:
    """Split a table by its first column, which becomes the name."""
    rows: dict[str, list[tuple[str, ...]]] = {}
    for row in whole.rows:
        rows.setdefault(row[0], []).append(row[1:])
    return [
        replace(whole, name=name, columns=whole.columns[1:], rows=tuple(part), raw=())
        for name, part in rows.items()
    ]


def refused(effect: Effect) -> bool:
    """Whether the interval of a difference makes a claim that its verdict does not."""
    ends = (effect.low, effect.high, effect.practical)
    if effect.verdict != CANNOT_TELL or None in ends:
        return False
    low, high, practical = (math.log(x) if effect.is_ratio else x for x in ends if x is not None)
    return bool(claim(low, high, practical))


def beside_lines(comparison: Beside) -> Iterator[Sentence]:
    """Return what holds in both studies, and what only one of them has."""
    yield from map(Sentence, comparison_content.summary(comparison))
    yield from map(Sentence, comparison_content.only_lines(comparison))


def comparison_blocks(compared: StudyComparison) -> Iterator[Block]:
    """Say what was changed, what holds, then the numbers of both studies."""
    comparison = compared.beside
    changed = comparison_content.changes(comparison)
    if changed.rows:
        yield replace(changed, name="what was changed")
    else:
        yield Verbatim("nothing was changed: design, measurements and code are the same")
    yield Verbatim("")
    yield from beside_lines(comparison)
    yield from beside_tables(comparison)


def beside_tables(comparison: Beside) -> Iterator[Table]:
    """Table of each response; a term is named in the first of its two rows."""
    notes = dict(comparison_content.quiet_lines(comparison))
    for table in by_response(comparison_content.table(comparison)):
        rows = [("", "", *row[2:]) if k % 2 else row for k, row in enumerate(table.rows)]
        # columns that hold dashes alone are left out: a terminal is narrow
        filled = [i for i in range(len(rows[0])) if any(row[i] != MISSING for row in rows)]
        yield replace(
            table,
            columns=tuple(table.columns[i] for i in filled),
            rows=tuple(tuple(row[i] for i in filled) for row in rows),
            note=notes.get(table.name, ""),
        )
