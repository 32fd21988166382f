"""The page of a verb about one thing: answer, figures, tables, warnings, data beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from study.reporting.content.table import Table
from study.reporting.figure.registry import Figure, slug
from study.reporting.output import write
from study.reporting.output.files import data_folder, replace_file
from study.reporting.output.page import _environment
from study.reporting.text import clean


@dataclass(frozen=True)
class AnswerPage:
    """What a page of one answer shows.

    Parameters
    ----------
    kind : str
        What it is about, for example ``mesh convergence``.
    stem : str
        End of its file's name.
    name, question : str
        Of what was asked; as the user wrote them.
    answer : sequence of str
        Sentences.
    figures : sequence of Figure
        In their order.
    tables : sequence of Table
        In their order.
    warnings : sequence of str
        May be empty.
    """

    kind: str
    stem: str
    name: str
    question: str
    answer: Sequence[str]
    figures: Sequence[Figure]
    tables: Sequence[Table]
    warnings: Sequence[str] = ()


def write_answer(page: AnswerPage, out_dir: str | Path) -> Path:
    """Write a page, and the CSV of its figures and tables in a folder beside it.

    Parameters
    ----------
    page : AnswerPage
        What it shows.
    out_dir : str or Path
        Made where it is missing.

    Returns
    -------
    Path
        The page.
    """
    folder = Path(out_dir)
    stem = f"{slug(page.name)}-{page.stem}"
    beside = data_folder(folder, stem)
    for figure in page.figures:
        if figure.data is not None:
            replace_file(beside / f"figure-{figure.name}.csv", write.of_frame(figure.data))
    for table in page.tables:
        replace_file(beside / f"table-{slug(table.name)}.csv", write.of_records(table.raw))
    text = _environment().get_template("answer.html.j2").render(
        kind=page.kind, name=clean(page.name), question=clean(page.question), answer=page.answer,
        figures=page.figures, tables=page.tables, warnings=page.warnings,
    )  # fmt: skip
    replace_file(folder / f"{stem}.html", clean(text))
    return folder / f"{stem}.html"
