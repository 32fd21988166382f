"""Where an energy loses its ellipticity: deformation may then gather in bands of no width.

An incompressible isotropic material is strongly elliptic in the plane of two principal
stretches l1, l2 where ``alpha > 0`` and ``beta > -sqrt(alpha gamma)`` (Dowaikh and Ogden 1990,
IMA J. Appl. Math. 44, 261, eqs. 2.14 to 2.18), with

    alpha = l1^2 (t1 - t2) / (l1^2 - l2^2),    gamma = alpha l2^2 / l1^2,
    2 beta = h11 - t1 + h22 - t2 - 2 h12 + 2 (l1^2 t2 - l2^2 t1) / (l1^2 - l2^2),

``t = dW / dln l`` and ``h = d2W / dln l dln l``. A common pressure drops out. Past that point
an answer depends on the mesh, and no finer one mends it. Ogden's terms with exponents of one
and more never get there; Hencky's quadratic logarithm, which an exponent of zero is, does at a
ratio of stretches of 11.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from study.arrays import Array
from study.material.material import Material

#: equal stretches are taken this far apart (relative), where the formulas have their limit
_APART = 1e-4


def always_elliptic(material: Material) -> bool:
    """Whether an energy is known to keep its ellipticity at every stretch; False says nothing.

    Parameters
    ----------
    material : Material
        Of any energy but one whose volume change belongs to all of it.
    """
    return material.small_strain or material.isochoric.always_elliptic(material.constants)


def ellipticity(material: Material, stretches: Array) -> Array:
    """How far from losing its ellipticity an energy is, in the worst of the principal planes.

    Parameters
    ----------
    material : Material
        Hyperelastic.
    stretches : ndarray, shape (3, n)
        Principal stretches; their volume change is left out.

    Returns
    -------
    ndarray, shape (n,)
        Smallest of alpha and beta + sqrt(alpha gamma) in MPa, not positive where it is lost.

    Examples
    --------
    >>> rubber = Material("neo-hookean", {"C10": 1.0}, incompressible=True)
    >>> ellipticity(rubber, np.array([[1.0], [1.0], [1.0]])).round(3)
    array([2.])
    """
    bar = _apart(stretches / np.cbrt(stretches.prod(axis=0)))
    energy, constants = material.isochoric, material.constants
    t = energy.principal_stress(constants, bar)
    h = energy.principal_stress_slope(constants, bar, np.eye(3))
    worst = np.full(bar.shape[1], np.inf)
    for i, j in combinations(range(3), 2):
        a, b = bar[i], bar[j]
        shear = (t[i] - t[j]) / (a**2 - b**2)
        beta = 0.5 * (h[i, i] - t[i] + h[j, j] - t[j]) - h[i, j]
        beta += (a**2 * t[j] - b**2 * t[i]) / (a**2 - b**2)
        alpha = shear * np.minimum(a, b) ** 2
        worst = np.minimum(worst, np.minimum(alpha, beta + a * b * shear))
    return worst


def _apart(bar: Array) -> Array:
    """Sorted stretches, the largest first, no two of them equal."""
    ordered = np.sort(bar, axis=0)[::-1].copy()
    ordered[0] *= np.where(ordered[0] < (1 + _APART) * ordered[1], 1 + _APART, 1.0)
    ordered[2] *= np.where(ordered[1] < (1 + _APART) * ordered[2], 1 - _APART, 1.0)
    return ordered
