"""Compiled element loops: residual and tangent of the mixed (u, p) form, axisymmetric and 3D.

The weak form is the stationarity of

    W_iso(F) + p (J - 1) - p^2 / (2 K)

in the reference configuration (total Lagrangian), with the isochoric invariants of
Penn's split ``I1bar = J^(-2/3) I1`` and ``I2bar = J^(-4/3) I2``. ``1/K = 0`` is the
incompressible limit. With no pressure unknowns (``n_pressure == 0``) the pressure is
``K (J - 1)`` at each quadrature point: the plain displacement formulation; the mixed form
may leave a share of K there as well. For the
small-strain law W_iso is ``mu dev(eps):dev(eps)`` and J is ``1 + tr(eps)``.

The deformation gradient is stored as nine numbers ``f[3 i + j] = F_ij``; in axisymmetric
space the axes are (r, z, hoop) and only five of them are ever different from zero.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from study.ground.arrays import Array, Elements, Unknowns
from study.ground.compilation import kernel, part
from study.mechanics.element.element_forms import (
    add_compressibility,
    add_coupling,
    add_volume,
    along_nodes,
    deformation_gradient,
    gather,
    held_pressure,
    place_coupling,
)
from study.mechanics.element.element_stiffness import add_first_invariant_stiffness, add_stiffness
from study.mechanics.element.invariant_law import FINITE_EXTENSIBILITY, POLYNOMIAL, invariant_energy
from study.mechanics.element.point_law import (
    EXTENDED_TUBE,
    SMALL_STRAIN,
    WORK_ROWS,
    add_pressure_tangent,
    cofactor,
    full_tangent,
    invariants_beyond_rest,
    isochoric,
)


@part()
def scatter(positions: Unknowns, K: Array, data: Array) -> None:
    """Add a packed tangent to the entries of the sparsity pattern; some positions are negative.

    Shapes: positions, K, data (m (m + 1) / 2,).
    """
    for s in range(K.size):
        k = positions[s]
        if k >= 0:
            data[k] += K[s]


@kernel(nogil=True)
def volume_ratios(elements: Elements, space: Shapes, x: Array, J: Array) -> float:
    """J = det F at every quadrature point of some elements; returns the smallest.

    In axisymmetric space a hoop stretch that is not positive counts as ``J = -1``, since
    two negative stretches would otherwise multiply to a volume that looks sound.
    """
    gradients, hoop, dofs = space.gradients, space.hoop, space.dofs
    nq, na, dim = gradients.shape[1:]
    f, g, u = np.empty(9), np.empty(9), np.empty((na, dim))
    smallest = np.inf
    for e in elements:
        gather(x, dofs, e, u)
        for q in range(nq):
            deformation_gradient(gradients[e, q], hoop[e, q], u, f)
            value = cofactor(f, g)
            if not f[8] > 0.0 and dim == 2:
                value = -1.0
            J[e, q] = value
            if not value >= smallest:
                smallest = value
    return smallest


@kernel(nogil=True)
def assemble(
    elements: Elements,
    space: Shapes,
    energy: ElementEnergy,
    x: Array,
    R: Array,
    want_tangent: bool,
    sums: Sums,
) -> float:
    """Residuals of some elements, and the sum of their tangents. Shapes: x, R (n,), mm, MPa."""
    # names of their own: fields would be counted as references at every point
    gradients, hoop, pressure_shape, weights, dofs = space
    law, constants, bulk, compliance, kappa = energy
    positions, data, slots, kept_sums = sums
    nq, na, dim = gradients.shape[1:]
    n_p, nu, m = pressure_shape.shape[2], dim * na, dofs.shape[1]
    u, f, stress, ratios = np.empty((na, dim)), np.empty(9), np.empty(9), np.empty(nq)
    work, tangent, nodal = np.zeros((WORK_ROWS, 9)), np.zeros((9, 9)), np.empty((na, 12))
    rates, coupling, K = np.empty((3, nu)), np.empty((n_p, nu)), np.empty(m * (m + 1) // 2)
    along, shared, smallest = rates[0], pressure_shape.shape[0] == 1, np.inf
    curved, first_alone = law != SMALL_STRAIN, law >= POLYNOMIAL and constants.shape[1] == 1
    for e in elements:
        gather(x, dofs, e, u)
        R[e] = 0.0
        if want_tangent:
            coupling[:] = 0.0
            K[:] = 0.0
        for q in range(nq):
            dN, H, w = gradients[e, q], hoop[e, q], weights[e, q]
            N = pressure_shape[0 if shared else e, q]
            deformation_gradient(dN, H, u, f)
            J = isochoric(law, f, constants, work, stress)
            if curved and (not J > 0.0 or (dim == 2 and not f[8] > 0.0)):
                return -1.0
            ratios[q] = J
            smallest = min(smallest, J)
            g, growth = work[0], J if curved else 1.0
            held = held_pressure(N, x, dofs[e])
            pressure = held + bulk * (J - 1.0)
            for i in range(9):
                stress[i] += pressure * growth * g[i]
            along_nodes(dN, H, stress, w, R[e])
            add_volume(N, J - 1.0 - held * compliance, w, R[e])
            if want_tangent:
                bend, stiff = pressure * growth if curved else 0.0, bulk * growth * growth
                if first_alone:
                    add_first_invariant_stiffness(dN, H, f, bend, stiff, work, w, m, nodal, K)
                else:
                    full_tangent(law, f, constants, dim == 2, bend, stiff, work, tangent)
                    add_stiffness(dN, H, tangent, w, m, K)
                if n_p > 0:  # dJ/du times N, and the compliance of N
                    along[:] = 0.0
                    along_nodes(dN, H, g, 1.0, along)
                    add_coupling(along, w * growth, N, coupling)
                    add_compressibility(N, w, compliance, m, K)
        if kappa != 0.0:
            still = gradients[e], hoop[e], weights[e]
            add_unevenness(still, u, ratios, kappa, want_tangent, f, work, tangent, rates, R[e], K)
        if want_tangent:
            place_coupling(coupling, m, K)
            scatter(positions[e], K, data)
            if slots[e] >= 0:
                kept_sums[slots[e]] = K
    return smallest


@kernel()
def constrained_product(
    elements: Unknowns, dofs: Unknowns, positions: Unknowns, K: Array, v: Array, out: Array
) -> None:
    """Add to ``out`` what K v has of the entries outside the sparsity pattern.

    Shapes: elements (n_kept,); K (n_kept, m (m + 1) / 2); dofs, positions, v, out (n,).
    """
    m = dofs.shape[1]
    for k, e in enumerate(elements):
        s = 0
        for i in range(m):
            row = dofs[e, i]
            for j in range(i, m):
                if positions[e, s] < 0:
                    column = dofs[e, j]
                    out[row] += K[k, s] * v[column]
                    if i != j:
                        out[column] += K[k, s] * v[row]
                s += 1


@kernel()
def gathered(dofs: Unknowns, residuals: Array, out: Array) -> None:
    """Sum of element residuals, shape (n,). Shapes: dofs, residuals, out (n_elements, m)."""
    out[:] = 0.0
    for e in range(dofs.shape[0]):
        for i in range(dofs.shape[1]):
            out[dofs[e, i]] += residuals[e, i]


class Shapes(NamedTuple):
    """Elements before anything moves."""

    #: shape (n_elements, n_quadrature, n_nodes, dim); reference gradients of the displacement shape
    #: functions.
    gradients: Array
    #: shape (n_elements, n_quadrature, n_nodes); N / R (axisymmetric; anything with as many axes in
    #: 3D).
    hoop: Array
    #: shape (n_elements or 1, n_quadrature, n_pressure)
    pressure_shape: Array
    #: shape (n_elements, n_quadrature); quadrature weights times volume (2 pi R included in
    #: axisymmetric space).
    weights: Array
    #: shape (n_elements, m); unknowns of each element: displacements node by node, then pressures.
    dofs: Unknowns


class ElementEnergy(NamedTuple):
    """What a loop knows of the material."""

    law: int
    #: shape (n, k); as this law takes them.
    constants: Array
    #: Bulk modulus that acts at every point, and 1 / K of the pressure field (mixed form; 0 when
    #: incompressible).
    bulk: float
    compliance: float
    #: Resistance to uneven volume within an element in N/mm^2, see :func:`add_unevenness`.
    evenness: float


class Sums(NamedTuple):
    """Where the tangents of the elements are added up."""

    #: shape (n_elements, m (m + 1) / 2); entry of ``data`` of each packed one; negative where a
    #: constrained unknown takes part.
    positions: Unknowns
    #: shape (n_entries,)
    data: Array
    #: shape (n_elements,); place in ``packed`` of the elements with constrained unknowns, else
    #: negative.
    slots: Unknowns
    #: shape (n_kept, m (m + 1) / 2); packed tangents of those elements.
    packed: Array


@part()
def _means(J: Array, w: Array, kappa: float) -> tuple[float, float, float, float]:
    """Volume, mean J, mean of kappa d^3, and integral of 3 kappa d^2 over one element."""
    volume, swollen = 0.0, 0.0
    for q in range(J.size):
        volume += w[q]
        swollen += w[q] * J[q]
    mean = swollen / volume
    even, stiff = 0.0, 0.0
    for q in range(J.size):
        d = J[q] - mean
        even += w[q] * kappa * d**3 / volume
        stiff += w[q] * 3.0 * kappa * d**2
    return volume, mean, even, stiff


@part()
def _add_means(cross: Array, mean_rate: Array, stiff: float, m: int, K: Array) -> None:
    """Add what the mean owes to the unknowns, to the packed tangent of one element."""
    nu, s = mean_rate.size, 0
    for i in range(nu):
        for j in range(i, nu):
            between = cross[i] * mean_rate[j] + mean_rate[i] * cross[j]
            K[s] += stiff * mean_rate[i] * mean_rate[j] - between
            s += 1
        s += m - nu


@part()
def add_unevenness(
    still: tuple[Array, Array, Array],
    u: Array,
    J: Array,
    kappa: float,
    want_tangent: bool,
    f: Array,
    work: Array,
    tangent: Array,
    rows: Array,
    R: Array,
    K: Array,
) -> None:
    """Add what uneven volume ratios ``J`` of an element cost to ``R`` and ``K``.

    With d = J - mean J, a constant part of d^3 does no work, since d sums to zero; the rest
    acts as a pressure.

    Shapes: u, J (n_nodes, dim), mm; want_tangent, R, K (m,).
    """
    gradients, hoop, weights = still
    m, g, rates, mean_rate, cross = R.size, work[0], rows[0], rows[1], rows[2]
    mean_rate[:] = 0.0
    cross[:] = 0.0
    volume, mean, even, stiff = _means(J, weights, kappa)
    for q in range(J.size):
        dN, H, w = gradients[q], hoop[q], weights[q]
        deformation_gradient(dN, H, u, f)
        growth = cofactor(f, g)
        d = growth - mean
        pressure, stiffness = kappa * d**3 - even, 3.0 * kappa * d**2
        along_nodes(dN, H, g, w * pressure, R)
        if want_tangent:
            rates[:] = 0.0
            along_nodes(dN, H, g, 1.0, rates)
            for i in range(rates.size):
                mean_rate[i] += w / volume * rates[i]
                cross[i] += w * stiffness * rates[i]
            for i in range(9):
                g[i] /= growth
            tangent[:] = 0.0
            bend = pressure * growth
            add_pressure_tangent(g, bend, stiffness * growth * growth, tangent)
            add_stiffness(dN, H, tangent, w, m, K)
    if want_tangent:
        _add_means(cross, mean_rate, stiff, m, K)


# Compiled sum of the energy that elements store, K (J - 1)^2 / 2 of the pressure's volume
# included; the resistance to uneven volume (``assembly``) is added up apart.


@part()
def _second_exponential_ratio(z: float) -> float:
    """(exp(z) - 1 - z) / z^2, 1/2 at zero."""
    if abs(z) > 0.5:
        return (math.expm1(z) - z) / (z * z)
    total, term = 0.0, 0.5
    for k in range(16):  # sum z^k / (k + 2)!: the formula cancels here
        total += term
        term *= z / (k + 3)
    return total


@part()
def ogden_energy(x: Array, terms: Array) -> float:
    """Isochoric energy ``sum 2 mu / alpha^2 (sum l^alpha - 3)`` per reference volume.

    Isochoric logarithmic stretches x (3,) add up to zero, so that ``exp(alpha x) - 1 - alpha x``
    may stand for ``l^alpha - 1``: it is positive and keeps its digits at small strain.
    """
    energy = 0.0
    for a in range(3):
        for k in range(terms.shape[0]):
            energy += 2.0 * terms[k, 0] * x[a] ** 2 * _second_exponential_ratio(terms[k, 1] * x[a])
    return energy


@part()
def isochoric_energy(law: int, f: Array, constants: Array, work: Array, stress: Array) -> float:
    """Energy per reference volume where ``isochoric`` was just called. Shapes: f, stress (9,)."""
    if law == SMALL_STRAIN:
        energy = 0.0
        for n in range(9):
            energy += 0.5 * stress[n] * (f[n] - (1.0 if n % 4 == 0 else 0.0))
        return energy
    if law < POLYNOMIAL and law != EXTENDED_TUBE:
        return ogden_energy(work[6, 3:6], constants)
    a, b = invariants_beyond_rest(f, work[1])
    if law != EXTENDED_TUBE:
        return invariant_energy(law, constants, a, b)
    tubes = ogden_energy(work[6, 3:6], constants[4:6].reshape(1, 2))
    return tubes + invariant_energy(FINITE_EXTENSIBILITY, constants, a, b)


@kernel(nogil=True)
def stored_energy(
    elements: Elements, space: Shapes, energy: ElementEnergy, x: Array, out: Array
) -> float:
    """Energy of some elements. Shapes: out (n_elements, 2), N mm."""
    gradients, hoop, pressure_shape, weights, dofs = space
    law, constants, bulk, compliance, kappa = energy
    nq, na, dim = gradients.shape[1:]
    shared = pressure_shape.shape[0] == 1
    u, f, stress, ratios = np.empty((na, dim)), np.empty(9), np.empty(9), np.empty(nq)
    work = np.zeros((WORK_ROWS, 9))
    for e in elements:
        gather(x, dofs, e, u)
        total, volume, swollen = 0.0, 0.0, 0.0
        for q in range(nq):
            deformation_gradient(gradients[e, q], hoop[e, q], u, f)
            J = isochoric(law, f, constants, work, stress)
            density = isochoric_energy(law, f, constants, work, stress)
            p = held_pressure(pressure_shape[0 if shared else e, q], x, dofs[e])
            density += p * (J - 1.0) - 0.5 * compliance * p * p + 0.5 * bulk * (J - 1.0) ** 2
            w = weights[e, q]
            ratios[q] = J
            total += w * density
            volume += w
            swollen += w * J
        uneven = 0.0
        for q in range(nq):
            uneven += 0.25 * kappa * weights[e, q] * (ratios[q] - swollen / volume) ** 4
        out[e, 0] = total
        out[e, 1] = uneven
    return 0.0
