"""Stresses of homogeneous tests by their names, as the literature gives them."""

from functools import partial

import numpy as np

from study.mechanics.material.homogeneous import MODES, response
from study.mechanics.material.material import Material

#: a foam, whose volume change belongs to all of its energy
FOAM = Material(
    "ogden-hill", {"mu1": 0.03, "alpha1": 4.0, "mu2": 0.01, "alpha2": -2.5}, poisson_ratio=0.2
)


def stress(mode, material, stretch):
    """Nominal stress in MPa, sides free but in the confined mode (V01 to V04, V06)."""
    return response(material, mode, stretch).stress.reshape(np.shape(stretch))


uniaxial, equibiaxial, planar, confined = (partial(stress, mode) for mode in MODES)
