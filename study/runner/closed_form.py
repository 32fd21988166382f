"""Closed form of the one homogeneous test: compression between frictionless plates.

Force = area x nominal stress at the stretch 1 - d/H, positive in compression, with the
lateral stretch of the nearly incompressible material where K is finite. The gradient with
respect to the constants is analytic, so a fit costs microseconds.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from study.curve import Curve
from study.errors import Fault, InputError
from study.material import Material
from study.material.homogeneous import response
from study.runner import build

Array = NDArray[np.float64]


def compression(specimen: Mapping[str, Any], material: Material, displacement_mm: Array) -> Curve:
    """Force of a cylinder or block compressed between frictionless plates.

    Parameters
    ----------
    specimen : mapping
        Specimen section with a height and a cross-section.
    displacement_mm : ndarray, shape (n,)
        Displacements, from 0 to below the height.

    Returns
    -------
    Curve
        With ``force_gradient`` in N per MPa for every constant.

    Raises
    ------
    InputError
        If a displacement reaches the height of the specimen.
    """
    height, area = build.height_mm(specimen), build.area_mm2(specimen)
    d = np.asarray(displacement_mm, dtype=float)
    if height is None or d.max(initial=0.0) >= height:
        rule = f"must stay below the height of the specimen ({height} mm), got {d.max():g} mm"
        raise InputError(Fault("test.displacement", rule))
    stretch = 1 - d / height
    state = response(material, "uniaxial", stretch)
    gradient = {name: -area * slope for name, slope in state.gradient.items()}
    return Curve(d, -area * state.stress, force_gradient=gradient)


def neo_hookean_start(
    config: Mapping[str, Any], displacement_mm: Array, force_N: Array
) -> dict[str, float]:
    """C10 (MPa) of the closed form that fits a measured curve best.

    The force is linear in C10 where Poisson's ratio is given, so one linear least
    squares step is the answer; elsewhere it is close enough for a start.
    """
    section = {**config["material"], "constants": None}
    unit = build.material({**section, "model": "neo-hookean"}, {"C10": 1e-2})
    model = compression(config["specimen"], unit, displacement_mm).force_N
    scale = float(model @ force_N / (model @ model))
    if not np.isfinite(scale) or scale <= 0:
        raise InputError(
            Fault(
                "measurements",
                "the measured force does not resist (wrong sign?)",
                "check measurements.sign and the force column",
            )
        )
    return {"C10": 1e-2 * scale}
