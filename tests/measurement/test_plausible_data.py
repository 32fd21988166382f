"""Data that are not what they seem: unloading, offsets, units; each with an answer from outside."""

import math
from dataclasses import replace

import numpy as np
import pytest

from study.ground.errors import InputError
from study.mechanics.measurement.conditioning import OFFSET, UNLOADED, Rules, condition, is_caution
from study.mechanics.measurement.measured_test import (
    SOFT_MPA,
    Measurements,
    apparent_modulus,
    checked,
)
from study.mechanics.measurement.measurement_section import Columns, MeasurementSpec
from study.mechanics.measurement.phases import phases_of
from study.mechanics.measurement.recording import Recording
from study.simulation.cell import CellProblem

COLUMNS = Columns(displacement="d", force="f")
RULES = Rules(MeasurementSpec(COLUMNS, points=10), 0.5, 5.0)
UP = np.linspace(0.0, 6.0, 61)


def conditioned(d, f, rules):
    return condition(d, f, rules, Recording("a test", {}, d, f))


def test_what_was_only_loaded_loses_nothing():
    random = np.random.default_rng(2)
    straight = UP + 0.05 * random.standard_normal(61)
    # rows in no order at all are sorted, as they always were
    for rows in (straight, -UP, UP[::-1], *(random.permutation(UP) for _ in range(50))):
        (phase,) = phases_of(rows)
        assert (phase.first, phase.last) == (0, 60)


@pytest.mark.parametrize(
    ("force", "told"),
    [
        (UP, None),
        (UP**1.5, None),  # Hertz: a line through its first tenth has an intercept of -0.6 %
        (UP**2, None),
        (np.sqrt(UP), None),  # steep at once, but from zero
        (UP + 0.3, 0.05 / 1.05),
        (UP**2 + 3.6, 0.1 / 1.1),
        (UP - 0.3, -0.05 / 0.95),
        (UP + 0.05, None),  # 0.8 %: less than it takes
    ],
)
def test_a_load_cell_that_does_not_begin_at_zero(force, told):
    found = conditioned(UP, force, RULES)
    if told is None:
        assert found.offset is None
    else:
        # the smaller of the first reading (exact here) and the straight line
        assert found.offset == pytest.approx(told, abs=0.006)
    zeroed = replace(RULES, spec=replace(RULES.spec, zero="first"))
    assert conditioned(UP, force, zeroed).offset is None
    assert all(map(is_caution, (OFFSET, UNLOADED)))


@pytest.mark.parametrize(("factor", "size"), [(1e-3, "small"), (1e3, "large")])
def test_travel_in_another_unit_is_recognised(factor, size):
    many = np.linspace(0.0, 6.0, 601)
    with pytest.raises(InputError, match=f"1000 times too {size}.*measurements.units"):
        conditioned(factor * many, many, RULES)


CYLINDER = {"shape": "cylinder", "radius_mm": 25.0, "height_mm": 30.0}
INDENTERS = {
    # Boussinesq 2aE*d, Hertz 4/3 E* R^(1/2) d^(3/2), Love 2/pi E* tan(alpha) d^2 (Sneddon 1965)
    "flat": ({"shape": "flat", "radius_mm": 5.0}, lambda e, d: 10 * e * d),
    "sphere": ({"shape": "sphere", "radius_mm": 4.0}, lambda e, d: 8 / 3 * e * d**1.5),
    "cone": ({"shape": "cone", "half_angle_deg": 45.0}, lambda e, d: 2 / math.pi * e * d**2),
}


def setup(indenter):
    if indenter is None:
        return CellProblem.of({"specimen": CYLINDER, "test": {"kind": "compression"}}).setup
    test = {"kind": "indentation", "indenter": INDENTERS[indenter][0]}
    return CellProblem.of({"specimen": CYLINDER, "test": test}).setup


@pytest.mark.parametrize("indenter", [None, *INDENTERS])
@pytest.mark.parametrize("young", [0.03, 2.0])
def test_the_modulus_behind_a_curve(indenter, young):
    d = 2.0
    if indenter is None:
        force = young * math.pi * 25**2 * d / 30
    else:
        force = INDENTERS[indenter][1](young / (1 - 0.5**2), d)
    assert apparent_modulus(setup(indenter), d, force) == pytest.approx(young, rel=1e-12)


@pytest.mark.parametrize("indenter", [None, *INDENTERS])
@pytest.mark.parametrize(
    ("factor", "hint"), [(1.0, None), (1e4, "1000 times smaller"), (1e-4, "1000 times larger")]
)
def test_forces_of_no_soft_material_are_told(indenter, factor, hint):
    made, d = setup(indenter), np.linspace(0.5, 2.5, 5)
    young = 0.05  # a silicone: factors of 10^4 leave the window, and 1000 brings them back
    unit = np.array([apparent_modulus(made, float(x), 1.0) for x in d], dtype=float)
    rules = Rules(MeasurementSpec(COLUMNS, points="raw"), 0.0, np.inf)
    test = conditioned(d, factor * young / unit, rules)
    notes = checked(Measurements((test,), d, rules.spec, files={"a.csv": ""}), made).notes
    if hint is None:
        assert notes == ()
    else:
        (note,) = notes
        assert hint in note
        assert "a.csv" in note
        assert "measurements.units" in note
        assert is_caution(note)
    assert SOFT_MPA[0] < young < SOFT_MPA[1]


def test_a_bulk_modulus_is_no_fault():
    gauge = {"shape": "homogeneous", "area_mm2": 1.0, "height_mm": 1.0}
    pressed = CellProblem.of({"specimen": gauge, "test": {"kind": "volumetric"}}).setup
    assert apparent_modulus(pressed, 0.01, 20.0) is None
