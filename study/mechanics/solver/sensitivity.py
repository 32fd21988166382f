"""How a converged state moves with the loading and with every constant: one linear solve.

Rates ``v`` of the unknowns and ``c`` of the contact pressures satisfy ``K v - N' W c = right``
at the free unknowns and ``N v = target`` at the closed contact points, where K holds none of
the springs by which Newton's method regularizes contact.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from study.ground.arrays import Array
from study.mechanics.contact.contact import TiedPoints
from study.mechanics.material.material import Material, is_dimensionless
from study.mechanics.solver.equilibrium import RandomLoad
from study.mechanics.solver.system import Assembly, State, System

#: corrections by one factorization; after as many the tangent itself is factorized in double
#: precision, and has as many
_CORRECTIONS = 12

#: energy of the error of the loading's rates over theirs, which is the relative error of dF/dd: of
#: a column of a thousand elements along its axis, a small residual allows an error of its size
_ENERGY_TOLERANCE = 1e-7

#: and how many before single precision is held to be too dull
_DULL = 7


@dataclass(frozen=True)
class Loads:
    """What moves a state, a column for each cause."""

    #: shape (n, k); minus the derivative of the residual at fixed unknowns.
    right: Array
    #: shape (n, k); rates of the constrained unknowns; zero elsewhere.
    start: Array
    #: shape (n_points, k); rates of n . x at the points of each contact while they stay closed.
    targets: tuple[Array, ...]


@dataclass(frozen=True)
class ClosedPoints:
    """Closed points of one contact: what they are to do, and the pressures that see to it."""

    #: shape (m,); which of the contact's points they are.
    among: NDArray[np.int64]
    #: shape (m, d); unknowns of each point, and N.
    dofs: NDArray[np.int64]
    normals: Array
    #: shape (m,); areas and stiffness of the springs.
    weights: Array
    eps: Array
    #: shape (m, k); rates of n . x, and those of the pressures, overwritten as they are found.
    target: Array
    pressure: Array

    def missed(self, x: Array) -> Array:
        """Rates that n . x lacks where the unknowns move with ``x``, shape (m, k)."""
        return np.asarray(self.target - np.einsum("cd,cdk->ck", self.normals, x[self.dofs]))

    def carried(self, x: Array) -> Array:
        """Rates of the pressures, those that the springs carry included, shape (m, k)."""
        return np.asarray(self.pressure + self.eps * self.missed(x))

    def push(self, left: Array, pressure: Array) -> None:
        """Add N' W pressure to ``left``, shape (n, k)."""
        forces = (self.weights[:, None] * pressure)[:, None, :] * self.normals[:, :, None]
        np.add.at(left, self.dofs.ravel(), forces.reshape(self.dofs.size, left.shape[1]))

    def force(self, pressure: Array) -> Array:
        """Norm of the forces that rates of the pressures make, one a column, shape (k,)."""
        lengths = np.linalg.norm(self.normals, axis=1) * self.weights
        return np.asarray(np.linalg.norm(lengths[:, None] * pressure, axis=0))


@dataclass(frozen=True)
class Rates:
    """Rates, and what they leave of their equations."""

    #: shape (n, k); of the unknowns.
    x: Array
    #: shape (n, k); ``right - K x + N' W c`` at the free unknowns, zero elsewhere.
    left: Array
    #: With the rates ``c`` of their pressures.
    contact: tuple[ClosedPoints, ...]
    #: Largest residual over the allowed residual: at most 1 where all converged.
    excess: float


