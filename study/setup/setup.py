"""A setup: specimen, test and discretization, and the checks across them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from study.material.material import Material
from study.setup.geometry import Formulation, Order, Shape, Space, Specimen
from study.setup.test_kind import Test

#: coarse : medium : fine are these multiples of the reference size (ratio 1.5 by default)
MESH_LEVELS = ("coarse", "medium", "fine")


@dataclass(frozen=True)
class Model:
    """Discretisation. Exactly one of ``mesh_size_mm`` and ``mesh`` is used (size wins).

    A ``mesh_seed`` moves the nodes of the mesh at random (see :mod:`study.fem.mesh.perturbation`).
    """

    space: Space = "axisymmetric"
    element_order: Order = "quadratic"
    element_shape: Shape = "simplex"
    formulation: Formulation = "mixed"
    mesh: Literal["coarse", "medium", "fine"] = "medium"
    mesh_ratio: float = 1.5
    mesh_size_mm: float | None = None
    mesh_seed: int | None = None


@dataclass(frozen=True)
class Problem:
    """One forward simulation."""

    specimen: Specimen
    test: Test
    material: Material
    model: Model


def mesh_level(model: Model) -> float:
    """Size of a named mesh over the reference size: 1 on the fine one."""
    steps = len(MESH_LEVELS) - 1 - MESH_LEVELS.index(model.mesh)
    return float(model.mesh_ratio**steps)
