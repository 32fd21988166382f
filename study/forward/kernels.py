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
from study.forward.law import add_pressure, cofactor, linear_stress, polynomial_stress
from study.forward.ogden import BY_EXPONENT, STRESS, WORK_ROWS, ogden_stress

Array = NDArray[np.float64]

#: reorder and contract sums, but keep NaN: an inverted element must still be seen
_FAST = {"contract", "reassoc", "arcp", "nsz"}

#: what the rows of an energy's constants mean: C_ij; (mu, alpha); the same, for the sum of
#: d(stress)/dalpha; a single shear modulus of small strain
POLYNOMIAL, OGDEN, OGDEN_BY_EXPONENT, LINEAR = 0, 1, 2, 3


@part(fastmath=_FAST)
def deformation_gradient(gradients: Array, hoop: Array, u: Array, f: Array) -> None:
    """F at one quadrature point from nodal displacements ``u`` (n_nodes, dim)."""
    dim = gradients.shape[1]
    f[:] = 0.0
    f[0] = 1.0
    f[4] = 1.0
    f[8] = 1.0
    for a in range(gradients.shape[0]):
        for i in range(dim):
            f[3 * i] += u[a, i] * gradients[a, 0]
            f[3 * i + 1] += u[a, i] * gradients[a, 1]
            if dim == 3:
                f[3 * i + 2] += u[a, i] * gradients[a, 2]
        if dim == 2:
            f[8] += u[a, 0] * hoop[a]


@part(fastmath=_FAST)
def add_stiffness_3d(dN: Array, A: Array, w: float, K: Array) -> None:
    """K_ai,bk += w dN_a,j A_ij,kl dN_b,l for b >= a, written out so that it vectorizes."""
    na = dN.shape[0]
    for a in range(na):
        x, y, z = w * dN[a, 0], w * dN[a, 1], w * dN[a, 2]
        for i in range(3):
            t0 = x * A[3 * i, 0] + y * A[3 * i + 1, 0] + z * A[3 * i + 2, 0]
            t1 = x * A[3 * i, 1] + y * A[3 * i + 1, 1] + z * A[3 * i + 2, 1]
            t2 = x * A[3 * i, 2] + y * A[3 * i + 1, 2] + z * A[3 * i + 2, 2]
            t3 = x * A[3 * i, 3] + y * A[3 * i + 1, 3] + z * A[3 * i + 2, 3]
            t4 = x * A[3 * i, 4] + y * A[3 * i + 1, 4] + z * A[3 * i + 2, 4]
            t5 = x * A[3 * i, 5] + y * A[3 * i + 1, 5] + z * A[3 * i + 2, 5]
            t6 = x * A[3 * i, 6] + y * A[3 * i + 1, 6] + z * A[3 * i + 2, 6]
            t7 = x * A[3 * i, 7] + y * A[3 * i + 1, 7] + z * A[3 * i + 2, 7]
            t8 = x * A[3 * i, 8] + y * A[3 * i + 1, 8] + z * A[3 * i + 2, 8]
            row = 3 * a + i
            for b in range(a, na):
                p, q, r = dN[b, 0], dN[b, 1], dN[b, 2]
                K[row, 3 * b] += t0 * p + t1 * q + t2 * r
                K[row, 3 * b + 1] += t3 * p + t4 * q + t5 * r
                K[row, 3 * b + 2] += t6 * p + t7 * q + t8 * r


@part(fastmath=_FAST)
def add_stiffness_axisymmetric(dN: Array, H: Array, A: Array, w: float, K: Array) -> None:
    """As in 3D, with the hoop component: radial displacement also moves F_33 by N / R."""
    na = dN.shape[0]
    for a in range(na):
        x, y, h = w * dN[a, 0], w * dN[a, 1], w * H[a]
        for i in range(2):
            hoop = h if i == 0 else 0.0
            t0 = x * A[3 * i, 0] + y * A[3 * i + 1, 0] + hoop * A[8, 0]
            t1 = x * A[3 * i, 1] + y * A[3 * i + 1, 1] + hoop * A[8, 1]
            t3 = x * A[3 * i, 3] + y * A[3 * i + 1, 3] + hoop * A[8, 3]
            t4 = x * A[3 * i, 4] + y * A[3 * i + 1, 4] + hoop * A[8, 4]
            t8 = x * A[3 * i, 8] + y * A[3 * i + 1, 8] + hoop * A[8, 8]
            row = 2 * a + i
            for b in range(a, na):
                K[row, 2 * b] += t0 * dN[b, 0] + t1 * dN[b, 1] + t8 * H[b]
                K[row, 2 * b + 1] += t3 * dN[b, 0] + t4 * dN[b, 1]


@part(fastmath=_FAST)
def along_nodes(dN: Array, H: Array, T: Array, out: Array) -> None:
    """T : dF/du at one quadrature point, node by node: forces of a stress, dJ/du of dJ/dF."""
    na, dim = dN.shape
    for a in range(na):
        for i in range(dim):
            total = dN[a, 0] * T[3 * i] + dN[a, 1] * T[3 * i + 1]
            if dim == 3:
                total += dN[a, 2] * T[3 * i + 2]
            elif i == 0:
                total += H[a] * T[8]
            out[dim * a + i] = total


@part(fastmath=_FAST)
def _add_coupling(rates: Array, w: float, N: Array, K: Array) -> None:
    """K_b,ai += w N_b dJ/du_ai: below the diagonal, where the unknowns of a row are neighbors."""
    nu = rates.size
    for b in range(N.size):
        share = w * N[b]
        for r in range(nu):
            K[nu + b, r] += share * rates[r]


