"""Write a report: the page, the data of its figures and tables, other formats on request."""

from __future__ import annotations

import csv
import io
import json
import math
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from study.bounded_file import read_existing
from study.errors import Fault, InputError, StudyError, nearest
from study.memory import uncollected
from study.reporting.content.methods import paragraph
from study.reporting.content.table import Table
from study.reporting.figure.registry import slug
from study.reporting.output.files import data_folder, replace_bytes, replace_file, replace_packed
from study.reporting.output.latex import document
from study.reporting.output.page import Contents, prepare, render
from study.reporting.text import clean
from study.study_result.report_data import CurvePair, ReportData

if TYPE_CHECKING:
    import pandas as pd

    from study.execution.worker import Worker

FORMATS = ("html", "csv", "tex", "pdf")


def write(
    report_data: ReportData,
    out_dir: str | Path,
    formats: Sequence[str] = ("html",),
    worker: Worker | None = None,
) -> Path:
    """Write a report into a folder and return its main file.

    The page is ``<name>.html``; beside it ``<name>-data/`` holds the CSV of every figure and
    table, ``cases.csv`` (one row a case), ``curves.csv.gz`` (every measured and predicted
    point) and ``numbers.json``, the statistics as the interface defines them: enough to compute
    every figure again. Files are replaced whole, never left half written.

    Parameters
    ----------
    report_data : ReportData
    out_dir : path
        Created where missing.
    formats : sequence of {"html", "csv", "tex", "pdf"}
        ``csv`` writes the data alone; they are always written.
    worker : Worker, optional
        Process that draws a part of the figures.

    Raises
    ------
    InputError
        For an unknown format, or ``pdf`` without a browser (before anything is written).
    StudyError
        If a link leads out of the folder.
    """
    asked = checked_formats(formats)
    folder = Path(out_dir)
    with uncollected():
        return _written(prepare(report_data, worker), folder, asked)


def _written(contents: Contents, folder: Path, asked: Sequence[str]) -> Path:
    report_data = contents.data
    stem = slug(report_data.name)
    beside = data_folder(folder, stem)
    _numbers(contents, beside)
    _tables(contents, beside)
    replace_file(beside / "cases.csv", of_frame(report_data.table))
    if report_data.curves:
        replace_packed(beside / "curves.csv.gz", _points(report_data.curves))
    for figure in contents.all_figures:
        if figure.data is not None:
            replace_file(beside / f"figure-{figure.name}.csv", of_frame(figure.data))
        if figure.svg:
            replace_file(beside / f"figure-{figure.name}.svg", figure.svg + "\n")
    html, latex, portable = (folder / f"{stem}.{suffix}" for suffix in ("html", "tex", "pdf"))
    if "html" in asked or "pdf" in asked:
        replace_file(html, render(contents))
    if "tex" in asked:
        replace_file(latex, _latex(contents))
    if "pdf" in asked:
        print_page(html, portable)
    return main_file(folder, report_data.name, asked)


def main_file(folder: Path, name: str, formats: Sequence[str]) -> Path:
    """Name the file of a report that is opened first.

    Parameters
    ----------
    folder, name, formats : Path, str, sequence of str
        Where the report goes; its study; the formats by :func:`checked_formats`.
    """
    stem = slug(name)
    page = folder / f"{stem}.html"
    beside = {"tex": folder / f"{stem}.tex", "csv": folder / f"{stem}-data" / "cases.csv"}
    return beside.get(formats[0], page)


def checked_formats(formats: Sequence[str]) -> tuple[str, ...]:
    """Sort the formats of a report by the order in which they are written.

    Parameters
    ----------
    formats : sequence of {"html", "csv", "tex", "pdf"}
        Repeated ones count once; ``html`` where there is none.

    Raises
    ------
    InputError
        For a format that is not known, or a PDF where no browser prints it.
    """
    asked = tuple(dict.fromkeys(formats)) or ("html",)
    faults = [
        Fault(f"report format {name!r}", "is not known", nearest(name, FORMATS))
        for name in asked
        if name not in FORMATS
    ]
    if faults:
        raise InputError(faults)
    if "pdf" in asked:
        browser()
    return tuple(sorted(asked, key=FORMATS.index))


def _tables(contents: Contents, beside: Path) -> None:
    known: list[Table] = list(contents.tables.values())
    every = [table for section in contents.sections for table in (section.anova, section.contrasts)]
    known += [table for table in every if table is not None]
    for table in known:
        text = of_records(table.raw) if table.raw else of_rows(table.columns, table.rows)
        replace_file(beside / f"table-{slug(table.name)}.csv", text)


def _numbers(contents: Contents, beside: Path) -> None:
    numbers = {
        response.name: None if response.result is None else response.result.to_json()
        for response in contents.data.responses
    }
    text = json.dumps(
        {"study": contents.data.name, "responses": numbers}, indent=1, allow_nan=False
    )
    replace_file(beside / "numbers.json", text + "\n")


def _points(curves: Sequence[CurvePair]) -> str:
    """CSV text of every measured point and the force predicted there (empty beyond its end)."""
    parts = ["case_id,curve,role,displacement_mm,measured_N,predicted_N\n"]
    for pair in curves:
        head = of_rows((pair.case_id, pair.label, pair.role), ()).removesuffix("\n")
        d, measured = pair.measured.displacement_mm, pair.measured.force_N
        reached = d[d <= pair.predicted.displacement_mm[-1]]
        force = [repr(f) for f in pair.predicted.force_at(reached).tolist()]
        force += [""] * (d.size - reached.size)
        points = zip(d.tolist(), measured.tolist(), force, strict=True)
        parts += [f"{head},{x!r},{m!r},{f}\n" for x, m, f in points]
    return "".join(parts)


