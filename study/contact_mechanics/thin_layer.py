"""Dimitriadis' series for a sphere on a layer, for comparison with published moduli.

Dimitriadis, Horkay, Maresca, Kachar and Chadwick 2002 (Biophys. J. 82, 2798, eq. 7 and 12) give
the force of a sphere over Hertz's as a polynomial of chi = sqrt(R d) / h. It is a truncated
expansion: against the integral equation its force is 1 % low at chi = 0.2, 3 % at 0.3 and 8 % at
0.5 (nu = 0.5, bonded), and moduli by it are high by as much. The coefficient of chi^4 at
nu = 0.5 bonded is -0.0976 by the paper's own formula, which is used here; the paper prints
+0.0975, a difference of 0.7 % of the force at chi = 0.5.
"""

from __future__ import annotations

import numpy as np

from study.arrays import Array
from study.contact_mechanics.layer import Layer


def coefficients(layer: Layer) -> Array:
    """Coefficients of chi^0 to chi^4, shape (5,).

    Parameters
    ----------
    layer : Layer
        Its Poisson's ratio and whether it is bonded to its base.

    Examples
    --------
    >>> coefficients(Layer(1.0, 0.5, bonded=False)).round(3).tolist()
    [1.0, 0.884, 0.781, 0.386, 0.005]
    """
    nu = layer.poisson_ratio
    if layer.bonded:
        alpha = -(1.2876 - 1.4678 * nu + 1.3442 * nu**2) / (1 - nu)
        beta = (0.6387 - 1.0277 * nu + 1.5164 * nu**2) / (1 - nu)
    else:
        alpha = -0.347 * (3 - 2 * nu) / (1 - nu)
        beta = 0.056 * (5 - 2 * nu) / (1 - nu)
    third = alpha**3 + 4 * np.pi**2 / 15 * beta
    fourth = alpha**3 + 3 * np.pi**2 / 5 * beta
    x = 1 / np.pi
    series = [1.0, -2 * alpha * x, 4 * alpha**2 * x**2, -8 * third * x**3]
    return np.array([*series, 16 * alpha * fourth * x**4])


def correction(layer: Layer, radius_mm: float, depth_mm: Array) -> Array:
    """Force of a sphere of a radius over Hertz's at depths, shape (n,).

    Parameters
    ----------
    layer : Layer
        What is indented.
    radius_mm : float
        Radius of the sphere.
    depth_mm : ndarray, shape (n,)
        Depths, not negative.
    """
    chi = np.sqrt(radius_mm * depth_mm) / layer.height_mm
    return np.asarray(np.polynomial.Polynomial(coefficients(layer))(chi))
