"""What holds a specimen in equilibrium, what touches it, and whether the equilibrium stands.

At a minimum of the energy the tangent of a mixed body has one negative eigenvalue for every
pressure and no other: contact springs only add to the rest. A factorization counts them
(Sylvester's law of inertia). A model of a half or quarter sees the modes that have its
symmetry. Those that have not are seen by the tangent of the same state and the same mesh with
other conditions on a plane of symmetry: what moves along it is held there, what crosses it is
free, so that the two sides sway together (Healey 1988, Comput. Methods Appl. Mech. Eng. 67, 257).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from study.ground.arrays import Array, Ints
from study.ground.canonical import Keyed
from study.mechanics.contact.collocation import _ring_shares
from study.mechanics.contact.contact import Constraints, TiedPoints, prescribed_rates
from study.mechanics.element.function_space import (
    _SAME,
    Pattern,
    at_level,
    facet_areas,
    middle_nodes,
    symmetric_product,
)
from study.mechanics.mesh.structured import MIDDLES, Mesh, mirror
from study.mechanics.setup.setup import Problem, Setup
from study.mechanics.setup.test_kind import buckling_strain, weight_strain
from study.mechanics.solver.internal_force import ContactBlocks, Tangent
from study.mechanics.solver.linear_solver import (
    KeptFactors,
    SingularMatrixError,
    _orthogonalized,
    make_solver,
)
from study.mechanics.solver.system import Assembly, Latest, State, System

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

#: share of the largest compliance below which a negative one is rounding: pressures hold some
#: motions, which have none
_ROUNDING = 1e-10

#: share of a load step by which the state of factors may differ from the one that they judge
_NEAR = 1e-3

#: share of a random load's displacements down to which factors at hand correct them, and most
#: corrections for that; the softest motions, of which one is the first to give way, have most of
#: these displacements
_CORRECTED = 1e-2
_CORRECTIONS = 12


@dataclass(frozen=True)
class Instability(Keyed):
    """Where an equilibrium becomes unstable, and the way in which it gives way."""

    KEYS = "displacement_mm stable_mm unstable_mm sway"

    #: Where the least stiffness passes zero, by a line between the two steps.
    displacement_mm: float
    #: The last step that is stable and the first that is not.
    stable_mm: float
    unstable_mm: float
    #: {"x", "y", None}: direction of a sway that the model's symmetry hides.
    sway: str | None
    #: shape (n_nodes, dim); motion of the nodes of the modelled part, the largest of length 1.
    mode: Array
    #: {-1, 1} by axis: the same motion mirrored, where the model has a plane of symmetry.
    parity: tuple[int, ...] = (1, 1, 1)

    @property
    def sentence(self) -> str:
        """Name it, for a message."""
        how = f"the specimen buckles in {self.sway}" if self.sway else "another shape costs less"
        if self.unstable_mm == self.stable_mm:
            return f"the equilibrium under its weight is unstable before the test begins: {how}"
        return (
            f"the equilibrium becomes unstable at {self.displacement_mm:.3g} mm (stable at "
            f"{self.stable_mm:.4g} mm, unstable at {self.unstable_mm:.4g} mm): {how}"
        )


def surplus(system: System) -> int | None:
    """Negative eigenvalues of the factors at hand beyond one for each free pressure."""
    negative = system.solver.negative_pivots()
    return None if negative is None else negative - (system.dofs - _motions(system))


def _motions(system: System) -> int:
    """Count the free displacements, which come before the free pressures."""
    return int(np.searchsorted(system.pattern.free, system.space.n_displacement))


def is_unstable(system: System, state: State) -> bool:
    """Whether the whole body has a way to give way at a state, whose tangent is factorized here.

    Where pivots tell nothing, or factors with perturbed pivots are far from the tangent, the least
    stiffness does. A mode of a few elements is a crease, or one of the elements alone (linear
    hexahedra at the rim of a punch have some): it is left to what is said of snaps and of meshes.
    """
    if system.tangent.state is not state:
        system.assemble(state)
    try:
        if system.factors.state is not state:
            system.factorize()
    except SingularMatrixError:
        return True
    if surplus(system) == 0 and (system.solver.unperturbed() or has_inertia_of_factors(system)):
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
    below = settled = np.zeros(0, np.int64)
    for j in range(steps):
        w = compliance(basis[j])
        column = _orthogonalized(w, basis)
        reduced[: j + 2, j] = column
        square = reduced[: j + 1, : j + 1]
        values, vectors = np.linalg.eigh((square + square.T) / 2)
        below = np.flatnonzero(values < -_ROUNDING * np.abs(values).max())
        is_settled = column[-1] * np.abs(vectors[-1]) <= _LANCZOS_TOLERANCE * np.abs(values)
        settled = below[is_settled[below]]
        # every negative one: what has yet to converge looks like a motion of the whole body;
        # without a negative one the softest way counts
        if is_settled[below].all() and (below.size or is_settled[-1]):
            break
        basis.append(w / column[-1])

    def of(k: int) -> tuple[float, Array]:
        motion = np.zeros(system.space.n)
        motion[free] = np.column_stack(basis[: len(values)]) @ vectors[:, k]
        mode = system.displacements(motion)
        return 1.0 / float(values[k]), mode / np.linalg.norm(mode, axis=1).max()

    negative = [of(int(k)) for k in (settled if settled.size else below)]
    return max(negative, key=lambda candidate: volume_share(system, candidate[1]), default=of(-1))


def are_factors_of_step(system: System, state: State, before: State) -> bool:
    """Whether the factors at hand tell at which of two steps stability is lost, as they are.

    So it is where they are of the last iterates before a state, closer to it than a small share of
    the load step ``before`` it: of no earlier contact, and without perturbed pivots.
    """
    factored = system.factors.state
    if not isinstance(factored, State) or factored.displacement_mm != state.displacement_mm:
        return False
    if not (system.factors.serves(system.latest.touching) and system.solver.unperturbed()):
        return False
    moved = slice(0, system.space.n_displacement)
    off, step = (np.linalg.norm(state.x[moved] - s.x[moved]) for s in (factored, before))
    return bool(off <= _NEAR * step)


@dataclass
class RandomLoad:
    """Corrections ``x += K0^-1 (b - K x)`` for a load b that excites every motion.

    They tell whether the last assembled tangent K has as many negative eigenvalues as K0, of the
    factors: on the line between the two a matrix is singular only if K0^-1 K has a negative
    eigenvalue, whose part of the error the corrections make larger. The load of a test leaves out
    motions of another symmetry, so that b is random, and its seed fixed.
    """

    system: System
    #: shape (n_free,); ``b - K x``.
    left: Array
    #: State whose tangent K0 is.
    factored: object
    #: Norms of the displacements of each correction: the softest motions have most of them.
    sizes: list[float]

    @classmethod
    def on(cls, system: System) -> RandomLoad:
        """Begin with the factors at hand."""
        left, n = np.zeros(system.dofs), _motions(system)
        left[:n] = np.random.default_rng(0).standard_normal(n)
        return cls(system, left, system.factors.state, [])

    @property
    def settled(self) -> bool:
        """Whether corrections have become small, as they do only with eigenvalues of one sign."""
        return len(self.sizes) > 1 and self.sizes[-1] <= _CORRECTED * self.sizes[0]

    def correct(self, x: Array) -> None:
        """Take the next correction, ``K0^-1`` times what is left."""
        if self.settled or self.factored is not self.system.factors.state:
            return
        x, pattern = np.ascontiguousarray(x), self.system.pattern
        self.sizes.append(float(np.linalg.norm(x[: _motions(self.system)])))
        if not self.settled:
            self.left -= symmetric_product(pattern.indptr, pattern.indices, self.system.data, x)

    def solved_beside(self, right: Array, *, refined: bool) -> Array:
        """Solve for other loads (n_free, k), and with them for the next correction."""
        if self.settled:
            return self.system.back_substitute(right, refined=refined)
        columns = np.column_stack([right, self.left])
        solution = self.system.back_substitute(columns, refined=refined)
        self.correct(solution[:, -1])
        return solution[:, :-1]


def has_inertia_of_factors(system: System, begun: RandomLoad | None = None) -> bool:
    """Whether the last assembled tangent has as many negative eigenvalues as that of the factors.

    ``begun`` are corrections of a random load by these factors, if there are some. False where
    they cost as much as a factorization.
    """
    load = begun or RandomLoad.on(system)
    if load.factored is not system.factors.state:
        load = RandomLoad.on(system)
    most = 1 + min(max(int(system.solver.worth()), 1), _CORRECTIONS)
    while len(load.sizes) < most and not load.settled:
        load.correct(system.solver.solve(load.left, refined=False))
    return load.settled


def swaying(system: System, problem: Problem) -> tuple[System, str, tuple[int, ...]] | None:
    """Equations of the sway that a quarter of a column hides, its direction and its parities.

    A column sways where it is thinnest: to one side between bonded plates, and to both sides,
    one plate against the other, where one of them lets it slide. None where Euler's load is far
    away, or where the model hides nothing.
    """
    setup, space, mesh = problem.setup, system.space, system.mesh
    critical = buckling_strain(setup.test, setup.specimen)
    if space.dim < 3 or mesh.is_whole or system.material.small_strain or critical is None:
        return None
    shortened = setup.test.depth_mm / mesh.height_mm
    shortened += weight_strain(setup.test, mesh.height_mm, system.material.mu0)
    if shortened < SUSPICIOUS * critical:
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
        blocks=ContactBlocks.of(system.contact, space.dim, pattern),
        tangent=Tangent.of(pattern, space.dofs),
        factors=KeptFactors(direct, pattern),
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
        points, cells, beyond = mirror(points, cells, mesh.kind, axis, level)
        shift = parity[axis] * moved[beyond]
        shift[:, axis] *= -1
        moved = np.vstack([moved, shift])
    return replace(mesh, points=points, cells=cells, half_height=False, is_whole=True), moved


# Forces that hold the specimen, and figures of its contact.


class Resultant(NamedTuple):
    """Force and moment of what the specimen is held by, on the whole specimen.

    ``side`` and ``moment`` are those that act on the specimen. Moments are about the middle of the
    face as it stands.
    """

    #: Against the loading: positive where it resists, N.
    axial: float
    #: shape (2,); along x and y, N.
    side: Array
    #: shape (3,); N mm.
    moment: Array


class ContactFigures(NamedTuple):
    """What the moving surface does to the specimen at one step; zeros without a touching point."""

    #: Deepest node or middle of a touching facet below the surface, mm.
    penetration_mm: float = 0.0
    #: Farthest node from the surface amid closed points, mm.
    gap_mm: float = 0.0
    #: Largest contact pressure over the area of a node, both as they are after the deformation.
    peak_pressure_MPa: float = 0.0  # noqa: N815
    #: Area of closed points and held faces after the deformation.
    area_mm2: float = 0.0


@dataclass(frozen=True)
class Equilibria(Keyed):
    """Equilibria of the points of a curve: what holds them, what touches, whether they stand."""

    KEYS = "reaction contact=contact_figures instability"

    #: Resultants on the moving plate or indenter, and on the base, one for each displacement.
    plate: tuple[Resultant, ...] = ()
    base: tuple[Resultant, ...] = ()
    contact: tuple[ContactFigures, ...] = ()
    #: Where the equilibrium becomes unstable; the curve ends before.
    instability: Instability | None = None

    def quantities(self) -> dict[str, Array]:
        """Responses of each point by their names: kPa, mm^2, N and N mm."""
        of_bodies = {
            f"{prefix}{name}": np.array([float(np.linalg.norm(vector)) for vector in vectors])
            for prefix, body in (("", self.plate), ("base_", self.base))
            for name, vectors in (
                ("side_force", [held.side for held in body]),
                ("moment", [held.moment for held in body]),
            )
        }
        return {
            "peak_contact_pressure": 1e3 * np.array([c.peak_pressure_MPa for c in self.contact]),
            "contact_area": np.array([c.area_mm2 for c in self.contact]),
            "base_force": np.array([held.axial for held in self.base]),
            **of_bodies,
        }

    @property
    def reaction(self) -> dict[str, object]:
        """Axial and side forces and moments of both bodies, N and N mm."""
        bodies = {"plate": self.plate, "base": self.base}
        return {name: _columns(Resultant._fields, body) for name, body in bodies.items()}

    @property
    def contact_figures(self) -> dict[str, object]:
        """Figures of the contact, mm, MPa and mm^2."""
        return _columns(ContactFigures._fields, self.contact)


def _columns(names: Sequence[str], rows: Sequence[object]) -> dict[str, object]:
    """Values of all points by the names of their figures."""
    return {name: [getattr(row, name) for row in rows] for name in names}


def nodal_reactions(system: System, assembly: Assembly) -> tuple[Array, Array]:
    """Split nodal forces into those of the plate or indenter and of the base, (n_nodes, dim)."""
    space, mesh, held = system.space, system.mesh, system.constraints
    dim, (above, below) = space.dim, np.zeros((2, space.n_displacement))
    dofs = np.setdiff1d(held.dofs[held.dofs < space.n_displacement], held.pins)
    upper = np.isin(dofs // dim, at_level(space, mesh, mesh.height_mm))
    above[dofs[upper]] = assembly.residual[dofs[upper]]
    below[dofs[~upper]] = assembly.residual[dofs[~upper]]
    for points, touch in zip(system.contact, assembly.contact, strict=True):
        onto = below if points.surface.speed == 0 else above
        # without the springs' share, which equilibrium does not count either
        carried = points.forces(touch) - points.regularization(touch)
        np.subtract.at(onto, points.dofs(dim).ravel(), carried.ravel())
    return above.reshape(-1, dim), below.reshape(-1, dim)


def resultants(
    system: System, state: State, forces: tuple[Array, Array], sense: float
) -> tuple[Resultant, Resultant]:
    """Sum of the forces on the nodes from the moving plate or indenter, and from the base."""
    space, mesh, dim = system.space, system.mesh, system.space.dim
    sector = system.force_scale / (2.0 if mesh.half_height else 1.0)
    moved = 0.0 if system.material.small_strain else system.displacements(state.x)
    places, is_part = space.nodes + moved, dim < 3 or sector > 1
    middle = np.zeros(3)
    if not is_part:
        face = np.isin(space.facets, at_level(space, mesh, mesh.height_mm)).all(axis=1)
        corners = places[space.facets[face, : _corners(space.facets.shape[1], dim)]]
        areas = facet_areas(corners)
        middle = areas @ corners.mean(axis=1) / areas.sum() if areas.size else middle
    bodies = []
    for force, sign, about in ((forces[0], sense, middle), (forces[1], -sense, np.zeros(3))):
        side, moment = np.zeros(2), np.zeros(3)
        if not is_part:  # symmetry leaves none of them
            side = force[:, :2].sum(axis=0)
            moment = np.cross(places - about, force).sum(axis=0)
        bodies.append(Resultant(sign * sector * float(force[:, -1].sum()), side, moment))
    return bodies[0], bodies[0 if mesh.half_height else 1]


#: corners of a facet between which further nodes lie
_BETWEEN: dict[int, list[tuple[int, ...]]] = {
    2: [(0, 1)], 3: MIDDLES["triangle6"], 4: MIDDLES["quad9"],
}  # fmt: skip

#: shape functions in the middle of a facet, by the number of its nodes
_MIDDLE = {
    2: np.full(2, 0.5),
    3: np.full(3, 1 / 3),
    4: np.full(4, 0.25),
    6: np.repeat([-1 / 9, 4 / 9], 3),
    9: np.r_[np.zeros(8), 1.0],
}


def _stretched_areas(system: System, u: Array) -> Array:
    """Deformed over reference area around every boundary node, shape (n_nodes,); 1 elsewhere."""
    space, dim = system.space, system.space.dim
    if system.material.small_strain:
        return np.ones(len(space.nodes))
    corners = space.facets[:, : _corners(space.facets.shape[1], dim)]
    areas = [facet_areas(x[corners]) for x in (space.nodes, space.nodes + u)]
    n, k = len(space.nodes), space.facets.shape[1]
    before, after = (np.bincount(space.facets.ravel(), np.repeat(a, k), n) for a in areas)
    return np.asarray(np.divide(after, before, out=np.ones(n), where=before > 0))


def _corners(facet: int, dim: int) -> int:
    """Corners of a facet with so many nodes."""
    return 2 if dim == 2 else 3 if facet in (3, 6) else 4


def contact_pressure(system: System, state: State, force: Array) -> Array:
    """Pressure of nodal forces at the nodes of the boundary, MPa, shape (n_nodes,).

    The forces are taken to the hats of the corners (a mid-side node halves its own), which are
    exact moments of the pressure, over the areas of these hats: what quadratic elements have at
    their nodes has the wrong sign at corners. Areas are those after the deformation. Between
    corners it is linear. Side forces of prescribed unknowns are shear of a held face, or what
    symmetry takes: no pressure.

    Shapes: force (n_nodes, dim).
    """
    space, n, dim, force = system.space, len(system.space.nodes), system.space.dim, force.copy()
    held = np.setdiff1d(system.constraints.dofs, system.constraints.pins)
    held = held[(held < space.n_displacement) & (held % dim < dim - 1)]
    force[held // dim, held % dim] = 0.0
    places = space.nodes + (0.0 if system.material.small_strain else system.displacements(state.x))
    # those that lie in the loaded face or that a moving surface may meet, none along an axis
    met = [at_level(space, system.mesh, system.mesh.height_mm)]
    met += [points.nodes for points in system.contact if points.surface.speed != 0]
    within = np.any([np.isin(space.facets, nodes).all(axis=1) for nodes in met], axis=0)
    facets = space.facets[within & (space.facet_weights > 0)]
    k = _corners(facets.shape[1], dim)
    corners = facets[:, :k]
    areas, shares = facet_areas(places[corners]), np.full((len(facets), k), 1.0 / k)
    if dim == 2:
        shares = _ring_shares(places[corners][:, :, 0])
    area = np.bincount(corners.ravel(), (areas[:, None] * shares).ravel(), n)
    hats, between, taken = force.copy(), list[tuple[Ints, Ints]](), np.zeros(n, dtype=bool)
    for ends in map(list, _BETWEEN[k] if facets.shape[1] > k else []):
        lies = middle_nodes(space, facets[:, k:], facets[:, ends])
        nodes, first = np.unique(lies, return_index=True)
        # each once: another facet may have the same edge between other corners of its own
        once = ~taken[nodes]
        nodes, first = nodes[once], first[once]
        taken[nodes] = True
        between.append((nodes, facets[first][:, ends]))
        for corner in ends:
            np.add.at(hats, facets[first, corner], force[nodes] / len(ends))
    pressure = np.zeros(n)
    np.divide(np.linalg.norm(hats, axis=1), area, out=pressure, where=area > 0)
    for nodes, around in between:
        pressure[nodes] = pressure[around].mean(axis=1)
    return pressure


def contact_gap(system: System, state: State) -> Array:
    """Distance of the nodes from the surfaces that they may meet, mm, NaN elsewhere, (n_nodes,)."""
    gap = np.full(len(system.space.nodes), np.nan)
    for points in system.contact:
        if isinstance(points, TiedPoints):
            continue
        nodes = np.unique(points.nodes)
        reference, moved = system.space.nodes[nodes], system.displacements(state.x)[nodes]
        gap[nodes] = np.fmin(gap[nodes], points.seen(reference, moved, state.displacement_mm)[0])
    return gap


def contact_figures(
    system: System, state: State, assembly: Assembly, force: Array
) -> ContactFigures:
    """How well the moving surface fits, and what it presses with. Shapes: force (n_nodes, dim)."""
    space, dim, u = system.space, system.space.dim, system.displacements(state.x)
    depth, gap, area = 0.0, 0.0, 0.0
    ratio, moved_by = _stretched_areas(system, u), 0.0 if system.material.small_strain else u
    for points, touch in zip(system.contact, assembly.contact, strict=True):
        if isinstance(points, TiedPoints) or points.surface.speed == 0:
            continue
        closed = touch.active if state.glue is None else touch.active | state.glue.held
        if not closed.any():
            continue
        stretched = np.einsum("ck,ck->c", points.shape, ratio[points.nodes])
        area += float((points.weights * stretched)[closed].sum())
        members = np.isin(space.facets, points.nodes).all(axis=1)
        facets = space.facets[members & np.isin(space.facets, points.nodes[closed]).any(axis=1)]
        inner_nodes = np.setdiff1d(points.nodes[closed], points.nodes[~closed])
        amid = np.isin(facets, inner_nodes).all(axis=1)
        k = facets.shape[1]
        inner = [] if dim == 2 and k == 3 else [_MIDDLE[k]]  # such an edge has a node there
        for local in (*np.eye(k), *inner):
            reference, moved = (np.einsum("a,faj->fj", local, v[facets]) for v in (space.nodes, u))
            off, _, _ = points.seen(reference, moved, state.displacement_mm)
            depth = max(depth, float(-off.min(initial=0.0)))
            gap = max(gap, float(off[amid].max(initial=0.0)))
    held = at_level(space, system.mesh, system.mesh.height_mm)
    driven = system.constraints.dofs[system.constraints.rate != 0] // dim
    face = np.isin(space.facets, np.intersect1d(held, driven)).all(axis=1)
    if face.any():
        k = _corners(space.facets.shape[1], dim)
        corners = (space.nodes + moved_by)[space.facets[face, :k]]
        area += float(facet_areas(corners).sum())
    if not area:
        return ContactFigures()
    sector = system.force_scale / (2.0 if system.mesh.half_height else 1.0)
    pressure = contact_pressure(system, state, force)
    return ContactFigures(depth, gap, float(pressure.max(initial=0.0)), sector * area)
