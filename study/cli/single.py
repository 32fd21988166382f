"""Verbs about one thing: new, solve, virtual, doctor (calibrate, converge: own files)."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from study.cli import show
from study.cli.calibration import calibrate
from study.cli.convergence import converge
from study.cli.studies import Json, Set
from study.errors import Fault, InputError


def new(
    file: Annotated[Path, typer.Argument(help="Design file to be written.")],
) -> None:
    """Write a commented design to start from."""
    from study.design import template

    try:
        with file.open("x", encoding="utf-8") as stream:
            stream.write(template())
    except FileExistsError:
        rule = "exists already"
        raise InputError(Fault(str(file), rule, "choose another name")) from None
    except OSError as error:
        rule = f"cannot be written ({error.strerror or error})"
        raise InputError(Fault(str(file), rule)) from None
    print(f"{file}: edit it, then: study plan {file}")


def solve(
    file: Annotated[Path, typer.Argument(help="Problem file.")],
    settings: Set = None,
    picture: Annotated[
        Path | None, typer.Option(help="SVG file for a picture of the deformed mesh.")
    ] = None,
    vtu: Annotated[
        Path | None, typer.Option(help="VTU file for the deformed fields, for ParaView.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Simulate one test."""
    from study import api
    from study.api.single import solution_json, writable, write_picture, write_vtu

    writable(picture, vtu)
    solution = api.solve(file, overrides=settings or ())
    found = solution_json(solution)
    if not found["displacement_mm"] and (picture or vtu):
        print("no step converged: nothing is drawn or written", file=sys.stderr)
        picture = vtu = None
    if picture is not None:
        write_picture(solution, picture)
    if vtu is not None:
        write_vtu(solution, vtu)
    if as_json:
        show.print_json(found)
    else:
        rows = [["displacement [mm]", "force [N]", "stiffness [N/mm]"]]
        columns = (found["displacement_mm"], found["force_N"], found["stiffness_N_per_mm"])
        rows += [[f"{v:.6g}" for v in row] for row in zip(*columns, strict=True)]
        show.table(rows)
        print(f"{found['status']}: {found['message']}")
        total = found["seconds"]["total"]
        print(f"{found['dofs']} unknowns, {total:.2f} s, {found['solver']}")
    if found["status"] != "converged":
        raise typer.Exit(1)


def virtual(
    out: Annotated[Path, typer.Argument(help="Folder for the generated CSV files.")],
    source: Annotated[
        Path | None, typer.Option("--from", help="Design whose measurements are imitated.")
    ] = None,
    truth: Annotated[
        str, typer.Option(help="Material behind the specimens: yeoh, ogden or humphrey.")
    ] = "yeoh",
    specimens: Annotated[
        int | None, typer.Option(min=2, help="Number of specimens (or batches).")
    ] = None,
    settings: Set = None,
) -> None:
    """Write virtual measurements as CSV."""
    from study import api

    chosen = {"overrides": settings or (), "truth": truth, "blocks": specimens}
    for path in api.virtual(out, source, **chosen):
        print(path)


def doctor(as_json: Json = False) -> None:
    """Check the installation."""
    from study.api.doctor import examine

    found = examine()
    if as_json:
        show.print_json(found)
    else:
        rows = [["check", "outcome", "finding"]]
        rows += [[c["name"], c["outcome"], c["finding"]] for c in found["checks"]]
        show.table(rows)
    if not found["ok"]:
        raise typer.Exit(1)


VERBS: tuple[Callable[..., None], ...] = (new, solve, calibrate, converge, virtual, doctor)
