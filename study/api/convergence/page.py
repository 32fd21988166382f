"""The page of a convergence study, with pictures of its meshes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from study.arrays import Array
from study.forward.closed_form import height_and_area
from study.reporting.output.convergence_page import write_convergence
from study.runner.numerical.solver import slug
from study.setup.setup import problem_of

#: cells whose coarsest and finest mesh are shown
SHOWN = 4

#: plane elements by their number of vertices
_SHAPES = {3: "triangles", 4: "quadrilaterals"}


def write_page(
    name: str,
    question: str,
    document: Mapping[str, Any],
    configs: Sequence[Mapping[str, Any]],
    reports: Path,
) -> Path:
    """Write the page of a document; a picture that cannot be made costs nothing else.

    Parameters
    ----------
    configs : sequence of mapping
        Resolved problem of every cell of the document.
    """
    cells = document.get("cells", [document])
    pictures, window = meshes(cells, configs)
    return write_convergence(name, question, document, reports / slug(name), pictures, window)


def meshes(
    cells: Sequence[Mapping[str, Any]], configs: Sequence[Mapping[str, Any]]
) -> tuple[list[tuple[str, Array, NDArray[np.int64]]], Array | None]:
    """Coarsest and finest plane mesh of cells with different meshes, and the window to see."""
    found: dict[str, tuple[str, Array, NDArray[np.int64]]] = {}
    window = None
    for cell, config in zip(cells, configs, strict=True):
        sizes = [m["mesh_size"] for m in cell.get("meshes") or () if m["status"] == "converged"]
        if config["model"].get("space") == "3d" or not sizes or len(found) >= 2 * SHOWN:
            continue
        for size in (sizes[-1], sizes[0]):
            key, picture = _picture(cell, config, float(size))
            found.setdefault(key, picture)
        window = near(config) if window is None else window
    return list(found.values()), window


def _picture(
    cell: Mapping[str, Any], config: Mapping[str, Any], size: float
) -> tuple[str, tuple[str, Array, NDArray[np.int64]]]:
    from study.fem.mesh.mesher import build_mesh

    model = {**config["model"], "mesh": None, "mesh_size_mm": size}
    mesh = build_mesh(problem_of({**config, "model": model}).setup)
    label = f"{_SHAPES[mesh.cells.shape[1]]}, {size:.3g} mm, {len(mesh.cells)} elements"
    return mesh.digest(), (label, np.asarray(mesh.points), np.asarray(mesh.cells))


def near(config: Mapping[str, Any]) -> Array:
    """Corner of the section that matters: under an indenter, or where plate and side meet."""
    made = problem_of(config)
    height, area = height_and_area(made.specimen)
    radius = float(np.sqrt(area / np.pi))
    if made.test.indenter is not None:
        reach = min(max(3 * made.test.depth_mm, 0.1 * radius), radius, height)
        return np.array([[0.0, height - reach], [reach, height]])
    reach = 0.4 * min(radius, height / 2)
    return np.array([[radius - reach, height - reach], [radius, height]])
