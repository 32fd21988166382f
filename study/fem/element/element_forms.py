"""Compiled forms of one element at one quadrature point, in axisymmetric space and in 3D.

Tangents go straight into the packed upper triangle of their element: the entry of row r and
column c >= r, of m unknowns, is number ``r m - r (r + 1) / 2 + c``. These numbers are unsigned:
of a signed one Numba asks each time whether it counts from the end, a fifth of all work here.
"""

from __future__ import annotations

import numpy as np

from study.arrays import Array, Unknowns
from study.compilation import FAST, part

ONE = np.uint64(1)
TWO = np.uint64(2)
THREE = np.uint64(3)


@part()
def packed(row: int, column: int, m: int) -> np.uint64:
    """Find the number of an entry in the packed upper triangle of m rows."""
    return np.uint64(row * m - row * (row + 1) // 2 + column)


@part()
def gather(x: Array, dofs: Unknowns, e: int, u: Array) -> None:
    """Displacements of the nodes of element ``e`` from all unknowns, shape (n_nodes, dim)."""
    dim = u.shape[1]
    for a in range(u.shape[0]):
        for i in range(dim):
            u[a, i] = x[dofs[e, dim * a + i]]


@part()
def held_pressure(N: Array, x: Array, dofs: Unknowns) -> float:
    """Pressure at one quadrature point from its unknowns, the last of the element's ``dofs``."""
    pressure, first = 0.0, dofs.size - N.size
    for b in range(N.size):
        pressure += N[b] * x[dofs[first + b]]
    return pressure


@part(fastmath=FAST)
def deformation_gradient(dN: Array, hoop: Array, u: Array, f: Array) -> None:
    """F at one quadrature point from nodal displacements ``u`` (n_nodes, dim)."""
    dim = dN.shape[1]
    f[:] = 0.0
    f[0] = 1.0
    f[4] = 1.0
    f[8] = 1.0
    for a in range(dN.shape[0]):
        for i in range(dim):
            f[3 * i] += u[a, i] * dN[a, 0]
            f[3 * i + 1] += u[a, i] * dN[a, 1]
            if dim == 3:
                f[3 * i + 2] += u[a, i] * dN[a, 2]
        if dim == 2:
            f[8] += u[a, 0] * hoop[a]


@part(fastmath=FAST)
def along_nodes(dN: Array, hoop: Array, T: Array, w: float, out: Array) -> None:
    """Add w T : dF/du, node by node: forces of a stress, or dJ/du of dJ/dF."""
    na, dim = dN.shape
    if dim == 3:
        for i in range(3):
            x, y, z = w * T[3 * i], w * T[3 * i + 1], w * T[3 * i + 2]
            for a in range(na):
                out[3 * a + i] += x * dN[a, 0] + y * dN[a, 1] + z * dN[a, 2]
    else:
        rr, rz, zr, zz, around = w * T[0], w * T[1], w * T[3], w * T[4], w * T[8]
        for a in range(na):
            x, y = dN[a, 0], dN[a, 1]
            out[2 * a] += rr * x + rz * y + around * hoop[a]
            out[2 * a + 1] += zr * x + zz * y


@part(fastmath=FAST)
def add_stiffness(dN: Array, hoop: Array, A: Array, w: float, m: int, K: Array) -> None:
    """Add w dF/du : A : dF/du to the packed tangent of an element with ``m`` unknowns."""
    if dN.shape[1] == 3:
        _add_stiffness_3d(dN, A, w, m, K)
    else:
        _add_stiffness_axisymmetric(dN, hoop, A, w, m, K)


@part(fastmath=FAST)
def _add_stiffness_3d(dN: Array, A: Array, w: float, m: int, K: Array) -> None:
    """K_ai,bk += w dN_a,j A_ij,kl dN_b,l for b >= a, written out: loops cost more than sums."""
    na = dN.shape[0]
    for a in range(na):
        x, y, z = w * dN[a, 0], w * dN[a, 1], w * dN[a, 2]
        p, q, r = dN[a, 0], dN[a, 1], dN[a, 2]
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
            s = packed(row, 3 * a, m)
            if i == 0:
                K[s] += t0 * p + t1 * q + t2 * r
            if i <= 1:
                K[s + ONE] += t3 * p + t4 * q + t5 * r
            K[s + TWO] += t6 * p + t7 * q + t8 * r
            for b in range(a + 1, na):
                s += THREE
                K[s] += t0 * dN[b, 0] + t1 * dN[b, 1] + t2 * dN[b, 2]
                K[s + ONE] += t3 * dN[b, 0] + t4 * dN[b, 1] + t5 * dN[b, 2]
                K[s + TWO] += t6 * dN[b, 0] + t7 * dN[b, 1] + t8 * dN[b, 2]


@part(fastmath=FAST)
def _add_stiffness_axisymmetric(
    dN: Array, hoop: Array, A: Array, w: float, m: int, K: Array
) -> None:
    """As in 3D, with the hoop component: radial displacement also moves F_33 by N / R."""
    na = dN.shape[0]
    for a in range(na):
        x, y, h = w * dN[a, 0], w * dN[a, 1], w * hoop[a]
        for i in range(2):
            around = h if i == 0 else 0.0
            t0 = x * A[3 * i, 0] + y * A[3 * i + 1, 0] + around * A[8, 0]
            t1 = x * A[3 * i, 1] + y * A[3 * i + 1, 1] + around * A[8, 1]
            t3 = x * A[3 * i, 3] + y * A[3 * i + 1, 3] + around * A[8, 3]
            t4 = x * A[3 * i, 4] + y * A[3 * i + 1, 4] + around * A[8, 4]
            t8 = x * A[3 * i, 8] + y * A[3 * i + 1, 8] + around * A[8, 8]
            row = 2 * a + i
            s = packed(row, 2 * a, m)
            if i == 0:
                K[s] += t0 * dN[a, 0] + t1 * dN[a, 1] + t8 * hoop[a]
            K[s + ONE] += t3 * dN[a, 0] + t4 * dN[a, 1]
            for b in range(a + 1, na):
                s += TWO
                K[s] += t0 * dN[b, 0] + t1 * dN[b, 1] + t8 * hoop[b]
                K[s + ONE] += t3 * dN[b, 0] + t4 * dN[b, 1]


@part(fastmath=FAST)
def add_coupling(rates: Array, w: float, N: Array, C: Array) -> None:
    """C_b,r += w N_b dJ/du_r, shape (n_pressure, n_displacement)."""
    for b in range(N.size):
        share = w * N[b]
        for r in range(rates.size):
            C[b, r] += share * rates[r]


@part()
def place_coupling(C: Array, m: int, K: Array) -> None:
    """Put what pressures do to displacements into the packed tangent."""
    n_p, nu = C.shape
    for r in range(nu):
        s = packed(r, nu, m)
        for b in range(n_p):
            K[s] = C[b, r]
            s += ONE


@part()
def add_volume(N: Array, excess: float, w: float, R: Array) -> None:
    """Add N_b (J - 1 - p / K), the equation of each pressure."""
    nu = R.size - N.size
    for b in range(N.size):
        R[nu + b] += w * excess * N[b]


@part()
def add_compressibility(N: Array, w: float, compliance: float, m: int, K: Array) -> None:
    """Subtract N_b N_c / K, the derivative of the pressures' equations by pressures."""
    nu = m - N.size
    for b in range(N.size):
        s = packed(nu + b, nu + b, m)
        for c in range(b, N.size):
            K[s] -= w * N[b] * N[c] * compliance
            s += ONE


@part(fastmath=FAST)
def add_dyads(
    dN: Array, hoop: Array, f: Array, bend: float, stiff: float, work: Array, w: float, m: int,
    nodal: Array, K: Array,
) -> None:  # fmt: skip
    """Add what :func:`study.fem.element.point_law.polynomial_tangent` and ``add_stiffness`` would.

    Parameters
    ----------
    nodal : ndarray, shape (n_nodes, 12)
        Scratch for f, g, P and Q of each node.
    """
    g = work[0]
    I1, s1 = work[6, 0], work[6, 2]
    first, curved = work[5, 0] * s1, work[5, 2]
    turned = w * (2.0 / 3.0 * first * I1 - bend)
    along, back = 2.0 * s1, -2.0 / 3.0 * s1 * I1
    ff = w * curved * along * along
    fg = w * (curved * along * back - 4.0 / 3.0 * first)
    gg = w * (4.0 / 9.0 * first * I1 + bend + stiff + curved * back * back)
    straight = 2.0 * w * first
    if dN.shape[1] == 3:
        for a in range(dN.shape[0]):
            x, y, z = dN[a, 0], dN[a, 1], dN[a, 2]
            for i in range(3):
                p = f[3 * i] * x + f[3 * i + 1] * y + f[3 * i + 2] * z
                q = g[3 * i] * x + g[3 * i + 1] * y + g[3 * i + 2] * z
                nodal[a, i] = p
                nodal[a, 3 + i] = q
                nodal[a, 6 + i] = ff * p + fg * q
                nodal[a, 9 + i] = fg * p + gg * q
        _add_3d(dN, nodal, straight, turned, m, K)
    else:
        for a in range(dN.shape[0]):
            x, y, h = dN[a, 0], dN[a, 1], hoop[a]
            for i in range(2):
                around = h if i == 0 else 0.0
                c, d = g[3 * i] * x, g[3 * i + 1] * y
                p = f[3 * i] * x + f[3 * i + 1] * y + f[8] * around
                q = c + d + g[8] * around
                nodal[a, i] = p
                nodal[a, 2 + i] = q
                nodal[a, 4 + i] = ff * p + fg * q
                nodal[a, 6 + i] = fg * p + gg * q
                nodal[a, 8 + i] = c + d
            nodal[a, 10], nodal[a, 11] = g[8] * h, g[8]
        _add_axisymmetric(dN, hoop, nodal, straight, turned, m, K)


@part(fastmath=FAST)
def _add_3d(dN: Array, nodal: Array, straight: float, turned: float, m: int, K: Array) -> None:
    na = dN.shape[0]
    for a in range(na):
        x, y, z = straight * dN[a, 0], straight * dN[a, 1], straight * dN[a, 2]
        f0, f1, f2 = nodal[a, 0], nodal[a, 1], nodal[a, 2]
        g0, g1, g2 = nodal[a, 3], nodal[a, 4], nodal[a, 5]
        t0, t1, t2 = turned * g0, turned * g1, turned * g2
        r0 = packed(3 * a, 3 * a, m)
        r1 = packed(3 * a + 1, 3 * a, m)
        r2 = packed(3 * a + 2, 3 * a, m)
        same = x * dN[a, 0] + y * dN[a, 1] + z * dN[a, 2]
        p1, p2, q1, q2 = nodal[a, 7], nodal[a, 8], nodal[a, 10], nodal[a, 11]
        K[r0] += same + f0 * nodal[a, 6] + g0 * nodal[a, 9] + t0 * g0
        K[r0 + ONE] += f0 * p1 + g0 * q1 + t1 * g0
        K[r0 + TWO] += f0 * p2 + g0 * q2 + t2 * g0
        K[r1 + ONE] += same + f1 * p1 + g1 * q1 + t1 * g1
        K[r1 + TWO] += f1 * p2 + g1 * q2 + t2 * g1
        K[r2 + TWO] += same + f2 * p2 + g2 * q2 + t2 * g2
        for b in range(a + 1, na):
            r0 += THREE
            r1 += THREE
            r2 += THREE
            same = x * dN[b, 0] + y * dN[b, 1] + z * dN[b, 2]
            h0, h1, h2 = nodal[b, 3], nodal[b, 4], nodal[b, 5]
            p0, p1, p2 = nodal[b, 6], nodal[b, 7], nodal[b, 8]
            q0, q1, q2 = nodal[b, 9], nodal[b, 10], nodal[b, 11]
            K[r0] += same + f0 * p0 + g0 * q0 + t0 * h0
            K[r0 + ONE] += f0 * p1 + g0 * q1 + t1 * h0
            K[r0 + TWO] += f0 * p2 + g0 * q2 + t2 * h0
            K[r1] += f1 * p0 + g1 * q0 + t0 * h1
            K[r1 + ONE] += same + f1 * p1 + g1 * q1 + t1 * h1
            K[r1 + TWO] += f1 * p2 + g1 * q2 + t2 * h1
            K[r2] += f2 * p0 + g2 * q0 + t0 * h2
            K[r2 + ONE] += f2 * p1 + g2 * q1 + t1 * h2
            K[r2 + TWO] += same + f2 * p2 + g2 * q2 + t2 * h2


@part(fastmath=FAST)
def _add_axisymmetric(
    dN: Array, hoop: Array, nodal: Array, straight: float, turned: float, m: int, K: Array
) -> None:
    na = dN.shape[0]
    for a in range(na):
        x, y = straight * dN[a, 0], straight * dN[a, 1]
        h = straight * hoop[a] + turned * nodal[a, 10] * nodal[a, 11]
        f0, f1, g0, g1 = nodal[a, 0], nodal[a, 1], nodal[a, 2], nodal[a, 3]
        t0, t1 = turned * nodal[a, 8], turned * nodal[a, 9]
        r0, r1 = packed(2 * a, 2 * a, m), packed(2 * a + 1, 2 * a, m)
        same = x * dN[a, 0] + y * dN[a, 1]
        p1, q1 = nodal[a, 5], nodal[a, 7]
        K[r0] += same + h * hoop[a] + f0 * nodal[a, 4] + g0 * nodal[a, 6] + t0 * nodal[a, 8]
        K[r0 + ONE] += f0 * p1 + g0 * q1 + t1 * nodal[a, 8]
        K[r1 + ONE] += same + f1 * p1 + g1 * q1 + t1 * nodal[a, 9]
        for b in range(a + 1, na):
            r0 += TWO
            r1 += TWO
            same = x * dN[b, 0] + y * dN[b, 1]
            p0, p1, q0, q1 = nodal[b, 4], nodal[b, 5], nodal[b, 6], nodal[b, 7]
            h0, h1 = nodal[b, 8], nodal[b, 9]
            K[r0] += same + h * hoop[b] + f0 * p0 + g0 * q0 + t0 * h0
            K[r0 + ONE] += f0 * p1 + g0 * q1 + t1 * h0
            K[r1] += f1 * p0 + g1 * q0 + t0 * h1
            K[r1 + ONE] += same + f1 * p1 + g1 * q1 + t1 * h1
