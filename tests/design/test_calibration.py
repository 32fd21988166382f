"""Calibration files, and the calibration problem of a design."""

from pathlib import Path

from study.harness.design import load
from study.mechanics.measurement.measurement_section import Range
from tests.cli.small import measured

PRESSED = """[[tests]]
test = { kind = "compression", interface = "frictionless", displacement = "6 mm" }
role = "fit"
weight = "scatter"
"""
SMALLER = """[[tests]]
test = { kind = "compression", interface = "bonded" }
specimen = { shape = "cylinder", radius = "10 mm", height = "20 mm" }
role = "held-out"
weight = 2.5
"""
TEXT = (
    'schema = 1\nspecimen = { shape = "cylinder", radius = "25 mm", height = "30 mm" }\n'
    'model = { space = "axisymmetric", element_order = "quadratic" }\n'
    'material = { model = "reduced-polynomial", order = 2, poisson_ratio = 0.4995 }\n'
    + "".join(
        test + measured(file).replace("[m", "[tests.m") + 'range = ["1 %", "20 %"]\n'
        for test, file in ((PRESSED, "a.csv"), (SMALLER, "b.csv"))
    )
)
CONICAL = (Path(__file__).parents[2] / "designs" / "conical-indentation.toml").read_text()


def test_tests_inherit_specimen_and_model():
    found = load.CALIBRATION.loads(TEXT)
    fit, held_out = found.tests
    assert found.material.order == 2
    assert fit.problem.setup.model.mesh == held_out.problem.setup.model.mesh == "medium"
    assert (fit.role, fit.weight) == ("fit", "scatter")
    assert (held_out.role, held_out.weight) == ("held-out", 2.5)
    assert (fit.problem.setup.height_mm, held_out.problem.setup.height_mm) == (30.0, 20.0)
    assert fit.measurements.range == Range("percent", 1.0, 20.0)
    assert (fit.problem.setup.test.depth_mm, held_out.problem.setup.test.depth_mm) == (6.0, 4.0)
    assert held_out.problem.setup.test.base == "bonded"


def test_no_calibration_where_constants_are_given():
    start, end = CONICAL.index("[calibration]"), CONICAL.index("[factors]")
    text = CONICAL[:start] + CONICAL[end:]
    fixed = text.replace('model = "neo-hookean"\n', 'model = "neo-hookean"\nC10 = "5 kPa"\n')
    cells = load.loads(fixed).treatments
    assert not cells[0].cell.is_calibrated  # neo-Hookean: constants given
    assert cells[-1].cell.is_calibrated
