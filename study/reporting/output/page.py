"""The two pages of a report: self-contained HTML, every word of a user escaped.

The first has the answer and what it rests on; the second, beside it, has everything else.
"""

from __future__ import annotations

import gzip
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

from study.harness.record.atomic_files import write_atomic, write_error
from study.harness.record.folder import own_folder
from study.reporting.content import (
    analysis_content,
    comparison_content,
    methods,
    recommendation,
    sentences,
    surface_content,
    tables,
    verdicts,
)
from study.reporting.content import front_page as front
from study.reporting.content.blocks import Figure, Table
from study.reporting.content.numbers import duration
from study.reporting.content.report_facts import Facts, facts, grouped_inputs
from study.reporting.content.text import clean, count, folded, name_of, plural_of, sentence
from study.reporting.content.verdicts import verdict
from study.reporting.figures import convergence_figures, registry, surface_figures
from study.reporting.figures.registry import slug
from study.reporting.results.study_result import FITTED_CURVE, ReportData, ResponseAnalysis

if TYPE_CHECKING:
    from jinja2 import Environment
    from markupsafe import Markup

    from study.harness.execution.local import Worker
    from study.statistics.surfaces.surface_profile import FittedSurface

_VERSION = "version of "
#: end of the name of the second page
DETAILS = "-details"


@dataclass(frozen=True)
class Section:
    """Everything the page shows about one response."""

    facts: Facts
    anchor: str
    verdicts: tuple[str, ...]
    contrasts: Table | None
    anova: Table | None
    strata: Table | None
    figures: Mapping[str, Figure]
    assumptions: Table | None
    cheaper: str


@dataclass(frozen=True)
class SurfaceSection:
    """Everything the page shows about one surface over numeric factors."""

    surface: FittedSurface
    title: str
    anchor: str
    lines: tuple[str, ...]
    sensitivity: Table | None
    coefficients: Table | None
    uncertain: Table | None
    figures: Mapping[str, Figure]


@dataclass(frozen=True)
class Contents:
    """A report with everything computed, before any markup."""

    data: ReportData
    found: tuple[Facts, ...]
    sections: tuple[Section, ...]
    figures: Mapping[str, Figure]
    tables: Mapping[str, Table]
    surfaces: tuple[SurfaceSection, ...] = ()
    records: Table | None = None

    @property
    def all_figures(self) -> tuple[Figure, ...]:
        """Figures in the order of the page."""
        drawn = [section.figures for section in self.sections]
        drawn += [section.figures for section in self.surfaces]
        return (
            *(figure for figures_of_section in drawn for figure in figures_of_section.values()),
            *self.figures.values(),
        )


def prepare(data: ReportData, worker: Worker | None = None) -> Contents:
    """Compute every sentence, table and figure of a report."""
    of_study = partial(registry.of_study, data)
    figures = of_study if worker is None else worker.begin(of_study)
    all_facts = facts(data)
    sections = tuple(_section(data, item) for item in all_facts if item.terms or not data.surfaces)
    over = tuple(_surface(data, surface) for surface in data.surfaces)
    records = tables.case_records(data, all_facts)
    cells = tables.matrix(data, all_facts)
    pattern, beside = data.failure_pattern, data.beside
    made: dict[str, Table | None] = {
        "verdicts": tables.verdicts(all_facts, data),
        "cells": cells if records is None else replace(cells, follow=tables.CELL),
        "fits": tables.fits(data) if data.fits else None,
        "every_fit": tables.every_fit(data) if data.fits else None,
        "markers": tables.marker_errors(data) if data.markers else None,
        "numerical": tables.numerical(data.numerical, data) if data.numerical else None,
        "expected": verdicts.table(data, all_facts) if data.expected else None,
        "validation": convergence_figures.table(data.validation, data.block)
        if data.validation
        else None,
        "beside": comparison_content.table(beside, data.labels) if beside else None,
        "changes": comparison_content.changes(beside) if beside else None,
        "failures": tables.failures(data) if data.failures else None,
        "retried": tables.retried_table(data.retried, data.block) if data.retried else None,
        "failure_tests": tables.tests(pattern, data.labels) if pattern and pattern.tests else None,
    }
    for section in over:
        of_surface = (section.sensitivity, section.coefficients, section.uncertain)
        made |= {table.name: table for table in of_surface if table is not None}
    present = {name: table for name, table in made.items() if table is not None}
    drawn = _first_figure(data, all_facts, over) | figures()
    return Contents(data, all_facts, sections, drawn, present, over, records)


