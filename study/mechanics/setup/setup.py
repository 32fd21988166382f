"""A setup: specimen, test and discretization, and the problem that they make with a material."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Literal

from study.ground.declaration import DERIVED, Bad, Reads, finite, quantity, section, word
from study.mechanics.material.material import Material
from study.mechanics.setup.geometry import Enclosed, Specimen
from study.mechanics.setup.test_kind import (
    TEST_KINDS,
    AroundContact,
    Contact,
    FaceCondition,
    MeshGrading,
    Test,
    TestKind,
    TowardsPlates,
    indenter_of_test,
)

Space = Literal["axisymmetric", "3d"]
Order = Literal["linear", "quadratic"]
Shape = Literal["simplex", "tensor"]
Formulation = Literal["mixed", "displacement"]
MeshName = Literal["coarse", "medium", "fine"]
#: Document of a problem: its tables by their names, in mm, N, MPa, deg and s.
Tables = Mapping[str, object]
#: coarse : medium : fine are these multiples of the reference size (ratio 1.5 by default)
MESH_LEVELS: tuple[MeshName, ...] = ("coarse", "medium", "fine")
#: shapes that deform the same everywhere where nothing holds their ends
HOMOGENEOUS_SHAPES = ("cylinder", "block", "homogeneous")

_ELEMENTS: Mapping[str, Shape] = {
    "triangle": "simplex",
    "tetrahedron": "simplex",
    "quadrilateral": "tensor",
    "hexahedron": "tensor",
}


def _size(value: object) -> float:
    """Read an element size; the name of a mesh has a key of its own."""
    if value in MESH_LEVELS:
        raise Bad(f"is the name of a mesh, {value!r}", f'write mesh = "{value}" (model.mesh)')
    return quantity("length")(value)


@section
class Model:
    """Discretization. Exactly one of ``mesh_size_mm`` and ``mesh`` is used (size wins)."""

    #: Axisymmetric for a cylinder unless the file says 3d, and 3d for all
    #: others.
    space: Annotated[Space, word("axisymmetric", "3d")] = "axisymmetric"
    element_order: Annotated[Order, word("linear", "quadratic")] = "quadratic"
    element_shape: Annotated[Shape, word("simplex", "tensor", synonyms=_ELEMENTS)] = "simplex"
    formulation: Annotated[Formulation, word("mixed", "displacement")] = "mixed"
    #: Size relative to a reference size of the problem.
    mesh: Annotated[MeshName, word(*MESH_LEVELS)] = "medium"
    #: Size of a named mesh over that of the next finer one; ``converge.ratio`` of the file.
    mesh_ratio: Annotated[float, DERIVED] = 1.5
    mesh_size_mm: Annotated[float, Reads(_size, "length", "", finite)] | None = None
    #: Moves the nodes of the mesh at random (see :mod:`study.mechanics.mesh.mesher`).
    mesh_seed: Annotated[int | None, DERIVED] = None

    @property
    def level(self) -> int:
        """Number of meshes with a name that are finer: 0 on the fine one."""
        return len(MESH_LEVELS) - 1 - MESH_LEVELS.index(self.mesh)

    def coarser(self, ratio: float) -> Model | None:
        """Discretization on the next coarser mesh; None on the coarsest with a name."""
        if self.mesh_size_mm is not None:
            return replace(self, mesh_size_mm=ratio * self.mesh_size_mm)
        at = MESH_LEVELS.index(self.mesh)
        return replace(self, mesh=MESH_LEVELS[at - 1]) if at else None


@dataclass(frozen=True)
class Setup:
    """What is tested and how it is discretized; the material is not part of it."""

    specimen: Specimen
    test: Test
    model: Model
    #: Of the specimen; None for a surface whose file has not been looked for.
    height_mm: float | None = None

    @property
    def kind(self) -> TestKind:
        """Rules of the kind of its test."""
        return TEST_KINDS[self.test.kind]

    @cached_property
    def faces(self) -> tuple[FaceCondition, ...]:
        """Motions that the test prescribes."""
        return self.kind.faces(self.test)

    @cached_property
    def contacts(self) -> tuple[Contact, ...]:
        """Rigid bodies that the surface may meet."""
        return self.kind.contacts(self.test)

    @cached_property
    def grading(self) -> MeshGrading:
        """Where elements are small: under an indenter, else at the rims of faces that are held."""
        if self.kind.takes_indenter:
            return AroundContact(indenter_of_test(self.test), self.test.depth_mm)
        held = {face.face for face in self.faces if face.is_held}
        return TowardsPlates("top" in held, "base" in held)

    @property
    def has_middle_plane(self) -> bool:
        """Whether the lower half is the mirror image of the upper one."""
        return self.kind.has_middle_plane(self.test) and not self.test.weight_N_mm3

    @property
    def is_whole(self) -> bool:
        """Whether the whole specimen is meshed in 3D: no plane through its axis mirrors it."""
        skew = any(face.besides is not None for face in self.faces)
        return isinstance(self.specimen, Enclosed) or skew

    @property
    def is_homogeneous(self) -> bool:
        """Whether the deformation is the same everywhere, as between frictionless plates."""
        # The closed form is then exact, and space, mesh, order and element shape cannot matter.
        can_be = self.specimen.shape in HOMOGENEOUS_SHAPES and not self.test.weight_N_mm3
        return can_be and self.kind.is_homogeneous(self.test)

    @property
    def has_no_elements(self) -> bool:
        """Whether it is a gauge section, of which the closed form is the only model."""
        return self.specimen.shape == "homogeneous"

    @property
    def has_close_equilibria(self) -> bool:
        """Whether the discretized contact is known to have several equilibria close together."""
        # Measured on a needle in linear tetrahedra, 4 mm deep: started from the load steps of
        # another specimen, four of five solutions of one cell ended on a neighbouring equilibrium,
        # 0.2 to 0.8 % away in force. The one that a load path from zero reaches is the answer.
        linear_solid = self.model.space == "3d" and self.model.element_order == "linear"
        return linear_solid and self.kind.strains_locally

    def problem(self, material: Material, displacement_mm: float | None = None) -> Problem:
        """Problem of this setup."""
        return Problem(self.specimen, self.test.to_depth(displacement_mm), material, self.model)


@dataclass(frozen=True)
class Problem:
    """One forward simulation: a setup and a material."""

    specimen: Specimen
    test: Test
    material: Material
    model: Model

    @cached_property
    def setup(self) -> Setup:
        """All but the material: what a mesh and its constraints depend on."""
        return Setup(self.specimen, self.test, self.model)


def mesh_level(model: Model) -> float:
    """Size of a named mesh over the reference size: 1 on the fine one."""
    return float(model.mesh_ratio**model.level)
