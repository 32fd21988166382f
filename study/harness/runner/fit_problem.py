"""A calibration without its data: which tables enter it, its name, and what starts it.

Cases share a fit when everything that decides it is the same: the calibrated problem, the
measured curve, the method and the code. A closed-form fit knows nothing of the modelling
space or the elements, so sixteen cells may share four of them.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import cast

import numpy as np

from study.ground.bounded_file import UnreadableError, read_existing, sha256_of
from study.ground.canonical import digest, plain
from study.ground.curve import Curve
from study.ground.errors import Fault, InputError
from study.harness.design.forward_section import ForwardModel, target_and_source
from study.harness.external import command, exchange
from study.harness.external.command import External
from study.harness.external.exchange import PythonFunction
from study.harness.runner.problem_tables import (
    PROBLEM,
    calibrated_test,
    method_of,
    own_tables,
    with_placeholder,
)
from study.harness.runner.provenance import code_version
from study.mechanics.material.material import ENERGIES
from study.mechanics.measurement.recording import locate
from study.mechanics.setup.declaration import table_of
from study.mechanics.setup.material_section import MaterialSection
from study.mechanics.setup.setup import Setup, Tables

# Programs and functions of a study: found, named, allowed, and asked for curves.

_WHERE = "forward.files"

#: bytes of a file that goes along with a case
MAX_BYTES = 2_000_000


@dataclass(frozen=True)
class Allowed:
    """What a run may use besides this package."""

    #: Whether commands may run; a text allows those whose digest begins with it.
    commands: bool | str = False
    #: What ``model = "python"`` stands for.
    function: PythonFunction | None = None


NOTHING = Allowed()


class Forwards:
    """Forward models of a study that are not ours, each found once for all cells that share it.

    Nothing is run: a program is known by the content of its file.
    """

    def __init__(self, places: Sequence[Path], function: PythonFunction | None) -> None:
        self._places, self._function = places, function
        self._tables: dict[ForwardModel, dict[str, object]] = {}

    def table(self, section: ForwardModel) -> Tables:
        """Table of a forward model with its files and its identity."""
        if section not in self._tables:
            made: dict[str, object] = dict(plain(section.document()))
            self._tables[section] = {k: v for k, v in made.items() if v is not None}
            self._tables[section] |= self._identity(section)
        return self._tables[section]

    def _identity(self, section: ForwardModel) -> dict[str, object]:
        function = self._function
        if section.model == "python":
            named = {} if function is None else {
                "function": function.text, "function_version": function.version
            }  # fmt: skip
            return dict(named)
        words = [argv[0] for argv in section.argv]
        # a program that should say its version and is missing says none, which is no fault
        words += filter(command.path_of, section.version[:1])
        files = map(target_and_source, section.files)
        return {
            "programs": {word: _program_sha(word) for word in words},
            "contents": {target: _text(source, self._places) for target, source in files},
        }


def check_templates(config: Tables, case_id: str) -> None:
    """Render the templates of a case before anything runs: what is wrong with them is told now.

    Constants that a fit has yet to find stand as 1 MPa.
    """
    external = External.of(config)
    if external is None or not external.section.rendered:
        return
    if "material" not in config:
        external.rendered({"case_id": case_id, **own_tables(config)})
        return
    depth = Setup.of(config).test.displacement_mm or 1.0
    request = exchange.request(with_placeholder(config, depth), np.array([depth]))
    section = MaterialSection.of(config)
    names = dict.fromkeys(section.calibrated_names, 1.0) | dict(section.constants)
    material = {**table_of(request, "material"), "constants_MPa": names}
    context = exchange.context_of({**request, "material": material, **own_tables(config)})
    external.rendered({"case_id": case_id, **context})


def _program_sha(word: str) -> str:
    path = command.path_of(word)
    return "" if path is None else _sha_of(path)


_sha_of = functools.cache(sha256_of)


def _text(name: str, places: Sequence[Path]) -> str:
    for folder in places:
        try:
            path = locate(name, folder, where=_WHERE)
            break
        except InputError:
            continue
    else:
        looked = " or ".join(repr(str(folder)) for folder in places)
        mend = "put it beside the design, and name it relative to that"
        raise InputError(Fault(_WHERE, f"there is no file {name!r} below {looked}", mend))
    try:
        text = read_existing(path, MAX_BYTES).decode("utf-8")
    except UnreadableError as error:
        mend = "name the program's own data by a path instead"
        raise InputError(Fault(_WHERE, f"{name!r} {error.rule}", mend)) from error
    except UnicodeDecodeError as error:
        raise InputError(Fault(_WHERE, f"{name!r} is no text in UTF-8")) from error
    return text.replace("\r\n", "\n").replace("\r", "\n")


def externals(configs: Iterable[Tables]) -> list[External]:
    """Forward models of some configurations that are not ours, each once."""
    by_digest = {
        model.digest: model for config in configs if (model := External.of(config)) is not None
    }
    return list(by_digest.values())


def identity(tables: Tables) -> list[str]:
    """Name of the external forward model of a case; empty where there is none."""
    external = External.of(tables)
    return [] if external is None else [external.digest]


def named(tables: Tables) -> Mapping[str, object]:
    """Tables for a key, in which the forward model is its name: a pickled function is none."""
    external = External.of(tables)
    return tables if external is None else {**tables, "forward": external.digest}


#: tables of a case that a calibration problem of its own may replace
_REPLACEABLE = ("specimen", "test")


@dataclass(frozen=True)
class FitProblem:
    """A calibration without its data."""

    #: ``"closed-form"``, ``"inverse-fem"``, ``"external"``, ``"together"`` (several tests) or
    #: ``"none"``.
    method: str
    #: Those that enter, and nothing else; for several tests ``material`` and ``tests``, each with
    #: its own ``method``.
    tables: Tables
    #: Whether the calibrated test is also the one that is scored.
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
        return [(str(part["method"]), {**shared, **part}) for part in parts]


def fit_problem(tables: Tables) -> FitProblem:
    """Calibration of the resolved tables of a case; of parameters alone there is none."""
    if "material" not in tables:
        return FitProblem("none", tables, False)
    calibration = calibrated_test(tables)
    scored = {k: tables[k] for k in PROBLEM if k in tables}
    merged = scored | {k: calibration[k] for k in _REPLACEABLE if calibration.get(k)}
    shared = merged == scored
    merged["material"] = _written(table_of(tables, "material"))
    external = External.of(merged)
    method = _method(method_of(tables), merged, external is not None)
    if method == "closed-form":
        merged.pop("model", None)
        merged.pop("forward", None)
        # its depth, steps and base do not enter
        test, relaxes = table_of(merged, "test"), bool(MaterialSection.of(merged).relaxation)
        entering_keys = {"kind": test["kind"], "interface": "frictionless"}
        entering = ["prestretch"] + ["speed_mm_per_s"] * relaxes
        merged["test"] = entering_keys | {key: test[key] for key in entering if test.get(key)}
    return FitProblem(method, merged, shared)


def together(tables: Tables, tests: Sequence[Tables]) -> FitProblem:
    """One fit to several tests, with the material and model of a case."""
    calibration = {"method": method_of(tables)}
    parts = []
    for test in tests:
        problem = fit_problem({**tables, **test, "calibration": calibration})
        sections = {k: v for k, v in problem.tables.items() if k != "material"}
        parts.append({"method": problem.method, **sections})
    material = _written(table_of(tables, "material"))
    return FitProblem("together", {"material": material, "tests": parts}, False)


def _written(material: Tables) -> dict[str, object]:
    """Material without keys that say nothing, so that equal materials have equal names."""
    return {k: v for k, v in material.items() if v not in (None, {}, False)}


def _method(method: str, tables: Tables, is_external: bool) -> str:
    if method == "none":
        return "none"
    if is_external and method != "analytic":
        return "external"
    setup = Setup.of(tables)
    homogeneous = setup.is_homogeneous
    if method == "analytic" and not homogeneous:
        rule = "method = 'analytic' needs compression with both faces frictionless"
        raise InputError(Fault("calibration.method", rule, "use 'auto' or 'inverse-fem'"))
    if method == "inverse-fem" and not setup.has_no_elements:
        return "inverse-fem"
    return "closed-form" if homogeneous else "inverse-fem"


def fit_key(problem: FitProblem, measured: Sequence[Curve]) -> str:
    """Name of a fit: a hash of the problem, the data and the code."""
    data = [curve.name for curve in measured]
    return digest([problem.method, named(problem.tables), data, code_version()], 32)


def start_problem(problem: FitProblem) -> FitProblem | None:
    """Fit of the same test whose constants start this one: neo-Hookean, or one order lower.

    A third-order polynomial that starts from the neo-Hookean constant alone walks into
    constants that soften without end. Start values are thus a function of the case alone.
    """
    section = problem.material
    simulated = any(method == "inverse-fem" for method, _ in problem.tests)
    if not simulated or section.constants:
        return None
    simpler = ENERGIES[section.model].simpler(section.order or 1)
    if simpler is None:
        return None
    model, order = simpler
    written = table_of(problem.tables, "material")
    material = _written({**written, "model": model, "order": order, "constants": None})
    return FitProblem(
        problem.method, {**problem.tables, "material": material}, problem.shares_scored_problem
    )