def _first_figure(
    data: ReportData, all_facts: Sequence[Facts], over: Sequence[SurfaceSection]
) -> dict[str, Figure]:
    """Figure of the first page: effects of levels, or how much each number drives a response."""
    effects = registry.overview(data, all_facts)
    shares = next((s.figures["shares"] for s in over if "shares" in s.figures), None)
    if effects or shares is None:
        return effects
    return {"overview": registry.renamed(shares, "overview")}


def _surface(data: ReportData, fitted: FittedSurface) -> SurfaceSection:
    named = surface_content.title(fitted, data)
    stem = f"surface-{slug(named)}"
    return SurfaceSection(
        fitted,
        named,
        stem,
        surface_content.surface_lines(fitted, data),
        surface_content.sensitivity(fitted, data),
        surface_content.coefficients(fitted, data),
        surface_content.table(fitted, data),
        registry.made(surface_figures.drawings(fitted, data), stem, named),
    )


def _section(data: ReportData, item: Facts) -> Section:
    strata = tables.strata(item, data) if item.rows else None
    judged = [effect for effect in item.terms if effect.is_main or effect.strength == "matters"]
    return Section(
        facts=item,
        anchor=f"r-{slug(item.name)}",
        verdicts=tuple(verdict(effect, item, data.labels) for effect in judged),
        contrasts=analysis_content.contrasts(item),
        anova=tables.anova(item, data) if item.rows else None,
        strata=strata if strata is not None and strata.rows else None,
        figures=registry.of_response(data, item),
        assumptions=analysis_content.checks(item.result, f"tests of assumptions {item.name}")
        if item.result
        else None,
        cheaper=recommendation.cheaper(data, item),
    )


def page_names(stem: str) -> tuple[str, str]:
    """Names of the first page of a report and of the second."""
    return f"{stem}.html", f"{stem}{DETAILS}.html"


def pages(contents: Contents) -> tuple[str, str]:
    """Return the HTML of the first page and of the second."""
    data, found = contents.data, contents.found
    name = slug(data.name)
    answer = front.short_answer(data, found)
    return front_page(contents, data.name, name, answer, "cases.csv"), details_page(contents)


def front_page(contents: Contents, title: str, stem: str, answer: Sequence[str], rows: str) -> str:
    """Return the HTML of the first page: question, answer, effects, checks, curves, what to do.

    Nothing is loaded from anywhere: styles and drawings are inline, and the content security
    policy allows no script but that of the second page, by its hash. Every text that came from a
    user is escaped by the templates.
    """
    data, found = contents.data, contents.found
    checks = analysis_content.all_checks(data, found)
    return filled(
        "front.html.j2",
        c=contents,
        data=data,
        kicker="Analysis of a table" if data.is_table else "Study report",
        title=title,
        partial=sentences.partial(data),
        answer=answer,
        card=front.report_card(analysis_content.grouped(checks), data),
        curves=contents.figures.get("few-curves", contents.figures.get("curves")),
        recommendation=front.what_to_do(data, found),
        would_change=recommendation.would_change(data, found),
        details=page_names(stem)[1],
        beside=f"{stem}-data",
        rows=rows,
    )


