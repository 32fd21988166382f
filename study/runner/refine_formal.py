"""Formal order of the force: what an element can promise where the solution is singular.

The force of a test driven by a displacement is a derivative of the energy, whose error is
the square of the error of the gradient: order 2 k for an element of degree k, if the
solution is smooth. A corner where the displacement goes as s^lambda allows 2 lambda only,
whatever the element (Babuska and Szabo 1982, Int. J. Numer. Meth. Eng. 18, 323).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from study.forward.problem import Cylinder, Flat, Problem
from study.material import Material
from study.runner import build

if TYPE_CHECKING:
    from study.runner.expand import CaseJob

_DEGREE = {"linear": 1, "quadratic": 2}


@dataclass(frozen=True)
class FormalOrder:
    """Order of the force in the mesh size, and what limits it."""

    order: float
    why: str


def formal_order(problem: Problem) -> FormalOrder:
    """Order that the element promises for the force of a problem; work and RMS share it."""
    smooth = 2.0 * _DEGREE[problem.model.element_order]
    degree = problem.model.element_order
    limits = [(smooth, f"{degree} elements: twice the order of their gradient")]
    limits += _limits(problem)
    order, why = min(limits, key=lambda item: item[0])
    return FormalOrder(order, why)


def formal_of_case(job: CaseJob) -> FormalOrder:
    """Formal order of a case whose constants are not known yet."""
    config = job.case.config
    section = {**config["material"], "model": "neo-hookean", "order": None}
    depth = max((float(d.measured.displacement_mm.max()) for d in job.directions), default=1.0)
    return formal_order(build.problem({**config, "material": section}, {"C10": 1.0}, depth))


def _limits(problem: Problem) -> list[tuple[float, str]]:
    test, found = problem.test, []
    if test.kind == "indentation":
        if isinstance(test.indenter, Flat) and test.indenter.edge_radius_mm == 0:
            why = (
                "the sharp edge of a flat punch: the stress goes as s^(-1/2) there, so the force "
                "is of first order whatever the element"
            )
            found.append((1.0, why))
        else:
            why = (
                "the rim of the contact, which a mesh places to within an element; the force is "
                "stationary in it"
            )
            found.append((2.0, why))
    elif "bonded" in (test.interface, test.base):
        exponent = clamped_corner(poisson_ratio(problem.material))
        why = (
            f"the corner between a bonded and a free face: the displacement goes as "
            f"s^{exponent:.3f} there"
        )
        found.append((2 * exponent, why))
    if problem.model.space == "3d" and isinstance(problem.specimen, Cylinder):
        found.append((2.0, "the cylinder's straight-sided elements"))
    return found


def clamped_corner(nu: float) -> float:
    """Exponent lambda of the displacement at a right angle between a bonded and a free face.

    Root of ``(3 - 4 nu) sin^2(pi lambda / 2) = 4 (1 - nu)^2 - lambda^2`` (Williams 1952,
    J. Appl. Mech. 19, 526).

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
    """Give the initial Poisson's ratio of a material."""
    K, mu = material.bulk, material.mu0
    return 0.5 if math.isinf(K) else (3 * K - 2 * mu) / (2 * (3 * K + mu))
