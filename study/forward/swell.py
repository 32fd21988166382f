"""A resistance to uneven volume within an element, which its pressures cannot see.

The bubble of a MINI triangle or tetrahedron can swell one part of its element and shrink
another at no cost but that of shear: the pressure is linear and holds averages alone. Under a
needle single elements then collapse into slivers (J of a tenth), and the surface slips over
the tip on one facet, for which the discrete equations have limit points that finer meshes
meet the earlier. To the energy is added, element by element,

    kappa / 4 * integral of (J - mean of J over the element)^4.

It leaves the average to the pressures, so that it locks nothing, and it is of fourth order: no
matter where an element deforms nearly evenly, and stiff where it is about to collapse.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from study.forward.compiled import kernel, part
from study.forward.kernels import (
    add_stiffness_3d,
    add_stiffness_axisymmetric,
    along_nodes,
    deformation_gradient,
)
from study.forward.law import add_pressure, cofactor

Array = NDArray[np.float64]


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
def _add_packed(Kl: Array, cross: Array, mean_rate: Array, stiff: float, m: int, K: Array) -> None:
    """Add the upper triangle of one element to its packed rows of ``m`` unknowns."""
    nu, s = mean_rate.size, 0
    for i in range(nu):
        for j in range(i, nu):
            between = cross[i] * mean_rate[j] + mean_rate[i] * cross[j]
            K[s] += Kl[i, j] - between + stiff * mean_rate[i] * mean_rate[j]
            s += 1
        s += m - nu


@kernel()
def add_unevenness(
    gradients: Array,
    hoop: Array,
    weights: Array,
    u: Array,
    J: Array,
    kappa: float,
    want_tangent: bool,
    R: Array,
    K: Array,
) -> None:
    """Add what uneven volume ratios ``J`` (n_elements, n_quadrature) cost to ``R`` and ``K``.

    ``kappa`` is in N/mm^2; shapes are those of
    :func:`study.forward.kernels.element_residuals`. With d = J - mean J, a constant part of
    d^3 does no work, since d sums to zero; the rest acts as a pressure.
    """
    ne, nq, na, dim = gradients.shape
    nu, m = dim * na, R.shape[1]
    f, g = np.empty(9), np.empty(9)
    stress, tangent = np.zeros(9), np.zeros((9, 9))
    Kl, Rl, rates = np.empty((nu, nu)), np.empty(nu), np.empty(nu)
    mean_rate, cross = np.empty(nu), np.empty(nu)
    for e in range(ne):
        Kl[:] = 0.0
        Rl[:] = 0.0
        mean_rate[:] = 0.0
        cross[:] = 0.0
        volume, mean, even, stiff = _means(J[e], weights[e], kappa)
        for q in range(nq):
            dN, H, w = gradients[e, q], hoop[e, q], weights[e, q]
            deformation_gradient(dN, H, u[e], f)
            growth = cofactor(f, g)
            d = growth - mean
            pressure, stiffness = kappa * d**3 - even, 3.0 * kappa * d**2
            along_nodes(dN, H, g, rates)
            Rl += w * pressure * rates
            if want_tangent:
                mean_rate += w / volume * rates
                cross += w * stiffness * rates
                for i in range(9):
                    g[i] /= growth
                stress[:] = 0.0
                tangent[:] = 0.0
                add_pressure(growth, g, pressure, stiffness, 1.0, stress, tangent, True)
                if dim == 3:
                    add_stiffness_3d(dN, tangent, w, Kl)
                else:
                    add_stiffness_axisymmetric(dN, H, tangent, w, Kl)
        for i in range(nu):
            R[e, i] += Rl[i]
        if want_tangent:
            _add_packed(Kl, cross, mean_rate, stiff, m, K[e])
