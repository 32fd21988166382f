"""Constants of one material from one or several measured tests (``study calibrate``)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from study.curve import Curve
from study.errors import Fault, InputError
from study.record import SORTED, MeasuredTest, read_measurements
from study.runner import build, fits, scoring

if TYPE_CHECKING:
    from study.calibration import Fit

Array = NDArray[np.float64]
Config = Mapping[str, Any]


@dataclass(frozen=True)
class CalibrationResult:
    """Fit of one material to several tests.

    Parameters
    ----------
    model : str
        Name of the energy.
    fit : Fit
        Of :mod:`study.calibration`; constants in MPa.
    stable : bool
        Drucker's criterion over the range of the fitted tests.
    stability : str
        The same in words.
    curves : tuple of dict
        ``file``, ``role``, ``rms_force_error`` (N), ``relative_rms_force_error`` (%).
    warnings : tuple of str
        What was done to the measurements that may mean that they are not what they seem.
    """

    model: str
    fit: Fit
    stable: bool
    stability: str
    curves: tuple[dict[str, Any], ...]
    warnings: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Document of ``study calibrate --json``."""
        from study.record.record import plain

        found = self.fit
        content = {
            "status": "converged" if found.converged else "not-converged",
            "message": found.status.sentence,
            "model": self.model,
            "parameters": {n: self._parameter(i, n) for i, n in enumerate(found.names)},
            "rss": found.rss,
            "r_squared": found.r_squared,
            "aicc": found.aicc,
            "correlation": found.correlation,
            "condition": found.condition,
            "identifiable": found.identifiable,
            "reason": found.reason,
            "stable": self.stable,
            "stability": self.stability,
            "evaluations": found.evaluations,
            "curves": list(self.curves),
            "warnings": list(self.warnings),
        }
        made: dict[str, Any] = plain(content, "calibration", {})
        return made

    def _parameter(self, index: int, name: str) -> dict[str, Any]:
        scale = 1.0 if scoring.is_plain(name) else 1000.0
        return {
            "value": scale * float(self.fit.values[index]),
            "unit": "" if scoring.is_plain(name) else "kPa",
            "standard_error": scale * float(self.fit.standard_error[index]),
            "ci95": [scale * float(v) for v in self.fit.ci95[index]],
        }


def calibrate(config: Config, root: Path) -> CalibrationResult:
    """Fit one material to all tests of a calibration at once.

    Parameters
    ----------
    config : mapping
        Of :func:`study.design.load_calibration`.
    root : Path
        Data root.

    Raises
    ------
    InputError
        If data are missing or malformed.
    """
    from study.calibration import MeasuredCurve, fit

    tests = list(config["tests"])
    measured = [_measured(test, root) for test in tests]
    if not any(test["role"] == "fit" for test in tests):
        raise InputError(Fault("tests", "none has role = 'fit': there is nothing to fit"))
    data = [
        MeasuredCurve(_name(test), m.curve, _weight(test, m), test["role"])
        for test, m in zip(tests, measured, strict=True)
    ]
    names, start = _start(tests, measured)
    models = [_model(test, m.curve, names) for test, m in zip(tests, measured, strict=True)]

    def predict(values: Array) -> list[Curve]:
        return [model(values)[0] for model in models]

    homogeneous = all(build.is_homogeneous(test) for test in tests)
    method = "closed-form" if homogeneous else "inverse-fem"
    found = fit(predict, data, names, start, **fits.TOLERANCES[method])
    return _result(config, tests, measured, found)


def _measured(test: Config, root: Path) -> MeasuredTest:
    height = build.height_mm(test["specimen"])
    depth = test["test"].get("displacement_mm")
    data = read_measurements(test["measurements"], root, height, depth)
    if len(data.blocks) > 1:
        rule = f"holds {len(data.blocks)} blocks ({', '.join(data.blocks[:5])}); a test is one"
        mend = "choose one with fit = { ... }"
        if data.fit is None:
            raise InputError(Fault("tests.measurements", rule, mend))
    return data.curve(None, **dict(data.fit or {}))


def _name(test: Config) -> str:
    spec = test["measurements"]
    return str(spec.file or spec.files)


def _weight(test: Config, measured: MeasuredTest) -> float | Array:
    """Weight of a test: a number, or one over the scatter of its repeats."""
    asked = test["weight"]
    if asked == "equal":
        return 1.0
    if asked != "scatter":
        return float(asked)
    if measured.scatter_N is None:
        mend = "average several repeats, or write weight = 'equal'"
        raise InputError(Fault("tests.weight", "a single test has no scatter", mend))
    # repeats meet by chance at some points, which must not count for everything
    floor = 0.1 * float(np.median(measured.scatter_N))
    return np.asarray(1 / np.maximum(measured.scatter_N, max(floor, 1e-9)))


def _start(
    tests: Sequence[Config], measured: Sequence[MeasuredTest]
) -> tuple[tuple[str, ...], Array]:
    """Given constants, or the neo-Hookean fit of the first fitted test."""
    index = next(i for i, test in enumerate(tests) if test["role"] == "fit")
    test, curve = tests[index], measured[index].curve
    section = {**test, "calibration": {"method": "auto"}}
    problem = fits.fit_problem(section)
    before = fits.start_problem(problem)
    values = None
    if before is not None:
        found = fits.perform(fits.payload(before, [curve], None))
        if found["status"] != "converged":
            message = f"the neo-Hookean start did not converge: {found['message']}"
            raise InputError(Fault("calibration", message, "give constants to start from"))
        values = found["values"]
    return fits.start_values(problem.config, [curve], values)


def _model(test: Config, curve: Curve, names: Sequence[str]) -> fits.Predict:
    problem = fits.fit_problem({**test, "calibration": {"method": "auto"}})
    if problem.method == "closed-form":
        return fits.closed_form_model(problem.config, [curve], names)
    return fits.InverseFem(problem.config, [curve], names)


def _result(
    config: Config, tests: Sequence[Config], measured: Sequence[MeasuredTest], found: Fit
) -> CalibrationResult:
    from study.material import stability

    curves = tuple(
        {
            "file": _name(test),
            "role": test["role"],
            "rms_force_error": scoring.rms_force_error(curve, m.curve),
            "relative_rms_force_error": scoring.relative_rms_force_error(curve, m.curve),
        }
        for test, m, curve in zip(tests, measured, found.curves, strict=True)
    )
    material = build.material(config["material"], found.constants())
    strains = [
        float(m.curve.displacement_mm.max()) / height
        for test, m in zip(tests, measured, strict=True)
        if (height := build.height_mm(test["specimen"])) and test["test"]["kind"] == "compression"
    ]
    judged = (
        stability(material, np.linspace(1 - max(strains), 1, 41))
        if strains
        else stability(material)
    )
    notes = tuple(note for m in measured for note in m.notes if SORTED in note)
    return CalibrationResult(
        config["material"]["model"], found, bool(judged.stable), judged.sentence, curves, notes
    )
