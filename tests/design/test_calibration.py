"""Calibration files, and the calibration problem of a design."""

from __future__ import annotations

from pathlib import Path

import pytest

from study.ground.errors import InputError
from study.harness.design import load
from study.mechanics.measurement.measurement_section import Range

TEXT = """
schema = 1
[specimen]
shape = "cylinder"
radius = "25 mm"
height = "30 mm"
[model]
space = "axisymmetric"
element_order = "quadratic"
[material]
model = "reduced-polynomial"
order = 2
poisson_ratio = 0.4995
[[tests]]
role = "fit"
test = { kind = "compression", interface = "frictionless", displacement = "6 mm" }
measurements = { file = "a.csv", columns = { displacement = "d", force = "f" }, units = { displacement = "mm", force = "N" }, range = ["1 %", "20 %"] }
weight = "scatter"
[[tests]]
role = "held-out"
test = { kind = "compression", interface = "bonded" }
specimen = { shape = "cylinder", radius = "10 mm", height = "20 mm" }
measurements = { file = "b.csv", columns = { displacement = "d", force = "f" }, units = { displacement = "mm", force = "N" }, range = ["1 %", "20 %"] }
weight = 2.5
"""  # noqa: E501
CONICAL = (Path(__file__).parents[2] / "designs" / "conical-indentation.toml").read_text()


def test_tests_inherit_specimen_and_model() -> None:
    found = load.loads_calibration(TEXT)
    fit, held_out = found.tests
    assert found.material.order == 2
    assert fit.setup.model.mesh == held_out.setup.model.mesh == "medium"
    assert (fit.role, fit.weight) == ("fit", "scatter")
    assert (held_out.role, held_out.weight) == ("held-out", 2.5)
    assert (fit.setup.height_mm, held_out.setup.height_mm) == (30.0, 20.0)
    assert fit.measurements.range == Range("percent", 1.0, 20.0)
    assert (fit.setup.test.depth_mm, held_out.setup.test.depth_mm) == (6.0, 4.0)
    assert held_out.setup.test.base == "bonded"


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('weight = "scatter"', 'weigth = "scatter"', "did you mean 'weight'"),
        ('"6 mm"', '"7 mm"', r"tests\[0\]\.test\.displacement: 7 mm, but .* ends at 6 mm"),
        ('"a.csv"', '"/a.csv"', r"tests\[0\]\.measurements\.file: must be relative"),
        ('"10 mm"', "10", r"tests\[1\]\.specimen\.radius: needs a unit"),
    ],
)
def test_faults_name_the_test(old: str, new: str, says: str) -> None:
    assert old in TEXT
    with pytest.raises(InputError, match=says):
        load.loads_calibration(TEXT.replace(old, new, 1))


def test_a_fault_of_an_inherited_table_is_told_once() -> None:
    with pytest.raises(InputError) as caught:
        load.loads(CONICAL.replace('"40 mm"', '"-40 mm"'), "x")
    assert [f.where for f in caught.value.faults] == ["x: specimen.height"]


def test_a_fault_of_the_calibration_problem_is_told_there() -> None:
    text = CONICAL.replace('["1 %", "30 %"]', '["1 %", "130 %"]')
    with pytest.raises(InputError) as caught:
        load.loads(text, "x")
    assert caught.value.faults[0].where == "x: calibration.problem.measurements.range"


def test_no_calibration_where_constants_are_given() -> None:
    start, end = CONICAL.index("[calibration]"), CONICAL.index("[factors]")
    text = CONICAL[:start] + CONICAL[end:]
    fixed = text.replace('model = "neo-hookean"\n', 'model = "neo-hookean"\nC10 = "5 kPa"\n')
    cells = load.loads(fixed).treatments
    assert not cells[0].cell.is_calibrated  # neo-Hookean: constants given
    assert cells[-1].cell.is_calibrated


def test_cross_validation() -> None:
    study = load.loads(CONICAL.replace('method = "auto"', 'method="auto"\nleave_out="specimen"'))
    assert study.calibration.leave_out == "specimen"
    assert study.treatments[0].config["calibration"]["leave_out"] == "specimen"
