"""Choice between energies: each is fitted to the same tests and weighed by AICc."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, cast

from study.calibration.lack_of_fit import akaike_weights
from study.canonical import digest
from study.curve import Curve
from study.errors import Fault, InputError
from study.measurement.measured_test import MeasuredTest, Measurements, Selection
from study.record.record import plain
from study.runner.calibration.calibrate import calibrate
from study.runner.calibration.result import CalibrationResult
from study.runner.fitting.fit_task import FitProblem, fit_problem, together
from study.runner.fitting.staged_fit import Progress
from study.runner.job import DataCache
from study.runner.tables import Tables

if TYPE_CHECKING:
    from study.design.spec import Case

#: energies compared: name, order, label
CANDIDATES = (
    ("neo-hookean", None, "neo-hookean"),
    ("mooney-rivlin", None, "mooney-rivlin"),
    ("reduced-polynomial", 2, "reduced-polynomial-2"),
    ("reduced-polynomial", 3, "reduced-polynomial-3"),
    ("ogden", 1, "ogden-1"),
    ("arruda-boyce", None, "arruda-boyce"),
    ("gent", None, "gent"),
    ("fung", None, "fung"),
    ("veronda-westmann", None, "veronda-westmann"),
    ("van-der-waals", None, "van-der-waals"),
    ("extended-tube", None, "extended-tube"),
)


@dataclass(frozen=True)
class EnergyChoice:
    """Fits of several energies to the same tests.

    Parameters
    ----------
    fits : mapping of str to CalibrationResult
        By label, in the order of the candidates.
    weights : mapping of str to float
        Akaike weights of those that converged.
    failures : mapping of str to str
        Energies without an answer, and why.
    """

    fits: Mapping[str, CalibrationResult]
    weights: Mapping[str, float]
    failures: Mapping[str, str]

    @property
    def best(self) -> str | None:
        """Label of the energy with the smallest AICc; None where none converged."""
        return max(self.weights, key=self.weights.__getitem__) if self.weights else None

    @property
    def sentence(self) -> str:
        """The choice in words, with what it does not say."""
        if self.best is None:
            return "no energy could be fitted"
        found = self.fits[self.best]
        said = f"AICc prefers {self.best} (weight {self.weights[self.best]:.3g})"
        if not found.fit.identifiable:
            return f"{said}, but its constants are not identifiable: {found.fit.reason}"
        return f"{said}; it compares energies on these data only, not the constants' truth"

    def to_json(self) -> dict[str, object]:
        """Table of the energies."""
        best = min((f.fit.aicc for f in self.fits.values()), default=0.0)

        content = {
            "best": self.best,
            "sentence": self.sentence,
            "energies": [
                {
                    "energy": label,
                    "status": found.status,
                    "constants": len(found.fit.names),
                    "aicc": found.fit.aicc,
                    "delta_aicc": found.fit.aicc - best,
                    "weight": self.weights.get(label),
                    "rss": found.fit.rss,
                    "mu0": None if found.material is None else 1e3 * found.material.mu0,
                    "identifiable": found.fit.identifiable,
                    "reason": found.fit.reason,
                    "stable": found.stable,
                    "held_out": [
                        c.as_dict()["relative_rms_force_error"]
                        for c in found.curves
                        if c.role == "held-out"
                    ],
                }
                for label, found in self.fits.items()
            ],
            "failures": dict(self.failures),
        }
        return cast("dict[str, object]", plain(content, "energies", {}))


def choose(config: Tables, root: Path, *, progress: Progress | None = None) -> EnergyChoice:
    """Fit every candidate to the tests of a calibration.

    Parameters
    ----------
    config : mapping
        Of :func:`study.design.load_calibration`; its material gives the compressibility.
    root : Path
        Data root.
    """
    found: dict[str, CalibrationResult] = {}
    failures: dict[str, str] = {}
    for model, order, label in CANDIDATES:
        try:
            result = calibrate(_with_energy(config, model, order), root, progress=progress)
        except InputError as error:
            failures[label] = str(error)
            continue
        if result.converged:
            found[label] = result
        else:
            failures[label] = f"{result.status}: {result.message}"
    weights = akaike_weights({label: one.fit.aicc for label, one in found.items()})
    return EnergyChoice(found, weights, failures)


def _with_energy(config: Tables, model: str, order: int | None) -> Tables:
    """Make the same calibration of another energy; start, bounds and extra fits do not carry."""
    material = {**config["material"], "model": model, "order": order, "constants": {}}
    tests = [{**test, "material": material} for test in config["tests"]]
    pooled: Tables = {"specimens": "pooled", "leave_out": None, "bounds": {}, "starts": 1}
    return {**config, "material": material, "tests": tests, "calibration": pooled}


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
    """List the tests of a study: its different specimens, tests and measurements."""
    found = {_name(config): _sections(config) for config in configs}
    return tuple(found.values())


def left_out(case: Case, scored: Measurements, data: DataCache) -> list[LeftOut]:
    """Every scored curve of a case, with the fit to everything else.

    Raises
    ------
    InputError
        If nothing else was measured.
    """
    if case.treatment.cell.leave_out == "specimen":
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
    spec = config["measurements"]
    written = spec.as_dict() if hasattr(spec, "as_dict") else spec
    test = {k: v for k, v in config["test"].items() if k != "steps"}
    return digest([config["specimen"], test, written])
