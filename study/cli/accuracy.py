"""Verbs that compare with an instrument: tracking, shape."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from study.cli import output
from study.cli.studies import REPORTS, Data, Json, Reports


def tracking(
    file: Annotated[Path, typer.Argument(help="TOML file of the tracker study.")],
    data: Data = None,
    reports: Reports = REPORTS,
    as_json: Json = False,
) -> None:
    """Judge a tracker: fixed distances, commanded displacements, a better instrument."""
    from study import api
    from study.reporting.content.tracker import answers

    found = api.tracking(file, data=data, reports=reports)
    if as_json:
        output.print_json(found.to_json())
        return
    for line in answers(found):
        output.paragraph(line)
    print(f"report: {found.report}")


VERBS: tuple[Callable[..., None], ...] = (tracking,)
