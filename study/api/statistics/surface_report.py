"""Write the page of a surface that was fitted to a table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from study.api.statistics.study_surface import SEE_SURFACE
from study.api.statistics.table_report import Source, check_taken, provenance
from study.reporting.output.write import write
from study.study_result.report_data import ReportData, ResponseAnalysis
from study.study_result.response_surface import FittedSurface

if TYPE_CHECKING:
    import pandas as pd

    from study.response_surface.factors import Runs
    from study.response_surface.result import SurfaceAnalysis


def write_surface_page(
    found: SurfaceAnalysis,
    out_dir: str | Path,
    *,
    source: Source,
    practical: float | None = None,
    formats: Sequence[str] = ("html",),
) -> Path:
    """Write the page of a surface, with the CSV of its tables and figures beside it.

    Parameters
    ----------
    found : SurfaceAnalysis
        Of :func:`study.fit_surface`.
    out_dir : str or Path
        Made where it is missing.
    source : Source
        File and command line, for the line that makes the page again.
    practical : float, optional
        Smallest difference that matters, in the response's unit.
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
    check_taken(found.runs.names)
    return write(_report_data(found, source, practical), out_dir, formats)


def _report_data(found: SurfaceAnalysis, source: Source, practical: float | None) -> ReportData:
    runs = found.runs
    table = _table(runs)
    ends = {f.name: (f.low, f.high) for f in runs.factors}
    return ReportData(
        name=source.name,
        question=f"How does {runs.name} depend on {', '.join(runs.names)}?",
        factors={name: tuple(table[name].unique()) for name in runs.names},
        table=table,
        responses=(
            ResponseAnalysis(
                runs.name, "", None, practical=practical, title=runs.name, refused=SEE_SURFACE
            ),
        ),
        block="block" if runs.blocks else "",
        blocks=tuple(dict.fromkeys(runs.blocks)),
        citation="" if source.path is None else source.path.name,
        provenance=provenance(source),
        commands=source.commands(),
        scheme=f"a table of {len(table):,} rows was analyzed",
        cells=len(runs.distinct()[0]),
        labels={name: name for name in (runs.name, *runs.names)},
        surfaces=(FittedSurface(runs.name, "", found, practical=practical),),
        ranges={name: f"{low:g} to {high:g}" for name, (low, high) in ends.items()},
        is_table=True,
    )


def _table(runs: Runs) -> pd.DataFrame:
    """Rows as a report wants them: settings, block, status, the response under its own name."""
    import pandas as pd

    settings = {
        factor.name: [f"{factor.setting(float(x)):.6g}" for x in column]
        for factor, column in zip(runs.factors, runs.coded.T, strict=True)
    }
    frame = pd.DataFrame({"case_id": [str(n + 1) for n in range(runs.response.size)], **settings})
    if runs.blocks:
        frame["block"] = list(runs.blocks)
    return frame.assign(status="converged", **{runs.name: runs.response})