@part()
def _add_volume(
    N: Array, excess: float, w: float, compliance: float, want_tangent: bool, R: Array, K: Array
) -> None:
    """Add N_b (J - 1 - p / K), the equation of each pressure, and its derivative by pressures."""
    nu = R.size - N.size
    for b in range(N.size):
        R[nu + b] += w * excess * N[b]
        if want_tangent:
            for c in range(b, N.size):
                K[nu + b, nu + c] -= w * N[b] * N[c] * compliance


@part()
def _pack(K: Array, nu: int, packed: Array) -> None:
    """Upper triangle of a symmetric tangent, row by row; its pressure rows hold the coupling."""
    m, s = K.shape[0], 0
    for i in range(m):
        for j in range(i, m):
            packed[s] = K[j, i] if i < nu <= j else K[i, j]
            s += 1


@part()
def isochoric(
    family: int,
    f: Array,
    constants: Array,
    work: Array,
    stress: Array,
    tangent: Array,
    want_tangent: bool,
) -> float:
    """Isochoric stress and tangent by family; J is returned, row 0 of ``work`` is dJ/dF / J.

    For small strain J is linear and row 0 is dJ/dF itself.
    """
    if family == POLYNOMIAL:
        return float(polynomial_stress(f, constants, work, stress, tangent, want_tangent))
    if family == LINEAR:
        return float(linear_stress(f, constants[0, 0], work, stress, tangent, want_tangent))
    J = cofactor(f, work[0])
    if J > 0.0:
        for i in range(9):
            work[0, i] /= J
        what = BY_EXPONENT if family == OGDEN_BY_EXPONENT else STRESS
        ogden_stress(f, constants, what, work, stress, tangent, want_tangent)
    return float(J)


@kernel(nogil=True)
def volume_ratios(gradients: Array, hoop: Array, u: Array, J: Array) -> float:
    """J = det F at every quadrature point; returns the smallest.

    In axisymmetric space a hoop stretch that is not positive counts as ``J = -1``, since
    two negative stretches would otherwise multiply to a volume that looks sound.
    """
    f = np.empty(9)
    g = np.empty(9)
    smallest = np.inf
    for e in range(gradients.shape[0]):
        for q in range(gradients.shape[1]):
            deformation_gradient(gradients[e, q], hoop[e, q], u[e], f)
            value = cofactor(f, g)
            if not f[8] > 0.0 and gradients.shape[3] == 2:
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
    u: Array,
    p: Array,
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
    u : ndarray, shape (n_elements, n_nodes, dim)
        Nodal displacements.
    p : ndarray, shape (n_elements, n_pressure)
        Pressure unknowns.
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
        Residuals, displacements first (node by node), then pressures.
    K : ndarray, shape (n_elements, m (m + 1) / 2)
        Upper triangle of each tangent, row by row.

    Returns
    -------
    float
        The smallest J; nothing is to be trusted when it is not positive, but for small
        strain, where it is the smallest 1 + tr(eps) and may have any sign.
    """
    ne, nq, na, dim = gradients.shape
    n_p = pressure_shape.shape[2]
    nu = dim * na
    m = nu + n_p
    f, stress = np.empty(9), np.empty(9)
    work, tangent = np.zeros((WORK_ROWS, 9)), np.empty((9, 9))
    Kl, Rl, rates = np.empty((m, m)), np.empty(m), np.empty(nu)
    shared = pressure_shape.shape[0] == 1
    curvature = 0.0 if family == LINEAR else 1.0
    smallest = np.inf
    for e in range(ne):
        Kl[:] = 0.0
        Rl[:] = 0.0
        for q in range(nq):
            dN, H = gradients[e, q], hoop[e, q]
            N = pressure_shape[0 if shared else e, q]
            w = weights[e, q]
            deformation_gradient(dN, H, u[e], f)
            J = isochoric(family, f, constants, work, stress, tangent, want_tangent)
            if curvature > 0.0 and (not J > 0.0 or (dim == 2 and not f[8] > 0.0)):
                return -1.0
            smallest = min(smallest, J)
            g, growth = work[0], J if curvature > 0.0 else 1.0
            held = 0.0
            for b in range(n_p):
                held += N[b] * p[e, b]
            pressure = held + bulk * (J - 1.0)
            add_pressure(growth, g, pressure, bulk, curvature, stress, tangent, want_tangent)
            along_nodes(dN, H, stress, rates)
            for r in range(nu):
                Rl[r] += w * rates[r]
            if want_tangent:
                if dim == 3:
                    add_stiffness_3d(dN, tangent, w, Kl)
                else:
                    add_stiffness_axisymmetric(dN, H, tangent, w, Kl)
                if n_p > 0:
                    along_nodes(dN, H, g, rates)
                    _add_coupling(rates, w * growth, N, Kl)
            _add_volume(N, J - 1.0 - held * compliance, w, compliance, want_tangent, Rl, Kl)
        R[e] = Rl
        if want_tangent:
            _pack(Kl, nu, K[e])
    return smallest


@kernel()
def packed_product(dofs: NDArray[np.int32], K: Array, v: Array, out: Array) -> None:
    """Out = K v from packed element tangents, constrained unknowns included."""
    out[:] = 0.0
    ne, m = dofs.shape
    for e in range(ne):
        s = 0
        for i in range(m):
            a = dofs[e, i]
            out[a] += K[e, s] * v[a]
            s += 1
            for j in range(i + 1, m):
                b = dofs[e, j]
                out[a] += K[e, s] * v[b]
                out[b] += K[e, s] * v[a]
                s += 1


@kernel()
def scatter(positions: NDArray[np.int32], values: Array, data: Array) -> None:
    """Add packed values to the entries of the fixed sparsity pattern (negative: constrained)."""
    data[:] = 0.0
    for i in range(positions.size):
        k = positions[i]
        if k >= 0:
            data[k] += values[i]
