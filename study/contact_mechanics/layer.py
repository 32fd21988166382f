"""Kernel of an elastic layer: what its support adds to the answer of a half-space.

The surface of a layer of height h answers a pressure of wave number x/h as that of a half-space
does, times K(x). On a bonded base, with the shear stress on the surface zero,

    K = ((3 - 4 nu) sinh 2x - 2x) / ((3 - 4 nu) cosh 2x + 2x^2 + 5 - 12 nu + 8 nu^2),

and on a frictionless base K = 2 sinh^2 x / (sinh 2x + 2x), whatever nu (Lebedev and Ufliand 1958,
J. Appl. Math. Mech. 22, 442; Hayes, Keer, Herrmann and Mockros 1972, J. Biomech. 5, 541).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from study.arrays import Array

#: wave number times height at which the integral is cut: 1 - K is below 1e-15 there
_LONGEST = 25.0

#: Gauss points over the wave numbers; cosines of contacts five heights wide are resolved
_WAVES = 240


@dataclass(frozen=True)
class Layer:
    """An elastic layer on a rigid base.

    Parameters
    ----------
    height_mm : float
        Its height, above zero; infinite for a half-space.
    poisson_ratio : float
        Above -1 and at most 0.5.
    bonded : bool
        Whether it sticks to the base; it slides without friction otherwise.
    """

    height_mm: float
    poisson_ratio: float
    bonded: bool = True

    @property
    def is_half_space(self) -> bool:
        """Whether nothing of the base is felt."""
        return not np.isfinite(self.height_mm)

    def coupling(self, places_mm: Array, others_mm: Array) -> Array:
        """Kernel of the integral equation, 1/mm, shape (n, m).

        2/(pi h) int (1 - K(x)) cos(x s/h) cos(x t/h) dx for places s and t, in mm from the axis.
        """
        if self.is_half_space:
            return np.zeros((places_mm.size, others_mm.size))
        waves, weights = _missing(self.poisson_ratio, self.bonded)
        first = np.cos(np.outer(places_mm / self.height_mm, waves))
        second = np.cos(np.outer(others_mm / self.height_mm, waves))
        return np.asarray(2 / (np.pi * self.height_mm) * (first * weights) @ second.T)


@lru_cache(maxsize=16)
def _missing(nu: float, bonded: bool) -> tuple[Array, Array]:
    """Gauss points x and weights of the integral of (1 - K(x)) times a function."""
    points, weights = np.polynomial.legendre.leggauss(_WAVES)
    x = 0.5 * _LONGEST * (points + 1)
    if bonded:
        k = 3 - 4 * nu
        below = k * np.cosh(2 * x) + 2 * x**2 + 5 - 12 * nu + 8 * nu**2
        answer = (k * np.sinh(2 * x) - 2 * x) / below
    else:
        answer = 2 * np.sinh(x) ** 2 / (np.sinh(2 * x) + 2 * x)
    return x, 0.5 * _LONGEST * weights * (1 - answer)
