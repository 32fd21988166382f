"""The verbs for a device that renders forces: its force law, and what its sensors must be."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from study.cli import output
from study.cli.studies import REPORTS, Json, Reports, Set
from study.haptics.export import sentences

if TYPE_CHECKING:
    from study.api.haptics.export import Export


def export(
    source: Annotated[
        Path,
        typer.Argument(help="Problem file, calibration.json, or results of a study (--case)."),
    ],
    form: Annotated[str, typer.Option("--as", help="What it becomes: force-law.")] = "force-law",
    case: Annotated[str, typer.Option(help="Case of a study: the beginning of its id.")] = "",
    test: Annotated[int, typer.Option(min=1, help="Test of a calibration, from 1.")] = 1,
    tolerance: Annotated[
        float, typer.Option(help="Wanted error bound over the largest force.")
    ] = 0.002,
    settings: Set = None,
    reports: Reports = REPORTS,
    as_json: Json = False,
) -> None:
    """Turn a simulated test into a function: JSON, CSV, Python and C, with its error bound."""
    from study import api

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


def _print_export(found: Export) -> None:
    for line in sentences(found.law):
        output.paragraph(line)
    for path in found.paths:
        print(f"written: {path}")


VERBS: tuple[Callable[..., None], ...] = (export,)
