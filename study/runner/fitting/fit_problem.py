"""A calibration without its data: which tables enter it, its name, and what starts it.

Cases share a fit when everything that decides it is the same: the calibrated problem, the
measured curve, the method and the code. A closed-form fit knows nothing of the modelling
space or the elements, so sixteen cells may share four of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import cast

from study.canonical import digest
from study.curve import Curve
from study.errors import Fault, InputError
from study.forward.external import External
from study.material.registry import ENERGIES
from study.runner.fitting.external_model import named
from study.runner.provenance import code_version
from study.runner.tables import PROBLEM, CalibrationTable
from study.setup.material_section import MaterialSection
from study.setup.section import table_of
from study.setup.setup import Setup, Tables

#: tables of a case that a calibration problem of its own may replace
_REPLACEABLE = ("specimen", "test")


@dataclass(frozen=True)
class FitProblem:
    """A calibration without its data.

    Parameters
    ----------
    method : str
        ``"closed-form"``, ``"inverse-fem"``, ``"external"``, ``"together"`` (several tests) or
        ``"none"``.
    tables : mapping
        Those that enter, and nothing else; for several tests ``material`` and
        ``tests``, each with its own ``method``.
    shares_scored_problem : bool
        Whether the calibrated test is also the one that is scored.
    """

    method: str
    tables: Tables
    shares_scored_problem: bool

    @cached_property
    def material(self) -> MaterialSection:
        """Energy that is fitted; with constants where the file gives those to start from."""
        return MaterialSection.of(self.tables)

    @property
    def tests(self) -> list[tuple[str, Tables]]:
        """Method and document of every test of the fit."""
        if self.method != "together":
            return [(self.method, self.tables)]
        shared = {"material": self.tables["material"]}
        parts = cast("list[dict[str, object]]", self.tables["tests"])
        return [(str(one["method"]), {**shared, **one}) for one in parts]


def fit_problem(tables: Tables) -> FitProblem:
    """Calibration of the resolved tables of a case.

    Parameters
    ----------
    tables : mapping
        In internal units. ``calibration`` may be left out; ``specimen`` and ``test`` of
        ``calibration.problem`` replace those of the case.

    Returns
    -------
    FitProblem
        Of a closed form without ``model`` and ``forward``, and with those keys of ``test`` alone
        that enter its constants.

    Raises
    ------
    InputError
        If ``method = "analytic"`` is asked of a test that has no closed form.
    """
    section = CalibrationTable.of(tables)
    own = section.problem or {}
    scored = {k: tables[k] for k in PROBLEM if k in tables}
    merged = scored | {k: own[k] for k in _REPLACEABLE if own.get(k)}
    shared = merged == scored
    merged["material"] = _written(table_of(tables, "material"))
    external = External.of(merged)
    method = _method(section.method, merged, external is not None)
    if method == "closed-form":
        merged.pop("model", None)
        merged.pop("forward", None)
        # its depth, steps and base do not enter
        test, relaxes = table_of(merged, "test"), bool(MaterialSection.of(merged).relaxation)
        kept = {"kind": test["kind"], "interface": "frictionless"}
        entering = ["prestretch"] + ["speed_mm_per_s"] * relaxes
        merged["test"] = kept | {key: test[key] for key in entering if test.get(key)}
    return FitProblem(method, merged, shared)


def together(tables: Tables, tests: Sequence[Tables]) -> FitProblem:
    """One fit to several tests, with the material and model of a case.

    Parameters
    ----------
    tables : mapping
        Resolved tables of the case; its calibration gives the method asked of every test.
    tests : sequence of mapping
        Tables that replace those of the case, such as ``specimen`` and ``test``, one mapping for
        each test.

    Returns
    -------
    FitProblem
        Of method ``"together"``, with ``tests`` in the order given.
    """
    asked = {"method": CalibrationTable.of(tables).method}
    parts = []
    for test in tests:
        found = fit_problem({**tables, **test, "calibration": asked})
        sections = {k: v for k, v in found.tables.items() if k != "material"}
        parts.append({"method": found.method, **sections})
    material = _written(table_of(tables, "material"))
    return FitProblem("together", {"material": material, "tests": parts}, False)


def _written(material: Tables) -> dict[str, object]:
    """Material without keys that say nothing, so that equal materials have equal names."""
    return {k: v for k, v in material.items() if v not in (None, {}, False)}


def _method(asked: str, tables: Tables, is_external: bool) -> str:
    if asked == "none":
        return "none"
    if is_external and asked != "analytic":
        return "external"
    setup = Setup.of(tables)
    homogeneous = setup.is_homogeneous
    if asked == "analytic" and not homogeneous:
        rule = "method = 'analytic' needs compression with both faces frictionless"
        raise InputError(Fault("calibration.method", rule, "use 'auto' or 'inverse-fem'"))
    if asked == "inverse-fem" and not setup.has_no_elements:
        return "inverse-fem"
    return "closed-form" if homogeneous else "inverse-fem"


def fit_key(problem: FitProblem, measured: Sequence[Curve]) -> str:
    """Name of a fit: a hash of the problem, the data and the code.

    Parameters
    ----------
    problem : FitProblem
        Its method and tables count; an external forward model counts by its digest.
    measured : sequence of Curve
        The averaged curves that are fitted.

    Returns
    -------
    str
        32 hex digits.
    """
    data = [curve.name for curve in measured]
    return digest([problem.method, named(problem.tables), data, code_version()], 32)


def start_problem(problem: FitProblem) -> FitProblem | None:
    """Fit of the same test whose constants start this one: neo-Hookean, or one order lower.

    A third-order polynomial that starts from the neo-Hookean constant alone walks into
    constants that soften without end. Start values are thus a function of the case alone.

    Parameters
    ----------
    problem : FitProblem
        The fit to be started.

    Returns
    -------
    FitProblem or None
        None where there is nothing to wait for: the fit is neo-Hookean or linear itself, no test of
        it is simulated by our own elements, or its start is given.
    """
    own = problem.material
    simulated = any(method == "inverse-fem" for method, _ in problem.tests)
    if not simulated or own.constants:
        return None
    simpler = ENERGIES[own.model].simpler(own.order or 1)
    if simpler is None:
        return None
    model, order = simpler
    written = table_of(problem.tables, "material")
    material = _written({**written, "model": model, "order": order, "constants": None})
    return FitProblem(
        problem.method, {**problem.tables, "material": material}, problem.shares_scored_problem
    )
