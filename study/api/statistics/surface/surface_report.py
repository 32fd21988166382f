"""Write the page of a surface that was fitted to a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from study.api.statistics.surface.study_surface import SEE_SURFACE
from study.api.statistics.table_report import Source, check_taken, provenance
from study.reporting.output.write import write
from study.study_result.report_data import ReportData, ResponseAnalysis
from study.study_result.response_surface import FittedSurface

if TYPE_CHECKING:
    import pandas as pd

    from study.response_surface.factors import Runs


def write_surface_page(
    found: Sequence[FittedSurface],
    out_dir: str | Path,
    *,
    source: Source,
    formats: Sequence[str] = ("html",),
) -> Path:
    """Write the page of the surfaces of one response, with the CSV of its tables and figures.

    Parameters
    ----------
    found : sequence of FittedSurface
        Of :func:`study.fit_surfaces`, one a combination of labels; one of them is fitted at least.
    out_dir : str or Path
        Made where it is missing.
    source : Source
        File and command line, for the line that makes the page again.
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
    runs = next(one.found for one in found if one.found is not None).runs
    check_taken([*runs.names, *found[0].labels])
    return write(_report_data(found, runs, source), out_dir, formats)


def _report_data(found: Sequence[FittedSurface], runs: Runs, source: Source) -> ReportData:
    practical = found[0].practical
    table = _table(found)
    ends = {f.name: (f.low, f.high) for f in runs.factors}
    labels = list(found[0].labels)
    return ReportData(
        name=source.name,
        question=f"How does {runs.name} depend on {', '.join([*labels, *runs.names])}?",
        factors={name: tuple(table[name].unique()) for name in (*labels, *runs.names)},
        table=table,
        responses=(
            ResponseAnalysis(
                runs.name, "", None, practical=practical, title=runs.name, refused=SEE_SURFACE
            ),
        ),
        block="block" if runs.blocks else "",
        blocks=tuple(table["block"].unique()) if runs.blocks else (),
        citation="" if source.path is None else source.path.name,
        provenance=provenance(source),
        commands=source.commands(),
        scheme=f"a table of {len(table):,} rows was analyzed",
        cells=sum(len(one.found.runs.distinct()[0]) for one in found if one.found is not None),
        labels={name: name for name in (runs.name, *labels, *runs.names)},
        surfaces=tuple(found),
        ranges={name: f"{low:g} to {high:g}" for name, (low, high) in ends.items()},
        is_table=True,
    )


def _table(found: Sequence[FittedSurface]) -> pd.DataFrame:
    """Rows as a report wants them: settings, block, status, the response under its own name."""
    import pandas as pd

    parts = [_rows(one.found.runs, one.labels) for one in found if one.found is not None]
    frame = pd.concat(parts, ignore_index=True)
    frame.insert(0, "case_id", [str(n + 1) for n in range(len(frame))])
    return frame


def _rows(runs: Runs, labels: Mapping[str, str]) -> pd.DataFrame:
    import pandas as pd

    settings = {
        factor.name: [f"{factor.setting(float(x)):.6g}" for x in column]
        for factor, column in zip(runs.factors, runs.coded.T, strict=True)
    }
    frame = pd.DataFrame({**{n: [at] * runs.response.size for n, at in labels.items()}, **settings})
    if runs.blocks:
        frame["block"] = list(runs.blocks)
    return frame.assign(status="converged", **{runs.name: runs.response})
