"""Stresses of homogeneous tests by their names, as the literature gives them."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from study.ground.arrays import Array
from study.mechanics.material.homogeneous import MODES, first_piola, response
from study.mechanics.material.material import Material

#: a foam, whose volume change belongs to all of its energy
FOAM = Material(
    "ogden-hill", {"mu1": 0.03, "alpha1": 4.0, "mu2": 0.01, "alpha2": -2.5}, poisson_ratio=0.2
)


def stress(mode: str, material: Material, stretch: ArrayLike) -> Array:
    """Nominal stress in MPa, sides free but in the confined mode (V01 to V04, V06)."""
    return _shaped(response(material, mode, stretch).stress, stretch)


uniaxial, equibiaxial, planar, confined = (partial(stress, mode) for mode in MODES)


def uniaxial_gradient(material: Material, stretch: ArrayLike) -> dict[str, Array]:
    """Total derivative of :func:`uniaxial` with respect to every constant, K(nu) included."""
    # Units: returns MPa.
    gradient = response(material, "uniaxial", stretch).gradient
    return {name: _shaped(value, stretch) for name, value in gradient.items()}


def simple_shear(material: Material, shear: ArrayLike) -> tuple[Array, Array, Array]:
    """Cauchy stresses (s12, s11, s22) in MPa in simple shear with s33 = 0 (V05); shear (n,)."""
    g = np.atleast_1d(np.asarray(shear, dtype=float))
    F = np.zeros((3, 3, g.size))
    F[[0, 1, 2], [0, 1, 2]], F[0, 1] = 1.0, g
    sigma = np.einsum("iA...,jA...->ij...", first_piola(material, F), F)
    parts = sigma[0, 1], sigma[0, 0] - sigma[2, 2], sigma[1, 1] - sigma[2, 2]
    s12, s11, s22 = (_shaped(part, shear) for part in parts)
    return s12, s11, s22


def _shaped(values: Array, like: ArrayLike) -> Array:
    return np.asarray(values).reshape(np.shape(like))
