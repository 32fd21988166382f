"""Configuration -> Problem: every section, every default, every missing thing by name."""

from __future__ import annotations

import pytest

from study.ground.declaration import Faults, Length, read_table, section
from study.ground.errors import InputError
from study.laboratory.sensors.force_model import force_model
from study.mechanics.setup.geometry import Flat
from study.simulation.cell import CellProblem

CONFIG = {
    "specimen": {"shape": "cylinder", "radius_mm": 25.0, "height_mm": 30.0},
    "test": {"kind": "compression", "interface": "bonded", "displacement_mm": 6.0, "steps": 10},
    "material": {"model": "neo-hookean", "constants": {"C10": 5e-3}, "poisson_ratio": 0.4995},
    "model": {"space": "3d", "element_order": "linear", "mesh": "coarse", "mesh_ratio": 1.5},
}


def problem(**tables):
    return CellProblem.of({**CONFIG, **tables})


def test_base_follows_interface_in_compression_and_holds_in_indentation():
    test = {"kind": "indentation", "displacement_mm": 2.0, "indenter": {"shape": "flat",
            "radius_mm": 3.0}}  # fmt: skip
    made = problem(test=test).at().test
    assert (made.base, made.interface, made.indenter) == ("bonded", "frictionless", Flat(3.0))
    assert problem(test={"kind": "compression"}).at(depth_mm=1.0).test.base == "frictionless"


def test_the_model_of_a_force_reaches_beyond_the_end_of_its_test():
    """As far as a tracker with errors may tell."""
    assert force_model(problem().at(), 9.0).problem.test.depth_mm == 9.0


def test_what_is_missing_is_named():
    with pytest.raises(InputError, match="displacement"):
        problem(test={"kind": "compression"}).at()
    with pytest.raises(InputError, match="constants"):
        problem(material={"model": "neo-hookean", "poisson_ratio": 0.49}).at()
    with pytest.raises(InputError, match="height_mm"):
        problem(specimen={"shape": "cylinder", "radius_mm": 1.0})


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"interface": "frictionless"}, True),
        ({"interface": "bonded"}, False),
        ({"interface": "frictionless", "base": "bonded"}, False),
        ({"kind": "indentation", "indenter": {"shape": "sphere", "radius_mm": 1.0}}, False),
    ],
)
def test_homogeneous_is_compression_with_both_faces_free(changes, expected):
    test = {"kind": "compression", "displacement_mm": 1.0, **changes}
    assert problem(test=test).setup.is_homogeneous is expected


@section
class Shaft:
    """A section of which nothing has asked yet."""

    length_mm: Length = 1.0


def test_names_of_the_caller_do_not_decide_how_a_section_is_read():
    """Pydantic builds a validator at the first use, and looks names up in the frame of the user."""
    Length = Annotated = Reads = "mine"  # noqa: F841, N806
    assert Shaft(length_mm=2.0).length_mm == 2.0
    assert read_table(Shaft, {"length": "3 mm"}, "shaft", Faults()).length_mm == 3.0
