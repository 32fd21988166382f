"""Compiled element loops: residual and tangent of the mixed (u, p) form, axisymmetric and 3D.

The weak form is the stationarity of

    W_iso(F) + p (J - 1) - p^2 / (2 K)

in the reference configuration (total Lagrangian), with the isochoric invariants of
Penn's split ``I1bar = J^(-2/3) I1`` and ``I2bar = J^(-4/3) I2``. ``1/K = 0`` is the
incompressible limit. With no pressure unknowns (``n_pressure == 0``) the pressure is
``K (J - 1)`` at each quadrature point: the plain displacement formulation.

The deformation gradient is stored as nine numbers ``f[3 i + j] = F_ij``; in axisymmetric
space the axes are (r, z, hoop) and only five of them are ever different from zero.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: reorder and contract sums, but keep NaN: an inverted element must still be seen
_FAST = {"contract", "reassoc", "arcp", "nsz"}


@njit(cache=True, inline="always")
def _power_derivatives(x: float, n: int) -> tuple[float, float, float]:
    """x^n and its first two derivatives, exact at x = 0."""
    value = x**n if n > 0 else 1.0
    first = n * x ** (n - 1) if n > 1 else (1.0 if n == 1 else 0.0)
    second = n * (n - 1) * x ** (n - 2) if n > 2 else (2.0 if n == 2 else 0.0)
    return value, first, second


@njit(cache=True)
def polynomial_derivatives(table: Array, a: float, b: float, out: Array) -> None:
    """Differentiate sum C_ij a^i b^j by a and b, with a = I1bar - 3, b = I2bar - 3.

    ``out`` receives W_a, W_b, W_aa, W_ab, W_bb.
    """
    out[:] = 0.0
    for i in range(table.shape[0]):
        ai, ai1, ai2 = _power_derivatives(a, i)
        for j in range(table.shape[1]):
            c = table[i, j]
            if c != 0.0:
                bj, bj1, bj2 = _power_derivatives(b, j)
                out[0] += c * ai1 * bj
                out[1] += c * ai * bj1
                out[2] += c * ai2 * bj
                out[3] += c * ai1 * bj1
                out[4] += c * ai * bj2


@njit(cache=True)
def cofactor(f: Array, g: Array) -> float:
    """Write the cofactor matrix dJ/dF of ``f`` into ``g``; return J."""
    g[0] = f[4] * f[8] - f[5] * f[7]
    g[1] = f[5] * f[6] - f[3] * f[8]
    g[2] = f[3] * f[7] - f[4] * f[6]
    g[3] = f[2] * f[7] - f[1] * f[8]
    g[4] = f[0] * f[8] - f[2] * f[6]
    g[5] = f[1] * f[6] - f[0] * f[7]
    g[6] = f[1] * f[5] - f[2] * f[4]
    g[7] = f[2] * f[3] - f[0] * f[5]
    g[8] = f[0] * f[4] - f[1] * f[3]
    return float(f[0] * g[0] + f[1] * g[1] + f[2] * g[2])


@njit(cache=True, fastmath=_FAST)
def polynomial_stress(
    f: Array, table: Array, work: Array, stress: Array, tangent: Array, want_tangent: bool
) -> float:
    """Isochoric nominal stress and its tangent for ``sum C_ij (I1bar-3)^i (I2bar-3)^j``.

    Parameters
    ----------
    f : ndarray, shape (9,)
        Deformation gradient.
    table : ndarray, shape (n, m)
        Constants C_ij.
    work : ndarray, shape (6, 9)
        Scratch; row 0 receives F^-T on return.
    stress : ndarray, shape (9,)
        dW/dF, overwritten.
    tangent : ndarray, shape (9, 9)
        d2W/dF2, overwritten where ``want_tangent``.

    Returns
    -------
    J : float
        Determinant of F.
    """
    g, right, left, d1, d2, w = work[0], work[1], work[2], work[3], work[4], work[5]
    J = cofactor(f, g)
    if not J > 0.0:
        return J
    for i in range(9):
        g[i] /= J
    I1 = 0.0
    for i in range(9):
        I1 += f[i] * f[i]
    s1 = J ** (-2.0 / 3.0)
    second = table.shape[1] > 1
    s2, I2 = s1 * s1, 0.0
    if second:
        trace = 0.0
        for i in range(3):
            for j in range(3):
                c = 0.0
                b = 0.0
                for k in range(3):
                    c += f[3 * k + i] * f[3 * k + j]
                    b += f[3 * i + k] * f[3 * j + k]
                right[3 * i + j] = c
                left[3 * i + j] = b
                trace += c * c
        I2 = 0.5 * (I1 * I1 - trace)
    polynomial_derivatives(table, s1 * I1 - 3.0, s2 * I2 - 3.0 if second else 0.0, w)
    for i in range(9):
        d1[i] = s1 * (2.0 * f[i] - 2.0 / 3.0 * I1 * g[i])
        stress[i] = w[0] * d1[i]
    if second:
        for i in range(3):
            for j in range(3):
                fc = 0.0
                for k in range(3):
                    fc += f[3 * i + k] * right[3 * k + j]
                n = 3 * i + j
                d2[n] = s2 * (2.0 * (I1 * f[n] - fc) - 4.0 / 3.0 * I2 * g[n])
                stress[n] += w[1] * d2[n]
    if want_tangent:
        _polynomial_tangent(f, I1, I2, s1, s2, work, second, tangent)
    return J


@njit(cache=True, fastmath=_FAST)
def _polynomial_tangent(
    f: Array,
    I1: float,
    I2: float,
    s1: float,
    s2: float,
    work: Array,
    second: bool,
    tangent: Array,
) -> None:
    g, right, left, d1, d2, w = work[0], work[1], work[2], work[3], work[4], work[5]
    for i in range(3):
        for j in range(3):
            n = 3 * i + j
            for k in range(3):
                for m in range(3):
                    o = 3 * k + m
                    if o < n:
                        continue
                    gg = g[n] * g[o]
                    gx = g[3 * i + m] * g[3 * k + j]
                    same = 2.0 if n == o else 0.0
                    a1 = same - 4.0 / 3.0 * (f[n] * g[o] + g[n] * f[o])
                    a1 += I1 * (4.0 / 9.0 * gg + 2.0 / 3.0 * gx)
                    value = w[0] * s1 * a1 + w[2] * d1[n] * d1[o]
                    if second:
                        # dI2/dF without its volumetric part: d2 / s2 + 4/3 I2 G
                        hn = d2[n] / s2 + 4.0 / 3.0 * I2 * g[n]
                        ho = d2[o] / s2 + 4.0 / 3.0 * I2 * g[o]
                        a2 = 2.0 * f[n] * f[o] - f[3 * i + m] * f[3 * k + j]
                        if i == k:
                            a2 -= right[3 * m + j]
                        if j == m:
                            a2 -= left[3 * i + k]
                        if n == o:
                            a2 += I1
                        a2 = 2.0 * a2 - 4.0 / 3.0 * (hn * g[o] + g[n] * ho)
                        a2 += I2 * (16.0 / 9.0 * gg + 4.0 / 3.0 * gx)
                        value += w[1] * s2 * a2 + w[4] * d2[n] * d2[o]
                        value += w[3] * (d1[n] * d2[o] + d2[n] * d1[o])
                    tangent[n, o] = value
                    tangent[o, n] = value


@njit(cache=True, fastmath=_FAST)
def _add_pressure(
    J: float,
    g: Array,
    p: float,
    stiffening: float,
    stress: Array,
    tangent: Array,
    want_tangent: bool,
) -> None:
    """Add p dJ/dF to the stress and its tangent; ``stiffening`` is dp/dJ (displacement form)."""
    for n in range(9):
        stress[n] += p * J * g[n]
    if want_tangent:
        for i in range(3):
            for j in range(3):
                n = 3 * i + j
                for k in range(3):
                    for m in range(3):
                        o = 3 * k + m
                        gx = g[3 * i + m] * g[3 * k + j]
                        tangent[n, o] += p * J * (g[n] * g[o] - gx)
                        tangent[n, o] += stiffening * J * J * g[n] * g[o]


@njit(cache=True, fastmath=_FAST)
def _deformation_gradient(gradients: Array, hoop: Array, u: Array, f: Array) -> None:
    """F at one quadrature point from nodal displacements ``u`` (n_nodes, dim)."""
    dim = gradients.shape[1]
    f[:] = 0.0
    f[0] = 1.0
    f[4] = 1.0
    f[8] = 1.0
    for a in range(gradients.shape[0]):
        for i in range(dim):
            for j in range(dim):
                f[3 * i + j] += u[a, i] * gradients[a, j]
        if dim == 2:
            f[8] += u[a, 0] * hoop[a]


@njit(cache=True, fastmath=_FAST)
def _add_stiffness_3d(dN: Array, A: Array, w: float, K: Array) -> None:
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


@njit(cache=True, fastmath=_FAST)
def _add_stiffness_axisymmetric(dN: Array, H: Array, A: Array, w: float, K: Array) -> None:
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


@njit(cache=True)
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
            _deformation_gradient(gradients[e, q], hoop[e, q], u[e], f)
            value = cofactor(f, g)
            if not f[8] > 0.0 and gradients.shape[3] == 2:
                value = -1.0
            J[e, q] = value
            if not value >= smallest:
                smallest = value
    return smallest


@njit(cache=True)
def element_residuals(
    gradients: Array,
    hoop: Array,
    pressure_shape: Array,
    weights: Array,
    u: Array,
    p: Array,
    table: Array,
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
    table : ndarray, shape (n, m)
        Constants C_ij.
    bulk, compliance : float
        K (displacement form) and 1/K (mixed form; 0 when incompressible).
    want_tangent : bool
        Whether ``K`` is filled.
    R : ndarray, shape (n_elements, m)
        Residuals, displacements first (node by node), then pressures.
    K : ndarray, shape (n_elements, m (m + 1) / 2)
        Upper triangle of each tangent, row by row.

    Returns
    -------
    float
        The smallest J; nothing is to be trusted when it is not positive.
    """
    ne, nq, na, dim = gradients.shape
    n_p = pressure_shape.shape[2]
    nu = dim * na
    m = nu + n_p
    f, stress = np.empty(9), np.empty(9)
    work, tangent = np.zeros((6, 9)), np.empty((9, 9))
    Kl, Rl = np.empty((m, m)), np.empty(m)
    shared = pressure_shape.shape[0] == 1
    smallest = np.inf
    for e in range(ne):
        Kl[:] = 0.0
        Rl[:] = 0.0
        for q in range(nq):
            dN, H = gradients[e, q], hoop[e, q]
            N = pressure_shape[0 if shared else e, q]
            w = weights[e, q]
            _deformation_gradient(dN, H, u[e], f)
            J = polynomial_stress(f, table, work, stress, tangent, want_tangent)
            if not J > 0.0 or (dim == 2 and not f[8] > 0.0):
                return -1.0
            smallest = min(smallest, J)
            g = work[0]
            pressure, stiffening = bulk * (J - 1.0), bulk
            if n_p > 0:
                pressure, stiffening = 0.0, 0.0
                for b in range(n_p):
                    pressure += N[b] * p[e, b]
            _add_pressure(J, g, pressure, stiffening, stress, tangent, want_tangent)
            for a in range(na):
                for i in range(dim):
                    r = 0.0
                    gn = 0.0
                    for j in range(dim):
                        r += dN[a, j] * stress[3 * i + j]
                        gn += dN[a, j] * g[3 * i + j]
                    if dim == 2 and i == 0:
                        r += H[a] * stress[8]
                        gn += H[a] * g[8]
                    row = dim * a + i
                    Rl[row] += w * r
                    for b in range(n_p):
                        Kl[row, nu + b] += w * J * gn * N[b]
            if want_tangent:
                if dim == 3:
                    _add_stiffness_3d(dN, tangent, w, Kl)
                else:
                    _add_stiffness_axisymmetric(dN, H, tangent, w, Kl)
            for b in range(n_p):
                Rl[nu + b] += w * (J - 1.0 - pressure * compliance) * N[b]
                if want_tangent:
                    for c in range(b, n_p):
                        Kl[nu + b, nu + c] -= w * N[b] * N[c] * compliance
        R[e] = Rl
        if want_tangent:
            s = 0
            for i in range(m):
                for j in range(i, m):
                    K[e, s] = Kl[i, j]
                    s += 1
    return smallest


@njit(cache=True)
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


@njit(cache=True)
def scatter(positions: NDArray[np.int32], values: Array, data: Array) -> None:
    """Add packed values to the entries of the fixed sparsity pattern (negative: constrained)."""
    data[:] = 0.0
    for i in range(positions.size):
        k = positions[i]
        if k >= 0:
            data[k] += values[i]
