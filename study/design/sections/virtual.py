"""``[virtual]``: how carefully the true curve of virtual specimens is solved."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from study.setup.quantity import Length, integer
from study.setup.section import Reads, section
from study.setup.setup import MESH_LEVELS
from study.setup.text import choice


@section
class Virtual:
    """Discretization of the reference curve that virtual specimens follow.

    Parameters
    ----------
    steps : int
        Load steps of the curve; between them it is interpolated with its tangent.
    element_order : {"quadratic", "linear"}
        Of its elements.
    mesh : str, optional
        Named mesh; without one, and without a size, one step finer than the finest of the design.
    mesh_size_mm : float, optional
        Element size, instead of a named mesh.
    """

    steps: Annotated[int, Reads(integer(1, 1000))] = 12
    element_order: Annotated[str, Reads(choice("quadratic", "linear"))] = "quadratic"
    mesh: Annotated[str | None, Reads(choice(*MESH_LEVELS))] = None
    mesh_size_mm: Length | None = Field(default=None, validation_alias="mesh_size")

    @property
    def chooses_mesh(self) -> bool:
        """Whether the mesh is given here."""
        return self.mesh is not None or self.mesh_size_mm is not None
