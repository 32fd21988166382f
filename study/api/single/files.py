"""Files of one simulation: fields for ParaView, a picture of the mesh."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from study.errors import Fault, InputError
from study.record.atomic_files import replaced, write_atomic
from study.reporting.figure.meshes import picture

if TYPE_CHECKING:
    from study.fem.solver.solution import Solution


def writable(*paths: Path | None) -> None:
    """Refuse files that could not be written, before anything is computed.

    Parameters
    ----------
    *paths : Path or None
        Files to be written; None is passed over.

    Raises
    ------
    InputError
        For a folder that does not exist, or a folder in place of a file.
    """
    faults = []
    for path in paths:
        if path is not None and not path.parent.is_dir():
            faults.append(Fault(str(path), f"there is no folder {path.parent}", "make it first"))
        elif path is not None and path.is_dir():
            faults.append(Fault(str(path), "is a folder", "name a file"))
    if faults:
        raise InputError(faults)


def write_vtu(solution: Solution, path: str | Path) -> None:
    """Write displacement, J and stress of the last converged step for ParaView.

    Parameters
    ----------
    solution : Solution
        One with elements.
    path : str or Path
        VTU file, overwritten where there is one.

    Raises
    ------
    InputError
        If no step converged.
    StoreError
        If the file cannot be written.
    """
    from study.fem.fields import write_vtu as write

    with replaced(Path(path)) as part:
        write(solution, part)


def write_picture(solution: Solution, path: str | Path) -> None:
    """Draw the mesh of a solution before and after its deformation.

    Parameters
    ----------
    solution : Solution
        One with elements; its last converged step is drawn.
    path : str or Path
        SVG file, overwritten where there is one.

    Raises
    ------
    InputError
        If there is nothing to draw.
    StoreError
        If the file cannot be written.
    """
    try:
        svg, _ = picture(solution.points, solution.cells, solution.displacement)
    except ValueError as error:
        raise InputError(Fault(str(path), f"no picture: {error}")) from None
    write_atomic(Path(path), f"{svg}\n".encode())
