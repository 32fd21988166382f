"""Write the page of one analysis: of a CSV, a table, or a study's records."""

from __future__ import annotations

import platform
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING

import study
from study.analysis.post_hoc.coefficients import coefficient_table
from study.analysis.post_hoc.pairwise import pairwise
from study.analysis.post_hoc.unusual_observations import diagnosed_rows, unusual_observations
from study.api.statistics.comparisons import against_reference
from study.bounded_file import sha256_of
from study.errors import Fault, InputError
from study.reporting.output.analysis_page import AnalysisReport, write_analysis
from study.study_result.report_data import ReportData, ResponseAnalysis

if TYPE_CHECKING:
    import pandas as pd

    from study.analysis.result import AnalysisResult

#: Names that the rows of an analysis have for themselves.
TAKEN = frozenset(
    ("row", "cell", "representative", "response", "block", "fitted", "residual", "leverage", "cook",
     "standardized", "press", "score", "case_id", "status", "seconds", "mean", "n", "y", "factor",
     "level", "other", "other_level", "place", "number")
)  # fmt: skip
_PACKAGES = ("numpy", "scipy", "pandas", "statsmodels")


@dataclass(frozen=True)
class Source:
    """Where the rows of an analysis come from, and how it was asked for.

    Parameters
    ----------
    path : Path or None
        The CSV; None for a table in memory.
    flags : mapping of str to str
        What the command line was given: ``{"--response": "life"}``.
    contrasts : tuple of str
        Differences that were asked for by name.
    """

    path: Path | None = None
    flags: Mapping[str, str] = field(default_factory=dict)
    contrasts: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Name of the table."""
        return "table" if self.path is None else self.path.name.split(".")[0] or "table"

    def digest(self) -> str | None:
        """Sha256 of the file."""
        return None if self.path is None else sha256_of(self.path)

    def commands(self) -> tuple[str, ...]:
        """Lines that check the file and make the analysis again; none for a table in memory."""
        if self.path is None:
            return ()
        check = f"{self.digest()}  {self.path}"
        given = [word for flag, value in self.flags.items() if value for word in (flag, value)]
        asked = [word for text in self.contrasts for word in ("--contrast", text)]
        again = ["study", "analyze", str(self.path), *given, *asked]
        return (f"echo {shlex.quote(check)} | sha256sum --check", shlex.join(again))


def write_page(
    found: AnalysisResult,
    out_dir: str | Path,
    *,
    source: Source | None = None,
    reference: str | None = None,
    formats: Sequence[str] = ("html",),
) -> Path:
    """Write the page of an analysis, with the CSV of its tables and figures beside it.

    Parameters
    ----------
    found : AnalysisResult
        Of :func:`study.analyze`.
    out_dir : str or Path
        Made where it is missing.
    source : Source, optional
        File and command line, for the line that makes the page again.
    reference : str, optional
        Level that the others of its factor are compared with (Dunnett).
    formats : sequence of {"html", "csv", "tex", "pdf"}
        As for a study's report.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        If a column has a name that the page needs for itself, or for an unknown format.
    """
    check_taken(found.request.factors)
    given = source or Source()
    report = AnalysisReport(
        found,
        report_data(found, given),
        coefficient_table(found),
        pairwise(found),
        unusual_observations(found),
        diagnosed_rows(found),
        None if reference is None else against_reference(found, reference),
    )
    return write_analysis(report, out_dir, formats)


def check_taken(factors: Sequence[str]) -> None:
    """Refuse factors with a name that the rows of a report have for themselves.

    Parameters
    ----------
    factors : sequence of str
        Columns of the user's table.

    Raises
    ------
    InputError
        Naming every such column; the names are :data:`TAKEN`.
    """
    taken = [name for name in factors if name in TAKEN]
    if taken:
        rule = "is a name that the report needs for a column of its own"
        mend = "rename the column, say to the quantity that it holds"
        raise InputError([Fault(f"column {name!r}", rule, mend) for name in taken])


def report_data(found: AnalysisResult, source: Source) -> ReportData:
    """Gather what a report shows of one analysis: levels, rows, provenance.

    Parameters
    ----------
    found : AnalysisResult
        Of a table; its only response is shown without a unit.
    source : Source
        File and command line, for provenance and the line that makes the page again.
    """
    request = found.request
    rows = found.data.residuals
    block = found.data.block
    labels = {name: name for name in (request.response, *request.factors)}
    return ReportData(
        name=source.name,
        question=_question(found),
        factors=_levels(found),
        table=_table(found),
        responses=(
            ResponseAnalysis(
                request.response,
                "",
                found,
                practical=None
                if request.scale.practical is None
                else request.scale.practical.value,
                relative=bool(request.scale.practical and request.scale.practical.relative),
                transform=request.scale.transform,
                title=request.response,
            ),
        ),
        block=block or "",
        blocks=() if block is None else tuple(rows["block"].astype(str).unique()),
        citation="" if source.path is None else source.path.name,
        seed=request.seed,
        alpha=request.alpha,
        provenance=provenance(source),
        commands=source.commands(),
        scheme=f"a table of {len(rows):,} rows was analyzed",
        cells=len(found.data.cell_means),
        labels=labels,
    )


def _question(found: AnalysisResult) -> str:
    named = ", ".join(found.request.factors)
    return f"What does {found.request.response} depend on: {named}?"


def _levels(found: AnalysisResult) -> dict[str, tuple[str, ...]]:
    own = {e.term: e.levels for e in found.effects if e.is_main}
    rows = found.data.residuals
    return {
        name: own.get(name) or tuple(rows[name].astype(str).unique())
        for name in found.request.factors
    }


def _table(found: AnalysisResult) -> pd.DataFrame:
    """Rows as a report wants them: levels, block, status, the response under its own name."""
    rows = found.data.residuals
    columns = {name: rows[name].astype(str) for name in found.request.factors}
    if "block" in rows:
        columns["block"] = rows["block"].astype(str)
    frame = rows[["row"]].assign(**columns, status="converged")
    frame = frame.rename(columns={"row": "case_id"})
    frame[found.request.response] = rows["response"]
    return frame


def provenance(source: Source) -> dict[str, str]:
    """List versions, and the hash of the file.

    Parameters
    ----------
    source : Source
        One without a file gives versions alone.

    Returns
    -------
    dict of str to str
        By what it is, such as ``"version of numpy"``; packages that are not installed are left out.
    """
    out = {"version of study": study.__version__, "version of python": platform.python_version()}
    for package in _PACKAGES:
        try:
            out[f"version of {package}"] = version(package)
        except PackageNotFoundError:
            continue
    if source.path is not None:
        out[f"sha256 of {source.path.name}"] = str(source.digest())
    return out
