"""The verb that plans the number of specimens."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated

import typer

from study.cli import output
from study.cli.studies import RESULTS, Data, Design, Json, Results, Set

if TYPE_CHECKING:
    from study.api.planning.detection import Detection


def power(
    design: Design,
    sd: Annotated[
        float | None,
        typer.Option(help="Scatter of a difference between specimens, in the response's unit."),
    ] = None,
    data: Data = None,
    settings: Set = None,
    results: Results = RESULTS,
    as_json: Json = False,
) -> None:
    """Say how many specimens a claim needs, and what they cost."""
    from study import api

    found = api.power(design, sd=sd, data=data, results=results, overrides=settings or ())
    output.warn(found.warnings)
    if as_json:
        output.print_json(found.to_json())
        return
    for one in found.detections:
        _print(one, found.blocks)


def _print(one: Detection, blocks: int) -> None:
    output.paragraph(
        f"{one.response}: {_size(one.practical, one)} matters; between specimens a difference "
        f"scatters by {_size(one.sd, one)} ({one.source})"
        + (f"; numerics {_size(one.u, one)}" if one.u else "")
    )
    rows = [["specimens", "shows that none matters", "shows that one matters", "cases", "time"]]
    for row in one.rows:
        mark = " (measured)" if row.blocks == blocks else ""
        rows.append(
            [
                f"{row.blocks}{mark}",
                f"{100 * row.equal.no_practical_difference:.0f} %",
                f"{100 * row.double.matters:.0f} %",
                str(row.cases),
                "" if row.seconds is None else output.seconds(row.seconds),
            ]
        )
    output.table(rows, "")
    said = [
        f"{100 * wanted:.0f} %: {'no number up to 200' if n is None else f'{n} specimens'}"
        for wanted, n in one.enough
    ]
    output.paragraph(
        "Right in both cases (no difference, and one twice as large as matters) with "
        + ", ".join(said)
        + "\n"
    )


def _size(value: float, one: Detection) -> str:
    """Return a difference with its unit, or a ratio."""
    return f"x {math.exp(value):.3g}" if one.ratio else f"{value:.3g} {one.unit}".rstrip()
