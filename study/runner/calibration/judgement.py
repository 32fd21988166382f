"""Whether the constants found make a material, and how far it is stable."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from study.design.sections.calibration_design import CalibratedTest
from study.errors import InputError
from study.material.material import Material
from study.material.stability import check, stability
from study.runner.calibration.measured_tests import FitCurve


def plausible(material: Material, message: str) -> tuple[str, str]:
    """Status of a converged fit by its initial shear modulus.

    Parameters
    ----------
    material : Material
        With the constants found.
    message : str
        How the fit ended; returned where nothing speaks against the constants.

    Returns
    -------
    status : {"converged", "implausible", "unstable"}
        ``"unstable"`` also where a user could not give such constants.
    message : str
        Why, where it is not ``"converged"``.
    """
    if not material.mu0 > 0:
        rule = f"the fit ended at an initial shear modulus of {1e3 * material.mu0:.4g} kPa"
        return "unstable", rule
    try:
        found = list(check(material))
    except InputError as error:
        return "unstable", str(error)
    if found:
        return "implausible", found[0]
    return "converged", message


def range_stability(
    tests: Sequence[CalibratedTest], curves: Sequence[FitCurve], material: Material
) -> tuple[bool, str]:
    """Drucker's criterion over the compressions that were measured, else over the usual range.

    Parameters
    ----------
    tests : sequence of CalibratedTest
        All of the calibration.
    curves : sequence of FitCurve
        Measured ones; the largest compressive strain among them, held-out ones included, bounds
        the range.
    material : Material
        With the constants found.

    Returns
    -------
    is_stable : bool
        In uniaxial, equibiaxial and planar loading.
    sentence : str
        The same in words.
    """
    strains = [
        float(c.measured.curve.displacement_mm.max()) / height
        for c in curves
        if (setup := tests[c.test].setup).kind.compresses
        and (height := setup.height_mm) is not None
    ]
    range_of = [np.linspace(1 - max(strains), 1, 41)] if strains else []
    judged = stability(material, *range_of)
    return bool(judged.stable), judged.sentence
