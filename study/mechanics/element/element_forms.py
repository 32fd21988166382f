"""Compiled forms of one element at one quadrature point, in axisymmetric space and in 3D.

Tangents go straight into the packed upper triangle of their element: the entry of row r and
column c >= r, of m unknowns, is number ``r m - r (r + 1) / 2 + c``. These numbers are unsigned:
of a signed one Numba asks each time whether it counts from the end, a fifth of all work here.
"""

from __future__ import annotations

import numpy as np

from study.ground.arrays import Array, Unknowns
from study.ground.compilation import FAST, part

ONE = np.uint64(1)
TWO = np.uint64(2)
THREE = np.uint64(3)


@part()
def packed(row: int, column: int, m: int) -> np.uint64:
    """Find the number of an entry in the packed upper triangle of m rows."""
    return np.uint64(row * m - row * (row + 1) // 2 + column)


@part()
def gather(x: Array, dofs: Unknowns, e: int, u: Array) -> None:
    """Displacements of the nodes of element ``e`` from all unknowns, shape (n_nodes, dim).

    Shapes: x (n,); dofs (n_elements, m); u mm.
    """
    dim = u.shape[1]
    for a in range(u.shape[0]):
        for i in range(dim):
            u[a, i] = x[dofs[e, dim * a + i]]


@part()
def held_pressure(N: Array, x: Array, dofs: Unknowns) -> float:
    """Pressure at one quadrature point from its unknowns, the last of the element's ``dofs``.

    Shapes: N (n_pressure,); x (n,), MPa; dofs (m,).
    """
    pressure, first = 0.0, dofs.size - N.size
    for b in range(N.size):
        pressure += N[b] * x[dofs[first + b]]
    return pressure


@part(fastmath=FAST)
def deformation_gradient(dN: Array, hoop: Array, u: Array, f: Array) -> None:
    """F at one quadrature point from nodal displacements.

    Shapes: dN (n_nodes, dim); hoop (n_nodes,); u (n_nodes, dim), mm; f (9,).
    """
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
    """Add w T : dF/du, node by node: forces of a stress, or dJ/du of dJ/dF.

    Shapes: T (9,), MPa; w mm^3; out (dim n_nodes or more,).
    """
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
def add_coupling(rates: Array, w: float, N: Array, C: Array) -> None:
    """C_b,r += w N_b dJ/du_r, shape (n_pressure, n_displacement).

    Shapes: rates (n_displacement,); w mm^3; N (n_pressure,).
    """
    for b in range(N.size):
        share = w * N[b]
        for r in range(rates.size):
            C[b, r] += share * rates[r]


@part()
def place_coupling(C: Array, m: int, K: Array) -> None:
    """Put what pressures do to displacements into the packed tangent.

    Shapes: C (n_pressure, n_displacement); K (m (m + 1) / 2,).
    """
    n_p, nu = C.shape
    for r in range(nu):
        s = packed(r, nu, m)
        for b in range(n_p):
            K[s] = C[b, r]
            s += ONE


@part()
def add_volume(N: Array, excess: float, w: float, R: Array) -> None:
    """Add N_b (J - 1 - p / K), the equation of each pressure; N (n_pressure,); w mm^3; R (m,)."""
    nu = R.size - N.size
    for b in range(N.size):
        R[nu + b] += w * excess * N[b]


@part()
def add_compressibility(N: Array, w: float, compliance: float, m: int, K: Array) -> None:
    """Subtract N_b N_c / K, the derivative of the pressures' equations by pressures.

    Shapes: N (n_pressure,); w mm^3; K (m (m + 1) / 2,).
    """
    nu = m - N.size
    for b in range(N.size):
        s = packed(nu + b, nu + b, m)
        for c in range(b, N.size):
            K[s] -= w * N[b] * N[c] * compliance
            s += ONE
