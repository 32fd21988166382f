"""The verb converge: what it asks and what it prints."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from study.cli import output
from study.cli.output import Document
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
    if as_json:
        output.print_json(document)
    else:
        for cell in cells:
            _print_series(cell)
        for front in document.get("fronts", ()):
            _print_front(front)
        if left_out := document.get("left_out"):
            cells_left = (" / ".join(map(str, cell["levels"].values())) for cell in left_out)
            print(f"not refined, for the time budget does not allow it: {', '.join(cells_left)}")
            print("  a longer budget in [converge], or none, refines them too\n")
        if document.get("report"):
            print(f"report: {document['report']}")
    if any(mesh["status"] != "converged" for cell in cells for mesh in cell.get("meshes", ())):
        raise typer.Exit(1)


def _numbers(text: str, option: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",") if part.strip()]
    except ValueError:
        rule = f"must be numbers with commas, got {text!r}"
        raise InputError(Fault(option, rule)) from None


def _print_series(cell: Document) -> None:
    from study.reporting.output import convergence_page

    labels = " / ".join(str(v) for v in (cell.get("levels") or {}).values())
    parts = (labels, cell["qoi"].removeprefix("value"), cell.get("note", ""))
    title = ": ".join(part for part in parts[:2] if part) + (f" ({parts[2]})" if parts[2] else "")
    print(title.strip())  # the title of a narrow table would be folded
    output.table(_mesh_rows(cell))
    print(cell["verdict"])
    if cell.get("formal_reason"):
        print(f"formal order {cell['formal_order']:.3g}: {cell['formal_reason']}")
    _print_limit(cell)
    if len(cell.get("quantities") or {}) > 1:
        output.content(convergence_page.series_table([cell]), "quantities")
    for table in convergence_page.sources_tables([cell]):
        output.content(table, "error by source")
    output.warn(cell.get("warnings") or ())
    print()


def _mesh_rows(cell: Document) -> list[list[str]]:
    unit = f"value [{cell['unit']}]" if cell["unit"] else "value"
    meshes = [m for m in cell.get("meshes") or () if m["status"] == "converged"]
    pairs = list(zip(cell["mesh_size"], cell["value"], strict=True))
    if len(meshes) != len(pairs):
        return [["mesh size", unit]] + [[f"{h:.5g}", f"{v:.8g}"] for h, v in pairs]
    rows = [["mesh size [mm]", unit, "elements", "unknowns", "seconds", "predicted", "MB"]]
    for (h, v), mesh in zip(pairs, meshes, strict=True):
        rows.append([
            f"{h:.5g}", f"{v:.8g}", str(mesh["elements"]), str(mesh["unknowns"]),
            f"{mesh['seconds']:.3g}", output.number(mesh["predicted_seconds"], 3),
            f"{mesh['memory_MB']:.0f}",
        ])  # fmt: skip
    return rows


def _print_limit(cell: Document) -> None:
    if cell["gci_fine"] is not None:
        print(f"order {output.number(cell['observed_order'])}, "
              f"extrapolated {output.number(cell['extrapolated'], 8)}, "
              f"GCI {100 * cell['gci_fine']:.4g} %")  # fmt: skip
    if cell["u_num"] is not None:
        unit = f" {cell['unit']}" if cell["unit"] else ""
        print(f"finest value {cell['value'][0]:.8g} +- {cell['u_num']:.3g}{unit}")
    given = cell.get("given_mesh")
    if given and given["u_num"] is not None:
        share = f" ({100 * given['u_num'] / abs(given['value']):.2g} %)" if given["value"] else ""
        print(f"on the mesh as given: {given['value']:.6g} +- {given['u_num']:.2g}{share}")
    if cell.get("mesh_size_needed"):
        print(f"{100 * cell['accuracy']:g} % needs a mesh size of {cell['mesh_size_needed']:.3g}")
    if cell.get("stopped"):
        print(f"stopped: {cell['stopped']}")


def _print_front(front: Document) -> None:
    title = f"error and seconds against the limit {front['reference']:.6g}"
    rows = [["cell", "mesh size", "unknowns", "seconds", "MB", "error"]]
    for p in front["points"]:
        rows.append([
            p["cell"], f"{p['mesh_size']:.3g}", str(p["unknowns"]), f"{p['seconds']:.3g}",
            f"{p['memory_MB']:.0f}", f"{100 * p['error']:.2g} %",
        ])  # fmt: skip
    print(title)
    output.table(rows)
    print(front["answer"])
