"""Exact derivatives of the force from the factorization that Newton leaves behind.

With ``v = dx/dd`` along the loading, the force is ``F = v . R_int``, its tangent
``dF/dd = v . K v`` and, for any constant, ``dF/dtheta = v . dR/dtheta`` (the adjoint of
Michaleris, Tortorelli and Vidal 1994, whose adjoint solve is the tangent solve here).
One vector serves all of them, whatever the number of constants.

Linear solves need not go far: what an approximate ``v`` leaves of its equations, weighted by
the equally approximate ``dx/dtheta``, is the first-order error of ``dF/dtheta`` (Pierce and
Giles 2000, SIAM Review 42, 247). With that taken off, and with the Lagrangian in place of
the energy for dF/dd, errors are products of two small ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from study.forward.glue import TiedPoints
from study.forward.rates import Loads, Rates, linear_rates
from study.forward.system import Assembly, State, System

Array = NDArray[np.float64]

#: Relative residual of the rates, of which dF/dd and dF/dtheta keep the square. It is the same
#: whatever is asked for: a curve has one slope.
RATE_TOLERANCE = 1e-4
#: The same where a bonded indenter holds points: their places inherit the error itself.
INHERITED_RATE_TOLERANCE = 1e-8


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
    constants: dict[str, Rate]


def step_gradients(
    system: System, state: State, assembly: Assembly, *, wanted: tuple[str, ...]
) -> StepGradients:
    """Force, tangent stiffness and derivatives at a converged state just assembled."""
    loads = _loads(system, state, assembly, wanted)
    tolerance = INHERITED_RATE_TOLERANCE if system.sticks else RATE_TOLERANCE
    rates = linear_rates(system, assembly, loads, tolerance)
    scale = system.force_scale
    return StepGradients(
        scale * _force(assembly, rates),
        scale * _stiffness(system, assembly, rates),
        {n: scale * _slope(rates, loads, j) for j, n in enumerate(wanted, start=1)},
        {n: _rate(system, rates, j) for j, n in enumerate(wanted, start=1)},
    )


def _loads(system: System, state: State, assembly: Assembly, wanted: tuple[str, ...]) -> Loads:
    """Put the loading in column 0, then the constants."""
    n, k = system.space.n, 1 + len(wanted)
    start, right = np.zeros((n, k)), np.zeros((n, k))
    start[system.constraints.dofs, 0] = system.constraints.rate
    # dR/dtheta reuses the element arrays for residuals only: the tangent stays valid
    for column, name in enumerate(wanted, start=1):
        right[:, column] = -system.constant_derivative(state, name)
    right[:, 0] = _rotations(system, assembly)
    return Loads(right, start, _targets(system, state, assembly, wanted))


def _force(assembly: Assembly, rates: Rates) -> float:
    """Work of the internal forces along the loading, with the closed points where they belong."""
    force = float(assembly.internal @ rates.x[:, 0])
    for each, touch in zip(rates.contact, assembly.contact, strict=True):
        pressure = touch.pressure[each.among]
        force += float((each.weights * pressure) @ each.missed(rates.x)[:, 0])
    return force


def _stiffness(system: System, assembly: Assembly, rates: Rates) -> float:
    """dF/dd as a value of the Lagrangian of the rates, which is stationary in them."""
    along = rates.x[:, 0]
    curvature = float(along @ system.tangent_product(along, contact=False))
    for points, touch, each in zip(system.contact, assembly.contact, rates.contact, strict=True):
        curvature += points.rotation_stiffness(touch, along[points.dofs(system.space.dim)])
        missed = each.missed(rates.x)[:, 0]
        curvature += 2.0 * float((each.weights * each.pressure[:, 0]) @ missed)
    return curvature


def _slope(rates: Rates, loads: Loads, j: int) -> float:
    """dF/dtheta of the constant in column ``j``, less the first-order error of the rates."""
    slope = -float(loads.right[:, j] @ rates.x[:, 0]) - float(rates.x[:, j] @ rates.left[:, 0])
    for each in rates.contact:
        # what a constant owes to the places where ties hold, and what the loading missed
        owed = each.pressure[:, 0] * each.target[:, j]
        owed += each.pressure[:, j] * each.missed(rates.x)[:, 0]
        slope += float(each.weights @ owed)
    return slope


def _rate(system: System, rates: Rates, j: int) -> Rate:
    """Rates by one constant, those of the pressures at all contact points."""
    pressures = []
    for points, each in zip(system.contact, rates.contact, strict=True):
        everywhere = np.zeros(points.size)
        everywhere[each.among] = each.pressure[:, j]
        pressures.append(everywhere)
    return Rate(rates.x[:, j].copy(), tuple(pressures))


def _rotations(system: System, assembly: Assembly) -> Array:
    """-dR/dd at fixed unknowns: contact normals turn while a curved surface moves past."""
    out = np.zeros(system.space.n)
    for points, touch in zip(system.contact, assembly.contact, strict=True):
        dofs = points.dofs(system.space.dim)
        np.add.at(out, dofs.ravel(), -points.rotation_forces(touch).ravel())
    return out


def _targets(
    system: System, state: State, assembly: Assembly, wanted: tuple[str, ...]
) -> tuple[Array, ...]:
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
    return tuple(targets)
