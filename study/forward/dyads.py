"""Stiffness of energies of the first invariant, straight from vectors at the nodes.

With ``f_a = F grad N_a`` and ``g_a = F^-T grad N_a`` the stiffness between nodes a and b of
``W(I1bar) + p J`` is a multiple of the identity and a few dyads,

    2 W1 J^(-2/3) (grad N_a . grad N_b) I + f_a x P_b + g_a x Q_b + t g_b x g_a,

with ``P_b`` and ``Q_b`` sums of ``f_b`` and ``g_b``: a third fewer operations than with the
fourth-order tangent, which is never written.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from study.forward.compiled import FAST, part
from study.forward.forms import ONE, THREE, TWO, packed

Array = NDArray[np.float64]


@part(fastmath=FAST)
def add_dyads(
    dN: Array, hoop: Array, f: Array, bend: float, stiff: float, work: Array, w: float, m: int,
    nodal: Array, K: Array,
) -> None:  # fmt: skip
    """Add what :func:`study.forward.law.polynomial_tangent` and ``add_stiffness`` would.

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