def linear_rates(
    system: System,
    assembly: Assembly,
    loads: Loads,
    tolerance: float,
    random_load: RandomLoad | None = None,
) -> Rates:
    """Solve for all rates together.

    The factorization is that of a late Newton iterate; corrections with the tangent of the
    converged state remove the difference, and an augmented-Lagrange update that of the
    contact springs. The tangent itself is factorized only where contact has changed since, or
    where corrections cost more. A random load is corrected beside them for little more.
    """
    free, x = system.pattern.free, loads.start.copy()
    closed = _closed_points(system, assembly, loads.targets)
    older = system.factors.serves(system.latest.touching)
    springs = any(each.among.size for each in closed)
    if not older:
        system.factorize()
    loaded, sizes, most = np.zeros(x.shape[1]), list[Array](), _CORRECTIONS
    energies = [0.0, 0.0]  # of each correction of the loading's rates, N/mm
    for corrections in itertools.count():
        product = np.column_stack([system.tangent_product(column) for column in x.T])
        left = loads.right - product
        if corrections == 0:
            loaded = np.linalg.norm(left[free], axis=0)
        for each in closed:
            each.push(left, each.eps * each.target + each.pressure)
        size = np.linalg.norm(left[free], axis=0)
        forces = [loaded, *(each.force(each.carried(x)) for each in closed)]
        allowed = tolerance * np.max(forces, axis=0)
        is_small = bool((size <= allowed).all())
        # the next correction's energy by the last two; the first one has that of the lift, which
        # is far more than the energy of the rates where a column is long
        energy = abs(float(x[:, 0] @ product[:, 0]))
        is_settled = energies[-1] ** 2 <= _ENERGY_TOLERANCE * energy * min(energies[-2], energy)
        if (is_small and is_settled) or corrections == 2 * _CORRECTIONS:
            break
        sizes.append(size)
        if corrections == _CORRECTIONS:
            system.factorize(exact=True)
            older, most = False, 2 * _CORRECTIONS
        elif older and _cost_ahead(sizes, allowed, springs) > system.solver.worth():
            system.factorize()
            older = False
        elif corrections >= _DULL and not system.solver.exact:
            left_to_try = (most - corrections) * x.shape[1]
            if is_small or _cost_ahead(sizes, allowed, springs) > left_to_try:
                system.factorize(exact=True)
                older = False
        solved = system.back_substitute if random_load is None else random_load.solved_beside
        correction = solved(left[free], refined=False)
        energies.append(abs(float(left[free, 0] @ correction[:, 0])))
        x[free] += correction
        for each in closed:
            each.pressure[:] = each.carried(x)
    for each in closed:
        each.push(left, -each.eps * each.missed(x))  # the springs hold nothing any more
    left[system.constraints.dofs] = 0.0
    return Rates(x, left, closed, float(np.max(size / np.maximum(allowed, 1e-300))))


def _closed_points(
    system: System, assembly: Assembly, targets: tuple[Array, ...]
) -> tuple[ClosedPoints, ...]:
    blocks = []
    for points, touch, target in zip(system.contact, assembly.contact, targets, strict=True):
        at = np.flatnonzero(touch.active)
        dofs, normals = points.dofs(system.space.dim)[at], touch.direction[at]
        weights, eps = points.weights[at], points.eps[at, None]
        gaps, pressure = target[at], np.zeros((at.size, target.shape[1]))
        blocks.append(ClosedPoints(at, dofs, normals, weights, eps, gaps, pressure))
    return tuple(blocks)


def _cost_ahead(sizes: list[Array], allowed: Array, springs: bool) -> float:
    """Back-substitutions that the corrections still cost at their speed so far.

    ``sizes`` are residuals, ``allowed`` what they are to fall to, one a column.

    With springs two corrections make one: the first loads them, the second hands their load
    over to the pressures. Of the very first one only the loading's column tells anything, as
    its motion is in the springs from the start.
    """
    if len(sizes) < 2:
        return 0.0
    each, columns = (2, slice(0, 1)) if springs else (1, slice(None))
    before, left, to = sizes[0][columns], sizes[1][columns], allowed[columns]
    if len(sizes) > 2:
        each, before, left, to = 2, sizes[-3], sizes[-1], allowed
    left = np.maximum(left, 1e-300)
    rate = np.minimum(left / np.maximum(before, 1e-300), 1.0 - 1e-9)
    share = np.clip(to / left, 1e-300, 1.0)
    many = each * np.log(share) / np.log(rate)
    return float(sizes[0].size * many.max())


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
    #: Work of the whole motion per displacement, and its derivative: the force and its stiffness,
    #: but of a plate that also moves sideways.
    work_N: float
    work_slope_N_per_mm: float
    #: Residual of the derivatives over the allowed residual: at most 1 where they converged.
    excess: float


def step_gradients(
    system: System,
    state: State,
    assembly: Assembly,
    *,
    parameters: tuple[str, ...],
    random_load: RandomLoad | None = None,
) -> StepGradients:
    """Force, tangent stiffness and derivatives at a converged state just assembled."""
    scales = system.weight is None and not system.sticks
    free = _free(system.material, parameters) if scales else None
    solved = tuple(name for name in parameters if name != free)
    loads = _loads(system, state, assembly, solved)
    tolerance = INHERITED_RATE_TOLERANCE if system.sticks else RATE_TOLERANCE
    rates = linear_rates(system, assembly, loads, tolerance, random_load)
    scale = system.force_scale
    axial = 0 if system.constraints.axial is None else loads.start.shape[1] - 1

    def reaction(t: int) -> tuple[float, float]:
        return scale * _force(assembly, rates, t), scale * _stiffness(system, assembly, rates, t)

    work = reaction(0)
    force = reaction(axial) if axial else work
    slopes = {n: scale * _slope(rates, loads, j, axial) for j, n in enumerate(solved, start=1)}
    by = {n: _rate(system, rates, j) for j, n in enumerate(solved, start=1)}
    if free is not None:
        slopes[free], by[free] = _by_euler(system, state, assembly, free, force[0], slopes, by)
    return StepGradients(*force, slopes, by, *work, rates.excess)


