"""One forward simulation: adaptive load steps to a force-displacement curve with gradients."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from study.ground.arrays import Array, Ints
from study.ground.compilation import vectors_alone
from study.ground.errors import Fault, InputError, MeshError
from study.ground.files import read_existing
from study.mechanics.contact.contact import BESIDES, face_motions
from study.mechanics.element.function_space import (
    _SAME,
    Discretization,
    at_level,
    deformation_gradient,
    middle_nodes,
)
from study.mechanics.material.homogeneous import UNIAXIAL, first_piola
from study.mechanics.material.stability import stability, stable_in
from study.mechanics.mesh.graded import turned
from study.mechanics.mesh.mesher import build_mesh, mesh_size
from study.mechanics.mesh.solid import surface_faults
from study.mechanics.mesh.structured import MIDDLES, QUADRATIC, Mesh, mirror
from study.mechanics.setup.geometry import Enclosed, Surface
from study.mechanics.setup.setup import Problem, Setup
from study.mechanics.solver.equilibrium import (
    contact_gap,
    contact_pressure,
    mirrored,
    nodal_reactions,
)
from study.mechanics.solver.load_path import LoadPath
from study.mechanics.solver.newton import NewtonSettings, Options, solve_step
from study.mechanics.solver.sensitivity import Loads, linear_rates
from study.mechanics.solver.solution import Solution, without_answer
from study.mechanics.solver.solution_cost import size_faults
from study.mechanics.solver.system import State, System
from study.mechanics.surface.closed_surface import PLAUSIBLE_MM, body, height_of

# -------------------------------------------------------------------------------------------------
# What a problem must satisfy before it is meshed.

#: no specimen of a testing machine is larger
LARGEST_MM = 1e4


def check(problem: Problem) -> None:
    """Refuse a problem that has no answer.

    Units: problem mm, MPa.
    """
    setup, specimen = problem.setup, problem.specimen
    if faults := [*surface_faults(setup)]:
        raise InputError(faults)
    solid = body(specimen) if isinstance(specimen, Enclosed) else specimen
    loading = setup.kind.faults(problem.test, solid.height_mm, solid.half_width_mm)
    faults = [*_material(problem), *loading] or [*size_faults(setup)]
    doubts = [*_unit(setup, doubted=bool(faults))]
    if faults or doubts:
        raise InputError([*doubts, *faults])


def _unit(setup: Setup, *, doubted: bool) -> Iterator[Fault]:
    """Say that a surface is in another unit: where it is absurdly large, or does not fit its test.

    A small one may be a spheroid of cells, and is believed while its test fits.
    """
    specimen = setup.specimen
    if not isinstance(specimen, Surface):
        return
    solid = body(specimen)
    extent = float(np.ptp(solid.points, axis=0).max())
    if extent > LARGEST_MM or (doubted and not PLAUSIBLE_MM[0] <= extent <= PLAUSIBLE_MM[1]):
        size, meant = f"{extent:.3g} mm large", "m" if extent < PLAUSIBLE_MM[0] else "mm"
        rule = f"the surface is {size} if its file is in {specimen.unit}"
        yield Fault("specimen.unit", rule, f'is the file in {meant}? Then write unit = "{meant}"')


def _material(problem: Problem) -> Iterator[Fault]:
    if problem.material.incompressible and problem.model.formulation == "displacement":
        mend = "use formulation = mixed, or a finite bulk_modulus or poisson_ratio"
        yield Fault("model.formulation", "needs a finite bulk modulus", mend)
    if problem.material.relaxation:
        rule = "is of a test in closed form: finite elements know no time"
        yield Fault("material.relaxation", rule, 'write specimen.shape = "homogeneous"')


def instability(problem: Problem) -> str:
    """Sentence about constants that are unstable within the test; empty where they are not.

    Only failure in uniaxial loading counts: the other modes are reached locally at most.
    """
    material, setup = problem.material, problem.setup
    if material.small_strain:
        return ""
    stretches = setup.kind.stretches(setup.test, height_of(setup.specimen))
    if stable_in(UNIAXIAL, material, stretches):
        return ""
    return stability(material, stretches).sentence


def solve(
    problem: Problem,
    *,
    gradients: bool = True,
    warm: Solution | None = None,
    progress: Callable[[float], None] | None = None,
    options: Options | None = None,
    mesh: Mesh | None = None,
) -> Solution:
    """Simulate one test."""
    began = time.perf_counter()
    options = options or Options()
    check(problem)
    unstable = instability(problem)
    if unstable:
        return without_answer(problem, "unstable", unstable, time.perf_counter() - began)
    try:
        with vectors_alone():
            system = _system(problem, warm, options, mesh)
            start_from = partial(LoadPath, system, problem, options, gradients, progress)
            run = start_from(warm).to_the_end()
            if warm is not None and run.may_do_better():
                system.factors.forget()
                run = start_from(None).to_the_end()
            return run.solution(time.perf_counter() - began)
    except MemoryError as error:
        message = f"{error}: use a larger mesh_size, or axisymmetric space"
        return without_answer(problem, "out-of-memory", message, time.perf_counter() - began)
    except MeshError as error:
        return without_answer(problem, "mesh-failed", str(error), time.perf_counter() - began)


#: largest motion of a column's imperfection over its thickness; the next where a path with the
#: one before ended on a branch that is not stable
IMPERFECTIONS = (0.02, 0.05)

#: linear elements over the thickness of a body that bends: two are 7 % too stiff, four 2 %
BENT_ELEMENTS = 4


def follow(
    problem: Problem,
    *,
    gradients: bool = True,
    progress: Callable[[float], None] | None = None,
    options: Options | None = None,
) -> Solution:
    """Simulate one test, behind an instability on the whole body, bent a little into its mode.

    An axisymmetric problem is one of 3D, and linear elements are small enough to bend. Without an
    instability the solution is that of :func:`solve`, of which the model is then a part.
    """
    model = replace(problem.model, space="3d")
    if model.element_order == "linear" and not isinstance(problem.specimen, Enclosed):
        most = 2 * problem.specimen.half_width_mm / BENT_ELEMENTS
        size_mm = mesh_size(replace(problem, model=model).setup)
        model = replace(model, mesh_size_mm=min(size_mm, most))
    solid = replace(problem, model=model)
    solve_solid = partial(solve, solid, gradients=gradients, options=options, progress=progress)
    part = solve_solid()
    bent, warm, specimen = part.instability, part.warm, problem.specimen
    if bent is None or warm is None or isinstance(specimen, Enclosed) or solid.setup.is_whole:
        return part
    mesh = warm.system.mesh
    whole, shape = mirrored(mesh, bent.mode[: len(mesh.points)], bent.parity, mesh.height_mm)
    branch = part
    for share in IMPERFECTIONS:
        points = whole.points + share * 2 * specimen.half_width_mm * shape
        branch = solve_solid(mesh=replace(whole, points=points))
        if branch.converged:
            break
    message = (
        f"{bent.sentence}; followed on the whole body in elements of {mesh.size_mm:.3g} mm, "
        f"bent by {100 * share:g} % of its thickness into that mode: {branch.message}"
    )
    return replace(branch, message=message, equilibria=replace(branch.equilibria, instability=bent))


def _system(problem: Problem, warm: Solution | None, options: Options, mesh: Mesh | None) -> System:
    if warm is not None and warm.warm is not None:
        system = warm.warm.system
        system = replace(system, material=problem.material, latest=replace(system.latest))
        system.factors.forget()
        return system
    return System.build(
        problem,
        build_mesh(problem.setup) if mesh is None else mesh,
        solver=options.linear_solver,
        folding=options.side_contact,
    )


# -------------------------------------------------------------------------------------------------
# Equilibria under any motion of a plate, and how they move with it.
#
# A load path brings a specimen to one motion. Equilibria at others are reached from there along
# the derivatives by the motion, which one factorization gives for all of its components: of an
# elastic body the way does not matter.

#: components of a motion: towards the specimen, x and y (mm), three rotations (rad), spread
COMPONENTS = 1 + BESIDES

#: residual of the derivatives over the forces that they balance
_PRESCRIBED_MOTION_TOLERANCE = 1e-6

#: halvings of a change of motion that is too large for one step
_PRESCRIBED_MOTION_HALVINGS = 5


@dataclass(frozen=True)
class MovedPlate:
    """Equilibrium at a motion of the plate."""

    #: shape (7,); down, x and y in mm, rotations about x, y and the axis in rad, spread.
    motion: Array
    state: State
    #: shape (n_nodes, 3); of the nodes, mm.
    displacement: Array
    #: shape (n_nodes, 3, 7); derivatives of the displacements by the motion.
    rates: Array


class NoEquilibrium(Exception):
    """No equilibrium was found at a motion of the plate."""


class PrescribedMotion:
    """A solved plate motion that can be taken elsewhere."""

    def __init__(self, problem: Problem, solution: Solution) -> None:
        if solution.warm is None or not solution.converged:
            raise NoEquilibrium(solution.message)
        self.system = solution.warm.system
        self._modes = _modes(self.system)
        state, besides = solution.warm.steps[-1].state, problem.test.motion
        others = np.zeros(BESIDES) if besides is None else besides.components()
        motion = np.concatenate([[problem.test.depth_mm], others])
        self.start = self._described(self._under(motion), motion, state)

    def at(self, motion: Array, near: MovedPlate) -> MovedPlate:
        """Equilibrium at another motion.

        Shapes: motion (7,).
        """
        if not motion[0] > 0:
            raise NoEquilibrium(f"the plate would move by {motion[0]:.3g} mm, off the specimen")
        return self._reached(motion, near, _PRESCRIBED_MOTION_HALVINGS)

    def _reached(self, motion: Array, near: MovedPlate, halvings: int) -> MovedPlate:
        system = self._under(motion)
        guess = near.state.x.copy()
        moved = near.displacement + near.rates @ (motion - near.motion)
        guess[: system.space.n_displacement] = moved.ravel()
        guess[system.constraints.dofs] = system.prescribed(float(motion[0]))
        start = replace(near.state, displacement_mm=float(motion[0]), x=guess)
        if (system.volume_ratios(guess) > 0).all():
            step = solve_step(system, start, NewtonSettings())
            if step.converged:
                return self._described(system, motion, step.state)
        if not halvings:
            raise NoEquilibrium("no equilibrium was found at the plate motion that fits")
        middle = self._reached(0.5 * (motion + near.motion), near, halvings - 1)
        return self._reached(motion, middle, halvings - 1)

    def _under(self, motion: Array) -> System:
        """Return the same equations under another motion; solver and arrays are shared."""
        rate = self._modes @ motion / motion[0]
        constraints = replace(self.system.constraints, rate=rate)
        return replace(self.system, constraints=constraints, latest=replace(self.system.latest))

    def _described(self, system: System, motion: Array, state: State) -> MovedPlate:
        """Equilibrium with the derivatives of all unknowns by the motion."""
        assembly, start = system.assemble(state), np.zeros((system.space.n, COMPONENTS))
        start[system.constraints.dofs] = self._modes
        targets = []
        for points, touch in zip(system.contact, assembly.contact, strict=True):
            target = np.zeros((points.size, COMPONENTS))  # sideways motion opens no plane contact
            target[:, 0] = -touch.normal()[:, -1] * points.surface.speed
            targets.append(target)
        loads = Loads(np.zeros_like(start), start, tuple(targets))
        rates = linear_rates(system, assembly, loads, _PRESCRIBED_MOTION_TOLERANCE)
        if rates.excess > 1:
            raise NoEquilibrium("the derivatives by the plate motion did not converge")
        of_nodes = rates.x[: system.space.n_displacement]
        return MovedPlate(
            motion=motion.copy(),
            state=state,
            displacement=system.displacements(state.x).copy(),
            rates=of_nodes.reshape(*system.space.nodes.shape, COMPONENTS),
        )


def _modes(system: System) -> Array:
    """Values of the constrained unknowns for a unit of every component, shape (n_held, 7)."""
    dim, dofs = system.space.dim, system.constraints.dofs
    top = at_level(system.space, system.mesh, system.mesh.height_mm)
    values = np.zeros((system.space.n, COMPONENTS))
    moved = (top[:, None] * dim + np.arange(dim)).ravel()
    if np.setdiff1d(moved, dofs).size:
        raise NoEquilibrium("the plate above must hold the face that it moves")
    down = np.zeros((top.size, dim, 1))
    down[:, -1] = -1.0
    every = np.concatenate([down, face_motions(system.space, top)], axis=2)
    values[moved] = every.reshape(-1, COMPONENTS)
    return values[dofs]


# -------------------------------------------------------------------------------------------------
# Fields of a solution for ParaView: the mesh with its mid-side nodes, displacement and stress.


@dataclass(frozen=True)
class Fields:
    """Fields of one step on the modelled part of the specimen, or on the whole.

    Axisymmetric coordinates are (r, z, 0), so that the axes of a tensor are r, z and hoop.
    """

    displacement_mm: float
    #: shape (n_nodes, 3); nodes before the deformation and their displacements, mm.
    points: Array
    displacement: Array
    #: Type of the cells as meshio names it.
    kind: str
    cells: Ints
    #: Further values by name, one row a node or a cell; nine columns are a tensor row by row.
    nodal: dict[str, Array]
    cellular: dict[str, Array]
    #: What is left out that symmetry would add, and the share of the body that is there.
    symmetry: str
    share: float
    #: Planes of symmetry, by axis and level in mm.
    planes: tuple[tuple[int, float], ...]
    #: {-1, 1} by axis, of a buckling mode.
    parity: tuple[int, ...] = (1, 1, 1)

    def whole(self) -> Fields:
        """Mirror the part at its planes of symmetry; an axisymmetric one becomes its section.

        The base rests, as in a model of the full height: of an upper half its middle plane does.
        """
        if not self.planes:
            return self
        body, extent = self, "the whole body"
        if not self.points[:, 2].any():  # either side of the axis carries half of a ring's force
            nodal = self.nodal | {"reaction_N": self.nodal["reaction_N"] / 2}
            body, extent = replace(self, nodal=nodal), "the section through the axis"
        for axis, level in self.planes:
            body = body._mirrored(axis, level)
            if level > 0:
                lowest = body.points[:, axis] <= body.points[:, axis].min() + _SAME * level
                body.displacement[:, axis] -= body.displacement[lowest, axis].mean()
        return replace(body, symmetry=f"{extent}, mirrored", planes=(), share=1.0)

    def _mirrored(self, axis: int, level: float) -> Fields:
        points, cells, beyond = mirror(self.points, self.cells, self.kind, axis, level)
        sign = np.ones(3)
        sign[axis] = -1.0
        tensor = np.outer(sign, sign).ravel()

        def image(name: str, values: Array) -> Array:
            columns = 1 if values.ndim == 1 else values.shape[1]
            if columns == 3 and name in _VECTORS:
                return values * sign * (self.parity[axis] if name == "buckling_mode" else 1)
            return values * tensor if columns == 9 else values

        moved = np.concatenate([self.displacement, (self.displacement * sign)[beyond]])
        nodal = {n: np.concatenate([v, image(n, v)[beyond]]) for n, v in self.nodal.items()}
        shared = np.setdiff1d(np.arange(len(self.points)), beyond)
        force = self.nodal["reaction_N"][shared]
        nodal["reaction_N"][shared] += image("reaction_N", force)
        cellular = {n: np.concatenate([v, image(n, v)]) for n, v in self.cellular.items()}
        return replace(
            self, points=points, displacement=moved, cells=cells, nodal=nodal, cellular=cellular
        )


#: fields of three columns that are vectors, not three numbers
_VECTORS = ("reaction_N", "buckling_mode")


def fields(solution: Solution, step: int = -1) -> Fields:
    """Fields of a requested step that converged, the last one if none is named."""
    if solution.warm is None or not solution.warm.steps:
        raise InputError(Fault("fields", f"no step converged: {solution.message}"))
    system, state = solution.warm.system, solution.warm.steps[step].state
    space, mesh = system.space, system.mesh
    # simplices have a positive volume in VTK; grids have it already
    simplex = mesh.cells.shape[1] == space.dim + 1
    upright = turned(mesh.points, mesh.cells.copy()) if simplex else mesh.cells
    kind, cells = _cells(space, mesh.kind, upright)
    used = np.unique(cells)  # bubbles belong to no corner and no side
    F = deformation_gradient(space, system.displacements(state.x))
    # the volume that a linear body sees
    small = system.material.small_strain
    J = np.trace(F) - 2 if small else np.linalg.det(np.moveaxis(F, (0, 1), (-2, -1)))
    stretches, strain, directions = _strains(F, small)
    principal = None if directions is None else (stretches, directions)
    stress = cauchy_stress(system, state, F, J, principal)
    means = space.weights / space.weights.sum(axis=1, keepdims=True)

    def mean(values: Array) -> Array:
        each = np.einsum("...eq,eq->e...", values, means)
        return np.asarray(each.reshape(space.n_elements, -1))

    tensors = {
        "cauchy_stress_MPa": mean(stress),
        "log_strain": mean(strain),
        "principal_stretch": mean(np.moveaxis(stretches, -1, 0)),
    }
    volumes = space.weights.sum(axis=1)
    nodal = {name: _at_nodes(space, values, volumes)[used] for name, values in tensors.items()}
    above, below = nodal_reactions(system, system.assemble(state, tangent=False))
    nodal["reaction_N"] = _in_space((above + below)[used])
    nodal["contact_pressure_MPa"] = contact_pressure(system, state, above)[used]
    nodal["contact_gap_mm"] = contact_gap(system, state)[used]
    bent = solution.instability
    if bent is not None and len(bent.mode) == len(space.nodes):
        nodal["buckling_mode"] = _in_space(bent.mode[used])
    is_part = system.force_scale > (2.0 if mesh.half_height else 1.0)
    planes = [(k, 0.0) for k in range(space.dim - 1) if is_part or space.dim == 2]
    planes += [(space.dim - 1, mesh.height_mm / 2)] if mesh.half_height else []
    part = "a section from the axis" if space.dim == 2 else "a quarter" if is_part else "the whole"
    return Fields(
        displacement_mm=state.displacement_mm,
        points=_in_space(space.nodes[used]),
        displacement=_in_space(system.displacements(state.x)[used]),
        kind=kind,
        cells=np.searchsorted(used, cells),
        nodal=nodal,
        cellular={"J": mean(J)[:, 0], **tensors},
        symmetry=f"{part} of the body{', its upper half' if mesh.half_height else ''}",
        share=1.0 / system.force_scale,
        planes=tuple(planes),
        parity=(1, 1, 1) if bent is None else bent.parity,
    )


def _strains(F: Array, small: bool) -> tuple[Array, Array, Array | None]:  # noqa: N803
    """Principal stretches, largest first, (..., 3), logarithmic strain (3, 3, ...), directions."""
    matrices = np.moveaxis(F, (0, 1), (-2, -1))
    if small:
        strain = (matrices + np.swapaxes(matrices, -2, -1)) / 2 - np.eye(3)
        stretches, directions = 1 + np.linalg.eigvalsh(strain)[..., ::-1], None
    else:
        left, stretches, directions = np.linalg.svd(matrices)
        strain = np.einsum("...ik,...k,...jk->...ij", left, np.log(stretches), left)
    return np.asarray(stretches, float), np.moveaxis(strain, (-2, -1), (0, 1)), directions


def _at_nodes(space: Discretization, values: Array, volumes: Array) -> Array:
    """Mean over the elements around every node, by their volumes. Shapes: values (n_cells, m)."""
    share, local = np.zeros((len(space.nodes), 1)), space.element_nodes
    total = np.zeros((len(space.nodes), values.shape[1]))
    for k in range(local.shape[1]):
        np.add.at(total, local[:, k], values * volumes[:, None])
        np.add.at(share, local[:, k], volumes[:, None])
    return np.asarray(total / share)


def write_vtu(solution: Solution, path: str | Path, step: int = -1, *, whole: bool = False) -> None:
    """Write the fields of a step into a VTU file for ParaView.

    Points are those before the deformation; *Warp By Vector* with ``displacement_mm`` deforms
    them. Cells carry ``J``, ``mean_stress_MPa`` (negative in compression), ``von_mises_MPa``,
    ``cauchy_stress_MPa``, ``log_strain`` (spatial) and ``principal_stretch``; nodes carry the last
    three as means of the cells around, ``reaction_N``, ``contact_pressure_MPa``,
    ``contact_gap_mm`` and, where the specimen buckles, ``buckling_mode``. The data of the file
    are reactions, moments, displacement and what the mesh leaves out.
    """
    import meshio

    arrays = fields(solution, step)
    arrays = arrays.whole() if whole else arrays
    tensor = arrays.cellular["cauchy_stress_MPa"].reshape(-1, 3, 3)
    mean = np.trace(tensor, axis1=1, axis2=2) / 3
    deviator = tensor - mean[:, None, None] * np.eye(3)
    cellular = {
        "mean_stress_MPa": mean,
        "von_mises_MPa": np.sqrt(1.5 * (deviator**2).sum(axis=(1, 2))),
        **arrays.cellular,
    }
    mesh = meshio.Mesh(
        arrays.points,
        [(arrays.kind, arrays.cells)],
        point_data={"displacement_mm": arrays.displacement, **arrays.nodal},
        cell_data={name: [values] for name, values in cellular.items()},
    )
    mesh.write(path, file_format="vtu")
    # what is of the whole file meshio does not write
    facts = {"displacement_mm": [arrays.displacement_mm], "modelled_share": [arrays.share]}
    bodies = {"plate": solution.equilibria.plate[step], "base": solution.equilibria.base[step]}
    for name, held in bodies.items():
        facts[f"{name}_axial_N"] = [held.axial]
        facts[f"{name}_side_N"] = [*held.side]
        facts[f"{name}_moment_Nmm"] = [*held.moment]
    rows = [
        f'<DataArray type="Float64" Name="{name}" NumberOfTuples="1" '
        f'NumberOfComponents="{len(values)}" format="ascii">'
        f"{' '.join(repr(float(v)) for v in values)}</DataArray>"
        for name, values in facts.items()
    ]
    grid = "<UnstructuredGrid>"
    data = f"{grid}\n<!-- {arrays.symmetry} -->\n<FieldData>{''.join(rows)}</FieldData>"
    path = Path(path)
    written = read_existing(path, limit=path.stat().st_size)
    path.write_bytes(written.replace(grid.encode(), data.encode(), 1))


def write_series(solution: Solution, path: str | Path, *, whole: bool = False) -> None:
    """Write every step that was asked for: a ``.pvd`` collection and a ``.vtu`` file a step.

    ParaView shows the displacement of the test as the time.
    """
    path = Path(path)
    steps = () if solution.warm is None else solution.warm.steps
    rows = []
    for k, step in enumerate(steps):
        name = f"{path.stem}_{k + 1:04d}.vtu"
        write_vtu(solution, path.with_name(name), k, whole=whole)
        time_mm = repr(float(step.state.displacement_mm))
        rows.append(f'<DataSet timestep="{time_mm}" part="0" file="{name}"/>')
    head = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n<Collection>\n'
    tail = "\n</Collection>\n</VTKFile>\n"
    path.write_text(head + "\n".join(rows) + tail, encoding="utf-8")


def cauchy_stress(
    system: System, state: State, F: Array, J: Array, principal: tuple[Array, Array] | None
) -> Array:
    """Cauchy stress at every quadrature point, the pressure as it was solved for, MPa.

    Shapes: F (3, 3, n_elements, n_quadrature); J (n_elements, n_quadrature); ``principal`` as in
    first_piola; returns (3, 3, n_elements, n_quadrature).
    """
    nominal, space = first_piola(system.material, F, principal), system.space
    small = system.material.small_strain
    stress = nominal if small else np.einsum("ij...,kj...->ik...", nominal, F) / J
    eye = np.eye(3)[:, :, None, None]
    mean = space.pressures(state.x) + system.internal.split(system.material).local * (J - 1)
    return np.asarray(stress + (mean - np.trace(stress) / 3) * eye)


def _cells(space: Discretization, linear: str, corners: Ints) -> tuple[str, Ints]:
    """Type and nodes of the cells, the further nodes found by where they lie."""
    kind, nodes = QUADRATIC[linear], space.element_nodes
    if nodes.shape[1] < corners.shape[1] + len(MIDDLES[kind]):  # bubbles are not drawn
        return linear, corners
    rest = nodes[~(nodes[:, :, None] == corners[:, None, :]).any(axis=2)].reshape(len(nodes), -1)
    middles = [middle_nodes(space, rest, corners[:, list(middle)]) for middle in MIDDLES[kind]]
    return kind, np.column_stack([corners, *middles])


def _in_space(plane: Array) -> Array:
    """Give vectors a third component where they have two."""
    return np.pad(plane, ((0, 0), (0, 3 - plane.shape[1])))
