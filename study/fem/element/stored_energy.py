"""Compiled sum of the energy that elements store: what the work of the test is compared with.

The mixed form stores ``W_iso(F) + p (J - 1) - p^2 / (2 K)``, whose middle and last term are
``K (J - 1)^2 / 2`` of the pressure's volume where the pressure is in equilibrium. The
resistance to uneven volume (:mod:`study.fem.element.assembly`) is no energy of the material and is
added up apart.
"""

from __future__ import annotations

import math

import numpy as np

from study.arrays import Array, Elements
from study.compilation import FAST, kernel, part
from study.fem.element.assembly import ElementEnergy, Shapes
from study.fem.element.element_forms import deformation_gradient, gather, held_pressure
from study.fem.element.invariant_law import (
    FINITE_EXTENSIBILITY,
    POLYNOMIAL,
    invariant_energy,
)
from study.fem.element.point_law import EXTENDED_TUBE, SMALL_STRAIN, cofactor
from study.fem.element.spectral import principal_axes


@part()
def _second_exponential_ratio(z: float) -> float:
    """(exp(z) - 1 - z) / z^2, 1/2 at zero."""
    if abs(z) > 0.5:
        return (math.expm1(z) - z) / (z * z)
    total, term = 0.0, 0.5
    for k in range(16):  # sum z^k / (k + 2)!: the formula cancels here
        total += term
        term *= z / (k + 3)
    return total


@part()
def ogden_energy(f: Array, terms: Array, c: Array, axes: Array) -> float:
    """Isochoric energy ``sum 2 mu / alpha^2 (sum l^alpha - 3)`` per reference volume.

    Isochoric logarithmic stretches x add up to zero, so that ``exp(alpha x) - 1 - alpha x``
    may stand for ``l^alpha - 1``: it is positive and keeps its digits at small strain.

    Parameters
    ----------
    f : ndarray, shape (9,)
        Deformation gradient.
    terms : ndarray, shape (n, 2)
        Rows (mu, alpha).
    c, axes : ndarray, shape (9,)
        Scratch.
    """
    for i in range(3):
        for j in range(3):
            c[3 * i + j] = f[i] * f[j] + f[3 + i] * f[3 + j] + f[6 + i] * f[6 + j]
    principal_axes(c, axes)
    mean = (math.log(c[0]) + math.log(c[4]) + math.log(c[8])) / 6.0
    energy = 0.0
    for a in range(3):
        x = 0.5 * math.log(c[4 * a]) - mean
        for k in range(terms.shape[0]):
            energy += 2.0 * terms[k, 0] * x * x * _second_exponential_ratio(terms[k, 1] * x)
    return energy


@part(fastmath=FAST)
def isochoric_energy(law: int, f: Array, J: float, constants: Array) -> float:
    """Energy W(I1bar, I2bar) per reference volume.

    Parameters
    ----------
    law : int
        Number of a :class:`study.material.energy.PointLaw`.
    f : ndarray, shape (9,)
        Deformation gradient.
    J : float
        Its determinant, positive.
    constants : ndarray, shape (n, m)
        Of the law; m = 1 if the second invariant does not enter.
    """
    I1 = 0.0
    for i in range(9):
        I1 += f[i] * f[i]
    s1 = J ** (-2.0 / 3.0)
    a, b = s1 * I1 - 3.0, 0.0
    if constants.shape[1] > 1:
        trace = 0.0
        for i in range(3):
            for j in range(3):
                c = f[i] * f[j] + f[3 + i] * f[3 + j] + f[6 + i] * f[6 + j]
                trace += c * c
        b = 0.5 * s1 * s1 * (I1 * I1 - trace) - 3.0
    return invariant_energy(law, constants, a, b)


@part()
def linear_energy(f: Array, mu: float) -> float:
    """Deviatoric small-strain energy ``mu dev(eps) : dev(eps)`` per volume.

    Parameters
    ----------
    f : ndarray, shape (9,)
        1 + grad u.
    mu : float
        Shear modulus, MPa.
    """
    mean, energy = (f[0] + f[4] + f[8]) / 3.0, 0.0
    for i in range(3):
        for j in range(3):
            strain = 0.5 * (f[3 * i + j] + f[3 * j + i]) - (mean if i == j else 0.0)
            energy += mu * strain * strain
    return energy


@kernel(nogil=True)
def stored_energy(
    elements: Elements, space: Shapes, energy: ElementEnergy, x: Array, out: Array
) -> float:
    """Energy of some elements.

    Parameters
    ----------
    elements, space, energy, x
        As for :func:`study.fem.element.assembly.assemble`.
    out : ndarray, shape (n_elements, 2)
        Overwritten: energy of the material, and of the resistance to uneven volume, N mm.

    Returns
    -------
    float
        0: parts of a mesh are gone through by what also looks for the smallest J.
    """
    gradients, hoop, pressure_shape, weights, dofs = space
    law, constants, bulk, compliance, kappa = energy
    nq, na, dim = gradients.shape[1:]
    shared = pressure_shape.shape[0] == 1
    u, f, g, axes, ratios = (
        np.empty((na, dim)), np.empty(9), np.empty(9), np.empty(9), np.empty(nq),
    )  # fmt: skip
    for e in elements:
        gather(x, dofs, e, u)
        total, volume, swollen = 0.0, 0.0, 0.0
        for q in range(nq):
            deformation_gradient(gradients[e, q], hoop[e, q], u, f)
            J = f[0] + f[4] + f[8] - 2.0 if law == SMALL_STRAIN else cofactor(f, g)
            if law == SMALL_STRAIN:
                density = linear_energy(f, constants[0, 0])
            elif law >= POLYNOMIAL:
                density = isochoric_energy(law, f, J, constants)
            elif law == EXTENDED_TUBE:
                tubes = constants[4:6].reshape(1, 2)
                density = isochoric_energy(FINITE_EXTENSIBILITY, f, J, constants)
                density += ogden_energy(f, tubes, g, axes)
            else:
                density = ogden_energy(f, constants, g, axes)
            p = held_pressure(pressure_shape[0 if shared else e, q], x, dofs[e])
            density += p * (J - 1.0) - 0.5 * compliance * p * p + 0.5 * bulk * (J - 1.0) ** 2
            w = weights[e, q]
            ratios[q] = J
            total += w * density
            volume += w
            swollen += w * J
        uneven = 0.0
        for q in range(nq):
            uneven += 0.25 * kappa * weights[e, q] * (ratios[q] - swollen / volume) ** 4
        out[e, 0] = total
        out[e, 1] = uneven
    return 0.0