def _free(material: Material, parameters: tuple[str, ...]) -> str | None:
    """Constant whose derivatives follow from those of the others, because all stresses scale."""
    moduli = [name for name in material.names if not is_dimensionless(name)]
    scales = material.bulk_modulus is None and not material.relaxation
    if not (scales and moduli and set(moduli) <= set(parameters)):
        return None
    return max(moduli, key=lambda name: abs(material.constants[name]))


def _by_euler(
    system: System,
    state: State,
    assembly: Assembly,
    free: str,
    force_N: float,  # noqa: N803
    slopes: dict[str, float],
    by: dict[str, Rate],
) -> tuple[float, Rate]:
    """Return the derivatives by one modulus: with all of them pressures grow and nothing moves."""
    moduli = {n: c for n, c in system.material.constants.items() if not is_dimensionless(n)}
    size = moduli.pop(free)
    x = state.x.copy()
    x[: system.space.n_displacement] = 0.0
    pressures = [touch.pressure * touch.active for touch in assembly.contact]
    for name, modulus in moduli.items():
        force_N -= modulus * slopes[name]
        x -= modulus * by[name].x
        pairs = zip(pressures, by[name].multipliers, strict=True)
        pressures = [pressure - modulus * rate for pressure, rate in pairs]
    return force_N / size, Rate(x / size, tuple(pressure / size for pressure in pressures))


def _loads(system: System, state: State, assembly: Assembly, parameters: tuple[str, ...]) -> Loads:
    """Put the loading in column 0, then the constants, then the motion along the axis alone."""
    straight = system.constraints.axial
    n, k = system.space.n, 1 + len(parameters) + (straight is not None)
    start, right = np.zeros((n, k)), np.zeros((n, k))
    start[system.constraints.dofs, 0] = system.constraints.rate
    if straight is not None:
        start[system.constraints.dofs, -1] = straight
    # dR/dtheta reuses the element arrays for residuals only: the tangent stays valid
    for column, name in enumerate(parameters, start=1):
        right[:, column] = -system.constant_derivative(state, name)
    targets = []  # the loading moves the surface; constants move where ties hold their points
    for points, touch in zip(system.contact, assembly.contact, strict=True):
        # -dR/dd at fixed unknowns: contact normals turn while a curved surface moves past
        dofs = points.dofs(system.space.dim)
        np.add.at(right[:, 0], dofs.ravel(), -points.rotation_forces(touch).ravel())
        target = np.zeros((points.size, k))
        target[:, 0] = -touch.normal()[:, -1] * points.surface.speed
        if straight is not None:
            target[:, -1] = target[:, 0]
        if state.glue is not None and isinstance(points, TiedPoints):
            for column, name in enumerate(parameters, start=1):
                target[:, column] = state.glue.rate(name)[:, points.surface.axis]
        targets.append(target)
    return Loads(right, start, tuple(targets))


def _force(assembly: Assembly, rates: Rates, t: int) -> float:
    """Work of the internal forces along column ``t``, with the closed points where they belong."""
    force = float(assembly.internal @ rates.x[:, t])
    for each, touch in zip(rates.contact, assembly.contact, strict=True):
        pressure = touch.pressure[each.among]
        force += float((each.weights * pressure) @ each.missed(rates.x)[:, t])
    return force


def _stiffness(system: System, assembly: Assembly, rates: Rates, t: int) -> float:
    """dF/dd as a value of the Lagrangian of the rates, which is stationary in them.

    ``t`` is the column of the motion whose force it is; another than the loading's turns no
    normal, since only planes have one.
    """
    along, virtual = rates.x[:, 0], rates.x[:, t]
    curvature = float(virtual @ system.tangent_product(along, contact=False))
    for points, touch, each in zip(system.contact, assembly.contact, rates.contact, strict=True):
        curvature += points.rotation_stiffness(touch, along[points.dofs(system.space.dim)])
        missed = each.missed(rates.x)
        curvature += float((each.weights * each.pressure[:, t]) @ missed[:, 0])
        curvature += float((each.weights * each.pressure[:, 0]) @ missed[:, t])
    return curvature


def _slope(rates: Rates, loads: Loads, j: int, t: int) -> float:
    """dF/dtheta of the constant in column ``j``, less the first-order error of the rates."""
    slope = -float(loads.right[:, j] @ rates.x[:, t]) - float(rates.x[:, j] @ rates.left[:, t])
    for each in rates.contact:
        # what a constant owes to the places where ties hold, and what the loading missed
        owed = each.pressure[:, t] * each.target[:, j]
        owed += each.pressure[:, j] * each.missed(rates.x)[:, t]
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
