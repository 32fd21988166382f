"""Checks of what is written against what can exist; all of them before anything is computed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from study.design.diagnostics import Faults
from study.design.spec import Config
from study.material.compressibility import Compressibility
from study.material.material import Material
from study.material.registry import ENERGIES
from study.material.stability import stability
from study.setup import setup
from study.setup.test_kind import Test
from study.setup.test_section import TEST_KINDS

#: window of moduli of tissue and silicone (MPa), 100 Pa to 10 MPa; outside it a unit is suspect
PLAUSIBLE_MPA = (1e-4, 10.0)


def check(config: Config, faults: Faults, places: Mapping[str, str]) -> None:
    """Check the sections of a problem against one another.

    Sections that already have faults carry None in their place and are passed over;
    ``places`` says where each table stands in the file.
    """
    _check_moduli(config["material"], faults, places)
    _check_displacement(config, faults, places)
    _check_model(config, faults, places)
    if config["test"].get("indenter"):
        _check_indenter(config, faults, places)


def initial_shear_modulus(material: Mapping[str, Any]) -> float | None:
    """mu0 in MPa of a material section, None where its constants are to be calibrated."""
    constants: Mapping[str, Any] = material["constants"]
    if not constants or any(v is None for v in constants.values()):
        return None
    energy = ENERGIES[material["model"]]
    resistance = Compressibility(material.get("bulk_modulus_MPa"), material.get("poisson_ratio"))
    mu0 = energy.initial_shear_modulus(constants, resistance)
    # a linear solid with E > 9 K is refused for its Poisson's ratio below -1
    return None if energy.small_strain and not 0 < mu0 < math.inf else mu0


def _check_moduli(material: Config, faults: Faults, places: Mapping[str, str]) -> None:
    mu0, bulk = initial_shear_modulus(material), material.get("bulk_modulus_MPa")
    where = f"{places['material']}.{next(iter(material['constants']), '')}"
    if mu0 is not None and mu0 <= 0:
        formula = ENERGIES[material["model"]].shear_modulus_formula
        rule = f"the initial shear modulus {formula} must be positive, got {mu0 * 1e3:g} kPa"
        faults.add(where, rule, "check the signs of the constants")
    elif mu0 is not None and bulk is not None and bulk < mu0:
        rule = f"{bulk * 1e3:g} kPa is below the initial shear modulus, {mu0 * 1e3:g} kPa"
        faults.add(f"{places['material']}.bulk_modulus", rule, "check the units (MPa, kPa) of both")


def _check_displacement(config: Config, faults: Faults, places: Mapping[str, str]) -> None:
    depth, height = config["test"]["displacement_mm"], config["specimen"].get("height_mm")
    kind = TEST_KINDS.get(config["test"]["kind"])
    if kind is not None and kind.sense > 0:
        return  # what is lengthened has no end
    if depth is not None and height is not None and depth >= height:
        rule = f"{depth:g} mm reaches the height of the specimen, {height:g} mm"
        faults.add(f"{places['test']}.displacement", rule, "make it smaller than specimen.height")


def _check_model(config: Config, faults: Faults, places: Mapping[str, str]) -> None:
    model, shape = config["model"], config["specimen"]["shape"]
    if config["material"].get("incompressible") and model["formulation"] == "displacement":
        rule = "the displacement formulation cannot hold the volume of an incompressible material"
        faults.add(f"{places['model']}.formulation", rule, 'write formulation = "mixed"')
    if shape == "surface" and model["space"] == "axisymmetric":
        rule = "a surface from a file has no axis of symmetry that could be relied on"
        faults.add(f"{places['model']}.space", rule, 'write space = "3d"')
    if shape == "surface" and model["element_shape"] == "tensor":
        rule = "the inside of a surface is meshed with tetrahedra"
        mend = 'write element_shape = "tetrahedron"'
        faults.add(f"{places['model']}.element_shape", rule, mend)


def _check_indenter(config: Config, faults: Faults, places: Mapping[str, str]) -> None:
    indenter: Config = config["test"]["indenter"]
    where = f"{places['test']}.indenter."
    if any(v is None for k, v in indenter.items() if k != "shaft_radius_mm"):
        return
    if indenter["shape"] == "flat" and indenter["edge_radius_mm"] > indenter["radius_mm"]:
        rule = "{edge_radius_mm:g} mm is larger than the radius, {radius_mm:g} mm"
        faults.add(f"{where}edge_radius", rule.format(**indenter), "round less")
    shaft = indenter.get("shaft_radius_mm")
    if shaft is not None and indenter["tip_radius_mm"] > shaft:
        rule = "{tip_radius_mm:g} mm is larger than the shaft radius, {shaft_radius_mm:g} mm"
        faults.add(f"{where}tip_radius", rule.format(**indenter), "a tip is inside its shaft")
    half, depth = half_width(config["specimen"]), config["test"]["displacement_mm"]
    reach = footprint(indenter, depth)
    if half is not None and reach is not None and reach >= half:
        key = "half_angle" if indenter["shape"] == "cone" else "radius"
        rule = f"the indenter is {reach:g} mm wide from its axis, the specimen {half:g} mm"
        faults.add(where + key, rule, "it must stay inside the top face at full depth")


def check_stability(config: Config, faults: Faults) -> None:
    """Refuse given constants that Drucker's criterion refutes on the way to full compression.

    Only what is solved as it stands is judged: constants that start a fit may be worse.
    """
    depth, height = config["test"]["displacement_mm"], config["specimen"].get("height_mm")
    given = tuple(config["material"]["constants"].items())
    mu0 = initial_shear_modulus(config["material"])
    if faults or not given or mu0 is None or config["test"]["kind"] != "compression":
        return
    if depth is None or height is None or depth >= height:
        return
    sentence = _unstable(config["material"]["model"], given, 1 - depth / height)
    if sentence:
        faults.add("material", sentence, f"give constants stable to stretch {1 - depth / height:g}")


@lru_cache(maxsize=1024)
def _unstable(model: str, constants: tuple[tuple[str, float], ...], stretch: float) -> str:
    """Verdict on uniaxial loading down to a stretch; empty if it is stable."""
    material = Material(model, dict(constants), poisson_ratio=0.4)  # K does not enter
    verdict = stability(material, [stretch, 1.0])
    return verdict.sentence if "uniaxial" in verdict.limits else ""


def half_width(specimen: Mapping[str, Any]) -> float | None:
    """Distance in mm from the axis to the nearest side; None for a surface."""
    if specimen.get("radius_mm") is not None:
        return float(specimen["radius_mm"])
    sides = [specimen.get("width_mm"), specimen.get("depth_mm")]
    return min(float(s) / 2 for s in sides if s) if all(sides) else None


def footprint(indenter: Mapping[str, Any], depth: float | None) -> float | None:
    """Radius in mm of the indenter in the plane of the undeformed top face, at full depth.

    A cone with a spherical tip of radius r touches the sphere at r (1 - sin a) above its
    lowest point, where it is r cos a wide; above, its width grows with tan a up to the shaft.
    """
    if indenter["shape"] == "flat":
        return float(indenter["radius_mm"])
    if depth is None:
        return None
    if indenter["shape"] == "sphere":
        radius = float(indenter["radius_mm"])
        return radius if depth >= radius else math.sqrt(depth * (2 * radius - depth))
    angle, tip = math.radians(indenter["half_angle_deg"]), float(indenter["tip_radius_mm"])
    join = tip * (1 - math.sin(angle))
    if depth < join:
        return math.sqrt(depth * (2 * tip - depth))
    wide = tip * math.cos(angle) + (depth - join) * math.tan(angle)
    shaft = indenter.get("shaft_radius_mm")
    return wide if shaft is None else min(wide, float(shaft))


def is_homogeneous(config: Mapping[str, Any]) -> bool:
    """Whether the deformation is the same everywhere: compression, both faces frictionless.

    The closed form is then exact, and space, mesh, order and element shape cannot matter.
    """
    test, shape = config["test"], config["specimen"]["shape"]
    loading = Test(test["kind"], None, test["interface"], test["base"])
    return setup.is_homogeneous(loading, shape)


def plausibility(config: Mapping[str, Any]) -> tuple[str, ...]:
    """Warnings about moduli that no tissue or silicone has: a unit may be wrong.

    Parameters
    ----------
    config : mapping
        Resolved configuration.
    """
    mu0 = initial_shear_modulus(config["material"])
    low, high = PLAUSIBLE_MPA
    if mu0 is None or low <= mu0 <= high:
        return ()
    return (
        f"material: an initial shear modulus of {mu0 * 1e3:.4g} kPa is outside {low * 1e3:g} to "
        f"{high * 1e3:g} kPa, the window of tissue and silicone: is the unit right?",
    )