def details_page(contents: Contents) -> str:
    """Return the HTML of the second page: all that the first leaves out."""
    data = contents.data
    stem = slug(data.name)
    return filled(
        "page.html.j2",
        c=contents,
        data=data,
        first=page_names(stem)[0],
        beside=f"{stem}-data",
        answer=(
            *sentences.answer(data, contents.found),
            *comparison_content.answer_lines(data.beside, data.labels),
        ),
        checks=analysis_content.grouped(analysis_content.all_checks(data, contents.found)),
        controls=analysis_content.grouped(data.controls),
        error_terms=sentences.error_terms(data, contents.found),
        virtual=sentences.VIRTUAL if data.virtual and contents.found else "",
        inputs=grouped_inputs(data.inputs),
        planned=_planned(data, len(contents.tables["cells"].rows)),
        methods=methods.paragraph(data, contents.found),
        failures=sentences.failures(data.failures, len(data.table)),
        retried=tables.retried_sentence(data.retried),
        failure_pattern=()
        if data.failure_pattern is None
        else tables.failure_sentences(data.failure_pattern, data.labels),
        warnings=_warnings(contents),
        verdict_groups=_groups(contents.tables["verdicts"]),
        sections={section.facts.title: section.anchor for section in contents.sections},
        glossary=methods.TERMS,
        what_if=verdicts.WHAT_IF,
        two=comparison_content,
        provenance=_provenance(data),
        total_time=sum(data.timings.values()),
    )


def printed(first: str, second: str) -> str:
    """Return both pages as one document, as a printer wants them."""
    return first.partition("</main>")[0] + second.partition("<main>")[2]


def filled(template: str, **values: object) -> str:
    """Fill a template of a page that may run the one script of the reports."""
    script = table_script()
    text: str = (
        _environment()
        .get_template(template)
        .render(script=script, script_hash=policy_hash(script), **values)
    )
    # control and direction characters are no markup, yet no document may hold them
    return clean(text)


def table_script() -> Markup:
    """Return the script that sorts and searches tables, as it stands in the page."""
    return _packaged("tables.js")


def policy_hash(script: str) -> str:
    """Source expression (``sha256-`` and digest) that lets a page run this script alone."""
    import base64
    import hashlib

    digest = hashlib.sha256(script.encode()).digest()
    return f"sha256-{base64.b64encode(digest).decode()}"


def _planned(data: ReportData, present: int) -> str:
    """Count the cells, against those of the design where some have no case yet."""
    if present >= data.planned:
        return count(present, "cell")
    return f"{present:,} of {count(data.planned, 'cell')} computed"


def _provenance(data: ReportData) -> dict[str, str]:
    """Provenance with all versions in one line; the seed has its own."""
    versions = [
        f"{clean(key).removeprefix(_VERSION)} {clean(value)}"
        for key, value in data.provenance.items()
        if key.startswith(_VERSION)
    ]
    rest = {k: v for k, v in data.provenance.items() if k != "seed" and not k.startswith(_VERSION)}
    return ({"versions": ", ".join(versions)} if versions else {}) | rest


def _groups(table: Table) -> list[tuple[str, list[tuple[str, ...]]]]:
    """Rows of a table by their first column, in the order given."""
    groups: dict[str, list[tuple[str, ...]]] = {}
    for row in table.rows:
        groups.setdefault(row[0], []).append(row)
    return list(groups.items())


def _warnings(contents: Contents) -> tuple[str, ...]:
    over = bool(contents.surfaces)  # a table of levels that a surface replaces is not missed
    read = [item for item in contents.found if item.terms or not over]
    pairs = [(item.title, warning) for item in read for warning in item.warnings]
    return (*dict.fromkeys(contents.data.warnings), *folded(pairs, contents.data))


