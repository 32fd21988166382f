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

from study.forward.glue import TiedPoints
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
    targets = _targets(system, state, assembly, wanted)
    x, carried = linear_rates(system, assembly, start, right, targets)
    along = x[:, 0]
    curvature = along @ system.tangent_product(along, contact=False)
    for points, touch in zip(system.contact, assembly.contact, strict=True):
        curvature += points.rotation_stiffness(touch, along[points.dofs(system.space.dim)])
    gradient = {
        name: system.force_scale
        * (_owed_to_ties(system, targets, carried, column) - float(right[:, column] @ along))
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


def _targets(
    system: System, state: State, assembly: Assembly, wanted: tuple[str, ...]
) -> list[Array]:
    """Rate of n . x that keeps active contact closed.

    The loading moves the surface; constants move the places where ties hold their points.
    """
    targets = []
    for points, touch in zip(system.contact, assembly.contact, strict=True):
        target = np.zeros((points.size, 1 + len(wanted)))
        target[:, 0] = -touch.normal()[:, -1] * points.surface.speed
        if state.glue is not None and isinstance(points, TiedPoints):
            for column, name in enumerate(wanted, start=1):
                target[:, column] = state.glue.rate(name)[:, points.surface.axis]
        targets.append(target)
    return targets


def _owed_to_ties(system: System, targets: list[Array], carried: list[Array], column: int) -> float:
    """Force that a constant owes to the places where ties hold: sum of w dp/dd d(place)."""
    return sum(
        float(points.weights @ (pressure[:, 0] * target[:, column]))
        for points, target, pressure in zip(system.contact, targets, carried, strict=True)
        if isinstance(points, TiedPoints)
    )


def linear_rates(
    system: System, assembly: Assembly, start: Array, right: Array, targets: list[Array]
) -> tuple[Array, list[Array]]:
    """Solve K v = right with v prescribed as in ``start`` and n . v = target on active contact.

    The factorization is that of a late Newton iterate; corrections with the tangent of the
    converged state remove the difference, and an augmented-Lagrange update that of the
    contact springs. All right-hand sides, shape (n, k), share each back-substitution. The
    tangent itself is factorized only where contact has changed since, or where corrections
    cost more.

    Returns
    -------
    v : ndarray, shape (n, k)
        Rates of the unknowns.
    carried : list of ndarray, shape (n_points, k)
        Rates of the contact pressures.
    """
    free, v = system.pattern.free, start.copy()
    carried = [np.zeros_like(target) for target in targets]
    older = system.factors_serve()
    if not older:
        system.factorize()
    scale, sizes = np.zeros(right.shape[1]), list[Array]()
    for _ in range(_CORRECTIONS):
        residual = right + _imbalance(system, assembly, v, targets, carried)
        size = np.linalg.norm(residual[free], axis=0)
        scale = np.maximum(scale, size)
        if (size <= _TOLERANCE * scale).all():
            break
        sizes.append(size / np.where(scale > 0, scale, 1.0))
        if older and _cost_ahead(sizes) > system.solver.worth():
            system.factorize()
            older = False
        v[free] += system.back_substitute(residual[free])
        for points, touch, target, extra in zip(
            system.contact, assembly.contact, targets, carried, strict=True
        ):
            moved = np.einsum("cd,cdk->ck", touch.direction, v[points.dofs(system.space.dim)])
            extra += np.where(touch.active[:, None], points.eps * (target - moved), 0.0)
    return v, carried


def _imbalance(
    system: System, assembly: Assembly, v: Array, targets: list[Array], carried: list[Array]
) -> Array:
    """Return what the rates ``v`` leave of -K v and of the targets, shape (n, k)."""
    left = -np.column_stack([system.tangent_product(column) for column in v.T])
    for points, touch, target, extra in zip(
        system.contact, assembly.contact, targets, carried, strict=True
    ):
        push = np.where(touch.active[:, None], points.eps * target + extra, 0.0)
        forces = (points.weights[:, None] * push)[:, None, :] * touch.direction[:, :, None]
        dofs = points.dofs(system.space.dim)
        np.add.at(left, dofs.ravel(), forces.reshape(dofs.size, -1))
    return left


def _cost_ahead(sizes: list[Array]) -> float:
    """Back-substitutions that the corrections still cost at the rate of the last one."""
    if len(sizes) < 2:
        return 0.0
    left = np.maximum(sizes[-1], 1e-300)
    rate = np.minimum(left / np.maximum(sizes[-2], 1e-300), 1.0 - 1e-9)
    many = np.log(np.minimum(_TOLERANCE / left, 1.0)) / np.log(rate)
    return float(left.size * many.max())
