"""How many unknowns, and how many seconds, each element needs for a force.

    make elements    solve every mesh, write elements.csv (3 minutes), then draw
    python docs/elements.py draw    write elements.svg and the tables of elements.md

The needle is the one of the other codes' figures: half-angle 30 degrees, tip of 1 mm, 2 mm
deep in a cylinder of 25 mm by 50 mm on a bonded base, K / mu0 = 1000, axisymmetric.
"""

from __future__ import annotations

import csv
import math
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

from study.ground.errors import MeshError
from study.mechanics.material.material import Material
from study.mechanics.mesh.mesher import build_mesh, regular_mesh
from study.mechanics.setup.geometry import Cone, Cylinder
from study.mechanics.setup.setup import Model, Problem
from study.mechanics.setup.test_kind import Test
from study.mechanics.solver.finite_element_solution import solve
from study.mechanics.solver.solution import Solution
from study.mechanics.solver.solution_cost import unknowns
from study.statistics.convergence.grid_convergence import ConvergenceResult, grid_convergence

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

HERE = Path(__file__).resolve().parent
TABLE, PICTURE, PAGE = HERE / "elements.csv", HERE / "elements.svg", HERE / "elements.md"

NEEDLE = Test("indentation", 2.0, "frictionless", "bonded", 4, Cone(30.0, 1.0))
RUBBER = Material("reduced-polynomial", {"C10": 5e-3, "C20": 1e-3}, bulk_modulus=10.0)
PROBLEM = Problem(Cylinder(25.0, 50.0), NEEDLE, RUBBER, Model())

#: named sizes at the tip, each 1.5 times the next
SIZES_MM = tuple(0.9 / 1.5**k for k in range(8))
#: the reference: quadratic mixed quadrilaterals, of which the last is the finest mesh of all
REFERENCE_MM = tuple(0.9 / 1.5**k for k in (5, 6, 7))
#: order that `study converge` expects where the rim of a contact lies inside an element
RIM_ORDER = 2.0
REFERENCE_ELEMENT = ("tensor", "quadratic", "mixed")
#: series begin and end at so many unknowns; displacement elements lock and take minutes
FEWEST, MOST = 100, {"mixed": 24_000, "displacement": 15_000}
#: accuracies that the table names
WANTED = (0.01, 0.001)

SHAPES = {"simplex": "triangles", "tensor": "quadrilaterals"}
ELEMENTS = list(product(("linear", "quadratic"), SHAPES, ("mixed", "displacement")))
COLUMNS = (
    "order", "shape", "formulation", "mesh_size_mm", "unknowns", "force_N", "status",
    "iterations", "seconds", "mesh_seconds",
)  # fmt: skip


# --- measuring ---------------------------------------------------------------------------
def measure() -> None:
    """Solve every mesh of every element and of the reference."""
    if os.environ.get("MKL_NUM_THREADS") != "1":
        sys.exit("seconds are those of one thread: run it as make elements")
    with TABLE.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
        writer.writeheader()
        for row in rows():
            print(*row.values(), sep="\t", flush=True)
            writer.writerow(row)


def rows() -> Iterator[dict[str, object]]:
    """Rows of the table, one a mesh; the last ones are the reference."""
    for order, shape, formulation in ELEMENTS:
        compiled(problem(order, shape, formulation, SIZES_MM[1]))
        for size in SIZES_MM:
            yield from measured(order, shape, formulation, size, MOST[formulation])
    shape, order, formulation = REFERENCE_ELEMENT
    for size in REFERENCE_MM:
        for row in measured(order, shape, formulation, size):
            yield row | {"formulation": "reference"}


def problem(order: str, shape: str, formulation: str, size_mm: float) -> Problem:
    """Return the needle on one mesh."""
    named: Any = {"element_order": order, "element_shape": shape, "formulation": formulation}
    return replace(PROBLEM, model=Model("axisymmetric", mesh_size_mm=size_mm, **named))


def compiled(asked: Problem) -> None:
    """Compile what a problem needs, so that no later one pays for it."""
    solve(replace(asked, test=replace(asked.test, displacement_mm=0.2, steps=1)), gradients=False)


def measured(
    order: str, shape: str, formulation: str, size_mm: float, most: float = float("inf")
) -> Iterator[dict[str, object]]:
    """Row of one mesh, if any: processor seconds of one thread, the least of three runs."""
    asked = problem(order, shape, formulation, size_mm)
    try:
        if not FEWEST <= unknowns(asked.setup, build_mesh(asked.setup)) <= most:
            return
        runs = [timed(asked)]
    except MeshError as error:
        print(f"{order} {shape} at {size_mm:.3g} mm: {error}", file=sys.stderr)
        return
    if runs[0][1] < 10.0:
        runs += [timed(asked) for _ in range(2)]
    solution = runs[0][0]
    forces = solution.curve.force_N
    values = (
        order, shape, formulation, f"{size_mm:.4g}", solution.dofs,
        f"{forces[-1]:.8g}" if solution.converged else "", solution.status,
        sum(solution.newton_iterations), f"{min(run[1] for run in runs):.3f}",
        f"{min(run[2] for run in runs):.3f}",
    )  # fmt: skip
    yield dict(zip(COLUMNS, values, strict=True))


