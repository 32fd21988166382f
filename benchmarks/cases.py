"""The cases, what is asked of `study` in each, and the codes that take part."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from benchmarks.exchange import Task
from benchmarks.peers import NAMES

#: neo-Hookean gel, MPa; the bulk modulus is 1000 times the shear modulus
C10, BULK = 5e-3, 10.0
RADIUS_MM, HEIGHT_MM = 25.0, 50.0
TOLERANCE = 1e-8


@dataclass(frozen=True)
class Case:
    """Bonded compression of a cylinder.

    Parameters
    ----------
    name, title : str
        For ``--only`` and for the reader.
    space : {"3d", "axisymmetric"}
        What is meshed.
    mesh_size_mm : float
        Size of the elements inside.
    percent, steps : float, int
        Compression of the height, and the number of its steps.
    codes : tuple of str
        Who takes part by default.
    repeats : int
        Runs of which the median counts.
    faster : float, optional
        How many times faster than the fastest peer `study` is asked to be.
    than : tuple of (str, float)
        The same against a code by name.
    memory_GB, setup_s, assembly_share : float, optional
        Largest allowed peak, set-up and part of a Newton iteration.
    """

    name: str
    title: str
    space: str
    mesh_size_mm: float
    percent: float
    steps: int
    codes: tuple[str, ...] = tuple(NAMES)
    repeats: int = 1
    faster: float | None = None
    than: tuple[tuple[str, float], ...] = ()
    memory_GB: float | None = None
    setup_s: float | None = None
    assembly_share: float | None = None

    def task(self) -> Task:
        """Mesh the case; every code gets the same mesh."""
        from study.mechanics.material.material import Material
        from study.mechanics.mesh.mesher import build_mesh
        from study.mechanics.setup.geometry import Cylinder
        from study.mechanics.setup.setup import Model, Problem
        from study.mechanics.setup.test_kind import Test

        displacement = self.percent / 100 * HEIGHT_MM
        test = Test("compression", displacement, "bonded", "bonded", steps=self.steps)
        gel = Material("neo-hookean", {"C10": C10}, bulk_modulus=BULK)
        model = Model(self.space, "quadratic", mesh_size_mm=self.mesh_size_mm)  # type: ignore[arg-type]
        mesh = build_mesh(Problem(Cylinder(RADIUS_MM, HEIGHT_MM), test, gel, model).setup)
        cells = oriented(mesh.points, mesh.cells)
        return Task(mesh.points, cells, displacement, self.steps, C10, BULK, TOLERANCE)

    def warm_up(self) -> Task:
        """Return a small task in the same space, solved before the clock starts."""
        size = 10.0 if self.space == "3d" else 5.0
        return replace(self, mesh_size_mm=size, percent=1.0, steps=1).task()


CASES = (
    Case(
        "axisymmetric-21k", "axisymmetric, one step of 5 %", "axisymmetric", 0.55, 5.0, 1,
        repeats=3, faster=2.0,
    ),
    Case(
        "compression-28k", "3D, one step of 5 %", "3d", 3.0, 5.0, 1,
        repeats=3, faster=1.4, than=(("forms", 3.0),),
    ),
    Case("ten-steps-28k", "3D, ten steps to 15 %", "3d", 3.0, 15.0, 10, faster=1.4),
    Case(
        "compression-108k", "3D, one step of 5 %", "3d", 1.75, 5.0, 1,
        faster=1.4, memory_GB=2.1, setup_s=2.0, assembly_share=0.05,
    ),
    Case("ten-steps-108k", "3D, ten steps to 15 %", "3d", 1.75, 15.0, 10, faster=2.5),
    Case("memory-290k", "3D, one step of 5 %", "3d", 1.17, 5.0, 1, codes=("study",), memory_GB=6.5),
)  # fmt: skip


def oriented(points: Any, cells: Any) -> Any:
    """Cells with a positive volume, which some codes insist on."""
    import numpy as np

    corners = points[cells]
    turned = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0
    out = cells.copy()
    out[turned, -2], out[turned, -1] = cells[turned, -1], cells[turned, -2]
    return out
