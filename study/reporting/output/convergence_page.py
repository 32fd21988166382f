"""The page of a mesh convergence study: answer, figures with their data, tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from study.ground.arrays import Array, Ints
from study.reporting.content.blocks import Block, Document, Table, Verbatim
from study.reporting.content.tables import label_of
from study.reporting.content.text import (
    MISSING,
    clean,
    general,
    name_of,
    quantity,
    sentence,
    significant,
)
from study.reporting.figures.axes import Plot, bound
from study.reporting.output.write import answer_blocks, write_answer

#: Parts of a value below this are written as "less than".
SMALLEST_PART = 1e-5
Meshes = Sequence[tuple[str, Array, Ints]]


def write_convergence(
    name: str,
    question: str,
    document: Document,
    out_dir: str | Path,
    meshes: Meshes = (),
    window: ArrayLike | None = None,
) -> Path:
    """Write the page of a convergence document, with the data of its figures beside it.

    Shapes: window (2, 2), mm.
    """
    cells = list(document.get("cells", [document]))
    plots = convergence_plots(cells, document.get("fronts", ()), meshes, window)
    tables = [series_table(cells), *sources_tables(cells)]
    blocks = answer_blocks(answers(cells, document), plots, tables, series_warnings(cells))
    return write_answer("mesh convergence", name, question, blocks, out_dir, stem="convergence")


def series_warnings(cells: Sequence[Document]) -> list[str]:
    """Warnings of every series, each with its cell where there are several."""
    return [
        f"{label_of(cell)}: {text}" if len(cells) > 1 else str(text)
        for cell in cells
        for text in cell.get("warnings") or ()
    ]


def convergence_plots(
    cells: Sequence[Document],
    fronts: Sequence[Document] = (),
    meshes: Meshes = (),
    window: ArrayLike | None = None,
) -> dict[str, Plot]:
    """Value against size, error against size, error against seconds, meshes."""
    import pandas as pd

    from study.reporting.figures import convergence_figures as convergence

    shown = [cell for cell in cells if len(cell.get("value", ())) > 1]
    plots: dict[str, Plot] = {}
    if shown:
        plots["values"] = bound(convergence.values_against(), shown)
    if any(cell["extrapolated"] is not None for cell in shown):
        plots["errors"] = bound(convergence.ERRORS, shown)
    plots |= {f"front-{k}": bound(convergence.FRONT, front) for k, front in enumerate(fronts, 1)}
    if meshes:
        sizes = [(label, len(points), len(elements)) for label, points, elements in meshes]
        plots["meshes"] = (
            "Meshes",
            lambda: pd.DataFrame(sizes, columns=["mesh", "points", "cells"]),
            lambda _: convergence.draw_meshes(meshes, np.asarray(window, float)),
            "The coarsest and the finest mesh, in the same window.",
        )
    return {f"convergence-{name}": plot for name, plot in plots.items()}


def answers(cells: Sequence[Document], document: Document) -> Iterator[str]:
    """Say in a few sentences what was found."""
    yield from (sentence(front["answer"]) for front in document.get("fronts", ()))
    for cell in cells if len(cells) == 1 else ():
        unit = f" in {clean(cell['unit'])}" if cell["unit"] else ""
        yield sentence(f"{name_of(cell['qoi'])}{unit}: {clean(cell['verdict'])}")
        given = cell.get("given_mesh")
        if given and given["u_num"] is not None and given["value"]:
            share = 100 * given["u_num"] / abs(given["value"])
            yield f"On the mesh as given the value is known to {share:.2g} %."
    yield from formal_orders(cells)
    if len(cells) > 1:
        kinds = Counter(str(cell["behaviour"]) for cell in cells)
        line = f"{len(cells)} series: " + ", ".join(f"{n} {kind}" for kind, n in kinds.items())
        orders = [c["observed_order"] for c in cells if c["observed_order"] is not None]
        between = f"; observed orders {min(orders):.2f} to {max(orders):.2f}" if orders else ""
        yield f"{line}{between}."


def formal_orders(cells: Sequence[Document]) -> list[str]:
    """Say which order is to be expected, and why, once for every reason."""
    return list(
        dict.fromkeys(
            f"Formal order {float(cell['formal_order']):.3g}: {clean(cell['formal_reason'])}."
            for cell in cells
            if cell.get("formal_reason") and cell.get("formal_order")
        )
    )


def part(share: float | None) -> str:
    """Write a part of a value in percent; below a thousandth no one can measure it."""
    if share is not None and 0 < share < SMALLEST_PART:
        return "< " + quantity(100 * SMALLEST_PART, "%", 1)
    return quantity(None if share is None else 100 * share, "%", 2)


def series_table(cells: Sequence[Document]) -> Table:
    """Every quantity of every cell: behavior, order, limit, uncertainty."""
    rows, raw = [], []
    for cell in cells:
        for name, q in (cell.get("quantities") or {cell["qoi"]: cell}).items():
            if not q["value"]:
                continue
            u = q["u_num"]
            share = MISSING if u is None else f"{significant(u, 3)} {clean(q['unit'])}".strip()
            if u is not None and q["value"][0]:
                share += f" ({part(u / abs(q['value'][0]))})"
            rows.append((
                clean(label_of(cell)), name_of(str(name)),
                f"{significant(q['value'][0], 4)} {clean(q['unit'])}".strip(),
                significant(q["extrapolated"], 4), significant(q["observed_order"]),
                significant(q["formal_order"]), share, clean(str(q["behaviour"])),
            ))  # fmt: skip
            raw.append({
                "cell": label_of(cell), "quantity": name, "unit": q["unit"],
                "finest_value": q["value"][0], "extrapolated": q["extrapolated"],
                "observed_order": q["observed_order"], "formal_order": q["formal_order"],
                "u_num": u, "gci_fine": q["gci_fine"], "behaviour": q["behaviour"],
                "verdict": q["verdict"],
            })  # fmt: skip
    columns = ("cell", "quantity", "finest value", "limit", "order", "formal", "u_num", "behavior")
    return of_cells(Table("Series", columns, tuple(rows), 2, 1, raw=tuple(raw)), len(cells))


def sources_tables(cells: Sequence[Document]) -> list[Table]:
    """One table of mesh, load steps and solver tolerance for all cells that have it."""
    rows, raw = [], []
    for cell in cells:
        for row in cell.get("sources") or ():
            name = name_of(str(row["quantity"]))
            rows.append((clean(label_of(cell)), name, clean(row["source"]), part(row["relative"])))
            raw.append({"cell": label_of(cell)} | {
                k: row[k] for k in ("quantity", "source", "unit", "u", "relative")
            })  # fmt: skip
    if not rows:
        return []
    columns = ("cell", "quantity", "source of error", "part of the value")
    return [
        of_cells(Table("Errors by source", columns, tuple(rows), 3, raw=tuple(raw)), len(cells))
    ]


def of_cells(table: Table, number: int) -> Table:
    """Table whose first column names the cells; a single one needs no name."""
    if number > 1:
        return table
    rows = tuple(row[1:] for row in table.rows)
    return replace(table, columns=table.columns[1:], rows=rows, left=table.left - 1)


def series_blocks(document: Document) -> Iterator[Block]:
    """Every series with its verdict and limit, then the fronts of error and cost."""
    for cell in document.get("cells", [document]):
        yield from _series(cell)
    for front in document.get("fronts", ()):
        yield Table.of(
            f"error and seconds against the limit {front['reference']:.6g}",
            front["points"],
            {
                "cell": lambda p: p["cell"],
                "mesh size": lambda p: f"{p['mesh_size']:.3g}",
                "unknowns": lambda p: str(p["unknowns"]),
                "seconds": lambda p: f"{p['seconds']:.3g}",
                "MB": lambda p: f"{p['memory_MB']:.0f}",
                "error": lambda p: f"{100 * p['error']:.2g} %",
            },
        )
        yield Verbatim(front["answer"])
    if left_out := document.get("left_out"):
        cells_left = (" / ".join(map(str, cell["levels"].values())) for cell in left_out)
        yield Verbatim(
            f"not refined, for the time budget does not allow it: {', '.join(cells_left)}"
        )
        yield Verbatim("  a longer budget in [converge], or none, refines them too\n")
    if document.get("report"):
        yield Verbatim(f"report: {document['report']}")


def _series(cell: Document) -> Iterator[Block]:
    labels = " / ".join(map(str, (cell.get("levels") or {}).values()))
    title = ": ".join(filter(None, (labels, cell["qoi"].removeprefix("value"))))
    note = f" ({cell['note']})" if cell.get("note") else ""
    yield Verbatim(f"{title}{note}".strip())  # the title of a narrow table would be folded
    yield _meshes(cell)
    yield Verbatim(cell["verdict"])
    if cell.get("formal_reason"):
        order = cell.get("formal_order")
        head = "no formal order" if order is None else f"formal order {order:.3g}"
        yield Verbatim(f"{head}: {cell['formal_reason']}")
    if cell["gci_fine"] is not None:
        yield Verbatim(
            f"order {general(cell['observed_order'])}, extrapolated "
            f"{general(cell['extrapolated'], 8)}, GCI {100 * cell['gci_fine']:.4g} %"
        )
    if cell["u_num"] is not None:
        u = quantity(cell["u_num"], cell["unit"] or "")
        yield Verbatim(f"finest value {cell['value'][0]:.8g} \N{PLUS-MINUS SIGN} {u}")
    given = cell.get("given_mesh")
    if given and given["u_num"] is not None:
        share = f" ({part(given['u_num'] / abs(given['value']))})" if given["value"] else ""
        u = quantity(given["u_num"], cell["unit"] or "")
        yield Verbatim(f"on the mesh as given: {given['value']:.6g} \N{PLUS-MINUS SIGN} {u}{share}")
    if cell.get("mesh_size_needed"):
        needed = f"a mesh size of {cell['mesh_size_needed']:.3g}"
        yield Verbatim(f"{100 * cell['accuracy']:g} % needs {needed}")
    if cell.get("stopped"):
        yield Verbatim(f"stopped: {cell['stopped']}")
    if len(cell.get("quantities") or {}) > 1:
        yield replace(series_table([cell]), name="quantities")
    yield from (replace(table, name="error by source") for table in sources_tables([cell]))
    yield Verbatim("")


def _meshes(cell: Document) -> Table:
    unit = f"value [{cell['unit']}]" if cell["unit"] else "value"
    meshes = [m for m in cell.get("meshes") or () if m["status"] == "converged"]
    pairs = list(zip(cell["mesh_size"], cell["value"], strict=True))
    if len(meshes) != len(pairs):
        return Table("", ("mesh size", unit), tuple((f"{h:.5g}", f"{v:.8g}") for h, v in pairs))
    return Table.of(
        "",
        [(h, v, mesh) for (h, v), mesh in zip(pairs, meshes, strict=True)],
        {
            "mesh size [mm]": lambda of: f"{of[0]:.5g}",
            unit: lambda of: f"{of[1]:.8g}",
            "elements": lambda of: str(of[2]["elements"]),
            "unknowns": lambda of: str(of[2]["unknowns"]),
            "seconds": lambda of: f"{of[2]['seconds']:.3g}",
            "predicted": lambda of: general(of[2]["predicted_seconds"], 3),
            "MB": lambda of: f"{of[2]['memory_MB']:.0f}",
        },
    )
