"""Refinement: the loop, and the series of a problem.

A series says which computations are due and takes what they gave, until it has enough; the loop
does what is due of all series at once. A problem asks for one mesh after the other, as long as
its accuracy and its budget want; the cells of a study know all their meshes from the start (see
:mod:`study.harness.runner.case_series`).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from study.ground.arrays import Array
from study.ground.canonical import Keyed
from study.ground.curve import Curve
from study.ground.errors import Fault, InputError, nearest
from study.ground.memory import free_memory_MB
from study.harness.design.cell import CellProblem
from study.harness.runner.solve_task import Solver, SolveResult, SolveTask, solutions
from study.mechanics.setup.geometry import Cylinder, Enclosed, Flat
from study.mechanics.setup.setup import Problem, Setup
from study.mechanics.setup.test_kind import ClampedCorner, RoundedEdge, SharpEdge, Singularity
from study.statistics.convergence.grid_convergence import ConvergenceResult, grid_convergence

if TYPE_CHECKING:
    from study.harness.design.study_file import Converge
    from study.harness.runner.job import CaseJob


#: seed of the other mesh of a surface, whose difference tells how far a choice of meshes moves it
OTHER_MESH = 1

#: an order needs as many meshes, and no series gets longer than this
FEWEST = 3
MOST = 10

#: part of the free memory that a solution may take, and what is free where no system says it
MEMORY_SHARE = 0.7
USUAL_MB = 4096.0

#: exponents of time in the unknowns where only one mesh is known (numerics.md)
_TIME_EXPONENT = {"axisymmetric": 1.2, "3d": 1.95}
_MEMORY_EXPONENT = 1.35


@dataclass(frozen=True)
class Predictions:
    """What a solution was predicted to take; None where nothing was known yet."""

    seconds: float | None = None
    memory_MB: float | None = None  # noqa: N815
    unknowns: int | None = None


@dataclass(frozen=True)
class MeshLevel(Keyed):
    """One mesh of a series: what was predicted and what came out."""

    mesh_size_mm: float
    result: SolveResult
    predicted: Predictions = field(default_factory=Predictions)

    KEYS = (
        "mesh_size=mesh_size_mm status=result.status message=result.message "
        "elements=result.elements unknowns=result.dofs seconds=result.seconds "
        "memory_MB=result.memory_MB predicted_seconds=predicted.seconds "
        "predicted_MB=predicted.memory_MB predicted_unknowns=predicted.unknowns"
    )


@dataclass(frozen=True)
class Budget:
    """When a series must stop: seconds from ``began``, and memory."""

    seconds: float | None = None
    memory_MB: float | None = None
    began: float = field(default_factory=time.monotonic)

    def refuses(self, seconds: float | None, memory: float | None) -> str:
        """Why a solution of this predicted cost is not begun; empty if it may."""
        left = None if self.seconds is None else self.seconds - (time.monotonic() - self.began)
        if left is not None and (seconds or 0.0) > left:
            return f"the next mesh would take {seconds or 0:.3g} s of {max(left, 0):.3g} s left"
        limit = self.memory_MB or MEMORY_SHARE * (free_memory_MB() or USUAL_MB)
        if memory is not None and memory > limit:
            return f"the next mesh would take {memory:.0f} MB of {limit:.0f} MB"
        return ""


# What a series says of its quantities.

Values = Mapping[str, tuple[Sequence[float], str]]

#: relative error of a force at the solver's tolerance
SOLVER_TOLERANCE = 1e-7

#: a value of this part of the largest of its kind is nothing to be settled
_NOTHING = 1e-9


def judged(
    sizes: Sequence[float],
    values: Values,
    formal: float | None,
    tolerance: float = SOLVER_TOLERANCE,
) -> dict[str, ConvergenceResult]:
    """Judge every quantity of a series of at least three meshes."""
    return {
        name: grid_convergence(
            sizes, numbers, formal_order=formal, qoi=name, unit=unit,
            tolerance=tolerance * max(abs(v) for v in numbers),
        )
        for name, (numbers, unit) in values.items()
    }  # fmt: skip


def within(results: Mapping[str, ConvergenceResult], accuracy: float) -> dict[str, bool]:
    """Whether the uncertainty of each quantity is at most a fraction of its value."""
    return {
        name: r.u_num is not None and r.u_num <= accuracy * abs(r.value[0]) + _NOTHING
        for name, r in results.items()
    }


def size_needed(result: ConvergenceResult, accuracy: float) -> float | None:
    """Mesh size whose uncertainty would be the wanted fraction of the value, by the order used."""
    if result.order_used is None or not result.u_num or result.extrapolated in (None, 0.0):
        return None
    allowed = accuracy * abs(result.extrapolated)
    return float(result.mesh_size[0] * (allowed / result.u_num) ** (1 / result.order_used))


@dataclass
class RefinementSeries:
    """Refinement of one problem, coarse to fine."""

    problem: CellProblem
    #: Ratio, number of meshes, wanted accuracy.
    spec: Converge
    #: What the elements promise, and what limits it.
    formal: FormalOrder
    budget: Budget = field(default_factory=Budget)
    #: Levels of the factors, where the problem is a cell.
    levels_of: Mapping[str, str] = field(default_factory=dict)
    levels: list[MeshLevel] = field(default_factory=list)
    stopped: str = ""

    @property
    def setup(self) -> Setup:
        """Specimen, test and discretization of what is refined."""
        return self.problem.setup

    @cached_property
    def first_mm(self) -> float:
        """Element size of the problem, the coarsest of the series."""
        return element_size_mm(self.problem.at())

    @property
    def good(self) -> list[MeshLevel]:
        """Meshes with an answer."""
        return [level for level in self.levels if level.result.converged]

    @property
    def next_mm(self) -> float | None:
        """Size of the next mesh; None where the series has ended (``stopped`` says why)."""
        self.stopped = self.stopped or self._end()
        return None if self.stopped else float(self.first_mm / self.spec.ratio ** len(self.levels))

    def _end(self) -> str:
        """Why no further mesh is solved; empty while one is wanted."""
        count, needed = len(self.levels), max(FEWEST, self.spec.levels)
        if count >= needed and len(self.good) >= FEWEST:
            if self.spec.tolerance is None:
                return f"{count} meshes were asked for"
            settled, needed_mm = self._outlook(self.spec.tolerance)
            if settled:
                return "every quantity has the wanted accuracy"
            if hopeless := self._hopeless(needed_mm):
                return hopeless
        if count >= MOST or (count >= needed + 2 and len(self.good) < FEWEST):
            return f"{count} meshes are enough"
        next_one = self.predicted()
        return self.budget.refuses(next_one.seconds, next_one.memory_MB) if count else ""

    def _outlook(self, accuracy: float) -> tuple[bool, float | None]:
        """Whether every quantity has the wanted accuracy, and the mesh size that it takes."""
        meshes, _ = usable(self.levels)
        if len(meshes) < FEWEST:
            return False, None
        results = judged_meshes(meshes, self.setup, self.formal.order)
        needed = [size_needed(result, accuracy) for result in results.values()]
        known = [size for size in needed if size is not None]
        return all(within(results, accuracy).values()), min(known, default=None)

    def _hopeless(self, needed_mm: float | None) -> str:
        """Why the mesh that would be fine enough is out of reach; empty if it may be."""
        last = self.good[-1]
        if needed_mm is None or needed_mm >= last.mesh_size_mm:
            return ""
        space = self.setup.model.space
        power = (2 if space == "axisymmetric" else 3) * _TIME_EXPONENT[space]
        seconds = last.result.seconds * (last.mesh_size_mm / needed_mm) ** power
        if not self.budget.refuses(seconds, None):
            return ""
        return (
            f"the wanted accuracy needs a mesh size of about {needed_mm:.2g} mm and "
            f"{seconds:.2g} s, which the budget does not have"
        )

    def predicted(self) -> Predictions:
        """Cost of the next mesh, from what the meshes so far took."""
        solved = [level.result for level in self.good if level.result.dofs > 0]
        if not solved:
            return Predictions()
        last, space = solved[-1], self.setup.model.space
        growth = self.spec.ratio ** (2 if space == "axisymmetric" else 3)
        time_exponent = _TIME_EXPONENT[space]
        if len(solved) > 1 and solved[-2].dofs < last.dofs:
            before, growth = solved[-2], last.dofs / solved[-2].dofs
            if before.seconds >= 0.02 and last.seconds > before.seconds:  # small times say nothing
                followed = math.log(last.seconds / before.seconds) / math.log(growth)
                time_exponent = min(max(followed, 1.0), 3.0)
        growth_MB = max(last.memory_MB - last.base_MB, 1.0)
        memory = last.base_MB + growth_MB * growth**_MEMORY_EXPONENT
        return Predictions(last.seconds * growth**time_exponent, memory, round(last.dofs * growth))


def refine(
    series: Sequence[RefinementSeries],
    solve: Solver,
    progress: Callable[[str], None] = lambda _: None,
) -> None:
    """Solve the next mesh of every series, all of one round together, until all have ended."""
    while due := [(member, mm) for member in series if (mm := member.next_mm) is not None]:
        predicted = [member.predicted() for member, _ in due]
        foretold = [each.seconds for each in predicted if each.seconds is not None]
        sizes = ", ".join(dict.fromkeys(f"{mm:.3g}" for _, mm in due[:4]))
        cost = f", about {sum(foretold):.2g} s of computing" if foretold else ""
        several = "s" if len(due) > 1 else ""
        progress(f"mesh size {sizes} mm: {len(due)} solution{several}{cost}")
        results = solutions(solve, [SolveTask.of(member.problem, mm) for member, mm in due])
        for (member, mm), result, cost_of in zip(due, results, predicted, strict=True):
            member.levels.append(MeshLevel(mm, result, cost_of))


# Single numbers of a curve whose convergence is judged: peak force, root mean square, work.

#: points of a curve that integrals over it take, between the solved steps by their tangents
_POINTS = 400


def _samples(curve: Curve) -> tuple[Array, Array]:
    """Displacements and forces, so close that the number of load steps does not matter."""
    d = np.linspace(0.0, float(curve.displacement_mm[-1]), _POINTS + 1)
    return d, curve.force_at(d)


def peak_force(curve: Curve) -> float:
    """Force at the last step, N."""
    return float(curve.force_N[-1])


def curve_rms(curve: Curve) -> float:
    """Root mean square of the force over the displacement, N: it stands for the whole curve."""
    return float(np.sqrt(np.mean(_samples(curve)[1][1:] ** 2)))


def work(curve: Curve) -> float:
    """Work done on the specimen, N mm."""
    d, force = _samples(curve)
    return float(np.trapezoid(force, d))


#: quantities of a curve that a series can watch, with their units
QUANTITIES: Mapping[str, tuple[Callable[[Curve], float], str]] = {
    "peak_force": (peak_force, "N"),
    "curve_rms": (curve_rms, "N"),
    "work": (work, "N mm"),
}


def quantity(name: str) -> tuple[Callable[[Curve], float], str]:
    """Look up function and unit of a quantity of a single problem."""
    if name not in QUANTITIES:
        rule = f"{name!r} needs measured curves"
        raise InputError(Fault("converge.qoi", rule, nearest(name, QUANTITIES)))
    return QUANTITIES[name]


# Formal order of the force: what an element can promise where the solution is singular.
#
# The force of a test driven by a displacement is a derivative of the energy, whose error is
# the square of the error of the gradient: order 2 k for an element of degree k, if the
# solution is smooth. A corner where the displacement goes as s^lambda allows 2 lambda only,
# whatever the element (Babuska and Szabo 1982, Int. J. Numer. Meth. Eng. 18, 323).
#
# The sharp edge of a flat punch has lambda = 1/2, bonded or not: the contact pressure goes as
# s^(-1/2) with the distance s to the edge (Sneddon 1965, Int. J. Eng. Sci. 3, 47; Johnson 1985,
# Contact Mechanics, chapters 2 and 3: bonded it oscillates besides, unless nu = 1/2).

_DEGREE = {"linear": 1, "quadratic": 2}

#: elements along the radius of a rounded edge from which on it is not sharp to a mesh
_ACROSS_EDGE = 2.0

#: depth over the coarsest element at a sharp edge from which on its strains are large on the
#: finest one; equilibria are not unique there then
_DEEP = 0.25
_RIM = (
    "the rim of the contact, which a mesh places to within an element; the force is stationary "
    "in it"
)


@dataclass(frozen=True)
class FormalOrder:
    """Order of the force in the mesh size, and what limits it."""

    #: None where a stranger's solver promises none.
    order: float | None
    why: str


def formal_order(problem: Problem) -> FormalOrder:
    """Order that the element promises for the force of a problem; work and RMS share it."""
    smooth = 2.0 * _DEGREE[problem.model.element_order]
    degree = problem.model.element_order
    singularities = problem.setup.kind.singularities(problem.test)
    singular = [_limit(problem, singularity) for singularity in singularities]
    if problem.model.space == "3d" and isinstance(problem.specimen, Cylinder):
        singular.append((2.0, "the cylinder's straight-sided elements"))
    if isinstance(problem.specimen, Enclosed):
        singular.append((2.0, "straight-sided elements, and edges of the surface that are corners"))
    limits = singular  # first: of two equal limits the problem's says more
    limits.append((smooth, f"{degree} elements: twice the order of their gradient"))
    order, why = min(limits, key=lambda item: item[0])
    return FormalOrder(order, why)


def _limit(problem: Problem, singularity: Singularity) -> tuple[float, str]:
    """Limit that a singularity sets, and why."""
    if isinstance(singularity, ClampedCorner):
        K, mu = problem.material.bulk, problem.material.mu0
        exponent = clamped_corner(0.5 if math.isinf(K) else (3 * K - 2 * mu) / (2 * (3 * K + mu)))
        return 2 * exponent, (
            f"the corner between a bonded and a free face: the displacement goes as "
            f"s^{exponent:.3f} there"
        )
    if isinstance(singularity, SharpEdge):
        return 1.0, _sharp(problem, singularity.name)
    if not isinstance(singularity, RoundedEdge):
        return 2.0, _RIM
    edge, size = singularity.radius_mm, element_size_mm(problem)
    if size > edge / _ACROSS_EDGE:
        return 1.0, (
            f"the edge of the flat punch, rounded with {edge:.3g} mm, which the coarsest mesh of "
            f"{size:.3g} mm does not resolve: it looks sharp, where the order is 1; meshes of "
            f"{edge / _ACROSS_EDGE:.3g} mm and less have order 2 at most"
        )
    return 2.0, (
        f"the rounded edge of the flat punch ({edge:.3g} mm), which the meshes resolve: the "
        f"pressure is finite, and what counts is {_RIM}"
    )


def _sharp(problem: Problem, edge: str) -> str:
    """Why the order is 1 under a sharp edge, and what may hide it."""
    depth = problem.test.depth_mm
    orders = " and ".join(f"{2 * degree} of {name}" for name, degree in _DEGREE.items())
    why = (
        f"the {edge} of the flat punch, where the contact pressure is singular as an "
        "inverse square root of the distance: energy and force converge with the mesh size, "
        "whatever the element, so an observed order near 1 is right here (the orders "
        f"{orders} elements need a smooth solution)"
    )
    size = element_size_mm(problem)
    if not problem.material.small_strain and depth > _DEEP * size:
        why += (
            f"; at a depth of {depth:.3g} mm, beside elements of {size:.3g} mm and less, large "
            "strains and sliding at the edge may hide the order: a smaller depth shows it"
        )
    return why


def element_size_mm(problem: Problem) -> float:
    """Element size of a problem, at the edge of a punch where it has one."""
    from study.mechanics.mesh.mesher import mesh_size

    return float(mesh_size(problem.setup))


def edge_rules(setup: Setup) -> bool:
    """Whether all error comes from a sharp edge, where the size at the edge is that of the mesh."""
    pressed = setup.test.indenter
    sharp = isinstance(pressed, Flat) and not pressed.edge_radius_mm
    return sharp and setup.model.space == "axisymmetric"


def clamped_corner(nu: float) -> float:
    """Exponent where a bonded meets a free face (Williams 1952, J. Appl. Mech. 19, 526)."""
    from scipy.optimize import brentq

    def mismatch(s: float) -> float:
        return (3 - 4 * nu) * math.sin(math.pi * s / 2) ** 2 - 4 * (1 - nu) ** 2 + s * s

    return float(brentq(mismatch, 0.3, 1.0)) if mismatch(1.0) > 0 else 1.0


def base_size_mm(job: CaseJob) -> float:
    """Element size of a case, named or given, in mm."""
    return element_size_mm(in_mind(job))


def in_mind(job: CaseJob) -> Problem:
    """Problem of a case whose constants are not known yet."""
    return job.case.tested.with_placeholder(job.depth_mm if job.directions else 1.0)


# Meshes of a series that can be judged, and the sizes by which they are.


def usable(levels: Sequence[MeshLevel]) -> tuple[list[MeshLevel], list[str]]:
    """Meshes with an answer and with elements of their own, and what is wrong with the others."""
    meshes: list[MeshLevel] = []
    warnings = [
        f"the mesh of {level.mesh_size_mm:.4g} mm gave no answer: {level.result.message}"
        for level in levels
        if not level.result.converged
    ]
    for level in levels:
        if not level.result.converged:
            continue
        count = level.result.elements
        same = [mesh for mesh in meshes if mesh.result.elements == count > 0]
        if same:
            warnings.append(
                f"the meshes of {same[0].mesh_size_mm:.4g} mm and {level.mesh_size_mm:.4g} mm "
                f"have the same {count} elements: the coarser is left out; a larger "
                "ratio or a smaller mesh_size would refine"
            )
            meshes.remove(same[0])
        meshes.append(level)
    return meshes, warnings


def judged_meshes(
    levels: Sequence[MeshLevel],
    setup: Setup,
    formal: float | None,
    tolerance: float = SOLVER_TOLERANCE,
) -> dict[str, ConvergenceResult]:
    """Judge every quantity of the curves of solved meshes by sizes scaled to the finest one's."""
    sizes, elements = zip(*((m.mesh_size_mm, m.result.elements) for m in levels), strict=True)
    values = {
        name: ([function(level.result.curve) for level in levels], unit)
        for name, (function, unit) in QUANTITIES.items()
    }
    return judged(series_sizes(sizes, elements, setup), values, formal, tolerance)


def series_sizes(
    sizes: Sequence[float],
    elements: Sequence[int],
    setup: Setup,
    *,
    anchor: int = -1,
) -> list[float]:
    """Sizes by which a series is judged: by its elements, or those at a sharp edge."""
    if edge_rules(setup) or min(elements) <= 0 or len(set(elements)) < len(elements):
        return list(sizes)
    # h = (V / N)^(1/d) of N elements, scaled to one of them (Celik et al. 2008)
    power = 1 / (3 if setup.model.space == "3d" else 2)
    return [sizes[anchor] * (elements[anchor] / n) ** power for n in elements]
