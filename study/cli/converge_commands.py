"""The verb converge: what it asks and what it prints."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from study.cli import output
from study.cli.study_commands import REPORTS, RESULTS, Data, Json, Reports, Results, Set
from study.ground.errors import Fault, InputError


def converge(
    file: Annotated[
        Path | None,
        typer.Argument(
            help="Problem, design, or the results of a study.", autocompletion=output.studies
        ),
    ] = None,
    values: Annotated[str, typer.Option(help="Values of the quantity, with commas.")] = "",
    sizes: Annotated[str, typer.Option(help="Mesh sizes of these values, with commas.")] = "",
    formal_order: Annotated[float | None, typer.Option(help="Order that elements promise.")] = None,
    tolerance: Annotated[float, typer.Option(help="Algebraic error of a value.")] = 0.0,
    data: Data = None,
    jobs: Annotated[int | None, typer.Option(help="Workers for the cells of a design.")] = None,
    memory: Annotated[float | None, typer.Option(help="MB that one solution may take.")] = None,
    settings: Set = None,
    results: Results = RESULTS,
    reports: Reports = REPORTS,
    as_json: Json = False,
) -> None:
    """Judge mesh convergence: observed order, extrapolated value, GCI, verdict."""
    from study import api

    answer = api.converge(
        file,
        values=_numbers(values, "--values"),
        sizes=_numbers(sizes, "--sizes"),
        formal_order=formal_order,
        tolerance=tolerance,
        overrides=settings or (),
        data=data,
        jobs=jobs,
        memory_MB=memory,
        results=results,
        reports=reports,
        progress=lambda text: print(text, file=sys.stderr, flush=True),
    )
    document = answer if isinstance(answer, dict) else answer.to_json()
    cells = document.get("cells", [document])
    from study.reporting.output.convergence_page import series_blocks

    warned = [text for cell in cells for text in cell.get("warnings") or ()]
    output.show(document, as_json, series_blocks, [] if as_json else warned)
    if any(mesh["status"] != "converged" for cell in cells for mesh in cell.get("meshes", ())):
        raise typer.Exit(1)


def _numbers(text: str, option: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",") if part.strip()]
    except ValueError:
        rule = f"must be numbers with commas, got {text!r}"
        raise InputError(Fault(option, rule)) from None
