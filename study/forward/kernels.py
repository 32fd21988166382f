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
from study.forward.forms import (
    ONE,
    add_compressibility,
    add_coupling,
    add_stiffness,
    add_volume,
    along_nodes,
    deformation_gradient,
    gather,
    packed,
    place_coupling,
)
from study.forward.law import (
    add_pressure_tangent,
    cofactor,
    linear_stress,
    linear_tangent,
    polynomial_stress,
    polynomial_tangent,
)
from study.forward.ogden import BY_EXPONENT, STRESS, WORK_ROWS, ogden_stress, ogden_tangent

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
    """Tangent of :func:`isochoric`, called before, and of a pressure."""
    if family == POLYNOMIAL:
        polynomial_tangent(f, constants.shape[1] > 1, plane, bend, stiff, work, tangent)
        return
    if family == LINEAR:
        linear_tangent(constants[0, 0], tangent)
    else:
        ogden_tangent(constants, work, tangent)
    add_pressure_tangent(work[0], bend, stiff, tangent)


@kernel(nogil=True)
def volume_ratios(gradients: Array, hoop: Array, dofs: Unknowns, x: Array, J: Array) -> float:
    """J = det F at every quadrature point; returns the smallest.

    In axisymmetric space a hoop stretch that is not positive counts as ``J = -1``, since
    two negative stretches would otherwise multiply to a volume that looks sound.
    """
    ne, nq, na, dim = gradients.shape
    f, g, u = np.empty(9), np.empty(9), np.empty((na, dim))
    smallest = np.inf
    for e in range(ne):
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
def element_residuals(
    gradients: Array,
    hoop: Array,
    pressure_shape: Array,
    weights: Array,
    dofs: Unknowns,
    x: Array,
    family: int,
    constants: Array,
    bulk: float,
    compliance: float,
    want_tangent: bool,
    R: Array,
    K: Array,
) -> float:
    """Element residuals and packed upper tangents.

    Parameters
    ----------
    gradients : ndarray, shape (n_elements, n_quadrature, n_nodes, dim)
        Reference gradients of the displacement shape functions.
    hoop : ndarray, shape (n_elements, n_quadrature, n_nodes)
        N / R (axisymmetric; anything of the right shape in 3D).
    pressure_shape : ndarray, shape (n_elements or 1, n_quadrature, n_pressure)
        Pressure shape functions.
    weights : ndarray, shape (n_elements, n_quadrature)
        Quadrature weights times volume (2 pi R included in axisymmetric space).
    dofs : ndarray of int32, shape (n_elements, m)
        Unknowns of each element: displacements node by node, then pressures.
    x : ndarray, shape (n,)
        All unknowns.
    family : int
        ``POLYNOMIAL``, ``OGDEN``, ``OGDEN_BY_EXPONENT`` or ``LINEAR``.
    constants : ndarray, shape (n, k)
        What the family says.
    bulk, compliance : float
        Bulk modulus that acts at every point, and 1 / K of the pressure field (mixed form; 0
        when incompressible).
    want_tangent : bool
        Whether ``K`` is filled.
    R : ndarray, shape (n_elements, m)
        Residuals.
    K : ndarray, shape (n_elements, m (m + 1) / 2)
        Upper triangle of each tangent, row by row.

    Returns
    -------
    float
        The smallest J; nothing is to be trusted when it is not positive, but for small
        strain, where it is the smallest 1 + tr(eps) and may have any sign.
    """
    ne, nq, na, dim = gradients.shape
    n_p, nu, m = pressure_shape.shape[2], dim * na, dofs.shape[1]
    u, f, stress = np.empty((na, dim)), np.empty(9), np.empty(9)
    work, tangent = np.zeros((WORK_ROWS, 9)), np.zeros((9, 9))
    rates, coupling = np.empty(nu), np.empty((n_p, nu))
    shared, curved = pressure_shape.shape[0] == 1, family != LINEAR
    smallest = np.inf
    for e in range(ne):
        gather(x, dofs, e, u)
        R[e] = 0.0
        coupling[:] = 0.0
        if want_tangent:
            K[e] = 0.0
        for q in range(nq):
            dN, H, w = gradients[e, q], hoop[e, q], weights[e, q]
            N = pressure_shape[0 if shared else e, q]
            deformation_gradient(dN, H, u, f)
            J = isochoric(family, f, constants, work, stress)
            if curved and (not J > 0.0 or (dim == 2 and not f[8] > 0.0)):
                return -1.0
            smallest = min(smallest, J)
            g, growth = work[0], J if curved else 1.0
            held = 0.0
            for b in range(n_p):
                held += N[b] * x[dofs[e, nu + b]]
            pressure = held + bulk * (J - 1.0)
            for i in range(9):
                stress[i] += pressure * growth * g[i]
            along_nodes(dN, H, stress, rates)
            for r in range(nu):
                R[e, r] += w * rates[r]
            add_volume(N, J - 1.0 - held * compliance, w, R[e])
            if want_tangent:
                bend, stiff = pressure * growth if curved else 0.0, bulk * growth * growth
                full_tangent(family, f, constants, dim == 2, bend, stiff, work, tangent)
                add_stiffness(dN, H, tangent, w, m, K[e])
                if n_p > 0:
                    along_nodes(dN, H, g, rates)
                    add_coupling(rates, w * growth, N, coupling)
                    add_compressibility(N, w, compliance, m, K[e])
        if want_tangent:
            place_coupling(coupling, m, K[e])
    return smallest


@kernel()
def packed_product(dofs: Unknowns, K: Array, v: Array, out: Array) -> None:
    """Out = K v from packed element tangents, constrained unknowns included."""
    out[:] = 0.0
    ne, m = dofs.shape
    into, own = np.empty(m), np.empty(m)
    for e in range(ne):
        for i in range(m):
            own[i] = v[dofs[e, i]]
            into[i] = 0.0
        s = packed(0, 0, m)
        for i in range(m):
            total = K[e, s] * own[i]
            s += ONE
            for j in range(i + 1, m):
                total += K[e, s] * own[j]
                into[j] += K[e, s] * own[i]
                s += ONE
            into[i] += total
        for i in range(m):
            out[dofs[e, i]] += into[i]


@kernel(nogil=True)
def scatter(
    elements: NDArray[np.int32], positions: NDArray[np.int32], values: Array, data: Array
) -> None:
    """Add packed values of some elements to the entries of the fixed sparsity pattern.

    Positions, shape (n_elements, m (m + 1) / 2), are negative for constrained unknowns.
    """
    for e in elements:
        for i in range(positions.shape[1]):
            k = positions[e, i]
            if k >= 0:
                data[k] += values[e, i]


@kernel()
def gathered(dofs: Unknowns, residuals: Array, out: Array) -> None:
    """Sum of element residuals, shape (n,)."""
    out[:] = 0.0
    for e in range(dofs.shape[0]):
        for i in range(dofs.shape[1]):
            out[dofs[e, i]] += residuals[e, i]
