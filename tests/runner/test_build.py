"""Configuration -> Problem: every section, every default, every missing thing by name."""

from __future__ import annotations

from typing import Any

import pytest

from study.errors import InputError
from study.runner import build
from study.setup.geometry import Block, Cone, Cylinder, Flat

CONFIG: dict[str, Any] = {
    "specimen": {"shape": "cylinder", "radius_mm": 25.0, "height_mm": 30.0},
    "test": {"kind": "compression", "interface": "bonded", "displacement_mm": 6.0, "steps": 10},
    "material": {"model": "neo-hookean", "constants": {"C10": 5e-3}, "poisson_ratio": 0.4995},
    "model": {"space": "3d", "element_order": "linear", "mesh": "coarse", "mesh_ratio": 1.5},
}


def test_every_section_arrives() -> None:
    made = build.problem(CONFIG)
    assert made.specimen == Cylinder(25.0, 30.0)
    assert (made.test.interface, made.test.base, made.test.steps) == ("bonded", "bonded", 10)
    assert made.material.constants == {"C10": 5e-3}
    assert (made.model.space, made.model.element_order, made.model.mesh) == (
        "3d", "linear", "coarse",
    )  # fmt: skip


def test_base_follows_interface_in_compression_and_holds_in_indentation() -> None:
    test = {"kind": "indentation", "displacement_mm": 2.0, "indenter": {"shape": "flat",
            "radius_mm": 3.0}}  # fmt: skip
    made = build.loading(test)
    assert made.base == "bonded"
    assert made.interface == "frictionless"
    assert made.indenter == Flat(3.0)
    assert build.loading(CONFIG["test"]).base == "bonded"
    assert build.loading({"kind": "compression"}, 1.0).base == "frictionless"


def test_shapes_and_synonyms() -> None:
    block = {"shape": "block", "width_mm": 1.0, "depth_mm": 2.0, "height_mm": 3.0}
    assert build.specimen(block) == Block(1.0, 2.0, 3.0)
    assert build.area_mm2(block) == 2.0
    cone = {"shape": "cone", "half_angle_deg": 30.0, "tip_radius_mm": 1.0, "shaft_radius_mm": None}
    assert build.indenter(cone) == Cone(30.0, 1.0)
    assert build.model({"element_shape": "hexahedron"}).element_shape == "tensor"
    assert build.model({"mesh": None, "mesh_size_mm": 2.0}).mesh_size_mm == 2.0


def test_what_is_missing_is_named() -> None:
    with pytest.raises(InputError, match="displacement"):
        build.loading({"kind": "compression"})
    with pytest.raises(InputError, match="constants"):
        build.material({"model": "neo-hookean", "poisson_ratio": 0.49})
    with pytest.raises(InputError, match="height_mm"):
        build.specimen({"shape": "cylinder", "radius_mm": 1.0})


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"interface": "frictionless"}, True),
        ({"interface": "bonded"}, False),
        ({"interface": "frictionless", "base": "bonded"}, False),
        ({"kind": "indentation", "indenter": {"shape": "sphere", "radius_mm": 1.0}}, False),
    ],
)
def test_homogeneous_is_compression_with_both_faces_free(
    changes: dict[str, Any], expected: bool
) -> None:
    test = {"kind": "compression", "displacement_mm": 1.0, **changes}
    assert build.is_homogeneous({**CONFIG, "test": test}) is expected
