"""Formal order of the force: what an element can promise where the solution is singular.

The force of a test driven by a displacement is a derivative of the energy, whose error is
the square of the error of the gradient: order 2 k for an element of degree k, if the
solution is smooth. A corner where the displacement goes as s^lambda allows 2 lambda only,
whatever the element (Babuska and Szabo 1982, Int. J. Numer. Meth. Eng. 18, 323).

Where a plate has moved by more than a part of an element, the free side beside it has folded onto
it on the finest meshes: the material fills a half-plane there, bonded on one side of the rim as
under a flat punch, and lambda is 1/2. With the exponent of the right angle the bounds of linear
elements on bonded Ogden and Mooney-Rivlin bodies (compressed by 10 to 25 %) fell short of errors.

The sharp edge of a flat punch has lambda = 1/2, bonded or not: the contact pressure goes as
s^(-1/2) with the distance s to the edge (Sneddon 1965, Int. J. Eng. Sci. 3, 47; Johnson 1985,
Contact Mechanics, chapters 2 and 3: bonded it oscillates besides, unless nu = 1/2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from study.mechanics.setup.geometry import Cylinder, Enclosed
from study.mechanics.setup.setup import Problem
from study.mechanics.setup.test_kind import Singularity

_DEGREE = {"linear": 1, "quadratic": 2}

#: elements along the radius of a rounded edge from which on it is not sharp to a mesh
_ACROSS_EDGE = 2.0

#: depth over the coarsest element at a sharp edge or a bonded corner from which on its strains are
#: large on the finest one; at an edge equilibria are not unique then, at a corner the side folds
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
    # of two equal limits the first counts: the problem's says more
    limits = [_limit(problem, singularity) for singularity in singularities]
    if problem.model.space == "3d" and isinstance(problem.specimen, Cylinder):
        limits.append((2.0, "the cylinder's straight-sided elements"))
    if isinstance(problem.specimen, Enclosed):
        limits.append((2.0, "straight-sided elements, and edges of the surface that are corners"))
    limits.append((smooth, f"{degree} elements: twice the order of their gradient"))
    order, why = min(limits, key=lambda item: item[0])
    return FormalOrder(order, why)


def _limit(problem: Problem, singularity: Singularity) -> tuple[float, str]:
    """Limit that a singularity sets, and why."""
    if singularity.kind == "clamped corner":
        K, mu = problem.material.bulk, problem.material.mu0
        exponent = clamped_corner(0.5 if math.isinf(K) else (3 * K - 2 * mu) / (2 * (3 * K + mu)))
        if exponent < 1 and _is_deep(problem):
            return 1.0, (
                f"the corner between a bonded and a free face: at {problem.test.depth_mm:.3g} mm "
                "the side folds onto the plate, and the rim is that of a bonded flat punch"
            )
        return 2 * exponent, (
            f"the corner between a bonded and a free face: the displacement goes as "
            f"s^{exponent:.3f} there"
        )
    if singularity.kind == "rim":
        return 2.0, _RIM
    if singularity.name:
        return 1.0, _sharp(problem, singularity.name)
    edge, size = singularity.rounding_mm, element_size_mm(problem)
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
    orders = " and ".join(f"{2 * degree} of {name}" for name, degree in _DEGREE.items())
    why = (
        f"the {edge} of the flat punch, where the contact pressure is singular as an "
        "inverse square root of the distance: energy and force converge with the mesh size, "
        "whatever the element, so an observed order near 1 is right here (the orders "
        f"{orders} elements need a smooth solution)"
    )
    if _is_deep(problem):
        why += (
            f"; at a depth of {problem.test.depth_mm:.3g} mm, beside elements of "
            f"{element_size_mm(problem):.3g} mm and less, large strains and sliding at the edge "
            "may hide the order: a smaller depth shows it"
        )
    return why


def _is_deep(problem: Problem) -> bool:
    """Whether strains at an edge or a corner are large on the finer meshes of a series."""
    small = problem.material.small_strain
    return not small and problem.test.depth_mm > _DEEP * element_size_mm(problem)


def element_size_mm(problem: Problem) -> float:
    """Element size of a problem, at the edge of a punch where it has one."""
    from study.mechanics.mesh.mesher import mesh_size

    return float(mesh_size(problem.setup))


def clamped_corner(nu: float) -> float:
    """Exponent where a bonded meets a free face (Williams 1952, J. Appl. Mech. 19, 526)."""
    from scipy.optimize import brentq

    def mismatch(s: float) -> float:
        return (3 - 4 * nu) * math.sin(math.pi * s / 2) ** 2 - 4 * (1 - nu) ** 2 + s * s

    return float(brentq(mismatch, 0.3, 1.0)) if mismatch(1.0) > 0 else 1.0
