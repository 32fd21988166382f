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
_TOLERANCE, _CORRECTIONS = 1e-10, 12


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
    n, k = system.space.n, 1 + len(wanted)
    start, right = np.zeros((n, k)), np.zeros((n, k))
    start[system.constraints.dofs, 0] = system.constraints.rate
    # dR/dtheta reuses the element arrays for residuals only: the tangent stays valid
    for column, name in enumerate(wanted, start=1):
        right[:, column] = -system.constant_derivative(state, name)
    right[:, 0] = _rotations(system, assembly)
    x, carried = linear_rates(system, assembly, start, right, _targets(system, assembly, k))
    along = x[:, 0]
    curvature = along @ system.tangent_product(along, contact=False)
    for points, touch in zip(system.contact, assembly.contact, strict=True):
        curvature += points.rotation_stiffness(touch, along[points.dofs(system.space.dim)])
    gradient = {
        name: -system.force_scale * float(right[:, column] @ along)
        for column, name in enumerate(wanted, start=1)
    }
    rates = [Rate(x[:, j].copy(), tuple(c[:, j].copy() for c in carried)) for j in range(k)]
    return StepGradients(
        system.force_scale * float(assembly.internal @ along),
        system.force_scale * float(curvature),
        gradient,
        rates[0],
        dict(zip(wanted, rates[1:], strict=True)),
    )


def _rotations(system: System, assembly: Assembly) -> Array:
    """-dR/dd at fixed unknowns: contact normals turn while a curved surface moves past."""
    out = np.zeros(system.space.n)
    for points, touch in zip(system.contact, assembly.contact, strict=True):
        dofs = points.dofs(system.space.dim)
        np.add.at(out, dofs.ravel(), -points.rotation_forces(touch).ravel())
    return out


def _targets(system: System, assembly: Assembly, k: int) -> list[Array]:
    """Rate of n . x that keeps active contact closed: only the loading moves the surface."""
    targets = []
    for points, touch in zip(system.contact, assembly.contact, strict=True):
        axial = touch.direction.reshape(points.size, -1, system.space.dim)[:, :, -1].sum(axis=1)
        target = np.zeros((points.size, k))
        target[:, 0] = -axial * points.surface.speed
        targets.append(target)
    return targets


def linear_rates(
    system: System, assembly: Assembly, start: Array, right: Array, targets: list[Array]
) -> tuple[Array, list[Array]]:
    """Solve K v = right with v prescribed as in ``start`` and n . v = target on active contact.

    The factorization is that of the last Newton iterate; corrections with the tangent of
    the converged state remove the difference, and an augmented-Lagrange update that of the
    contact springs. All right-hand sides, shape (n, k), share each back-substitution.

    Returns
    -------
    v : ndarray, shape (n, k)
        Rates of the unknowns.
    carried : list of ndarray, shape (n_points, k)
        Rates of the contact pressures.
    """
    free, v = system.pattern.free, start.copy()
    carried = [np.zeros_like(target) for target in targets]
    scale = np.zeros(right.shape[1])
    for correction in range(_CORRECTIONS):
        residual = right - np.column_stack([system.tangent_product(c) for c in v.T])
        for points, touch, target, extra in zip(
            system.contact, assembly.contact, targets, carried, strict=True
        ):
            push = np.where(touch.active[:, None], points.eps * target + extra, 0.0)
            forces = (points.weights[:, None] * push)[:, None, :] * touch.direction[:, :, None]
            dofs = points.dofs(system.space.dim)
            np.add.at(residual, dofs.ravel(), forces.reshape(dofs.size, -1))
        size = np.linalg.norm(residual[free], axis=0)
        scale = np.maximum(scale, size)
        if (size <= _TOLERANCE * scale).all():
            break
        if correction == _CORRECTIONS // 2:
            system.factorize()
        v[free] += system.back_substitute(residual[free])
        for points, touch, target, extra in zip(
            system.contact, assembly.contact, targets, carried, strict=True
        ):
            moved = np.einsum("cd,cdk->ck", touch.direction, v[points.dofs(system.space.dim)])
            extra += np.where(touch.active[:, None], points.eps * (target - moved), 0.0)
    return v, carried
