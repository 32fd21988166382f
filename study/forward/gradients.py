"""Exact derivatives of the force from the factorization that Newton leaves behind.

With ``v = dx/dd`` along the loading, the force is ``F = v . R_int``, its tangent
``dF/dd = v . K v`` and, for any constant, ``dF/dtheta = v . dR/dtheta`` (the adjoint of
Michaleris, Tortorelli and Vidal 1994, whose adjoint solve is the tangent solve here).
One vector serves all of them, whatever the number of constants.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from study.forward.system import Assembly, State, System

Array = NDArray[np.float64]

#: linear solves end here: relative residual, and how many corrections are tried
_TOLERANCE, _CORRECTIONS = 1e-11, 12


@dataclass(frozen=True)
class Rate:
    """Derivative of a converged state: unknowns and contact pressures."""

    x: Array
    multipliers: tuple[Array, ...]


@dataclass(frozen=True)
class StepGradients:
    """Force of one converged step and its derivatives (whole specimen, N and mm)."""

    force_N: float
    stiffness_N_per_mm: float
    force_gradient: dict[str, float]
    along: Rate
    constants: dict[str, Rate]


def step_gradients(
    system: System, state: State, assembly: Assembly, *, wanted: tuple[str, ...]
) -> StepGradients:
    """Force, tangent stiffness and derivatives at a converged state just assembled."""
    velocity = np.zeros(system.space.n)
    velocity[system.constraints.dofs] = system.constraints.rate
    stiff = 1.0
    targets = tuple(
        -stiff
        * touch.direction.reshape(points.size, -1, system.space.dim)[:, :, -1].sum(axis=1)
        * points.surface.speed
        for points, touch in zip(system.contact, assembly.contact, strict=True)
    )
    along = linear_rate(system, assembly, velocity, np.zeros(system.space.n), targets)
    force = system.force_scale * float(assembly.internal @ along.x)
    curvature = along.x @ system.tangent_product(along.x, contact=False)
    still = tuple(np.zeros(points.size) for points in system.contact)
    gradient, rates = {}, {}
    # dR/dtheta reuses the element arrays for residuals only: the tangent stays valid
    for name in wanted:
        slope = system.constant_derivative(state, name)
        gradient[name] = system.force_scale * float(slope @ along.x)
        rates[name] = linear_rate(system, assembly, np.zeros(system.space.n), -slope, still)
    return StepGradients(force, system.force_scale * float(curvature), gradient, along, rates)


def linear_rate(
    system: System, assembly: Assembly, start: Array, right: Array, targets: tuple[Array, ...]
) -> Rate:
    """Solve K v = right with v prescribed as in ``start`` and n . v = target on active contact.

    The factorization is that of the last Newton iterate; corrections with the tangent of
    the converged state remove the difference, and an augmented-Lagrange update that of the
    contact springs.
    """
    free, v = system.pattern.free, start.copy()
    carried = [np.zeros(points.size) for points in system.contact]
    scale, refactored = 0.0, False
    for correction in range(_CORRECTIONS):
        residual = right - system.tangent_product(v)
        for points, touch, target, extra in zip(
            system.contact, assembly.contact, targets, carried, strict=True
        ):
            push = points.weights * np.where(touch.active, points.eps * target + extra, 0.0)
            dofs = points.dofs(system.space.dim)
            np.add.at(residual, dofs.ravel(), (push[:, None] * touch.direction).ravel())
        size = float(np.linalg.norm(residual[free]))
        scale = max(scale, size)
        if size <= _TOLERANCE * scale:
            break
        if correction == _CORRECTIONS // 2 and not refactored:
            system.factorize()
            refactored = True
        v[free] += system.back_substitute(residual[free])
        for points, touch, target, extra in zip(
            system.contact, assembly.contact, targets, carried, strict=True
        ):
            moved = np.einsum("ck,ck->c", touch.direction, v[points.dofs(system.space.dim)])
            extra += np.where(touch.active, points.eps * (target - moved), 0.0)
    return Rate(v, tuple(carried))
