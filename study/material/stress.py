"""Stress and tangent of a material at a deformation gradient."""

from __future__ import annotations

import math

import numpy as np

from study.arrays import Array
from study.errors import Fault, InputError
from study.material.material import Material


def strain_energy(material: Material, F: Array) -> Array:
    """Strain energy per unit reference volume in MPa.

    Parameters
    ----------
    material : Material
        With K/2 (J-1)^2 where K is finite, its isochoric part alone otherwise.
    F : ndarray, shape (3, 3, ...)
        Deformation gradient with positive determinant.

    Returns
    -------
    ndarray, shape (...)

    Raises
    ------
    InputError
        If the energy does not reach this state (its chains end before).
    """
    if material.small_strain:
        strain, trace = _small_strain(F)
        mu, pressure = material.mu0, _finite(material.bulk)
        dev = strain - trace / 3 * _identity(F)
        return np.asarray(mu * (dev**2).sum((0, 1)) + pressure / 2 * trace**2)
    stretch, _, J = _spectral(F)
    if (foam := material.compressible) is not None:
        found = foam.energy_density(material.constants, material.compressibility, stretch)
        return _reached(material, found)
    bar = stretch / np.cbrt(J)
    energy = _reached(material, material.isochoric.energy_density(material.constants, bar))
    return energy + _finite(material.bulk) / 2 * (J - 1) ** 2


def first_piola(material: Material, F: Array) -> Array:
    """First Piola-Kirchhoff (nominal) stress dW/dF in MPa, shape (3, 3, ...).

    Parameters
    ----------
    material : Material
        With K where it is finite; the isochoric stress alone otherwise.
    F : ndarray, shape (3, 3, ...)
        Deformation gradient with positive determinant.

    Raises
    ------
    InputError
        If the energy does not reach this state (its chains end before).
    """
    if material.small_strain:
        return _linear_stress(F, material.mu0, _finite(material.bulk))
    stretch, axes, J = _spectral(F)
    if (foam := material.compressible) is not None:
        tau = foam.kirchhoff(material.constants, material.compressibility, stretch)
        return _assemble(F, stretch, axes, _reached(material, tau))
    bar = stretch / np.cbrt(J)
    stress = _reached(material, material.isochoric.principal_stress(material.constants, bar))
    kirchhoff = deviator(stress)
    return _assemble(F, stretch, axes, kirchhoff + _finite(material.bulk) * J * (J - 1))


def first_piola_gradient(material: Material, F: Array) -> dict[str, Array]:
    """Differentiate :func:`first_piola` by every constant, K(nu) included.

    Parameters
    ----------
    material, F
        As for :func:`first_piola`.

    Returns
    -------
    dict of str to ndarray, shape (3, 3, ...)
        By the name of the constant: MPa over the constant's unit.
    """
    dbulk = material.bulk_gradient()
    if material.small_strain:
        dmu = material.mu0_gradient()
        return {n: _linear_stress(F, dmu[n], dbulk[n]) for n in material.names}
    stretch, axes, J = _spectral(F)
    if (foam := material.compressible) is not None:
        slopes = foam.kirchhoff_gradient(material.constants, material.compressibility, stretch)
        return {name: _assemble(F, stretch, axes, slope) for name, slope in slopes.items()}
    partial = material.isochoric.principal_stress_gradient(material.constants, stretch / np.cbrt(J))
    return {
        name: _assemble(F, stretch, axes, deviator(value) + dbulk[name] * J * (J - 1))
        for name, value in partial.items()
    }


def _reached(material: Material, values: Array) -> Array:
    """Refuse states that an energy does not reach, where it answers NaN."""
    if np.isnan(values).any():
        rule = f"{material.model} has no stress at this state: it lies beyond the end of the chains"
        mend = "deform less, or give constants whose limit lies further away"
        raise InputError(Fault("material", rule, mend))
    return values


def deviator(values: Array) -> Array:
    """Subtract the mean over the first axis.

    Parameters
    ----------
    values : ndarray, shape (3, ...)
        One row for each principal direction.
    """
    # what ``mean`` computes, at half its cost for a few points
    return np.asarray(values - np.add.reduce(values) / len(values))


def _assemble(F: Array, stretch: Array, axes: Array, kirchhoff: Array) -> Array:
    """F S with S = sum tau_i / l_i^2 N_i x N_i."""
    S = np.einsum("Ai...,Bi...,i...->AB...", axes, axes, kirchhoff / stretch**2)
    return np.asarray(np.einsum("iA...,AB...->iB...", F, S))


def _spectral(F: Array) -> tuple[Array, Array, Array]:
    """Principal stretches (3, ...), their reference axes (3, 3, ...) and J (...)."""
    moved = np.moveaxis(F, (0, 1), (-2, -1))
    # singular values of F lose no digits, eigenvalues of F'F would lose half near singularity
    _, stretch, axes = np.linalg.svd(moved)
    return (
        np.moveaxis(stretch, -1, 0),
        np.moveaxis(axes, (-1, -2), (0, 1)),
        np.asarray(np.linalg.det(moved)),
    )


def _linear_stress(F: Array, mu: float, bulk: float) -> Array:
    strain, trace = _small_strain(F)
    eye = _identity(F)
    return np.asarray(2 * mu * (strain - trace / 3 * eye) + bulk * trace * eye)


def _small_strain(F: Array) -> tuple[Array, Array]:
    strain = 0.5 * (F + np.swapaxes(F, 0, 1)) - _identity(F)
    return strain, np.asarray(np.trace(strain))


def _identity(F: Array) -> Array:
    return np.eye(3).reshape((3, 3) + (1,) * (F.ndim - 2))


def _finite(bulk: float) -> float:
    return 0.0 if math.isinf(bulk) else bulk
