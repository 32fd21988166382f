"""The page of a convergence study, with pictures of its meshes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from study.api.convergence.result import DesignConvergence, ProblemConvergence
from study.arrays import Array
from study.forward.closed_form import height_and_area
from study.reporting.output.convergence_page import write_convergence
from study.runner.numerical.judgement import SeriesJudgement
from study.runner.numerical.solve_task import SolveTask
from study.runner.numerical.solver import slug
from study.setup.setup import Setup, Tables, problem_of

#: cells whose coarsest and finest mesh are shown
SHOWN = 4

#: plane elements by their number of vertices
_SHAPES = {3: "triangles", 4: "quadrilaterals"}


def write_page(
    name: str,
    question: str,
    found: ProblemConvergence | DesignConvergence,
    tables: Sequence[Tables],
    reports: Path,
) -> Path:
    """Write the page of what was found; a picture that cannot be made costs nothing else.

    Parameters
    ----------
    name : str
        Title of the page; its folder below ``reports`` has the same name, made fit for a file.
    question : str
        Of the study; empty for a problem.
    found : ProblemConvergence or DesignConvergence
        Series of one problem, or of every cell of a design.
    tables : sequence of mapping
        Resolved problem of every cell.
    reports : Path
        Folder of all reports.

    Returns
    -------
    Path
        The page.
    """
    pictures, window = meshes(found.cells, tables)
    folder = reports / slug(name)
    return write_convergence(name, question, found.to_json(), folder, pictures, window)


def meshes(
    cells: Sequence[SeriesJudgement], tables: Sequence[Tables]
) -> tuple[list[tuple[str, Array, NDArray[np.int64]]], Array | None]:
    """Coarsest and finest plane mesh of cells with different meshes, and the window to see.

    Parameters
    ----------
    cells : sequence of SeriesJudgement
        Cells in 3D and cells without a converged mesh are passed over.
    tables : sequence of mapping
        Resolved problem of every cell, in the same order.

    Returns
    -------
    pictures : list of tuple
        Label, vertices in mm, shape (n, 2), and vertex numbers of the elements, shape (m, 3) or
        (m, 4); at most two meshes of each of :data:`SHOWN` cells.
    window : ndarray, shape (2, 2), or None
        Of :func:`near`, for the first cell shown; None where no mesh is shown.
    """
    found: dict[str, tuple[str, Array, NDArray[np.int64]]] = {}
    window = None
    for cell, own in zip(cells, tables, strict=True):
        sizes = [level.mesh_size_mm for level in cell.meshes if level.converged]
        if Setup.of(own).model.space == "3d" or not sizes or len(found) >= 2 * SHOWN:
            continue
        for size in (sizes[-1], sizes[0]):
            key, picture = _picture(own, size)
            found.setdefault(key, picture)
        window = near(own) if window is None else window
    return list(found.values()), window


def _picture(tables: Tables, size: float) -> tuple[str, tuple[str, Array, NDArray[np.int64]]]:
    from study.fem.mesh.mesher import build_mesh

    mesh = build_mesh(problem_of(SolveTask.of(tables, size).tables).setup)
    label = f"{_SHAPES[mesh.cells.shape[1]]}, {size:.3g} mm, {len(mesh.cells)} elements"
    return mesh.digest(), (label, np.asarray(mesh.points), np.asarray(mesh.cells))


def near(tables: Tables) -> Array:
    """Corner of the section that matters: under an indenter, or where plate and side meet.

    Parameters
    ----------
    tables : mapping
        Resolved problem.

    Returns
    -------
    ndarray, shape (2, 2)
        Radius and height in mm of the lower inner and of the upper outer corner of a window.
    """
    made = problem_of(tables)
    height, area = height_and_area(made.specimen)
    radius = float(np.sqrt(area / np.pi))
    if made.test.indenter is not None:
        reach = min(max(3 * made.test.depth_mm, 0.1 * radius), radius, height)
        return np.array([[0.0, height - reach], [reach, height]])
    reach = 0.4 * min(radius, height / 2)
    return np.array([[radius - reach, height - reach], [radius, height]])
