"""Constants of one material from one or several measured tests (``study calibrate``)."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from study.arrays import Array
from study.calibration.function import EvaluationFailed
from study.calibration.identifiability import identify
from study.calibration.lack_of_fit import lack_of_fit, pattern, same_constants
from study.calibration.profile_likelihood import profile
from study.calibration.random_effects import population
from study.canonical import digest
from study.curve import Curve
from study.design.sections.calibration_design import CalibrationDesign
from study.errors import Fault, InputError
from study.measurement.conditioning import is_caution
from study.runner.calibration.bootstrap import bootstrap
from study.runner.calibration.judgement import plausible, range_stability
from study.runner.calibration.measured_tests import (
    FitCurve,
    in_order,
    left_out,
    of_specimens,
    parts_of,
    problem_of,
    read_tests,
    warnings_of,
)
from study.runner.calibration.nuisance.propagation import predicted
from study.runner.calibration.optimal_design import next_tests
from study.runner.calibration.result import CalibrationResult, CurveFit, PartialFit
from study.runner.calibration.search import Setting, from_all_starts, setting_of
from study.runner.fitting import fit_task
from study.runner.fitting.fit_summary import status_of
from study.runner.fitting.staged_fit import (
    Checkpoint,
    Progress,
    Staged,
)
from study.runner.provenance import code_version
from study.setup.section import table_of

if TYPE_CHECKING:
    from study.calibration.fit import Fit
    from study.calibration.measured_curve import MeasuredCurve
    from study.calibration.profile_likelihood import Profile

#: correlation of neighboring rows from which a misfit is more likely than noise
_ORDERED = 0.5


def calibrate(
    config: CalibrationDesign,
    root: Path,
    *,
    progress: Progress | None = None,
    profiles: bool = False,
    resamples: int = 0,
    folder: Path | None = None,
    begin: Mapping[str, float] | None = None,
) -> CalibrationResult:
    """Fit one material to all tests of a calibration at once.

    Parameters
    ----------
    config : CalibrationDesign
        The calibration.
    root : Path
        Data root.
    progress : callable, optional
        Gets every accepted iteration of every stage.
    profiles : bool
        Whether profile-likelihood intervals are computed.
    resamples : int
        How many resampled fits give bootstrap intervals; 0 for none.
    folder : Path, optional
        Where accepted iterations are kept, so that an interrupted calibration can go on.
    begin : mapping of str to float, optional
        Constants to start from, MPa (exponents plain), in place of all starts of the calibration.

    Raises
    ------
    InputError
        If data are missing or malformed, or cannot answer.
    """
    began = time.perf_counter()
    curves, notes = read_tests(config.tests, root)
    own, left = _splits(config, curves)
    checkpoint = _checkpoint(folder, config, curves)
    setting = setting_of(config, curves, progress, checkpoint, begin)
    done, starts = setting.fitted(curves, checkpoint), None
    if begin is None:
        done, starts = from_all_starts(setting, curves, done)
    found = done.fit
    specimens = tuple(_partial(setting, label, group) for label, group in own.items())
    cross = tuple(_partial(setting, label, group) for label, group in left)
    result = _result(setting, curves, done)
    result = replace(
        result,
        specimens=specimens,
        same_constants_p=_same_constants(found, specimens),
        population=population([one.fit for one in specimens]),
        cross_validation=cross,
        profiles=_profiles(setting, curves, found) if profiles and found.converged else {},
        bootstrap=(
            bootstrap(found, config, curves, resamples, setting.bounds)
            if resamples and found.converged
            else None
        ),
        starts=starts,
        notes=(*notes, *setting.moved, *(() if starts is None else (starts.sentence,))),
        warnings=(*(note for note in notes if is_caution(note)), *result.warnings),
        seconds=time.perf_counter() - began,
    )
    checkpoint.clear()
    return result


def _checkpoint(
    folder: Path | None, config: CalibrationDesign, curves: Sequence[FitCurve]
) -> Checkpoint:
    if folder is None:
        return Checkpoint()
    data = [[c.label, c.role, c.weight, c.measured.curve.as_dict()] for c in curves]
    problems = [problem_of(test.tables).tables for test in config.tests]
    key = digest([problems, config.document, data, code_version()], 32)
    return Checkpoint(folder / "calibration.checkpoint.json", key)


def _splits(
    config: CalibrationDesign, curves: Sequence[FitCurve]
) -> tuple[dict[str, list[FitCurve]], list[tuple[str, list[FitCurve]]]]:
    """Choose the curves of every specimen and of every leave-out, before anything is fitted."""
    asked = config.asked
    own = of_specimens(curves) if asked.specimens == "each" else {}
    if asked.specimens == "each" and len(own) < 2:
        mend = "name the column of the specimens in measurements.block"
        raise InputError(Fault("calibration.specimens", "there is only one specimen", mend))
    return own, left_out(curves, asked.leave_out) if asked.leave_out else []


def _partial(setting: Setting, label: str, curves: Sequence[FitCurve]) -> PartialFit:
    done = setting.fitted(curves)
    return PartialFit(label, done.fit, _predictions(setting, curves, done.fit))


def _predictions(setting: Setting, curves: Sequence[FitCurve], found: Fit) -> tuple[CurveFit, ...]:
    """Every curve beside its prediction; those of held-out tests are made now."""
    fitted = iter(found.curves)
    known = {id(c): next(fitted, None) for c in in_order(curves)}
    out = []
    for curve in curves:
        predicted, message = known.get(id(curve)), "" if found.status.usable else found.message
        if curve.role == "held-out" and found.status.usable:
            predicted, message = _predicted(setting, curve, found)
        out.append(
            CurveFit(curve.file, curve.specimen, curve.role, curve.measured, predicted, message)
        )
    return tuple(out)


def _predicted(setting: Setting, curve: FitCurve, found: Fit) -> tuple[Curve | None, str]:
    (part,) = parts_of(setting.tests, [curve])
    try:
        model = fit_task.model(part.method, part.tables, [curve.measured.curve], setting.names)
        return model(found.values)[0], ""
    except EvaluationFailed as error:
        return None, str(error)


def _same_constants(found: Fit, specimens: Sequence[PartialFit]) -> float | None:
    if len(specimens) < 2 or not all(one.fit.converged for one in specimens):
        return None
    fits = [one.fit for one in specimens]
    rows = sum(
        one.n if one.serial is None else min(one.n, one.serial.effective_rows) for one in fits
    )
    own = sum(one.rss for one in fits)
    return same_constants(found.rss, own, rows, len(found.names), len(specimens))


def _profiles(setting: Setting, curves: Sequence[FitCurve], found: Fit) -> dict[str, Profile]:
    own = in_order(curves)
    parts = parts_of(setting.tests, own)
    models = [
        fit_task.model(p.method, p.tables, [m.curve for m in p.measured], setting.names)
        for p in parts
    ]

    def predict(values: Array) -> list[Curve]:
        if found.joint is not None:
            return predicted(parts, setting.tests, own, setting.names, values)
        return [curve for model in models for curve in model(values)]

    whole = found.joint or found
    free = [(-np.inf, np.inf)] * (len(whole.names) - len(setting.names))
    bounds = None if setting.bounds is None else [*setting.bounds, *free]
    measured = [m for part in parts for m in part.measured]
    known = {n for n, e in zip(whole.names, whole.standard_error, strict=True) if e > 0}
    return {
        name: profile(predict, measured, whole, name, bounds=bounds)
        for name in whole.names
        if name in known
    }


def _measured(setting: Setting, curves: Sequence[FitCurve]) -> list[MeasuredCurve]:
    parts = parts_of(setting.tests, in_order(curves))
    return [one for part in parts for one in part.measured]


def _result(setting: Setting, curves: Sequence[FitCurve], done: Staged) -> CalibrationResult:
    found, section = done.fit, setting.config.material
    predictions = _predictions(setting, curves, found)
    status: str = status_of(found)
    message = done.message
    material, stable, stability = None, False, "nothing is known of it"
    cautions: list[str] = []
    if found.status.usable:
        material = section.material(found.constants())
        judged_as, message = plausible(material, message)
        status = status if judged_as == "converged" else judged_as
        stable, stability = range_stability(setting.tests, curves, material)
    judged = list(zip(in_order(curves), found.curves, strict=False))
    repeated = [r for c, p in judged if (r := c.repeated(p)) is not None]
    order = pattern([c.residual(p) for c, p in judged])
    if found.serial is not None and found.serial.correlation > _ORDERED:
        cautions.append(
            f"neighboring rows are correlated by {found.serial.correlation:.2f}, which is "
            "misfit rather than noise: intervals and AICc allow for a drift, not for an energy "
            "that is wrong"
        )
    if setting.config.asked.specimens == "pooled" and len(of_specimens(curves)) > 1:
        cautions.append(
            "specimens are pooled: intervals are those of these specimens, not of the population; "
            'write calibration.specimens = "each"'
        )
    return CalibrationResult(
        name=setting.config.name,
        model=section.model,
        status=status,
        message=message,
        fit=found,
        material=material,
        stable=stable,
        stability=stability,
        curves=predictions,
        evaluations=done.evaluations,
        seconds=0.0,
        lack_of_fit=lack_of_fit(repeated, len(found.names)) if found.converged else None,
        pattern=order,
        identified=identify(found, _measured(setting, curves)) if found.converged else None,
        next_tests=(
            next_tests(found, curves, material, setting.tests)
            if found.converged and material is not None
            else None
        ),
        warnings=(*warnings_of(curves), *cautions),
        tests=tuple(
            {
                table: table_of(test.tables, table)
                for table in ("specimen", "test", "material", "model")
            }
            for test in setting.tests
        ),
    )
