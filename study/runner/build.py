"""Resolved configuration -> Problem: the only place that turns levels into a problem.

The sections are plain dictionaries, already validated and in mm, N, MPa and degrees.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from study.errors import Fault, InputError
from study.material.energy import constant_names
from study.material.material import Material
from study.setup.geometry import (
    Block,
    Cone,
    Cylinder,
    Flat,
    Indenter,
    Interface,
    Shape,
    Specimen,
    Sphere,
    Surface,
)
from study.setup.setup import Model, Problem
from study.setup.test_kind import Test

Config = Mapping[str, Any]
_SHAPES: dict[str, type[Any]] = {"cylinder": Cylinder, "block": Block, "surface": Surface}
_INDENTERS: dict[str, type[Any]] = {"flat": Flat, "cone": Cone, "sphere": Sphere}
_ELEMENTS: dict[str, Shape] = {
    "simplex": "simplex",
    "tensor": "tensor",
    "triangle": "simplex",
    "tetrahedron": "simplex",
    "quadrilateral": "tensor",
    "hexahedron": "tensor",
}


def problem(
    config: Config,
    constants: Mapping[str, float] | None = None,
    displacement_mm: float | None = None,
) -> Problem:
    """Problem of a resolved configuration.

    Parameters
    ----------
    config : mapping
        Sections ``specimen``, ``test``, ``material`` and ``model``.
    constants : mapping of str to float, optional
        Constants in MPa instead of those of the configuration.
    displacement_mm : float, optional
        Final displacement where the configuration leaves it to the measurements.

    Raises
    ------
    InputError
        If something that the solver needs is missing.
    """
    return Problem(
        specimen(config["specimen"]),
        loading(config["test"], displacement_mm),
        material(config["material"], constants),
        model(config.get("model", {})),
    )


def specimen(section: Config) -> Specimen:
    """Specimen from its section."""
    if section.get("path"):  # a file, found below its folder
        section = {**section, "file": section["path"]}
    made: Specimen = _make("specimen", section, _SHAPES)
    return made


def loading(section: Config, displacement_mm: float | None = None) -> Test:
    """Test from its section; ``displacement_mm`` where the section has none."""
    depth = section.get("displacement_mm")
    depth = displacement_mm if depth is None else depth
    if depth is None:
        mend = "give it, or a measurements.range that ends where the test should"
        raise InputError(Fault("test.displacement", "the test needs a displacement", mend))
    kind = section["kind"]
    interface: Interface = section.get("interface") or "frictionless"
    base: Interface = section.get("base") or (interface if kind == "compression" else "bonded")
    pressed = section.get("indenter")
    return Test(
        kind=kind,
        displacement_mm=float(depth),
        interface=interface,
        base=base,
        steps=int(section.get("steps") or 10),
        indenter=None if pressed is None or kind == "compression" else indenter(pressed),
    )


def indenter(section: Config) -> Indenter:
    """Indenter from its section."""
    made: Indenter = _make("test.indenter", section, _INDENTERS)
    return made


def material(section: Config, constants: Mapping[str, float] | None = None) -> Material:
    """Material from its section; ``constants`` (MPa) replace those of the section."""
    values = constants if constants is not None else section.get("constants") or {}
    if not values:
        rule = "the constants are not known yet"
        raise InputError(Fault("material", rule, "give them or calibrate"))
    return Material(
        model=section["model"],
        constants=dict(values),
        bulk_modulus=section.get("bulk_modulus_MPa"),
        poisson_ratio=section.get("poisson_ratio"),
        incompressible=bool(section.get("incompressible", False)),
    )


def calibrated_names(section: Config) -> tuple[str, ...]:
    """Names of the constants that a calibration of this material finds."""
    given = section.get("constants") or {}
    if given:
        return tuple(given)
    return tuple(constant_names(section["model"], section.get("order")))


def model(section: Config) -> Model:
    """Discretisation from its section."""
    size = section.get("mesh_size_mm")
    return Model(
        space=section.get("space", "axisymmetric"),
        element_order=section.get("element_order", "quadratic"),
        element_shape=_ELEMENTS[section.get("element_shape") or "simplex"],
        formulation=section.get("formulation", "mixed"),
        mesh=section.get("mesh") or "medium",
        mesh_ratio=float(section.get("mesh_ratio") or 1.5),
        mesh_size_mm=None if size is None else float(size),
        mesh_seed=section.get("mesh_seed"),
    )


def is_homogeneous(config: Config) -> bool:
    """Whether the deformation is the same everywhere: compression, both faces frictionless."""
    made = loading(config["test"], displacement_mm=1.0)
    return (
        made.kind == "compression"
        and made.interface == "frictionless"
        and made.base == "frictionless"
        and config["specimen"]["shape"] in ("cylinder", "block")
    )


def area_mm2(section: Config) -> float:
    """Cross-section area of a cylinder or block, the mean one of a surface."""
    made = specimen(section)
    if isinstance(made, Cylinder):
        return 3.141592653589793 * made.radius_mm**2
    if isinstance(made, Block):
        return made.width_mm * made.depth_mm
    from study.surface.surface import body

    found = body(made)
    return found.volume_mm3 / found.height_mm


def height_mm(section: Config) -> float | None:
    """Height of a specimen; None for a surface whose file has not been looked for."""
    height = section.get("height_mm")
    return None if height is None else float(height)


def _make(where: str, section: Config, kinds: Mapping[str, type[Any]]) -> Any:
    kind = kinds[section["shape"]]
    known = kind.__dataclass_fields__
    values = {k: v for k, v in section.items() if k in known and v is not None}
    try:
        return kind(**values)
    except TypeError as error:
        missing = str(error).split("argument")[-1].lstrip("s: ")
        raise InputError(Fault(where, f"{section['shape']} needs {missing}")) from None
