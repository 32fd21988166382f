"""A resistance to uneven volume within an element, which its pressures cannot see.

The bubble of a MINI triangle or tetrahedron can swell one part of its element and shrink
another at no cost but that of shear: the pressure is linear and holds averages alone. Under a
needle single elements then collapse into slivers (J of a tenth), and the surface slips over
the tip on one facet, for which the discrete equations have limit points that finer meshes
meet the earlier. To the energy is added, element by element,

    kappa / 4 * integral of (J - mean of J over the element)^4.

Quadratic tetrahedra do the like where a surface is drawn over a sharp edge and stretched five
times: single points collapse between the nodes.

It leaves the average to the pressures, so that it locks nothing, and it is of fourth order: no
matter where an element deforms nearly evenly, and stiff where it is about to collapse.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from study.forward.compiled import kernel, part
from study.forward.forms import add_stiffness, along_nodes, deformation_gradient, gather
from study.forward.law import add_pressure_tangent, cofactor

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
def _add_means(cross: Array, mean_rate: Array, stiff: float, m: int, K: Array) -> None:
    """Add what the mean owes to the unknowns, to the packed tangent of one element."""
    nu, s = mean_rate.size, 0
    for i in range(nu):
        for j in range(i, nu):
            between = cross[i] * mean_rate[j] + mean_rate[i] * cross[j]
            K[s] += stiff * mean_rate[i] * mean_rate[j] - between
            s += 1
        s += m - nu


@kernel()
def add_unevenness(
    gradients: Array,
    hoop: Array,
    weights: Array,
    dofs: NDArray[np.int32],
    x: Array,
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
    nu, m = dim * na, dofs.shape[1]
    u, f, g, tangent = np.empty((na, dim)), np.empty(9), np.empty(9), np.empty((9, 9))
    rates, mean_rate, cross = np.empty(nu), np.empty(nu), np.empty(nu)
    for e in range(ne):
        gather(x, dofs, e, u)
        mean_rate[:] = 0.0
        cross[:] = 0.0
        volume, mean, even, stiff = _means(J[e], weights[e], kappa)
        for q in range(nq):
            dN, H, w = gradients[e, q], hoop[e, q], weights[e, q]
            deformation_gradient(dN, H, u, f)
            growth = cofactor(f, g)
            d = growth - mean
            pressure, stiffness = kappa * d**3 - even, 3.0 * kappa * d**2
            along_nodes(dN, H, g, rates)
            for i in range(nu):
                R[e, i] += w * pressure * rates[i]
            if want_tangent:
                mean_rate += w / volume * rates
                cross += w * stiffness * rates
                for i in range(9):
                    g[i] /= growth
                tangent[:] = 0.0
                bend = pressure * growth
                add_pressure_tangent(g, bend, stiffness * growth * growth, tangent)
                add_stiffness(dN, H, tangent, w, m, K[e])
        if want_tangent:
            _add_means(cross, mean_rate, stiff, m, K[e])
