"""Constants of one material from one or several measured tests (``study calibrate``)."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from study.ground.arrays import Array
from study.ground.canonical import digest
from study.ground.curve import Curve
from study.ground.declaration import table_of
from study.ground.errors import Fault, InputError
from study.mechanics.calibration.fit_influence import population, with_serial_correlation
from study.mechanics.calibration.identifiability import identify, profile
from study.mechanics.calibration.lack_of_fit import (
    Verdict,
    adequacy,
    lack_of_fit,
    pattern,
    same_constants,
)
from study.mechanics.calibration.residual_function import EvaluationFailed
from study.mechanics.material.material import Material, is_dimensionless
from study.mechanics.material.stability import check
from study.mechanics.measurement.conditioning import is_caution
from study.mechanics.measurement.reading import first_notes
from study.mechanics.measurement.recording import LARGEST_STRETCH
from study.simulation.calibration.calibration_bound import estimated_bound, with_numerical
from study.simulation.calibration.calibration_file import CalibratedTest, CalibrationDesign
from study.simulation.calibration.calibration_result import CalibrationResult, PartialFit
from study.simulation.calibration.measured_tests import (
    FitCurve,
    in_order,
    left_out,
    machine_notes,
    of_specimens,
    parts_of,
    read_tests,
    warnings_of,
    with_contact_offsets,
)
from study.simulation.calibration.nuisance import NuisancePredictions, with_nuisance
from study.simulation.calibration.optimal_tests import next_tests
from study.simulation.calibration.resampling import (
    Starts,
    bootstrap,
    excluded,
    refuse_bootstrap,
    scattered,
)
from study.simulation.fit_task import (
    NO_LIMITS,
    Checkpoint,
    Limits,
    Progress,
    Staged,
    StagedSearch,
    begun_stage,
    cheaper,
    gentler,
    least_minimum,
    models_of,
    named_open,
    staged_fit,
    start_values,
)
from study.simulation.job import FitProblem, fitted_test, stability_over, start_problem, status_of
from study.simulation.provenance import code_version
from study.simulation.response import residual_N

if TYPE_CHECKING:
    from study.mechanics.calibration.fit import Fit
    from study.mechanics.calibration.identifiability import LikelihoodProfile


# Whether the constants found make a material, and how far it is stable.


def plausible(material: Material, message: str) -> tuple[str, str]:
    """Status of a converged fit by its initial shear modulus."""
    if not material.mu0 > 0:
        rule = f"the fit ended at an initial shear modulus of {1e3 * material.mu0:.4g} kPa"
        return "unstable", rule
    try:
        faults = list(check(material))
    except InputError as error:
        return "unstable", str(error)
    if faults:
        return "implausible", faults[0]
    return "converged", message


# Where the search for the constants of a calibration begins, and within which bounds.


@dataclass(frozen=True)
class Setting:
    """What all fits of one calibration share."""

    config: CalibrationDesign
    tests: Sequence[CalibratedTest]
    names: tuple[str, ...]
    start: Array
    bounds: Sequence[tuple[float, float]]
    progress: Progress | None
    #: what was done to a start outside the bounds, in words
    moved: tuple[str, ...] = ()
    limits: Limits = NO_LIMITS

    def search(self, checkpoint: Checkpoint | None = None) -> StagedSearch:
        """Search of its stages; without a checkpoint nothing of it is kept."""
        kept_at = checkpoint or Checkpoint(limits=self.limits)
        return StagedSearch(self.names, self.bounds, self.progress, kept_at)

    def fitted(self, curves: Sequence[FitCurve], checkpoint: Checkpoint | None = None) -> Staged:
        """Fit to the curves whose role is ``fit``."""
        ordered = in_order(curves)
        done = staged_fit(parts_of(self.tests, ordered), self.start, self.search(checkpoint))
        corrected = with_serial_correlation(done.fit, ordered)
        return replace(done, fit=with_nuisance(corrected, self.tests, ordered, self.bounds))


def setting_of(
    config: CalibrationDesign,
    curves: Sequence[FitCurve],
    progress: Progress | None,
    checkpoint: Checkpoint,
    begin: Mapping[str, float] | None = None,
) -> Setting:
    """Constants, start and bounds of a calibration. Units: begin MPa."""
    tests, given = config.tests, config.bounds
    if begin is None:
        names, start = _start(tests, curves, progress, checkpoint)
    else:
        names, start = tuple(begin), np.array(list(begin.values()), float)
    bounds = config.bounds_of(names)
    low, high = np.array(bounds).T
    inside = np.clip(start, low, high)
    outside = [name for name, moved in zip(names, inside != start, strict=True) if moved]
    if outside and config.material.constants:
        raise InputError([excluded(n, start[names.index(n)], given[n]) for n in outside])
    moved = tuple(
        f"the start of {n} lay outside its bounds and was moved to {inside[names.index(n)]:.6g}"
        for n in outside
    )
    return Setting(config, tests, names, inside, bounds, progress, moved, checkpoint.limits)


def from_all_starts(
    setting: Setting, curves: Sequence[FitCurve], first: Staged
) -> tuple[Staged, Starts | None, tuple[Staged, ...]]:
    """Fit from other starts; the least sum of squares is the answer, with its rivals.

    Energies with exponents begin on both sides of zero, unasked; others as often as asked.
    """
    count, seed = setting.config.fitting.starts, setting.config.fitting.seed
    rng, parts = np.random.default_rng(seed), parts_of(setting.tests, in_order(curves))
    quiet = replace(setting, progress=None)
    search = quiet.search()

    def fit_from(start: Array) -> Staged:
        return replace(quiet, start=start).fitted(curves)

    drawn = [scattered(search, setting.start, parts, rng) for _ in range(count - 1)]
    tried = [first, *map(fit_from, drawn)]
    chosen, others = least_minimum(tried, parts, setting.start, search, fit_from)
    rss = tuple(start.fit.rss if start.fit.converged else None for start in tried)
    return chosen, Starts(seed, rss) if count > 1 else None, others


def _start(
    tests: Sequence[CalibratedTest],
    curves: Sequence[FitCurve],
    progress: Progress | None,
    checkpoint: Checkpoint,
) -> tuple[tuple[str, ...], Array]:
    """Find the start: the given constants, or those of a simpler fit of one fitted test."""
    # A homogeneous test is preferred: its closed form costs nothing.
    fitted = list(dict.fromkeys(c.test for c in in_order(curves)))
    ways = {number: fitted_test("auto", tests[number].problem) for number in fitted}
    closed = [number for number in fitted if ways[number].method == "closed-form"]
    number = (closed or fitted)[0]
    part = parts_of(tests, [c for c in in_order(curves) if c.test == number])[0]
    measured = [m.curve for m in part.measured]
    constants: dict[str, float] | None = None
    chain: list[FitProblem] = []  # of problems that lead to this one, the neo-Hookean one first
    simplest = start_problem(FitProblem(ways[number].method, (ways[number],)))
    while simplest is not None:
        chain.insert(0, simplest)
        simplest = start_problem(simplest)
    for before in chain:
        begun = before.tests[0].problem
        names, first = start_values(begun, measured, constants)
        simpler_part = replace(part, problem=begun)
        stage = f"start ({before.material.model}, {len(names)} constants)"
        search = StagedSearch(names, None, progress, checkpoint)
        stage_parts = [cheaper(simpler_part) or simpler_part]
        simpler = begun_stage(stage, stage_parts, gentler(names, first), search).fit
        if not simpler.status.usable:
            message = f"the {stage} did not converge: {simpler.message}"
            raise InputError(Fault("calibration", message, "give constants to start from"))
        constants = simpler.constants()
    return start_values(ways[number].problem, measured, constants)


def calibrate(
    config: CalibrationDesign,
    root: Path,
    *,
    progress: Progress | None = None,
    profiles: bool = False,
    resamples: int = 0,
    folder: Path | None = None,
    begin: Mapping[str, float] | None = None,
    plan: bool = True,
) -> CalibrationResult:
    """Fit one material to all tests of a calibration at once, and ``plan`` the next test.

    Units: begin MPa.
    """
    began = time.perf_counter()
    curves, notes = read_tests(config.tests, root, config.fitting.loss)
    config = replace(config, tests=with_contact_offsets(config.tests, curves))
    refuse_bootstrap(config.tests, resamples)
    by_specimen, left = _splits(config, curves)
    allowed = math.inf if config.fitting.max_time is None else config.fitting.max_time
    limits = Limits(config.fitting.max_evaluations, time.monotonic() + allowed)
    checkpoint = _checkpoint(folder, config, curves, limits)
    setting = setting_of(config, curves, progress, checkpoint, begin)
    done, starts = setting.fitted(curves, checkpoint), None
    others: tuple[Staged, ...] = ()
    if begin is None:
        done, starts, others = from_all_starts(setting, curves, done)
    fit = done.fit
    if any(is_dimensionless(name) for name in setting.names) and fit.converged:
        setting = replace(setting, start=fit.values)  # parts of the data begin at this minimum
    specimens = tuple(_partial(setting, label, group) for label, group in by_specimen.items())
    cross = tuple(_partial(setting, label, group) for label, group in left)
    result = _result(setting, curves, done)
    if plan and fit.converged and result.material is not None and result.adequacy.describes:
        result = replace(result, next_tests=next_tests(fit, curves, result.material, setting.tests))
    parts, judged = parts_of(setting.tests, in_order(curves)), named_open(fit, others)
    numerical = estimated_bound(fit, parts, done.models) if fit.converged else None
    by_machine = first_notes(machine_notes(setting.tests, result.curves))
    result = replace(
        result,
        fit=judged if numerical is None else with_numerical(judged, numerical),
        numerical=None if numerical is None else numerical.as_dict(),
        specimens=specimens,
        same_constants_p=_same_constants(fit, specimens),
        population=population([specimen.fit for specimen in specimens]),
        cross_validation=cross,
        profiles=_profiles(setting, curves, fit) if profiles and fit.converged else {},
        bootstrap=bootstrap(fit, config, curves, resamples, setting.bounds)
        if resamples and fit.converged
        else None,
        starts=starts,
        minima=tuple(minimum.fit for minimum in (done, *others)),
        notes=(
            *notes,
            *by_machine,
            *setting.moved,
            *(() if starts is None else (starts.sentence,)),
        ),
        warnings=(*(note for note in notes if is_caution(note)), *result.warnings),
        seconds=time.perf_counter() - began,
    )
    checkpoint.clear()
    return result


def _checkpoint(
    folder: Path | None, config: CalibrationDesign, curves: Sequence[FitCurve], limits: Limits
) -> Checkpoint:
    if folder is None:
        return Checkpoint(limits=limits)
    data = [[c.label, c.role, c.weight, c.curve.as_dict()] for c in curves]
    problems = [fitted_test("auto", test.problem).name for test in config.tests]
    key = digest([problems, config.document, data, code_version()], 32)
    return Checkpoint(folder / "calibration.checkpoint.json", key, limits)


def _splits(
    config: CalibrationDesign, curves: Sequence[FitCurve]
) -> tuple[dict[str, list[FitCurve]], list[tuple[str, list[FitCurve]]]]:
    """Choose the curves of every specimen and of every leave-out, before anything is fitted."""
    settings = config.fitting
    by_specimen = of_specimens(curves) if settings.specimens == "each" else {}
    if settings.specimens == "each" and len(by_specimen) < 2:
        mend = "name the column of the specimens in measurements.block"
        raise InputError(Fault("calibration.specimens", "there is only one specimen", mend))
    return by_specimen, left_out(curves, settings.leave_out) if settings.leave_out else []


def _partial(setting: Setting, label: str, curves: Sequence[FitCurve]) -> PartialFit:
    done = setting.fitted(curves)
    return PartialFit(label, done.fit, _predictions(setting, curves, done.fit))


def _predictions(setting: Setting, curves: Sequence[FitCurve], fit: Fit) -> tuple[FitCurve, ...]:
    """Every curve beside its prediction; those of held-out tests are made now."""
    fitted = dict(zip(map(id, in_order(curves)), fit.curves, strict=False))
    out = []
    for curve in curves:
        predicted, message = fitted.get(id(curve)), "" if fit.status.usable else fit.message
        if curve.role == "held-out" and fit.status.usable:
            try:
                (model,) = models_of(parts_of(setting.tests, [curve]), setting.names)
                predicted = model(fit.values)[0]
            except EvaluationFailed as error:
                message = str(error)
        out.append(replace(curve, predicted=predicted, message=message))
    return tuple(out)


def _same_constants(pooled: Fit, specimens: Sequence[PartialFit]) -> float | None:
    if len(specimens) < 2 or not all(specimen.fit.converged for specimen in specimens):
        return None
    fits = [specimen.fit for specimen in specimens]
    rows = sum(
        each.n if each.serial is None else min(each.n, each.serial.effective_rows) for each in fits
    )
    separate = sum(each.rss for each in fits)
    return same_constants(pooled.rss, separate, rows, len(pooled.names), len(specimens))


def _profiles(
    setting: Setting, curves: Sequence[FitCurve], fit: Fit
) -> dict[str, LikelihoodProfile]:
    ordered = in_order(curves)
    models = models_of(parts_of(setting.tests, ordered), setting.names)

    def predict(values: Array) -> list[Curve]:
        if fit.joint is not None:
            model = NuisancePredictions(setting.tests, ordered, setting.names)
            return model(values, [param for param in model.parameters if param.is_fitted])
        return [curve for model in models for curve in model(values)]

    whole = fit.joint or fit
    free = [(-np.inf, np.inf)] * (len(whole.names) - len(setting.names))
    bounds = [*setting.bounds, *free]
    estimated = {n for n, e in zip(whole.names, whole.standard_error, strict=True) if e > 0}
    return {
        name: profile(predict, ordered, whole, name, bounds=bounds)
        for name in whole.names
        if name in estimated
    }


def _implausible_stretches(
    tests: Sequence[CalibratedTest], curves: Sequence[FitCurve]
) -> list[tuple[Verdict, str]]:
    """Stretches that no soft material reaches: a unit is wrong."""
    out: list[tuple[Verdict, str]] = []
    for curve in in_order(curves):
        setup, places = tests[curve.test].problem.setup, curve.curve.displacement_mm
        if setup.height_mm is None or setup.kind.compresses or setup.test.indenter is not None:
            continue
        stretch = 1 + float(np.abs(places).max()) / setup.height_mm
        if stretch > LARGEST_STRETCH:
            why = (
                f"{curve.label}: a stretch of {stretch:.4g} is not plausible: check units, "
                'strain = "%" may be meant'
            )
            out.append(("does not describe", why))
    return list(dict.fromkeys(out))


def _result(setting: Setting, curves: Sequence[FitCurve], done: Staged) -> CalibrationResult:
    fit, section = done.fit, setting.config.material
    predictions = _predictions(setting, curves, fit)
    status = status_of(fit)
    message = done.message
    material, stable, stability = None, False, "nothing is known of it"
    cautions: list[str] = []
    if fit.status.usable:
        material = section.material(fit.constants())
        judged_as, message = plausible(material, message)
        status = status if judged_as == "converged" else judged_as
        reached = [(setting.tests[c.test].problem.setup, c.curve.displacement_mm) for c in curves]
        judged_stable = stability_over(material, reached)
        stable, stability = judged_stable.stable, judged_stable.sentence
    ordered = in_order(predictions)
    weighted = [
        (curve, curve.weight * residual_N(curve.predicted, curve.curve))
        for curve in ordered
        if curve.predicted is not None
    ]
    repeated = [
        (left, c.weight * c.measured.scatter_N, c.measured.n_repeats)
        for c, left in weighted
        if c.measured.scatter_N is not None
    ]
    lack = lack_of_fit(repeated, len(fit.names)) if fit.converged else None
    judgement = adequacy(
        fit, ordered, tests=[c.test for c in ordered], lack=lack,
        more=_implausible_stretches(setting.tests, curves),
    )  # fmt: skip
    gauges = {setting.tests[c.test].problem.setup.has_no_elements for c in ordered}
    if len(gauges) > 1 and all(isinstance(c.weight, float) for c in ordered):
        cautions.append(
            "forces of gauge sections and of simulated specimens are weighed in N, so that the "
            'cross-sections decide which counts: write weight = "scatter", "relative" or a number'
        )
    if setting.config.fitting.specimens == "pooled" and len(of_specimens(curves)) > 1:
        cautions.append(
            "specimens are pooled: intervals are those of these specimens, not of the population; "
            'write calibration.specimens = "each"'
        )
    return CalibrationResult(
        name=setting.config.name,
        model=section.model,
        status=status,
        message=message,
        fit=fit,
        material=material,
        stable=stable,
        stability=stability,
        curves=predictions,
        evaluations=done.evaluations,
        seconds=0.0,
        adequacy=judgement,
        lack_of_fit=lack,
        pattern=pattern([left for _, left in weighted]),
        identified=identify(fit, ordered) if fit.converged else None,
        warnings=(*warnings_of(curves), *cautions),
        tests=tuple(
            {
                table: table_of(document, table)
                for table in ("specimen", "test", "material", "model")
            }
            for document in (test.problem.document() for test in setting.tests)
        ),
    )