def timed(asked: Problem) -> tuple[Solution, float, float]:
    """Solution, processor seconds in all, and those of making the mesh."""
    regular_mesh.cache_clear()
    began = time.process_time()
    mesh = build_mesh(asked.setup)
    meshed = time.process_time()
    solution = solve(asked, gradients=False, mesh=mesh)
    return solution, time.process_time() - began, meshed - began


# --- drawing -----------------------------------------------------------------------------
def draw() -> None:
    """Write the picture and the tables of the page."""
    from study.reporting.figures.axes import render

    frame, reference = read()
    svg = render(lambda: picture(frame, reference), "elements", "Error of the force by element")
    # it stands alone here: a page around it would have given it a font and a ground
    own = '<svg style="background: #ffffff; font-family: DejaVu Sans, Arial, sans-serif" '
    PICTURE.write_text(svg.replace("<svg ", own, 1) + "\n", encoding="utf-8")
    text = PAGE.read_text(encoding="utf-8")
    for name, table in (
        ("needed", needed(frame, doubt(reference))),
        ("meshes", meshes(frame, reference)),
    ):
        text = between(text, name, table)
    PAGE.write_text(text, encoding="utf-8")
    print(f"reference {reference.value[0]:.6g} N, {reference.behaviour}, u = {reference.u_num:.2g}")


def between(text: str, name: str, table: str) -> str:
    """Return the page with a new table between two marks."""
    start, end = f"<!-- {name}: made by elements.py -->\n", f"<!-- end of {name} -->"
    before, rest = text.split(start)
    return before + start + "\n" + table + "\n" + end + rest.split(end)[1]


def read() -> tuple[pd.DataFrame, ConvergenceResult]:
    """Rows with their relative errors, and the reference with its uncertainty."""
    import pandas as pd

    frame = pd.read_csv(TABLE)
    finest = frame[frame["formulation"] == "reference"]
    reference = grid_convergence(
        finest["mesh_size_mm"], finest["force_N"], formal_order=RIM_ORDER, tolerance=1e-8,
        qoi="force", unit="N",
    )  # fmt: skip
    kept = frame[frame["formulation"] != "reference"].copy()
    kept["error"] = (kept["force_N"] - reference.value[0]).abs() / reference.value[0]
    return kept, reference


def doubt(reference: ConvergenceResult) -> float:
    """Relative uncertainty of the reference."""
    return (reference.u_num or 0.0) / reference.value[0]


def named(order: str, shape: str) -> str:
    """Name of an element."""
    return f"{order} {SHAPES[shape]}"


def picture(frame: pd.DataFrame, reference: ConvergenceResult) -> Figure:
    """Error against unknowns and against seconds."""
    from study.reporting.figures.axes import WIDTH_IN, canvas

    figure = canvas(WIDTH_IN, 4.9)
    left, right = figure.subplots(1, 2, sharey=True)
    for ax, column in ((left, "unknowns"), (right, "seconds")):
        lines(ax, frame, column, doubt(reference))
    left.set_xlabel("unknowns")
    right.set_xlabel("seconds of one processor, mesh included")
    left.set_ylabel("error of the force at 2 mm")
    ticks(left, "x", (100, 300, 1000, 3000, 10_000), "{:,g}")
    ticks(right, "x", (0.1, 0.3, 1, 3, 10, 30, 100, 300), "{:g}")
    ticks(left, "y", (1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1, 3), "{:g} %", scale=100)
    figure.legend(handles=key(), loc="outside lower center", ncols=6, handlelength=2.6)
    return figure


def key() -> list[Line2D]:
    """Entries of the legend: colors and marks of the elements, strokes of the formulations."""
    from matplotlib.lines import Line2D

    from study.reporting.figures.axes import MARKERS, MUTED, color_of

    pairs = list(product(("linear", "quadratic"), SHAPES))
    entries = [
        Line2D([], [], color=color_of(k), marker=MARKERS[k], markersize=5, label=named(*pair))
        for k, pair in enumerate(pairs)
    ]
    for formulation in ("mixed", "displacement"):
        look = stroke(formulation, MUTED)
        entries.append(Line2D([], [], color=MUTED, marker="o", label=formulation, **look))
    return entries


def stroke(formulation: str, color: str) -> dict[str, Any]:
    """Return filled marks on a line for mixed elements, hollow ones on dashes for others."""
    mixed = formulation == "mixed"
    line = "-" if mixed else (0, (4, 2))
    return {"linestyle": line, "markerfacecolor": color if mixed else "white", "markersize": 5}