def _latex(contents: Contents) -> str:
    known = [("Verdicts", contents.tables["verdicts"])]
    known += [
        (f"Analysis of variance of the {section.facts.title}", section.anova)
        for section in contents.sections
        if section.anova is not None
    ]
    known.append(("Cells", contents.tables["cells"]))
    return document(known, paragraph(contents.data, contents.found))


BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
_SECONDS = 120


def browser() -> str:
    """Path of a Chromium-like browser.

    Raises
    ------
    InputError
        If none is on the path.
    """
    for name in BROWSERS:
        found = shutil.which(name)
        if found:
            return found
    raise InputError(
        Fault(
            "report format 'pdf'",
            "needs Chromium or Chrome, and none was found",
            "install it (Debian: apt-get install chromium), or open the HTML report and print it",
        )
    )


def print_page(page: Path, out: Path) -> None:
    """Print an HTML file to a PDF file.

    Parameters
    ----------
    page, out : Path
        The HTML file, and the PDF file that is replaced whole.

    Raises
    ------
    InputError
        If no browser is installed.
    StudyError
        If the browser fails or takes longer than two minutes.
    """
    program = browser()
    with tempfile.TemporaryDirectory() as profile:
        # the browser writes through a link, and leaves half a file where it is stopped
        printed = Path(profile, "page.pdf")
        command = [
            program, "--headless", "--disable-gpu", "--no-first-run",
            "--disable-background-networking", "--disable-component-update", "--disable-sync",
            "--no-pdf-header-footer", "--generate-pdf-document-outline",
            f"--user-data-dir={profile}", f"--print-to-pdf={printed}",
        ]  # fmt: skip
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            command.append("--no-sandbox")  # Chromium's sandbox refuses to run as root
        command.append(page.resolve().as_uri())
        try:
            done = subprocess.run(command, capture_output=True, timeout=_SECONDS, check=False)
        except subprocess.TimeoutExpired as error:
            raise StudyError(f"{program} did not print {page} within {_SECONDS} s") from error
        if done.returncode or not printed.is_file():
            last = done.stderr.decode(errors="replace").strip().splitlines()[-1:] or ["no message"]
            raise StudyError(f"{program} could not print {page}: {last[0][:300]}")
        replace_bytes(out, read_existing(printed))


# CWE-1236: a text cell that starts with one of these is a formula to a spreadsheet
_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n")


def safe_cell(value: object) -> object:
    """Cell for a CSV: numbers stay numbers, text that could be a formula gets a quote.

    Parameters
    ----------
    value : object
        What is missing or not finite leaves the cell empty; a NumPy scalar counts as its number.

    Examples
    --------
    >>> safe_cell("=1+1"), safe_cell(-1.5), safe_cell("-1.5"), safe_cell(None)
    ("'=1+1", -1.5, "'-1.5", '')
    """
    if hasattr(value, "item"):
        value = value.item()
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ""
    if isinstance(value, bool | int | float):
        return value
    # the csv module quotes a line feed but not a lone carriage return
    text = clean(value).replace("\r\n", "\n").replace("\r", "\n")
    # leading spaces do not protect: some programs strip them
    return f"'{text}" if text.lstrip(" ").startswith(_FORMULA) or text[:1] in _FORMULA else text


def of_frame(frame: pd.DataFrame) -> str:
    """CSV text of a data frame, without its index.

    Parameters
    ----------
    frame : DataFrame
        Cells become what :func:`safe_cell` makes of them; what is not finite is left empty.
    """
    columns = [_cells(frame.iloc[:, k]) for k in range(frame.shape[1])]
    return _text(list(frame.columns), zip(*columns, strict=True))


def _cells(column: pd.Series[float]) -> Sequence[object]:
    """Cells of a column as :func:`safe_cell` makes them, numbers all at once."""
    kind = column.dtype.kind if isinstance(column.dtype, np.dtype) else ""
    if kind == "f":
        return [value if math.isfinite(value) else "" for value in column.tolist()]
    if kind in "iub" and kind:
        return column.tolist()
    known = column.astype(object).where(column.notna(), None)
    return [safe_cell(value) for value in known.tolist()]


def of_records(records: Sequence[Mapping[str, object]]) -> str:
    """CSV text of mappings; columns in the order of first appearance.

    Parameters
    ----------
    records : sequence of mapping
        One a row; a key that a row lacks leaves its cell empty.
    """
    columns = list(dict.fromkeys(key for record in records for key in record))
    return of_rows(columns, ([record.get(key) for key in columns] for record in records))


def of_rows(columns: Iterable[object], rows: Iterable[Iterable[object]]) -> str:
    """CSV text: comma, quotes where needed, one newline a row.

    Parameters
    ----------
    columns, rows : iterable
        Header; cells of every row in its order, made safe here.
    """
    return _text(columns, ([safe_cell(cell) for cell in row] for row in rows))


def _text(columns: Iterable[object], rows: Iterable[Iterable[object]]) -> str:
    """CSV text of cells that are safe."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow([safe_cell(column) for column in columns])
    writer.writerows(rows)
    return buffer.getvalue()
