"""The verb ``verify``: every number of a report once more."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from study.cli import next_command, output
from study.cli.studies import REPORTS, RESULTS, Data, Json, Reports, Results

if TYPE_CHECKING:
    from study.api.verification import Verification


def verify(
    path: Annotated[
        Path,
        typer.Argument(
            help="Page or folder of a report, or study name.", autocompletion=next_command.studies
        ),
    ],
    resolve: Annotated[
        int, typer.Option(min=0, help="Cases to be solved again from nothing, drawn at random.")
    ] = 0,
    seed: Annotated[int, typer.Option(min=0, help="Of the draw.")] = 1,
    data: Data = None,
    results: Results = RESULTS,
    reports: Reports = REPORTS,
    allow_commands: Annotated[
        bool, typer.Option("--allow-commands", help="Let --resolve run programs.")
    ] = False,
    tolerance: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            help="Relative difference to pass over: by default none, and 1e-9 where the report was "
            "written on another kind of processor or with other libraries.",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Compute every number of a report again from its records; exit 1 if one differs."""
    from study import api

    found = api.verify(
        path, results=results, reports=reports, resolve=resolve, seed=seed, data=data,
        allow_commands=allow_commands, tolerance=tolerance,
    )  # fmt: skip
    if as_json:
        output.print_json(found.to_json())
    else:
        _show(found)
    raise typer.Exit(0 if found.agrees else 1)


def _show(found: Verification) -> None:
    from study.api.verification import TOLD

    counted = ", ".join(f"{count} of {kind}" for kind, count in sorted(found.numbers.items()))
    print(f"{found.numbers.total()} numbers computed again (100 %): {counted}")
    print(f"{found.records} records checked against their sums")
    if found.solved:
        print(f"{found.solved} cases solved again from nothing")
    if found.rounded:
        print(
            f"{found.rounded} lines agree to a relative {found.tolerance:g} and not to the last "
            "digit: another processor, or other libraries, add up the same numbers otherwise"
        )
    for one in found.differences[:TOLD]:
        print(f"{one.where}\n    reported:   {one.reported}\n    recomputed: {one.recomputed}")
    if len(found.differences) > TOLD:
        print(f"and {len(found.differences) - TOLD} more")
    print("all agree" if found.agrees else f"{len(found.differences)} differences")


VERBS: tuple[Callable[..., None], ...] = (verify,)
