"""Verbs about one thing: new, solve, converge, virtual, doctor (calibrate has its own file)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from study.cli import show
from study.cli.calibration import calibrate
from study.cli.studies import RESULTS, Json, Results, Set
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
    as_json: Json = False,
) -> None:
    """Simulate one test."""
    from study import api
    from study.api.single import solution_json

    found = solution_json(api.solve(file, overrides=settings or ()))
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


def converge(
    file: Annotated[Path | None, typer.Argument(help="Problem file, or a finished study.")] = None,
    values: Annotated[str, typer.Option(help="Values of the quantity, with commas.")] = "",
    sizes: Annotated[str, typer.Option(help="Mesh sizes of these values, with commas.")] = "",
    formal_order: Annotated[float | None, typer.Option(help="Order that elements promise.")] = None,
    tolerance: Annotated[float, typer.Option(help="Algebraic error of a value.")] = 0.0,
    settings: Set = None,
    results: Results = RESULTS,
    as_json: Json = False,
) -> None:
    """Judge mesh convergence: observed order, extrapolated value, GCI."""
    import sys

    from study import api

    found = api.converge(
        file,
        values=_numbers(values, "--values"),
        sizes=_numbers(sizes, "--sizes"),
        formal_order=formal_order,
        tolerance=tolerance,
        overrides=settings or (),
        results=results,
        progress=lambda text: print(text, file=sys.stderr),
    )
    document = found if isinstance(found, dict) else found.to_json()
    if as_json:
        show.print_json(document)
        return
    for cell in document.get("cells", [document]):
        _print_series(cell)


def _numbers(text: str, option: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",") if part.strip()]
    except ValueError:
        rule = f"must be numbers with commas, got {text!r}"
        raise InputError(Fault(option, rule)) from None


def _print_series(cell: dict[str, Any]) -> None:
    title = f"{cell['qoi']} {cell.get('note', '')}".strip().removeprefix("value")
    rows = [["mesh size", f"value [{cell['unit']}]" if cell["unit"] else "value"]]
    pairs = zip(cell["mesh_size"], cell["value"], strict=True)
    rows += [[f"{size:.5g}", f"{value:.8g}"] for size, value in pairs]
    show.table(rows, title)
    print(cell["verdict"])
    if cell["gci_fine"] is not None:
        print(f"order {cell['observed_order']:.4g}, extrapolated {cell['extrapolated']:.8g}, "
              f"GCI {100 * cell['gci_fine']:.4g} %")  # fmt: skip
    print()


def virtual(
    out: Annotated[Path, typer.Argument(help="Folder for the generated CSV files.")],
    source: Annotated[
        Path | None, typer.Option("--from", help="Design whose measurements are imitated.")
    ] = None,
    settings: Set = None,
) -> None:
    """Write virtual measurements as CSV."""
    from study import api

    for path in api.virtual(out, source, overrides=settings or ()):
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
