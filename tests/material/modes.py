"""Stresses of homogeneous tests by their names, as the literature gives them."""

from functools import partial

import numpy as np

from study.mechanics.material.homogeneous import MODES, response
from study.mechanics.material.material import Material, constant_names, energy_named

#: a foam, whose volume change belongs to all of its energy
FOAM = Material(
    "ogden-hill", {"mu1": 0.03, "alpha1": 4.0, "mu2": 0.01, "alpha2": -2.5}, poisson_ratio=0.2
)


def solid(model, *values, **volume):
    """Material with its constants in the order of the energy."""
    orders = (1, 2, 3) if energy_named(model).has_order else (None,)
    names = next(n for o in orders if len(n := constant_names(model, o)) == len(values))
    return Material(model, dict(zip(names, values, strict=True)), **volume)


def stress(mode, material, stretch):
    """Nominal stress in MPa, sides free but in the confined mode (V01 to V04, V06)."""
    return response(material, mode, stretch).stress.reshape(np.shape(stretch))


uniaxial, equibiaxial, planar, confined = (partial(stress, mode) for mode in MODES)
