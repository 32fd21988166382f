"""The two pages of a report: the answer and what it rests on, then everything else."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from study.reporting.content import (
    analysis_content,
    comparison_content,
    effect_words,
    methods,
    sentences,
    surface_content,
    tables,
)
from study.reporting.content.blocks import (
    Block,
    Blocks,
    Card,
    Definition,
    Definitions,
    Figure,
    Figures,
    Folded,
    Heading,
    Points,
    Sentence,
    Verbatim,
    titled,
)
from study.reporting.content.report_facts import Facts, facts, grouped_inputs
from study.reporting.content.text import (
    capital,
    clean,
    count,
    duration,
    listing,
    name_of,
    plural_of,
    sentence,
    slug,
    slugs,
    trimmed,
)
from study.reporting.figures.axes import figures_of
from study.reporting.output.page import Page, Pages, page_names
from study.reporting.results.study_result import FITTED_CURVE, Check, ReportData

if TYPE_CHECKING:
    from study.execution.local import Worker

_VERSION = "version of "


def prepare(data: ReportData, worker: Worker | None = None) -> Pages:
    """Compute every sentence, table and figure of a report."""
    from study.reporting.figures import study_figures, surface_figures

    # what these figures do not need is not sent: an analysis of 4,096 cells has 400 MB of matrices
    of_study = partial(study_figures.of_study, replace(data, analyses=(), surfaces=()))
    figures = of_study if worker is None else worker.begin(of_study)
    all_facts = facts(data)
    of_each = {item.name: study_figures.of_response(data, item) for item in all_facts}
    shapes = {surface_content.title(fit, data): fit for fit in data.surfaces}
    names = {title: f"surface-{name}" for title, name in slugs(shapes).items()}
    over = {
        title: figures_of(surface_figures.drawings(fit, data), names[title], title)
        for title, fit in shapes.items()
    }
    effects = study_figures.overview(data, all_facts)
    shares = next((of["shares"] for of in over.values() if "shares" in of), None)
    if shares is not None and effects is None:
        effects = replace(shares, name="overview")
    parts = [(item, of_each[item.name]) for item in all_facts if item.terms or not shapes]
    middle: list[Block | None] = []
    if profilers := surface_figures.profilers(data):
        middle += [Heading("Prediction profiler", 2, "profiler"), *profilers]
    for title, fit in shapes.items():
        middle += surface_content.surface_blocks(fit, data, names[title], over[title])
        notes = () if fit.surface is None else fit.surface.notes
        middle += [Sentence(sentence(text), kind="note") for text in notes]
    middle += [block for part in parts for block in _response(data, *part)]
    of_all = figures()
    blocks = [
        *_study(data, all_facts),
        *_checks(data, all_facts, of_all),
        *error_terms(data, all_facts if parts else ()),
        *middle,
        *_expected(data, all_facts),
        *_beside(data),
        *_assumptions(data, parts),
        *_specimens(data, of_all),
        *_failures(data, of_all),
        *_cost(data, parts),
    ]
    curves = of_all.get("few-curves", of_all.get("curves"))
    if curves is None:
        curves = next(iter(surface_figures.profilers(data, is_first_page=True)), None)
    # of a table of levels that a surface replaces, nothing is missed
    pairs = [(item.title, warning) for item, _ in parts for warning in item.warnings]
    warnings = (*dict.fromkeys(data.warnings), *sentences.folded(pairs, data))
    shown = effects, curves
    return two_pages(data, all_facts, slug(data.name), data.name, shown, blocks, warnings)


def anchor_of(item: Facts, data: ReportData) -> str:
    """Name of the section of a response."""
    return f"r-{slugs(response.name for response in data.analyses)[item.name]}"


def two_pages(
    data: ReportData,
    all_facts: Sequence[Facts],
    stem: str,
    name: str,
    figures: tuple[Figure | None, Figure | None],
    details: Iterable[Block | None],
    warnings: Sequence[str],
    rows: str = "cases.csv",
) -> Pages:
    """Question, answer, effects, checks, curves, what to do; then all effects and the details.

    ``figures`` are those of the effects and of the curves.
    """
    effects, curves = figures
    answer = in_few((*sentences.answer(data, all_facts, is_short=True), *_held(data)))
    advice = what_to_do(data, all_facts)
    would_change = sentences.would_change(data, all_facts)
    blocks: list[Block] = [Heading("Answer", 2, "answer"), *map(Sentence, answer)]
    if effects is not None:
        blocks += [Heading(effects.title, 2, "effects"), effects]
    if curves is not None:
        words = curves.title if data.surfaces else "Measured and predicted"
        blocks += [Heading(words, 2, "curves"), curves]
    checks = analysis_content.all_checks(data, all_facts)
    blocks += [Heading("Report card", 2, "card"), report_card(checks, data)]
    title = "Recommendation" if advice else "What would change this"
    if data.surfaces and advice:
        title = "Smallest and largest predictions"
    blocks += [Heading(title, 2, "recommendation"), *map(Sentence, advice)]
    blocks.append(Sentence(would_change, "What would change this." if advice else ""))
    kicker = "Analysis of a table" if data.is_table else "Study report"
    files, more = f"{stem}-data", "All tables, figures, checks and methods"
    links = {"effects": "table-verdicts.csv", "every row": rows, "all statistics": "numbers.json"}
    first = Page(
        title=f"{name}: {kicker.lower()}",
        kicker=kicker,
        name=name,
        question=data.question,
        blocks=blocks,
        files=files,
        flag="virtual specimens" if data.virtual else "",
        unfinished=sentences.partial(data),
        footer=(
            Sentence(more, kind="more", links=((more, page_names(stem)[1]),)),
            _linked(f"Data: {', '.join(links)}.", links, files),
        ),
    )
    second = replace(
        first,
        title=f"{name}: details" if name == data.name else f"{name}, {data.name}: details",
        blocks=[
            *_effects(data, all_facts, files, rows),
            *details,
            Heading("Methods, to paste", 2, "methods", short="Methods"),
            Sentence(methods.paragraph(data, all_facts), kind="quote"),
            *_provenance(data, warnings),
            Heading("Glossary", 2, "glossary"),
            Definitions.of(methods.TERMS.items()),
        ],
        back=page_names(stem)[0],
        about=data.name,
        unfinished="",
        footer=(),
    )
    return Pages(first, second)


# The first page in words: an answer of few sentences, a line for every check, what to do.

#: sentences of the answer
MOST_SENTENCES = 5
_END = re.compile(r"(?<=[.?!])\s+(?=[A-Z\N{MULTIPLICATION SIGN}])")


def in_few(lines: Iterable[str]) -> tuple[str, ...]:
    """Return the lines that together have at most five sentences, the first sentence by itself."""
    shown: list[str] = []
    left = MOST_SENTENCES
    for line in filter(None, lines):
        parts = _END.split(line)
        if not shown:
            shown += filter(None, (parts[0], " ".join(parts[1:left])))
        elif len(parts) <= left:
            shown.append(line)
        else:
            continue
        left -= min(len(parts), left)
    return tuple(shown)


def report_card(checks: Iterable[Check], data: ReportData) -> Card:
    """Return one line a check, the worst first, and one for the notes of the second page.

    A check that does not apply, and changes nothing, stands on the second page alone.
    """
    lines = []
    for group in analysis_content.by_name(checks):
        first = group[0]
        if first.outcome == "not applicable" and not first.consequence:
            continue
        worst = [check for check in group if check.outcome == first.outcome]
        meaning = first.consequence or first.finding
        named = listing([check.of for check in worst if check.of])
        if named and len(worst) < len(group):
            meaning = f"{named}: {meaning}"
        lines.append((first.outcome, sentence(first.name).rstrip("."), sentence(meaning)))
    if number := len(data.warnings) + len(data.data_notes):
        notes = f"{count(number, 'note')} on the data and the run, on the second page."
        lines.append(("note", "Notes", notes))
    return Card(lines)


def what_to_do(data: ReportData, all_facts: Sequence[Facts]) -> tuple[str, ...]:
    """Recommendation of every response that has a better end; why there is none otherwise."""
    if data.surfaces and not any(facts.terms for facts in all_facts):
        first = data.surfaces[: sentences.MOST_RESPONSES]
        lines = [
            sentence(f"{surface_content.title(finding, data)}. {ends}")
            for finding in first
            if (ends := " ".join(surface_content.extremes(finding, data)))
        ]
        if more := len(data.surfaces) - len(first):
            lines.append(f"The second page has those of {count(more, 'more surface')}.")
        return tuple(lines)
    if data.is_table:
        return ()
    if advice := sentences.recommendations(data, all_facts):
        return advice
    if not any(facts.terms for facts in all_facts):
        return ("Nothing can be recommended, because no response could be analyzed.",)
    return (
        "No goal (minimize or maximize) was given, so no best setting is named: choose by the "
        "effects above and by cost.",
    )


def _linked(words: str, links: Mapping[str, str], folder: str) -> Sentence:
    """Note with the files of a report that it names."""
    addresses = tuple((part, f"{folder}/{name}") for part, name in links.items())
    return Sentence(words, kind="note", links=addresses)


def _held(data: ReportData) -> tuple[str, ...]:
    """Say how many conclusions hold in the other study too; empty without one."""
    return comparison_content.summary(data.beside, data.labels)[:1] if data.beside else ()


def _effects(data: ReportData, all_facts: Sequence[Facts], files: str, rows: str) -> Blocks:
    yield Heading("Effects in full", 2, "answer")
    yield from map(Sentence, (*sentences.answer(data, all_facts), *_held(data)))
    table = tables.verdicts(all_facts, data)
    anchors = {item.title: anchor_of(item, data) for item in all_facts if not data.is_table}
    yield replace(table, links=tuple(anchors.get(row[0], "") for row in table.rows))
    if table.rows:
        links = {"these numbers as CSV": "table-verdicts.csv", rows: rows}
        words = f"these numbers as CSV; every case they come from: {rows}"
        if data.curves:
            links |= {"curves.csv.gz": "curves.csv.gz"}
            words += "; every point of every curve: curves.csv.gz"
        yield _linked(f"{words}.", links, files)


def _study(data: ReportData, all_facts: Sequence[Facts]) -> Iterator[Block]:
    cells, records = tables.matrix(data, all_facts), tables.case_records(data, all_facts)
    if records is not None:
        names = tuple(f"{tables.CELL}{k}" for k in range(1, len(cells.rows) + 1))
        cells = replace(cells, links=names)
    measured = data.citation or "No citation given."
    if data.virtual:
        measured = f"Generated, not measured: {data.citation or 'virtual specimens'}"
    elif data.imported:
        measured = " ".join(data.imported)
    elif not data.is_measured:
        measured = "none: every response is one of the simulation alone"
    present = len(cells.rows)
    computed = f"{present:,} of {count(data.planned, 'cell')} computed"
    if present >= data.planned:
        computed = count(present, "cell")
    inputs = grouped_inputs(data.inputs)
    yield Heading("Study", 2, "study")
    yield Definitions([
        Definition("Factors", [
            Sentence(data.ranges.get(key) or ", ".join(levels), name_of(key, data.labels))
            for key, levels in data.factors.items()
        ]),
        *blocks_of(data, len(data.blocks)),
        Definition("Cases", [Sentence(f"{computed}, {len(data.table):,} cases")]),
        Definition("Responses", [Sentence(note(f), f.title) for f in all_facts]),
        Definition("Measurements", [Sentence(measured)]),
        *(Definition(key, [Sentence(text)], "assumed" * (key in data.assumed))
          for key, text in inputs.items()),
        *(Definition(key, [Sentence(text)], "assumed")
          for key, text in data.assumed.items() if key not in inputs),
        *([Definition("Excluded", [Sentence(f"{what}: {why}") for what, why in data.exclusions])]
          if data.exclusions else []),
    ])  # fmt: skip
    summary = f"The matrix: {present} cells with their means and times"
    yield Folded(summary, (cells,), "matrix")
    if records is not None:
        summary = f"Every case with its record: {len(records.rows):,}"
        yield Folded(summary, (records,), "records")


def blocks_of(data: ReportData, most: int) -> list[Definition]:
    """Name the blocks, the first of many; nothing where there are none."""
    if not data.blocks:
        return []
    more = f", and {len(data.blocks) - most} more" if len(data.blocks) > most else ""
    named = ", ".join(data.blocks[:most])
    return [Definition("Blocks", [Sentence(f"{len(data.blocks)} ({data.block}): {named}{more}")])]


def note(response: Facts) -> str:
    """Say what was declared of a response: its unit, what matters, how it is analyzed."""
    parts = [response.unit] if response.unit else []
    if response.practical is not None:
        limit = f"{trimmed(response.practical, 6)} {response.difference_unit}"
        if response.relative:
            limit = f"{100 * response.practical:g} % of the mean"
        parts.append(f"a difference of {limit.strip()} matters")
    if response.transform == "log":
        parts.append("analyzed on the log, effects are ratios")
    if response.scored_on == FITTED_CURVE:
        parts.append("scored on the curve fitted: it says how well a model fits, not predicts")
    elif response.cross_validated:
        parts.append("each specimen predicted by constants fitted to the other specimens")
    elif response.scored_on:
        parts.append(f"scored on: {response.scored_on}")
    if response.better:
        parts.append(f"{response.better} is better")
    return "; ".join(parts)


def _checks(data: ReportData, all_facts: Sequence[Facts], figures: Figures) -> Blocks:
    yield Heading("Checks", 2, "checks")
    yield analysis_content.check_table(analysis_content.all_checks(data, all_facts), "checks")
    if data.is_table:
        return
    yield Heading("Numerical credibility", 2, "numerics")
    if data.numerical:
        yield Sentence(
            f"How far the answer still depends on the {data.refinement.name}. U, the bound of this "
            "error for a difference, is added to both ends of its interval."
        )
        yield tables.numerical(data.numerical, data)
    else:
        yield Sentence(
            "No mesh refinement was made for this study, so the numerical uncertainty is unknown: "
            "differences between discretizations are not separated from mesh error."
        )
    yield figures.get("convergence")
    if data.validation:
        yield Heading("Comparison with the measurements, E \N{PLUS-MINUS SIGN} u_val")
        yield Sentence(
            "E is simulated minus measured force at the end of the curve; u_val adds up what the "
            "mesh, the uncertain inputs and the scatter of the data leave open (ASME V&V 20). "
            "Where |E| is larger, the model is wrong by about E; where it is smaller, nothing can "
            "be said of the model."
        )
        yield figures["validation"]
        yield tables.validation(data.validation, data.block)
    if data.controls:
        yield Heading("Controls")
        yield analysis_content.check_table(data.controls, "controls")


def error_terms(data: ReportData, all_facts: Sequence[Facts]) -> Iterator[Block]:
    """Say what effects are compared with."""
    if not all_facts:
        return
    yield Heading("Error term", 2, "error")
    for who, text in sentences.error_terms(data, all_facts):
        yield Sentence(text, "" if data.is_table else who)
    if data.virtual:
        yield Sentence(sentences.VIRTUAL)


def drawn(figures: Figures, *kinds: str) -> Iterator[Figure]:
    """Figures of some kinds, those that were drawn."""
    return (figures[kind] for kind in kinds if kind in figures)


def _response(data: ReportData, item: Facts, figures: Figures) -> Blocks:
    yield Heading(capital(item.title), 2, anchor_of(item, data), item.unit)
    if item.result is None or not item.terms:
        yield Sentence(f"Not analyzed. {' '.join(item.warnings)}", kind="missing")
        return
    yield analysis_content.open_effects(item, data)
    yield from titled(analysis_content.contrasts(item), analysis_content.ASKED)
    yield from drawn(figures, "contrasts")
    title = f"Analysis of variance, type {item.result.anova.type}"
    yield from titled(tables.anova(item, data), title)
    yield Folded(tables.SIZES, (tables.sizes(item, data),))
    yield from drawn(figures, "means", "interactions", "cells")
    if tables.lists_records(data):
        yield Sentence(
            "The cells behind these means stand in the matrix, which leads to the record of every "
            "case.",
            kind="note",
            links=(("the matrix", "#matrix"),),
        )
    if "depth" in figures:
        yield Heading("Effects against the depth of the test")
        yield figures["depth"]


def _expected(data: ReportData, all_facts: Sequence[Facts]) -> Iterator[Block]:
    if data.expected:
        yield Heading("What was expected", 2, "expected")
        yield Sentence(
            "Expectations that the design states, beside what the study found. A larger effect is "
            "one whose interval lies above the other's; a cell behind the best by less than what "
            "matters may be the best."
        )
        yield effect_words.table(data, all_facts)


def _beside(data: ReportData) -> Iterator[Block]:
    if data.beside is None:
        return
    yield Heading(f"Compared with {data.beside.names[1]}", 2, "beside")
    yield Sentence(
        "Which conclusions of this study hold in another one too. A conclusion that survives the "
        "changes listed here is stronger than either study alone."
    )
    yield from comparison_content.beside_blocks(data.beside, data.labels)


def _assumptions(data: ReportData, parts: Sequence[tuple[Facts, Figures]]) -> Blocks:
    blocks: list[Block] = []
    for item, figures in parts:
        if item.result is not None and item.terms:
            name = f"tests of assumptions {item.name}"
            table = analysis_content.checks(item.result, name, data.labels)
            shown = [block for block in (table, *drawn(figures, "residuals", "spread")) if block]
            blocks += [Heading(capital(item.title)), *shown] if shown else []
    if blocks:
        yield Heading("Assumptions", 2, "assumptions")
        yield from blocks


def _specimens(data: ReportData, figures: Figures) -> Blocks:
    if "few-curves" in figures:
        yield Heading("Curves", 2, "curves")
        yield figures["curves"]
    if data.fits:
        yield Heading("Fitted constants", 2, "constants")
        yield Sentence(
            f"Median and range over the fits of all {plural_of(data.block or 'block')}; standard "
            "error (relative), correlation and residual are medians. A constant that the data do "
            "not determine, because its interval is wide or another constant can make up for it, "
            "is a number without a meaning of its own: only the curve that it helps to draw counts."
        )
        yield figures.get("constants")
        yield tables.fits(data)
        yield Folded("Every fit with its 95 % interval", (tables.every_fit(data),))
    if data.markers:
        yield Heading("Markers inside the specimen", 2, "markers", short="Markers")
        yield Sentence(
            "Root mean square distance between measured and predicted places of the markers, "
            "beside the motion of the plate that leaves it (with its standard error where it was "
            "fitted). The floor is how far the measured displacements are from any smooth field: "
            "what is localization, and no model can mend. Markers that told the motion of the "
            "plate judge a fit; only the others judge a prediction. Axes are those of the "
            "specimen: z up, towards the plate that moves."
        )
        yield figures.get("markers")
        yield tables.marker_errors(data)


def _failures(data: ReportData, figures: Figures) -> Blocks:
    if data.is_table:
        return
    pattern = data.failure_pattern
    yield Heading("Failures", 2, "failures")
    if pattern is not None:
        first, *rest = tables.failure_sentences(pattern, data.labels)
        yield Sentence(first, kind="lead")
        yield from map(Sentence, rest)
    yield Sentence(sentences.failures(data.failures, len(data.table)))
    if data.failures:
        if pattern is not None:
            yield tables.tests(pattern, data.labels)
        yield figures["failures"]
        yield tables.failures(data)
    if data.retried:
        yield Sentence(tables.retried_sentence(data.retried))
        yield tables.retried_table(data.retried, data.block)


def _cost(data: ReportData, parts: Sequence[tuple[Facts, Figures]]) -> Iterator[Block]:
    if not parts:
        return
    yield Heading("Cost against accuracy", 2, "cost")
    weighed: list[Block] = []
    for item, figures in parts:
        weighed += map(Sentence, filter(None, [sentences.cheaper(data, item)]))
        weighed += drawn(figures, "front")
    none = "No response has a better end and a computing time, so cost is not weighed."
    yield from weighed or [Sentence(none)]


def _provenance(data: ReportData, warnings: Sequence[str]) -> Iterator[Block]:
    """Say what makes the report again, with which programs, in which time, and what to mind."""
    versions = [
        f"{clean(key).removeprefix(_VERSION)} {clean(value)}"
        for key, value in data.provenance.items()
        if key.startswith(_VERSION)
    ]
    rows = {"seed": str(data.seed)} | ({"versions": ", ".join(versions)} if versions else {})
    rows |= {
        key: value
        for key, value in data.provenance.items()
        if key != "seed" and not key.startswith(_VERSION)
    }
    if data.timings:
        parts = ", ".join(f"{key} {duration(value)}" for key, value in data.timings.items())
        rows["time"] = f"{parts} (sum {duration(sum(data.timings.values()))})"
    yield Heading("Provenance", 2, "provenance")
    if data.commands:
        yield Heading("To reproduce")
        yield Verbatim("\n".join(data.commands))
    yield Definitions.of(rows.items(), exact=True)
    for title, lines in (("Notes on the measurements", data.data_notes), ("Warnings", warnings)):
        if lines:
            yield Heading(title)
            yield Points(lines)
    if data.design_text:
        yield Folded("The design file", (Verbatim(data.design_text),))
