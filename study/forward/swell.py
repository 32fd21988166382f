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

from study.forward.compiled import part
from study.forward.forms import add_stiffness, along_nodes, deformation_gradient
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
    """Add what uneven volume ratios ``J`` (n_quadrature,) of an element cost to ``R`` and ``K``.

    With d = J - mean J, a constant part of d^3 does no work, since d sums to zero; the rest
    acts as a pressure.

    Parameters
    ----------
    still : tuple of ndarray
        Gradients (n_quadrature, n_nodes, dim), hoop and weights of the element.
    u : ndarray, shape (n_nodes, dim)
        Displacements.
    kappa : float
        Resistance, N/mm^2.
    f, work, tangent, rows : ndarray
        Scratch: (9,), (1 or more, 9), (9, 9) and (3, n_displacement).
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
