"""Cross-validation: which curve a score is held out from, and the fit that did not see it.

A model with more constants fits the curve that it was fitted to at least as well, whatever the
truth. Under a truth of two constants a model of five is the better one in 100 % of simulated
studies that score the curve fitted, and in 11 % of those that score other specimens. A study
that would score the curve fitted is therefore cross-validated over its blocks (Stone 1974, J. R.
Stat. Soc. B 36, 111).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from study.canonical import digest
from study.curve import Curve
from study.design.sections.calibration import NOTHING
from study.errors import Fault, InputError
from study.measurement.measured_test import MeasuredTest, Measurements, Selection
from study.runner.fitting.fit_problem import FitProblem, fit_problem, together
from study.runner.job import DataCache
from study.runner.tables import measurements_of
from study.setup.section import table_of
from study.setup.setup import Tables

if TYPE_CHECKING:
    from study.design.spec import Case

#: fewest blocks of which one is held out: of two, one specimen would stand for all others
FEWEST_BLOCKS = 3


def held_out(
    leave_out: str | None,
    fit: Selection | None,
    score: Selection | None,
    blocks: int,
    *,
    other_test: bool,
) -> str | None:
    """Say what is left out of the fit that a curve is scored with.

    Parameters
    ----------
    leave_out : {"specimen", "test", "nothing"}, optional
        As the study file asks.
    fit, score : mapping, optional
        Selections of the curves that are fitted and scored.
    blocks : int
        Number of blocks.
    other_test : bool
        Whether the constants are fitted to another test than the scored one.

    Returns
    -------
    str or None
        ``"specimen"``, ``"test"``, or None where the fit sees what its selection names.
    """
    if leave_out is not None:
        return None if leave_out == NOTHING else leave_out
    sees_the_scored = not other_test and dict(fit or {}) == dict(score or fit or {})
    return "specimen" if sees_the_scored and blocks >= FEWEST_BLOCKS else None


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
    score_where: Selection | None
    problem: FitProblem
    measured: tuple[Curve, ...]
    label: str


def distinct_tests(configs: Sequence[Tables]) -> tuple[Tables, ...]:
    """List the tests of a study: its different specimens, tests and measurements.

    Parameters
    ----------
    configs : sequence of mapping
        Resolved tables of the cells; tests that differ in their load steps alone count as one.

    Returns
    -------
    tuple of mapping
        ``specimen``, ``test`` and ``measurements`` of each test.
    """
    found = {_name(config): _sections(config) for config in configs}
    return tuple(found.values())


def left_out(kind: str, case: Case, scored: Measurements, data: DataCache) -> list[LeftOut]:
    """Every scored curve of a case, with the fit to everything else.

    Parameters
    ----------
    kind : {"specimen", "test"}
        What is left out.
    case : Case
        Its block is the specimen that is scored.
    scored : Measurements
        Those that the case is scored on.
    data : DataCache
        Measurements of the tests of the study, and of one that only the calibration uses.

    Returns
    -------
    list of LeftOut
        One; two with ``"specimen"`` where fit and score also change places.

    Raises
    ------
    InputError
        If nothing else was measured.
    """
    if kind == "specimen":
        return _without_specimen(case, scored, data)
    return [_without_test(case, scored, data)]


def _without_specimen(case: Case, scored: Measurements, data: DataCache) -> list[LeftOut]:
    own = data.calibrated(case.config)
    fitted = scored if own is None else own
    others = [block for block in fitted.blocks if block != case.block]
    if not others or case.block is None:
        rule = "leaves one specimen out, but the measurements have fewer than two blocks"
        mend = "name the column of the specimens in measurements.block"
        raise InputError(Fault("calibration.leave_out", rule, mend))
    out = []
    for fit_where, score_where in scored.sides:
        where = dict((fit_where if own is None else own.fit) or {})
        curves = tuple(fitted.curve(block, **where).curve for block in others)
        test = scored.curve(case.block, **dict(score_where or {}))
        label = f"all but {case.block}"
        out.append(LeftOut(test, score_where, fit_problem(case.config), curves, label))
    return out


def _without_test(case: Case, scored: Measurements, data: DataCache) -> LeftOut:
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


def _sections(config: Tables) -> Tables:
    return {key: config[key] for key in ("specimen", "test", "measurements")}


def _name(config: Tables) -> str:
    spec = measurements_of(config)
    test = {k: v for k, v in table_of(config, "test").items() if k != "steps"}
    return digest([config["specimen"], test, None if spec is None else spec.as_dict()])
