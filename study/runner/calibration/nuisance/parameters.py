"""Nuisance parameters as a fit sees them: names, expected values, and the curves they move."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast

from study.design.sections.calibration_design import CalibratedTest
from study.errors import Fault, InputError
from study.runner.calibration.measured_tests import FitCurve
from study.runner.tables import value_named
from study.setup.section import table_of
from study.setup.setup import Tables

OFFSET = "displacement_offset"
ZERO = "force_zero"
FRICTION = "friction"

#: change of an input without an uncertainty from which its influence is taken, over its value
_STEP = 0.01


@dataclass(frozen=True)
class NuisanceParameter:
    """One nuisance parameter of a fit; mm, N, MPa, degrees or plain.

    Parameters
    ----------
    name, key : str
        What it is called, and its key in the file.
    expected : float
        Value before the fit.
    uncertainty : float or None
        Standard uncertainty of it; None where nothing is known.
    is_fitted : bool
        Whether the tests may move it; else its uncertainty is propagated.
    curves : tuple of int
        Places of the curves that it moves, in the order of the fit.
    """

    name: str
    key: str
    expected: float
    uncertainty: float | None
    is_fitted: bool
    curves: tuple[int, ...]

    @property
    def is_input(self) -> bool:
        """Whether it is an input of the simulation."""
        return self.key not in (OFFSET, ZERO, FRICTION)

    @property
    def step(self) -> float:
        """Change from which its influence is taken."""
        return self.uncertainty or _STEP * abs(self.expected)


def parameters_of(
    tests: Sequence[CalibratedTest], curves: Sequence[FitCurve]
) -> tuple[NuisanceParameter, ...]:
    """Nuisance parameters of a fit.

    Parameters
    ----------
    tests : sequence of CalibratedTest
        All of the calibration.
    curves : sequence of FitCurve
        Fitted, in the order of the fit.

    Raises
    ------
    InputError
        If a test has no such input, or tests that share one expect different values.
    """
    units: dict[tuple[str, str], list[int]] = {}
    for place, curve in enumerate(curves):
        for key, asked in tests[curve.test].nuisance.items():
            units.setdefault((key, _unit(asked.each, curve)), []).append(place)
    count = {key: sum(other == key for other, _ in units) for key, _ in units}
    return tuple(
        _parameter(tests, curves, key, key if count[key] == 1 else f"{key} [{unit}]", places)
        for (key, unit), places in units.items()
    )


def _unit(each: str, curve: FitCurve) -> str:
    return {"curve": curve.label, "test": f"tests[{curve.test}]", "all": ""}[each]


def _parameter(
    tests: Sequence[CalibratedTest],
    curves: Sequence[FitCurve],
    key: str,
    name: str,
    places: list[int],
) -> NuisanceParameter:
    own = [tests[curves[place].test] for place in places]
    asked = own[0].nuisance[key]
    expected = [_expected(test, key) for test in own]
    if max(expected) - min(expected) > 1e-12 * max(map(abs, expected)):
        rule = "differs between the tests that share it"
        raise InputError(Fault(f"nuisance.{key}", rule, 'write each = "test"'))
    uncertainty = asked.uncertainty
    if asked.relative and uncertainty is not None:
        uncertainty = uncertainty * abs(expected[0])
    found = NuisanceParameter(
        name, key, expected[0], uncertainty, asked.treat == "fitted", tuple(places)
    )
    if key == "material.poisson_ratio" and expected[0] + found.step >= 0.5:
        rule = f"{expected[0]:g} with an uncertainty of {found.step:g} reaches 0.5"
        mend = "give a smaller one, or material.bulk_modulus with its uncertainty"
        raise InputError(Fault(f"nuisance.{key}", rule, mend))
    return found


def _expected(test: CalibratedTest, key: str) -> float:
    if key == FRICTION and (test.setup.has_no_elements or not test.setup.kind.compresses):
        rule = "is that of two plates, and this is no compression of a specimen between them"
        mend = "declare it in the [[tests]] that have plates: nuisance = { friction = ... }"
        raise InputError(Fault("nuisance.friction", rule, mend))
    value = test.nuisance[key].value
    if value is not None:
        return value
    table, name = _located(test.tables, key)
    return float(cast(float, table[name]))


def _located(test: Tables, key: str) -> tuple[Mapping[str, object], str]:
    """Return the table of an input, and its name there."""
    *path, last = key.split(".")
    table: Mapping[str, object] = test
    for part in path:
        table = table_of(table, part)
    found = value_named(table, last)
    if found is not None:
        return table, found[0]
    mend = "declare it in the [[tests]] that have it: nuisance = { ... }"
    raise InputError(Fault(f"nuisance.{key}", "is no input of this test", mend))


def moved(test: Tables, key: str, amount: float) -> Tables:
    """Copy of the tables of a test with one input changed.

    Parameters
    ----------
    test : mapping
        Resolved tables of the test.
    key : str
        Dotted key of the input as the file has it, such as ``"specimen.height"``.
    amount : float
        Added to its value, in the unit of the tables: mm, mm^2, MPa, deg or plain.

    Raises
    ------
    InputError
        If the test has no such input.
    """
    table, name = _located(test, key)
    *path, _ = key.split(".")
    changed: Mapping[str, object] = {**table, name: float(cast(float, table[name])) + amount}
    for depth in range(len(path), 0, -1):
        outer: Mapping[str, object] = test
        for part in path[: depth - 1]:
            outer = table_of(outer, part)
        changed = {**outer, path[depth - 1]: changed}
    return changed
