"""Whether an equilibrium stands: the inertia of its tangent, and modes that symmetry hides.

At a minimum of the energy the tangent of a mixed body has one negative eigenvalue for every
pressure and no other: contact springs only add to the rest. A factorization counts them
(Sylvester's law of inertia). A model of a half or quarter sees the modes that have its
symmetry. Those that have not are seen by the tangent of the same state and the same mesh with
other conditions on a plane of symmetry: what moves along it is held there, what crosses it is
free, so that the two sides sway together (Healey 1988, Comput. Methods Appl. Mech. Eng. 67, 257).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from study.ground.arrays import Array
from study.mechanics.contact.contact import Constraints, prescribed_rates
from study.mechanics.element.function_space import _SAME, Pattern, at_level
from study.mechanics.mesh.structured import Mesh
from study.mechanics.setup.setup import Problem, Setup
from study.mechanics.setup.test_kinds import buckling_strain
from study.mechanics.solver.internal_force import Tangent
from study.mechanics.solver.linear_solver import (
    KeptFactors,
    SingularMatrixError,
    _orthogonalized,
    make_solver,
)
from study.mechanics.solver.system import ContactTerms, Latest, State, System

#: share of the strain by Euler's load above which hidden modes are looked for: elements bend
#: too stiffly, never too softly, and a bonded column is a little stiffer than a free one
SUSPICIOUS = 0.6

#: vectors of a Lanczos iteration: the least stiffness of a state next to an instability is far
#: from all others
_LANCZOS = 40

#: share of the volume in a mode below which it is one of a few elements: at the rim of a punch in
#: linear hexahedra it is 0.0003, in a column that sways 0.3
LOCAL_SHARE = 0.05

#: residual of an eigenvector over its eigenvalue at which the iteration ends
_LANCZOS_TOLERANCE = 1e-4


@dataclass(frozen=True)
class Instability:
    """Where an equilibrium becomes unstable, and the way in which it gives way."""

    #: Where the least stiffness passes zero, by a line between the two steps.
    displacement_mm: float
    #: The last step that is stable and the first that is not.
    stable_mm: float
    unstable_mm: float
    #: {"x", "y", ""}: direction of a sway that the model's symmetry hides.
    sway: str
    #: shape (n_nodes, dim); motion of the nodes of the modelled part, the largest of length 1.
    mode: Array
    #: {-1, 1} by axis: the same motion mirrored, where the model has a plane of symmetry.
    parity: tuple[int, ...] = (1, 1, 1)

    def to_json(self) -> dict[str, object]:
        """Document of ``study solve --json``, without the mode."""
        return {
            "displacement_mm": self.displacement_mm,
            "stable_mm": self.stable_mm,
            "unstable_mm": self.unstable_mm,
            "sway": self.sway or None,
        }

    @property
    def sentence(self) -> str:
        """Name it, for a message."""
        how = f"the specimen buckles in {self.sway}" if self.sway else "another shape costs less"
        return (
            f"the equilibrium becomes unstable at {self.displacement_mm:.3g} mm (stable at "
            f"{self.stable_mm:.4g} mm, unstable at {self.unstable_mm:.4g} mm): {how}"
        )


def surplus(system: System) -> int | None:
    """Negative eigenvalues of the last factorized tangent beyond one for each pressure."""
    negative = system.solver.negative_pivots()
    return None if negative is None else negative - pressures(system)


def pressures(system: System) -> int:
    """Count the free pressures."""
    return int(np.count_nonzero(system.pattern.free >= system.space.n_displacement))


def is_unstable(system: System, state: State) -> bool:
    """Whether the whole body has a way to give way at a state, assembled and factorized here.

    Where pivots tell nothing, the least stiffness does. A mode of a few elements is a crease, or
    one of the elements alone (linear hexahedra at the rim of a punch have some): it is left to
    what is said of snaps and of meshes.
    """
    system.assemble(state)
    try:
        system.factorize()
    except SingularMatrixError:
        return True
    if surplus(system) == 0:
        return False
    stiffness, mode = least_stiffness(system)
    return stiffness < 0 and volume_share(system, mode) > LOCAL_SHARE


def volume_share(system: System, mode: Array) -> float:
    """Share of the volume that takes part in a mode (Bell and Dean 1970, participation ratio)."""
    space = system.space
    each, local = np.zeros(len(space.nodes)), space.element_nodes
    np.add.at(each, local, space.weights.sum(axis=1)[:, None] / local.shape[1])
    square = (mode**2).sum(axis=1)
    return float((each @ square) ** 2 / (each @ square**2) / each.sum())


def least_stiffness(system: System) -> tuple[float, Array]:
    """Lowest stiffness of the last factorized tangent, N/mm, and its mode, shape (n_nodes, dim).

    Lanczos iteration with the compliance of the displacements, which has a negative eigenvalue
    wherever the stiffness has one: just past zero it is the largest of all. Of several negative
    ones it is that of the mode in which most of the body takes part.
    """
    free = system.pattern.free
    moves = free < system.space.n_displacement

    def compliance(v: Array) -> Array:
        return np.where(moves, system.back_substitute(v), 0.0)

    start = np.where(moves, np.random.default_rng(0).standard_normal(free.size), 0.0)
    basis = [start / np.linalg.norm(start)]
    steps = min(_LANCZOS, int(moves.sum()))
    reduced, values, vectors = np.zeros((steps + 1, steps)), np.zeros(1), np.ones((1, 1))
    for j in range(steps):
        w = compliance(basis[j])
        column = _orthogonalized(w, basis)
        reduced[: j + 2, j] = column
        square = reduced[: j + 1, : j + 1]
        values, vectors = np.linalg.eigh((square + square.T) / 2)
        k = 0 if values[0] < 0 else -1  # without a negative one the softest way counts
        if column[-1] * abs(vectors[-1, k]) <= _LANCZOS_TOLERANCE * abs(values[k]):
            break
        basis.append(w / column[-1])

    def of(k: int) -> tuple[float, Array]:
        motion = np.zeros(system.space.n)
        motion[free] = np.column_stack(basis[: len(values)]) @ vectors[:, k]
        mode = system.displacements(motion)
        return 1.0 / float(values[k]), mode / np.linalg.norm(mode, axis=1).max()

    negative = [of(int(k)) for k in np.flatnonzero(values < 0)]
    return max(negative, key=lambda one: volume_share(system, one[1]), default=of(-1))


def swaying(system: System, problem: Problem) -> tuple[System, str, tuple[int, ...]] | None:
    """Equations of the sway that a quarter of a column hides, its direction and its parities.

    A column sways where it is thinnest: to one side between bonded plates, and to both sides,
    one plate against the other, where one of them lets it slide. None where Euler's load is far
    away, or where the model hides nothing.
    """
    setup, space, mesh = problem.setup, system.space, system.mesh
    critical = buckling_strain(setup.test, setup.specimen)
    strain = setup.test.depth_mm / system.height_mm
    if space.dim < 3 or mesh.is_whole or system.small_strain or critical is None:
        return None
    if setup.is_whole or strain < SUSPICIOUS * critical:
        return None
    width = getattr(setup.specimen, "width_mm", 0.0)
    axis = 1 if width > getattr(setup.specimen, "depth_mm", width) else 0
    turns = mesh.half_height and setup.test.interface == "frictionless"
    held = _sway_constraints(system, setup, axis, turns=turns)
    pattern = Pattern.build(space.dofs, space.n, held.dofs)
    direct = make_solver(pattern, system.solver.name, plane=False)
    equations = replace(
        system,
        constraints=held,
        contact_terms=ContactTerms.at(system.contact, space.dim, pattern),
        tangent=Tangent.of(pattern, space.dofs),
        kept=KeptFactors(direct, pattern),
        latest=Latest(),
    )
    parity = (-1 if axis == 0 else 1, -1 if axis == 1 else 1, -1 if turns else 1)
    return equations, "xy"[axis], parity


def _sway_constraints(system: System, setup: Setup, axis: int, *, turns: bool) -> Constraints:
    """Hold what a sway along ``axis`` does not move; with ``turns`` also on the middle plane."""
    space, mesh = system.space, system.mesh
    tol, rate = _SAME * mesh.height_mm, prescribed_rates(setup, space, mesh)
    planes = [(i, 0.0, i == axis) for i in (0, 1)]
    if mesh.half_height:
        planes.append((2, mesh.height_mm / 2, turns))
    if turns:  # the condition of the lower face holds the middle plane
        middle = {3 * int(n) + 2 for n in at_level(space, mesh, mesh.height_mm / 2)}
        rate = {dof: v for dof, v in rate.items() if dof not in middle}
    is_continuous = setup.model.element_shape == "simplex" and space.n > space.n_displacement
    for i, level, crossed in planes:
        nodes = np.flatnonzero(np.abs(space.nodes[:, i] - level) < tol)
        for along in range(3):
            if crossed != (along == i):
                rate |= {int(n) * 3 + along: 0.0 for n in nodes}
        if crossed and is_continuous:
            corners = np.flatnonzero(np.abs(mesh.points[:, i] - level) < tol)
            rate |= {space.n_displacement + int(c): 0.0 for c in corners}
    if not any(dof % 3 == axis and dof < space.n_displacement for dof in rate):
        rate[int(np.argmin(np.abs(space.nodes).sum(axis=1))) * 3 + axis] = 0.0  # it may slide
    return Constraints.of(rate)


def mirrored(
    mesh: Mesh, moved: Array, parity: tuple[int, ...], height_mm: float
) -> tuple[Mesh, Array]:
    """Whole body of a quarter or an eighth, and the motion of its points.

    Shapes: moved (n_points, 3); parity of that motion by axis.
    """
    points, cells = mesh.points, mesh.cells
    planes = [(0, 0.0), (1, 0.0), *([(2, height_mm / 2)] if mesh.half_height else [])]
    for axis, level in planes:
        image, shift = points.copy(), moved.copy()
        image[:, axis] = 2 * level - image[:, axis]
        shift *= parity[axis]
        shift[:, axis] *= -1
        on_plane = np.abs(points[:, axis] - level) < _SAME * height_mm
        number = np.where(on_plane, np.arange(len(points)), 0)
        number[~on_plane] = len(points) + np.arange(np.count_nonzero(~on_plane))
        turned = _turned(number[cells])
        points = np.vstack([points, image[~on_plane]])
        moved = np.vstack([moved, shift[~on_plane]])
        cells = np.vstack([cells, turned])
    return replace(mesh, points=points, cells=cells, half_height=False, is_whole=True), moved


def _turned(cells: Array) -> Array:
    """Mirrored cells in the order of their corners that gives a positive volume."""
    order = [4, 5, 6, 7, 0, 1, 2, 3] if cells.shape[1] == 8 else [0, 1, 3, 2]
    return cells[:, order]