def lines(ax: Axes, frame: pd.DataFrame, column: str, unknown: float) -> None:
    """Draw one line an element; below the band the reference itself is not known."""
    from study.reporting.figures.axes import BAND, MARKERS, MUTED, color_of

    ax.set_xscale("log")
    ax.set_yscale("log")
    for k, (order, shape) in enumerate(product(("linear", "quadratic"), SHAPES)):
        for formulation in ("mixed", "displacement"):
            part = series(frame, order, shape, formulation)
            part = part[part["error"] > unknown]
            ax.plot(
                part[column], part["error"], color=color_of(k), marker=MARKERS[k],
                **stroke(formulation, color_of(k)),
            )  # fmt: skip
    low = unknown / 3
    ax.axhspan(low, unknown, color=BAND, zorder=0)
    ax.text(
        0.98, unknown * 0.58, "uncertainty of the reference", color=MUTED, fontsize=7.5,
        transform=ax.get_yaxis_transform(), ha="right", va="center",
    )  # fmt: skip
    ax.set_ylim(bottom=low)


def ticks(ax: Axes, axis: str, places: tuple[float, ...], shown: str, *, scale: float = 1) -> None:
    """Plain numbers on a logarithmic axis, where they are within its range."""
    from matplotlib.ticker import NullFormatter

    low, high = ax.get_xlim() if axis == "x" else ax.get_ylim()
    within = [p for p in places if low <= p <= high]
    one = ax.xaxis if axis == "x" else ax.yaxis
    one.set_ticks(within, [shown.format(p * scale) for p in within])
    one.set_minor_formatter(NullFormatter())


def series(frame: pd.DataFrame, order: str, shape: str, formulation: str) -> pd.DataFrame:
    """Meshes of one element that were solved, coarse to fine."""
    chosen = frame[(frame["order"] == order) & (frame["shape"] == shape)]
    chosen = chosen[(chosen["formulation"] == formulation) & (chosen["status"] == "converged")]
    return chosen.sort_values("mesh_size_mm", ascending=False)


def needed(frame: pd.DataFrame, unknown: float) -> str:
    """Table: the first mesh of each series from which on the error stays below a bound."""
    heads = ["element", "formulation"]
    heads += [f"within {100 * w:g} %: unknowns, seconds" for w in WANTED]
    heads += ["smallest error (unknowns, seconds)", "order", "unsolved"]
    body = []
    for order, shape, formulation in ELEMENTS:
        part = series(frame, order, shape, formulation)
        part = part.assign(error=part["error"].clip(lower=unknown))
        best = part.loc[part["error"] == part["error"].min()].iloc[0]
        failed = frame[
            (frame["order"] == order) & (frame["shape"] == shape)
            & (frame["formulation"] == formulation) & (frame["status"] != "converged")
        ]  # fmt: skip
        cells = [named(order, shape), formulation, *(first(part, w) for w in WANTED)]
        below = "< " if best["error"] <= unknown else ""
        cells.append(f"{below}{percent(best['error'])} ({cost(best)})")
        cells += [falls(part), ", ".join(f"{n:,}" for n in failed["unknowns"])]
        body.append(cells)
    return markdown(heads, body)


def first(part: pd.DataFrame, wanted: float) -> str:
    """Cost of the first mesh from which on every one is good enough."""
    bad = part.index[part["error"] > wanted]
    good = part if bad.empty else part.loc[part.index > bad.max()]
    return cost(good.iloc[0]) if len(good) else "not reached"


def falls(part: pd.DataFrame) -> str:
    """Power of the size that the errors below 10 % follow, by least squares."""
    import numpy as np

    known = part[part["error"] < 0.1]
    if len(known) < 3:
        return ""
    slope = np.polyfit(np.log(known["mesh_size_mm"]), np.log(known["error"]), 1)[0]
    return f"{slope:.1f}"


def cost(row: pd.Series) -> str:
    """Unknowns and seconds of one mesh."""
    return f"{row['unknowns']:,}, {plain(row['seconds'])} s"


def percent(error: float) -> str:
    """Error in percent with two digits that count."""
    return f"{plain(100 * error)} %"


def plain(value: float) -> str:
    """Two digits that count, without a power of ten."""
    digits = max(0, 1 - math.floor(math.log10(value)))
    return f"{value:.{digits}f}"


def meshes(frame: pd.DataFrame, reference: ConvergenceResult) -> str:
    """Table: error by size and element."""
    heads = ["size at the contact (mm)"]
    heads += [f"{named(order, shape)}, {kind}" for order, shape, kind in ELEMENTS]
    body = []
    for size in sorted(set(frame["mesh_size_mm"]), reverse=True):
        cells = [f"{size:.3g}"]
        for order, shape, kind in ELEMENTS:
            part = series(frame, order, shape, kind)
            part = part[part["mesh_size_mm"] == size]
            known = len(part) and float(part["error"].iloc[0]) > doubt(reference)
            shown = percent(part["error"].iloc[0]) if known else f"< {percent(doubt(reference))}"
            cells.append(f"{shown} ({part['unknowns'].iloc[0]:,})" if len(part) else "")
        body.append(cells)
    return markdown(heads, body)


def markdown(heads: list[str], body: list[list[str]]) -> str:
    """Table in Markdown."""
    lines = [heads, ["---"] * len(heads), *body]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


if __name__ == "__main__":
    if sys.argv[1:] not in (["measure"], ["draw"]):
        sys.exit("python docs/elements.py measure | draw")
    measure() if sys.argv[1] == "measure" else draw()
