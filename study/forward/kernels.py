"""Compiled element loops: residual and tangent of the mixed (u, p) form, axisymmetric and 3D.

The weak form is the stationarity of

    W_iso(F) + p (J - 1) - p^2 / (2 K)

in the reference configuration (total Lagrangian), with the isochoric invariants of
Penn's split ``I1bar = J^(-2/3) I1`` and ``I2bar = J^(-4/3) I2``. ``1/K = 0`` is the
incompressible limit. With no pressure unknowns (``n_pressure == 0``) the pressure is
``K (J - 1)`` at each quadrature point: the plain displacement formulation; the mixed form
may leave a share of K there as well. For the
linear-elastic family W_iso is ``mu dev(eps):dev(eps)`` and J is ``1 + tr(eps)``.

The deformation gradient is stored as nine numbers ``f[3 i + j] = F_ij``; in axisymmetric
space the axes are (r, z, hoop) and only five of them are ever different from zero.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from study.forward.compiled import kernel, part
from study.forward.dyads import add_dyads
from study.forward.forms import (
    add_compressibility,
    add_coupling,
    add_stiffness,
    add_volume,
    along_nodes,
    deformation_gradient,
    gather,
    held_pressure,
    place_coupling,
)
from study.forward.handed import Elements, Energy, Shapes, Sums
from study.forward.law import (
    add_pressure_tangent,
    cofactor,
    linear_stress,
    linear_tangent,
    polynomial_stress,
    polynomial_tangent,
)
from study.forward.ogden import BY_EXPONENT, STRESS, WORK_ROWS, ogden_stress, ogden_tangent
from study.forward.swell import add_unevenness

Array = NDArray[np.float64]
Unknowns = NDArray[np.int32]

#: what the rows of an energy's constants mean: C_ij; (mu, alpha); the same, for the sum of
#: d(stress)/dalpha; a single shear modulus of small strain
POLYNOMIAL, OGDEN, OGDEN_BY_EXPONENT, LINEAR = 0, 1, 2, 3


@part()
def isochoric(family: int, f: Array, constants: Array, work: Array, stress: Array) -> float:
    """Isochoric stress by family; J is returned, row 0 of ``work`` is dJ/dF / J.

    For small strain J is linear and row 0 is dJ/dF itself.
    """
    if family == POLYNOMIAL:
        return float(polynomial_stress(f, constants, work, stress))
    if family == LINEAR:
        return float(linear_stress(f, constants[0, 0], work, stress))
    J = cofactor(f, work[0])
    if J > 0.0:
        for i in range(9):
            work[0, i] /= J
        what = BY_EXPONENT if family == OGDEN_BY_EXPONENT else STRESS
        ogden_stress(f, constants, what, work, stress)
    return float(J)


@part()
def full_tangent(
    family: int,
    f: Array,
    constants: Array,
    plane: bool,
    bend: float,
    stiff: float,
    work: Array,
    tangent: Array,
) -> None:
    """Tangent of :func:`isochoric`, called before, and of a pressure.

    ``bend`` is p J, zero where J is linear, and ``stiff`` is J^2 dp/dJ.
    """
    if family == POLYNOMIAL:
        polynomial_tangent(f, plane, bend, stiff, work, tangent)
        return
    if family == LINEAR:
        linear_tangent(constants[0, 0], tangent)
    else:
        ogden_tangent(constants, work, tangent)
    add_pressure_tangent(work[0], bend, stiff, tangent)


@part()
def scatter(positions: Unknowns, K: Array, data: Array) -> None:
    """Add a packed tangent to the entries of the sparsity pattern; some positions are negative."""
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
    energy: Energy,
    x: Array,
    R: Array,
    want_tangent: bool,
    sums: Sums,
) -> float:
    """Residuals of some elements, and the sum of their tangents.

    Parameters
    ----------
    elements : ndarray of uint32
        Which: unsigned, or every access would look for an index from the end.
    x : ndarray, shape (n,)
        All unknowns.
    R : ndarray, shape (n_elements, m)
        Residuals, overwritten.
    want_tangent : bool
        Whether tangents are added to ``sums``.

    Returns
    -------
    float
        The smallest J; nothing is to be trusted when it is not positive, but for small
        strain, where it is the smallest 1 + tr(eps) and may have any sign.
    """
    # names of their own: fields would be counted as references at every point
    gradients, hoop, pressure_shape, weights, dofs = space
    family, constants, bulk, compliance, kappa = energy
    positions, data, slots, kept = sums
    nq, na, dim = gradients.shape[1:]
    n_p, nu, m = pressure_shape.shape[2], dim * na, dofs.shape[1]
    u, f, stress, ratios = np.empty((na, dim)), np.empty(9), np.empty(9), np.empty(nq)
    work, tangent, nodal = np.zeros((WORK_ROWS, 9)), np.zeros((9, 9)), np.empty((na, 12))
    rates, coupling, K = np.empty((3, nu)), np.empty((n_p, nu)), np.empty(m * (m + 1) // 2)
    along, shared, smallest = rates[0], pressure_shape.shape[0] == 1, np.inf
    curved, first_alone = family != LINEAR, family == POLYNOMIAL and constants.shape[1] == 1
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
            J = isochoric(family, f, constants, work, stress)
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
                    add_dyads(dN, H, f, bend, stiff, work, w, m, nodal, K)
                else:
                    full_tangent(family, f, constants, dim == 2, bend, stiff, work, tangent)
                    add_stiffness(dN, H, tangent, w, m, K)
                if n_p > 0:
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
                kept[slots[e]] = K
    return smallest


@kernel()
def constrained_product(
    elements: Unknowns, dofs: Unknowns, positions: Unknowns, K: Array, v: Array, out: Array
) -> None:
    """Add to ``out`` what K v has of the entries outside the sparsity pattern.

    Parameters
    ----------
    elements : ndarray of int32, shape (n_kept,)
        Rows of ``dofs`` and ``positions`` that ``K`` belongs to.
    K : ndarray, shape (n_kept, m (m + 1) / 2)
        Packed upper triangles; an entry counts where its position is negative.
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
    """Sum of element residuals, shape (n,)."""
    out[:] = 0.0
    for e in range(dofs.shape[0]):
        for i in range(dofs.shape[1]):
            out[dofs[e, i]] += residuals[e, i]
