"""Measured forces that no soft material gives: a unit or a size may be wrong.

The modulus behind a curve is estimated from one point in the middle of it: nominal stress over
nominal strain where plates load a specimen, and the half-spaces of Boussinesq (flat), Hertz
(sphere) and Love (cone) where an indenter does (Sneddon 1965, Int. J. Eng. Sci. 3, 47, with
Poisson's ratio 1/2). A specimen that is bonded or thin is some times stiffer than that; a window
of five decades does not mind.
"""

from __future__ import annotations

import math
from dataclasses import replace

from study.material.loading import LOADINGS
from study.measurement.measured_test import Measurements
from study.setup.geometry import Cone, Enclosed, Flat, Indenter, Sphere
from study.setup.setup import Setup

#: Young's moduli of tissue, gels, silicone and rubber, MPa: 0.1 kPa to 30 MPa
SOFT_MPA = (1e-4, 30.0)
#: 1 - nu^2 of what keeps its volume
_PLANE = 0.75
_THOUSAND = 1000.0

#: how a note of this module can be told from others
IMPLAUSIBLE = "no soft material"


def apparent_modulus(setup: Setup, displacement_mm: float, force_N: float) -> float | None:  # noqa: N803
    """Young's modulus in MPa that one point of a curve speaks for.

    Parameters
    ----------
    setup : Setup
        Specimen and test.
    displacement_mm, force_N : float
        The point, both positive.

    Returns
    -------
    float or None
        None for a specimen whose section is not known.

    Examples
    --------
    A cylinder of 10 mm radius and 20 mm height, pressed 2 mm by 3.1416 N: 10 kPa over 10 %.

    >>> from study.setup.setup import Setup
    >>> cylinder = {"shape": "cylinder", "radius_mm": 10.0, "height_mm": 20.0}
    >>> setup = Setup.of({"specimen": cylinder, "test": {"kind": "compression"}})
    >>> round(apparent_modulus(setup, 2.0, 3.1416), 4)
    0.1
    """
    indenter = setup.test.indenter
    if indenter is not None:
        return force_N * _PLANE / _half_space(indenter, displacement_mm)
    if setup.height_mm is None or isinstance(setup.specimen, Enclosed):
        return None
    if LOADINGS[setup.kind.mode].is_volumetric:
        return None  # a bulk modulus, which soft materials have in gigapascals
    strain = displacement_mm / setup.height_mm
    return force_N / setup.specimen.area_mm2 / strain


def _half_space(indenter: Indenter, depth_mm: float) -> float:
    """Force over plane-strain modulus at a depth, mm^2."""
    if isinstance(indenter, Flat):
        return 2 * indenter.radius_mm * depth_mm
    if isinstance(indenter, Sphere):
        return 4 / 3 * math.sqrt(indenter.radius_mm * depth_mm**3)
    if isinstance(indenter, Cone):
        return 2 / math.pi * math.tan(math.radians(indenter.half_angle_deg)) * depth_mm**2
    raise TypeError(f"no half-space is known for {type(indenter).__name__}")


def checked(found: Measurements, setup: Setup) -> Measurements:
    """Copy measurements with a note on every test whose modulus no soft material has.

    Parameters
    ----------
    found : Measurements
        As read.
    setup : Setup
        Specimen and test that they belong to.
    """
    middle = len(found.displacement_mm) // 2
    place = float(found.displacement_mm[middle])
    low, high = SOFT_MPA
    odd: list[tuple[float, float]] = []
    for test in found.tests:
        force = float(test.force_N[middle])
        modulus = apparent_modulus(setup, place, force) if place > 0 and force > 0 else None
        if modulus is not None and not low <= modulus <= high:
            odd.append((force, modulus))
    if not odd:
        return found
    return replace(found, notes=(*found.notes, _sentence(odd, len(found.tests), place, found)))


def _sentence(odd: list[tuple[float, float]], total: int, place: float, found: Measurements) -> str:
    """Say which forces are meant, and what would make them plausible."""
    force, modulus = odd[0]
    low, high = SOFT_MPA
    factor = _THOUSAND if modulus < low else 1 / _THOUSAND
    likely = low <= modulus * factor <= high
    size = "1000 times larger" if factor > 1 else "1000 times smaller"
    hint = f"; a force {size} would be one of a soft material" if likely else ""
    return (
        f"{', '.join(sorted(found.files)[:2])}: {force:.4g} N at {place:.4g} mm means a Young's "
        f"modulus of about {_in_words(modulus)}, that of {IMPLAUSIBLE} ({_in_words(low)} to "
        f"{_in_words(high)}; in {len(odd)} of {total} tests){hint}: check measurements.units "
        "and the size of the specimen"
    )


def _in_words(modulus_MPa: float) -> str:  # noqa: N803
    if modulus_MPa >= 1:
        return f"{modulus_MPa:.3g} MPa"
    return f"{modulus_MPa * 1e3:.3g} kPa" if modulus_MPa >= 1e-4 else f"{modulus_MPa * 1e6:.3g} Pa"
