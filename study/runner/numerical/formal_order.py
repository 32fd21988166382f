"""Formal order of the force: what an element can promise where the solution is singular.

The force of a test driven by a displacement is a derivative of the energy, whose error is
the square of the error of the gradient: order 2 k for an element of degree k, if the
solution is smooth. A corner where the displacement goes as s^lambda allows 2 lambda only,
whatever the element (Babuska and Szabo 1982, Int. J. Numer. Meth. Eng. 18, 323).

The sharp edge of a flat punch has lambda = 1/2, bonded or not: the contact pressure goes as
s^(-1/2) with the distance s to the edge (Sneddon 1965, Int. J. Eng. Sci. 3, 47; Johnson 1985,
Contact Mechanics, chapters 2 and 3: bonded it oscillates besides, unless nu = 1/2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from study.material.material import Material
from study.runner.tables import with_placeholder
from study.setup.geometry import Cylinder, Enclosed, Flat
from study.setup.setup import Problem, Setup
from study.setup.test_kind import ClampedCorner, RoundedEdge, SharpEdge, Singularity

if TYPE_CHECKING:
    from study.runner.job import CaseJob

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

    order: float
    why: str


def formal_order(problem: Problem) -> FormalOrder:
    """Order that the element promises for the force of a problem; work and RMS share it.

    Parameters
    ----------
    problem : Problem
        Its element size decides whether the mesh resolves a rounded edge.
    """
    smooth = 2.0 * _DEGREE[problem.model.element_order]
    degree = problem.model.element_order
    limits = _limits(problem)  # first: of two equal limits the problem's says more
    limits.append((smooth, f"{degree} elements: twice the order of their gradient"))
    order, why = min(limits, key=lambda item: item[0])
    return FormalOrder(order, why)


def formal_of_case(job: CaseJob) -> FormalOrder:
    """Formal order of a case whose constants are not known yet.

    Parameters
    ----------
    job : CaseJob
        Where its tables give no displacement, the largest measured one counts, or 1 mm without
        directions.
    """
    return formal_order(_in_mind(job))


def _limits(problem: Problem) -> list[tuple[float, str]]:
    singularities = problem.setup.kind.singularities(problem.test)
    found = [_limit(problem, singularity) for singularity in singularities]
    if problem.model.space == "3d" and isinstance(problem.specimen, Cylinder):
        found.append((2.0, "the cylinder's straight-sided elements"))
    if isinstance(problem.specimen, Enclosed):
        found.append((2.0, "straight-sided elements, and edges of the surface that are corners"))
    return found


def _limit(problem: Problem, singularity: Singularity) -> tuple[float, str]:
    """Limit that a singularity sets, and why."""
    if isinstance(singularity, ClampedCorner):
        exponent = clamped_corner(poisson_ratio(problem.material))
        return 2 * exponent, (
            f"the corner between a bonded and a free face: the displacement goes as "
            f"s^{exponent:.3f} there"
        )
    if isinstance(singularity, SharpEdge):
        return 1.0, _sharp(problem, singularity.name)
    if isinstance(singularity, RoundedEdge):
        return _rounded(singularity.radius_mm, _edge_size(problem))
    return 2.0, _RIM


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
    size = _edge_size(problem)
    large = not problem.material.small_strain
    if large and size is not None and depth > _DEEP * size:
        why += (
            f"; at a depth of {depth:.3g} mm, beside elements of {size:.3g} mm and less, large "
            "strains and sliding at the edge may hide the order: a smaller depth shows it"
        )
    return why


def _rounded(edge: float, size: float | None) -> tuple[float, str]:
    """Limit that a rounded edge sets, by whether elements of a size resolve it."""
    if size is not None and size > edge / _ACROSS_EDGE:
        return 1.0, (
            f"the edge of the flat punch, rounded with {edge:.3g} mm, which the coarsest mesh of "
            f"{size:.3g} mm does not resolve: it looks sharp, where the order is 1; meshes of "
            f"{edge / _ACROSS_EDGE:.3g} mm and less have order 2 at most"
        )
    return 2.0, (
        f"the rounded edge of the flat punch ({edge:.3g} mm), which the meshes resolve: the "
        f"pressure is finite, and what counts is {_RIM}"
    )


def _edge_size(problem: Problem) -> float:
    """Element size at the edge of a punch."""
    from study.fem.mesh.mesher import mesh_size

    return float(mesh_size(problem.setup))


def edge_rules(setup: Setup) -> bool:
    """Whether all error comes from a sharp edge around which every mesh looks the same.

    The size at the edge is the size of the mesh then: how many elements lie elsewhere says
    nothing of it.

    Parameters
    ----------
    setup : Setup
        Only a flat punch without an edge radius, in axisymmetric space, has such an edge.
    """
    pressed = setup.test.indenter
    sharp = isinstance(pressed, Flat) and not pressed.edge_radius_mm
    return sharp and setup.model.space == "axisymmetric"


def clamped_corner(nu: float) -> float:
    """Exponent lambda of the displacement at a right angle between a bonded and a free face.

    Root of ``(3 - 4 nu) sin^2(pi lambda / 2) = 4 (1 - nu)^2 - lambda^2`` (Williams 1952,
    J. Appl. Mech. 19, 526).

    Parameters
    ----------
    nu : float
        Poisson's ratio, 0 to 0.5; at 0 the corner is not singular and lambda is 1.

    Examples
    --------
    >>> round(clamped_corner(0.3), 4), round(clamped_corner(0.5), 4)
    (0.7112, 0.5946)
    """
    from scipy.optimize import brentq

    def mismatch(s: float) -> float:
        return (3 - 4 * nu) * math.sin(math.pi * s / 2) ** 2 - 4 * (1 - nu) ** 2 + s * s

    return float(brentq(mismatch, 0.3, 1.0)) if mismatch(1.0) > 0 else 1.0


def poisson_ratio(material: Material) -> float:
    """Give the initial Poisson's ratio of a material.

    Parameters
    ----------
    material : Material
        With its constants; 0.5 where its bulk modulus is infinite.
    """
    K, mu = material.bulk, material.mu0
    return 0.5 if math.isinf(K) else (3 * K - 2 * mu) / (2 * (3 * K + mu))


def base_size_mm(job: CaseJob) -> float:
    """Element size of a case, named or given, in mm.

    Parameters
    ----------
    job : CaseJob
        Where its tables give no displacement, the largest measured one counts, or 1 mm without
        directions; the file of a surface is read.
    """
    from study.fem.mesh.mesher import mesh_size

    return float(mesh_size(_in_mind(job).setup))


def _in_mind(job: CaseJob) -> Problem:
    """Problem of a case whose constants are not known yet."""
    return with_placeholder(job.case.config, job.depth_mm if job.directions else 1.0)
