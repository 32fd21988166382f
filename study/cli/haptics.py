"""The verbs for a device that renders forces: its force law, and what its sensors must be."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from study.cli import next_command, output
from study.cli.studies import REPORTS, RESULTS, Jobs, Json, Reports, Results, Set

if TYPE_CHECKING:
    from study.api.haptics.export import Export
    from study.api.haptics.material import MaterialExport
    from study.api.haptics.require import Required


def export(
    source: Annotated[
        Path,
        typer.Argument(
            help="Problem file, calibration.json, or results of a study (--case).",
            autocompletion=next_command.studies,
        ),
    ],
    form: Annotated[
        str, typer.Option("--as", help="What it becomes: force-law, emulator, abaqus or febio.")
    ] = "force-law",
    case: Annotated[str, typer.Option(help="Case of a study: the beginning of its id.")] = "",
    test: Annotated[int, typer.Option(min=1, help="Test of a calibration, from 1.")] = 1,
    tolerance: Annotated[
        float, typer.Option(help="Wanted error bound over the largest force.")
    ] = 0.002,
    response: Annotated[
        str | None, typer.Option(help="With --as emulator: one response; all by default.")
    ] = None,
    settings: Set = None,
    reports: Reports = REPORTS,
    results: Results = RESULTS,
    as_json: Json = False,
) -> None:
    """Turn a test or surfaces into functions, or a material into input of Abaqus or FEBio."""
    from study import api

    if form == "emulator":
        made = api.export_surface(source, response=response, out=reports, results=results)
        output.warn(made.warnings)
        if as_json:
            output.print_json(made.to_json())
            return
        for line in (said for one in made.functions for said in one.sentences()):
            output.paragraph(line)
        for path in made.paths:
            print(f"written: {path}")
        return
    found = api.export(
        source, form=form, case=case, test=test, tolerance=tolerance, overrides=settings or (),
        out=reports, progress=_say,
    )  # fmt: skip
    output.warn(found.warnings)
    if as_json:
        output.print_json(found.to_json())
        return
    _print_export(found)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _print_export(found: Export | MaterialExport) -> None:
    for line in found.sentences():
        output.paragraph(line)
    for path in found.paths:
        print(f"written: {path}")


def require(
    file: Annotated[
        Path,
        typer.Argument(
            help="Problem with sensors and what is asked of them.",
            autocompletion=next_command.designs,
        ),
    ],
    settings: Set = None,
    jobs: Jobs = None,
    reports: Reports = REPORTS,
    as_json: Json = False,
) -> None:
    """Say how uncertain sensors make constants and force, and what they must be."""
    from study import api

    found = api.require(file, overrides=settings or (), jobs=jobs, out=reports, progress=_say)
    output.warn(found.warnings)
    if as_json:
        output.print_json(found.to_json())
        return
    _print_requirement(found)


def _print_requirement(found: Required) -> None:
    from study.sensors import requirement

    for line in requirement.sentences(found.requirement):
        output.paragraph(line)
    rows = [["sensor", "error", "given", "allowed alone", "allowed beside the others"]]
    for k, source in enumerate(found.requirement.propagation.sources):
        alone, beside = (requirement.size(source, v) for v in found.requirement.allowed(k))
        given = requirement.size(source, source.given)
        rows.append([source.sensor, source.name, given, alone, beside])
    output.table(rows)
    print(f"report: {found.page}")


VERBS: tuple[Callable[..., None], ...] = (export, require)