@cache  # a template is compiled once a process
def _environment() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("study.reporting", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["duration"] = duration
    environment.filters["name"] = name_of
    # only drawings that this package rendered pass unescaped
    environment.filters["drawing"] = _drawing
    environment.filters["slug"] = slug
    environment.filters["sentence"] = sentence
    environment.filters["sub"] = _subscripts
    environment.filters["term"] = _heading
    environment.filters["gloss"] = methods.glossed
    environment.globals["groups"] = _groups
    environment.globals["plural_of"] = plural_of
    environment.globals["response_note"] = response_note
    return environment


def _subscripts(text: str) -> Markup:
    """Text with ``u_num`` and its kin as a letter and its subscript, all else escaped."""
    from markupsafe import Markup, escape

    parts = re.sub(r"\bu_(num|val|input|D)\b", r"u<sub>\1</sub>", str(escape(text)))
    # escaped first, so nothing but these tags is markup
    return Markup(parts)  # noqa: S704


def _heading(text: str) -> Markup:
    """Heading of a column, explained where the glossary holds it."""
    return methods.explained(text) if text in methods.TERMS else _subscripts(text)


def _drawing(figure: Figure) -> Markup:
    from markupsafe import Markup

    return Markup(figure.svg)  # noqa: S704


def response_note(response: ResponseAnalysis) -> str:
    """Say what was declared of a response: its unit, what matters, how it is analyzed."""
    parts = [response.unit] if response.unit else []
    if response.practical is not None:
        if response.relative:
            limit = f"{100 * response.practical:g} % of the mean"
        else:
            limit = f"{response.practical:g} {'pp' if response.unit == '%' else response.unit}"
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


# Files of a report: each replaced whole, none outside the folder it was asked for.
#
# A project may come from others, with links in it that lead elsewhere. The folder that the user
# names may be a link; what the program puts below it may not lead out again.


def data_folder(folder: Path, stem: str) -> Path:
    """Make the folder for what a page was drawn from, beside the page."""
    files = own_folder(folder, f"{stem}-data")
    try:
        files.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise write_error(files, error) from error
    return files


def replace_file(path: Path, text: str) -> None:
    """Write a text beside, then rename: a reader never sees half a file."""
    replace_bytes(path, text.encode())


def replace_packed(path: Path, text: str) -> None:
    """Write a gzip file, the same bytes for the same text."""
    replace_bytes(path, gzip.compress(text.encode(), 6, mtime=0))


def replace_bytes(path: Path, data: bytes) -> None:
    """Write the bytes of a file beside, then rename; see :func:`replace_file`."""
    write_atomic(path, data, flush=False)


# The page that watches studies: those at work with their progress, and all others.


@dataclass(frozen=True)
class StudyProgress:
    """How many computations of how many a runner has done, and the same in words."""

    done: int
    total: int
    said: str


@dataclass(frozen=True)
class StudyState:
    """One study as its folders show it: its cases in words, and the address of its report."""

    name: str
    question: str
    cases: str
    progress: StudyProgress | None
    page: str


def render_overview(states: Sequence[StudyState]) -> tuple[str, str]:
    """Return the page of every study, and the policy that lets it run its own script and style."""
    script, style = _packaged("overview.js"), _packaged("style.css") + _packaged("overview.css")
    text: str = _environment().get_template("overview.html.j2").render(
        running=[state for state in states if state.progress is not None],
        others=[state for state in states if state.progress is None],
        script=script,
        style=style,
        clean=clean,
    )  # fmt: skip
    policy = (
        f"default-src 'none'; style-src '{policy_hash(style)}'; "
        f"script-src '{policy_hash(script)}'; connect-src 'self'; img-src data:; "
        "form-action 'none'; base-uri 'none'; frame-ancestors 'none'"
    )
    return text, policy


def _packaged(name: str) -> Markup:
    """Text of a file of this package, which holds no word of a user."""
    from importlib.resources import files

    from markupsafe import Markup

    text = (files("study.reporting") / "templates" / name).read_text(encoding="utf-8")
    return Markup(text)  # noqa: S704
