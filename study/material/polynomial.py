"""Isochoric energies in principal stretches: the formulas behind every closed form.

With isochoric principal stretches ``bar`` (product 1) the *source* is
``s_i = bar_i dW/dbar_i``; its deviator is the principal isochoric Kirchhoff stress
(Holzapfel 2000, eqs. 6.82 and 6.103). Everything is differentiated with respect to
logarithmic stretches, where the derivative of the source is symmetric.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.polynomial import polynomial

from study.arrays import Array
from study.material.material import Material


def source(material: Material, bar: Array) -> Array:
    """``bar_i dW/dbar_i``, up to a common constant that the deviator drops.

    Parameters
    ----------
    material : Material
        Of the polynomial or the Ogden family.
    bar : ndarray, shape (3, ...)
        Isochoric principal stretches.

    Returns
    -------
    ndarray, shape (3, ...)
        In MPa.
    """
    if material.family == "ogden":
        log = np.log(bar)
        terms = zip(*material.ogden_terms(), strict=True)
        return np.asarray(sum(2 * mu * log * _phi(alpha * log) for mu, alpha in terms))
    return _polynomial_source(material.coefficient_table(), bar)


def source_slope(material: Material, bar: Array, direction: Array) -> Array:
    """Differentiate :func:`source` along a direction of logarithmic isochoric stretches.

    Parameters
    ----------
    material : Material
        Of the polynomial or the Ogden family.
    bar : ndarray, shape (3, n)
        Isochoric principal stretches.
    direction : ndarray, shape (3,)
        Rates of ``ln bar``.
    """
    v = direction[:, None]
    if material.family == "ogden":
        terms = zip(*material.ogden_terms(), strict=True)
        return np.asarray(sum(2 * mu * bar**alpha * v for mu, alpha in terms))
    table = material.coefficient_table()
    b, i1, x, y = _invariants(bar)
    w1, w2 = _slopes(table, x, y)
    w11, w12 = _slopes(np.asarray(polynomial.polyder(table, axis=0), float), x, y)
    w22 = _slopes(np.asarray(polynomial.polyder(table, axis=1), float), x, y)[1]
    db = 2 * b * v
    di1, di2 = db.sum(0), ((i1 - b) * db).sum(0)
    dw1, dw2 = w11 * di1 + w12 * di2, w12 * di1 + w22 * di2
    return np.asarray(
        2 * db * (w1 + w2 * (i1 - b)) + 2 * b * (dw1 + dw2 * (i1 - b) + w2 * (di1 - db))
    )


def source_gradient(material: Material, bar: Array) -> dict[str, Array]:
    """Differentiate :func:`source` with respect to every constant, each shape (3, ...)."""
    if material.family == "ogden":
        return _ogden_gradient(material, bar)
    gradient = {}
    for name in material.names:
        unit = np.zeros_like(material.coefficient_table())
        unit[material.table_index(name)] = 1.0
        gradient[name] = _polynomial_source(unit, bar)
    return gradient


def energy_density(material: Material, bar: Array) -> Array:
    """Isochoric strain energy in MPa at isochoric principal stretches, shape (3, ...)."""
    if material.family == "ogden":
        log = np.log(bar)
        # sum (l^a - 3)/a^2 with sum(log) = 0: quadratic in log, and finite at a = 0
        terms = zip(*material.ogden_terms(), strict=True)
        return np.asarray(sum(2 * mu * (log**2 * _phi2(alpha * log)).sum(0) for mu, alpha in terms))
    _, _, x, y = _invariants(bar)
    return np.asarray(polynomial.polyval2d(x, y, material.coefficient_table()))


def deviator(values: Array) -> Array:
    """Subtract the mean over the first axis."""
    return np.asarray(values - values.mean(0))


def _polynomial_source(table: Array, bar: Array) -> Array:
    b, i1, x, y = _invariants(bar)
    w1, w2 = _slopes(table, x, y)
    return np.asarray(2 * b * (w1 + w2 * (i1 - b)))


def _invariants(bar: Array) -> tuple[Array, Array, Array, Array]:
    b = bar**2
    i1 = b.sum(0)
    i2 = b[0] * b[1] + b[1] * b[2] + b[2] * b[0]
    return b, i1, i1 - 3, i2 - 3


def _slopes(table: Array, x: Array, y: Array) -> tuple[Array, Array]:
    d1 = polynomial.polyval2d(x, y, polynomial.polyder(table, axis=0))
    d2 = polynomial.polyval2d(x, y, polynomial.polyder(table, axis=1))
    return np.asarray(d1, float), np.asarray(d2, float)


def _ogden_gradient(material: Material, bar: Array) -> dict[str, Array]:
    log = np.log(bar)
    gradient: dict[str, Array] = {}
    for i, (mu, alpha) in enumerate(zip(*material.ogden_terms(), strict=True), start=1):
        z = alpha * log
        gradient[f"mu{i}"] = 2 * log * _phi(z)
        gradient[f"alpha{i}"] = 2 * mu * log**2 * _phi_slope(z)
    return gradient


def _phi(z: Array) -> Array:
    """(e^z - 1) / z, with its limit 1 at zero."""
    return _series_or(z, lambda k: 1.0 / (k + 1), lambda w: np.expm1(w) / w)


def _phi2(z: Array) -> Array:
    """(e^z - 1 - z) / z^2, with its limit 1/2 at zero."""
    return _series_or(z, lambda k: 1.0 / ((k + 1) * (k + 2)), lambda w: (np.expm1(w) - w) / w**2)


def _phi_slope(z: Array) -> Array:
    """Differentiate :func:`_phi`, with its limit 1/2 at zero."""
    return _series_or(z, lambda k: 1.0 / (k + 2), lambda w: (np.exp(w) * (w - 1) + 1) / w**2)


def _series_or(
    z: Array, weight: Callable[[int], float], formula: Callable[[Array], Array]
) -> Array:
    """Power series sum weight(k) z^k / k! where |z| < 0.5, the formula elsewhere.

    Below 0.5 the formulas lose digits to cancellation; 18 terms reach rounding there.
    """
    z = np.asarray(z, dtype=float)
    small = np.abs(z) < 0.5
    near, total, power = np.where(small, z, 0.0), np.zeros_like(z), np.ones_like(z)
    for k in range(18):
        total = total + weight(k) * power
        power = power * near / (k + 1)
    far = formula(np.where(small, 1.0, z))
    return np.where(small, total, far)
