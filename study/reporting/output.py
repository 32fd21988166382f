"""Write a report: the page, the data of its figures and tables, other formats on request."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from study.errors import Fault, InputError, nearest
from study.reporting import methods, page, pdf, safecsv, tex
from study.reporting.data import CurvePair, ReportData
from study.reporting.figures import slug
from study.reporting.page import Contents
from study.reporting.tables import Table

FORMATS = ("html", "csv", "tex", "pdf")


def write(report_data: ReportData, out_dir: str | Path, formats: Sequence[str] = ("html",)) -> Path:
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

    Raises
    ------
    InputError
        For an unknown format, or ``pdf`` without a browser (before anything is written).
    """
    asked = _checked(formats)
    folder = Path(out_dir)
    stem = slug(report_data.name)
    contents = page.prepare(report_data)
    beside = folder / f"{stem}-data"
    beside.mkdir(parents=True, exist_ok=True)
    _numbers(contents, beside)
    _tables(contents, beside)
    _replace(beside / "cases.csv", safecsv.of_frame(report_data.table))
    if report_data.curves:
        _replace_packed(beside / "curves.csv.gz", _points(report_data.curves))
    for figure in contents.all_figures:
        if figure.data is not None:
            _replace(beside / f"figure-{figure.name}.csv", safecsv.of_frame(figure.data))
    html, latex, portable = (folder / f"{stem}.{suffix}" for suffix in ("html", "tex", "pdf"))
    if "html" in asked or "pdf" in asked:
        _replace(html, page.render(contents))
    if "tex" in asked:
        _replace(latex, _latex(contents))
    if "pdf" in asked:
        pdf.print_page(html, portable)
    return {"html": html, "pdf": html, "tex": latex, "csv": beside / "cases.csv"}[asked[0]]


def _checked(formats: Sequence[str]) -> tuple[str, ...]:
    asked = tuple(dict.fromkeys(formats)) or ("html",)
    faults = [
        Fault(f"report format {name!r}", "is not known", nearest(name, FORMATS))
        for name in asked
        if name not in FORMATS
    ]
    if faults:
        raise InputError(faults)
    if "pdf" in asked:
        pdf.browser()
    return tuple(sorted(asked, key=FORMATS.index))


def _tables(contents: Contents, beside: Path) -> None:
    known: list[Table] = list(contents.tables.values())
    known += [section.anova for section in contents.sections if section.anova is not None]
    for table in known:
        text = (
            safecsv.of_records(table.raw)
            if table.raw
            else safecsv.of_rows(table.columns, table.rows)
        )
        _replace(beside / f"table-{slug(table.name)}.csv", text)


def _numbers(contents: Contents, beside: Path) -> None:
    numbers: dict[str, Any] = {
        response.name: None if response.result is None else response.result.to_json()
        for response in contents.data.responses
    }
    text = json.dumps(
        {"study": contents.data.name, "responses": numbers}, indent=1, allow_nan=False
    )
    _replace(beside / "numbers.json", text + "\n")


def _points(curves: Sequence[CurvePair]) -> str:
    """Every measured point of every case with the predicted force there, as CSV text.

    A prediction that stopped early leaves the cells beyond its end empty.
    """
    parts = ["case_id,curve,role,displacement_mm,measured_N,predicted_N\n"]
    for pair in curves:
        head = safecsv.of_rows((pair.case_id, pair.label, pair.role), ()).removesuffix("\n")
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
    return tex.document(known, methods.paragraph(contents.data, contents.found))


def _replace_packed(path: Path, text: str) -> None:
    """Write a gzip file, the same bytes for the same text."""
    import gzip

    partial = path.with_name(path.name + ".part")
    partial.write_bytes(gzip.compress(text.encode(), 6, mtime=0))
    os.replace(partial, path)


def _replace(path: Path, text: str) -> None:
    """Write beside, then rename: a reader never sees half a file."""
    partial = path.with_name(path.name + ".part")
    partial.write_text(text, encoding="utf-8", newline="\n")
    os.replace(partial, path)
