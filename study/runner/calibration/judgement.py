"""Whether the constants found make a material, and how far it is stable."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from study.errors import InputError
from study.material.material import Material
from study.material.stability import check, stability
from study.runner.calibration.measured_tests import FitCurve
from study.runner.tables import Tables
from study.setup.setup import known_height_mm


def plausible(material: Material, message: str) -> tuple[str, str, list[str]]:
    """Status of a converged fit by its initial shear modulus."""
    if not material.mu0 > 0:
        rule = f"the fit ended at an initial shear modulus of {1e3 * material.mu0:.4g} kPa"
        return "unstable", rule, []
    try:
        found = list(check(material))
    except InputError as error:
        return "unstable", str(error), []
    if found:
        return "implausible", found[0], []
    return "converged", message, []


def range_stability(
    tests: Sequence[Tables], curves: Sequence[FitCurve], material: Material
) -> tuple[bool, str]:
    """Drucker's criterion over the compressions that were fitted, else over the usual range."""
    strains = [
        float(c.measured.curve.displacement_mm.max()) / height
        for c in curves
        if tests[c.test]["test"]["kind"] == "compression"
        and (height := known_height_mm(tests[c.test]["specimen"])) is not None
    ]
    range_of = [np.linspace(1 - max(strains), 1, 41)] if strains else []
    judged = stability(material, *range_of)
    return bool(judged.stable), judged.sentence
