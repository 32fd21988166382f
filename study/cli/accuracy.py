"""Verbs that compare with an instrument: tracking, shape."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from study.cli import next_command, output
from study.cli.studies import REPORTS, Data, Json, Reports, Set


def tracking(
    file: Annotated[
        Path,
        typer.Argument(help="TOML file of the tracker study.", autocompletion=next_command.designs),
    ],
    data: Data = None,
    reports: Reports = REPORTS,
    as_json: Json = False,
) -> None:
    """Judge a tracker: fixed distances, commanded displacements, a better instrument."""
    from study import api
    from study.reporting.accuracy.tracker import answers

    found = api.tracking(file, data=data, reports=reports)
    if as_json:
        output.print_json(found.to_json())
        return
    for line in answers(found):
        output.paragraph(line)
    print(f"report: {found.report}")


def shape(
    simulation: Annotated[
        Path, typer.Argument(help="Problem file, VTU of study solve, or deformed surface.")
    ],
    scan: Annotated[Path, typer.Option(help="Scanned cloud or surface: PLY, STL, OBJ or CSV.")],
    markers: Annotated[
        Path | None, typer.Option(help="CSV of marked points: x, y, z, and x0, y0, z0 at rest.")
    ] = None,
    unit: Annotated[str, typer.Option(help="Unit of scan and markers.")] = "mm",
    surface_unit: Annotated[str, typer.Option(help="Unit of a simulated surface file.")] = "mm",
    as_it_lies: Annotated[
        bool, typer.Option("--as-it-lies", help="Compare without registration.")
    ] = False,
    any_state: Annotated[
        bool, typer.Option("--any-state", help="Also a scan that another state fits better.")
    ] = False,
    settings: Set = None,
    reports: Reports = REPORTS,
    as_json: Json = False,
) -> None:
    """Compare a simulated, deformed body with a scan of the real one."""
    from study import api
    from study.reporting.accuracy.scan import answers
    from study.shape_validation.deviation import Options

    found = api.shape(
        simulation, scan, markers=markers, unit=unit, surface_unit=surface_unit,
        options=Options(not as_it_lies, any_state), overrides=settings or (), reports=reports,
    )  # fmt: skip
    output.warn(found.notes)
    if as_json:
        output.print_json(found.to_json())
        return
    for line in answers(found):
        output.paragraph(line)
    print(f"report: {found.report}")


VERBS: tuple[Callable[..., None], ...] = (tracking, shape)
