"""Cross-validation inside a study: constants from everything but what is scored.

``calibration.leave_out = "specimen"``: a case is scored on its own block, with constants from
all other blocks at once. ``"test"``: with constants from the same block's other tests, where
the tests of a design are its different sections ``specimen``, ``test`` and ``measurements``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from study.curve import Curve
from study.errors import Fault, InputError
from study.record import MeasuredTest, Measurements
from study.runner.fits import FitProblem, fit_problem, together
from study.runner.identity import digest

if TYPE_CHECKING:
    from study.design import Case

Config = Mapping[str, Any]


class Data(Protocol):
    """The measurements of a study."""

    tests: Sequence[Config]

    def scored(self, config: Config) -> Measurements | None:
        """Measurements that a configuration is scored on."""

    def calibrated(self, config: Config) -> Measurements | None:
        """Measurements that only the calibration uses."""


@dataclass(frozen=True)
class LeftOut:
    """One scored curve and the fit that did not see it.

    Parameters
    ----------
    test : MeasuredTest
        What is scored.
    score_where : mapping or None
        Its selection.
    problem : FitProblem
        The fit.
    measured : tuple of Curve
        Its curves.
    label : str
        What was fitted, in words.
    """

    test: MeasuredTest
    score_where: Mapping[str, Any] | None
    problem: FitProblem
    measured: tuple[Curve, ...]
    label: str


def distinct_tests(configs: Sequence[Config]) -> tuple[Config, ...]:
    """List the tests of a study: its different specimens, tests and measurements."""
    found = {_name(config): _sections(config) for config in configs}
    return tuple(found.values())


def left_out(case: Case, scored: Measurements, data: Data) -> list[LeftOut]:
    """Every scored curve of a case, with the fit to everything else.

    Raises
    ------
    InputError
        If nothing else was measured.
    """
    if case.config["calibration"]["leave_out"] == "specimen":
        return _without_specimen(case, scored, data)
    return [_without_test(case, scored, data)]


def _without_specimen(case: Case, scored: Measurements, data: Data) -> list[LeftOut]:
    own = data.calibrated(case.config)
    fitted = scored if own is None else own
    others = [block for block in fitted.blocks if block != case.block]
    if not others or case.block is None:
        rule = "leaves one specimen out, but the measurements have fewer than two blocks"
        mend = "name the column of the specimens in measurements.block"
        raise InputError(Fault("calibration.leave_out", rule, mend))
    sides = [(scored.fit, scored.score or scored.fit)]
    if scored.swap:
        sides.append((sides[0][1], sides[0][0]))
    out = []
    for fit_where, score_where in sides:
        where = dict((fit_where if own is None else own.fit) or {})
        curves = tuple(fitted.curve(block, **where).curve for block in others)
        test = scored.curve(case.block, **dict(score_where or {}))
        label = f"all but {case.block}"
        out.append(LeftOut(test, score_where, fit_problem(case.config), curves, label))
    return out


def _without_test(case: Case, scored: Measurements, data: Data) -> LeftOut:
    own = _name(case.config)
    others = [test for test in data.tests if _name(test) != own]
    if not others:
        rule = "leaves one test out, but the design has only one"
        mend = "make the tests a factor: presets with test and measurements"
        raise InputError(Fault("calibration.leave_out", rule, mend))
    curves = []
    for test in others:
        found = data.scored(test)
        if found is None:
            raise InputError(Fault("measurements", "are missing for one of the tests"))
        block = case.block if found.block is not None else None
        curves.append(found.curve(block, **dict(found.fit or {})).curve)
    problem = together(case.config, others)
    where = scored.score or scored.fit
    held = scored.curve(case.block, **dict(where or {}))
    return LeftOut(held, where, problem, tuple(curves), "all other tests")


def _sections(config: Config) -> Config:
    return {key: config[key] for key in ("specimen", "test", "measurements")}


def _name(config: Config) -> str:
    spec = config["measurements"]
    written = spec.as_dict() if hasattr(spec, "as_dict") else spec
    test = {k: v for k, v in config["test"].items() if k != "steps"}
    return digest([config["specimen"], test, written])
