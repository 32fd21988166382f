"""The verb invert: all inputs of a study whose curve agrees with a measured one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from study import api
from study.api.fitting_surfaces import coded_settings, ranges_of
from study.api.folders import RESULTS
from study.api.predicting import (
    Permission,
    confirm,
    joined,
    number_in_unit,
    unknown_factors,
)
from study.ground import tabular, units
from study.ground.curve import Curve
from study.ground.errors import Fault, InputError, RefusedError
from study.harness.record.record import is_repeat
from study.harness.record.store import Store
from study.mechanics.calibration.serial_correlation import effective_rows
from study.reporting.results.study_answers import Checked, Determined, InputSet, Inverted
from study.statistics.surfaces.surface_factors import Runs
from study.statistics.surfaces.surface_inversion import InversionAgreement, agreeing
from study.statistics.surfaces.surface_profile import CurveEmulator, fit_curves

if TYPE_CHECKING:
    from study.api.predicting import Setting
    from study.ground.arrays import Array
    from study.harness.record.record import Record
    from study.reporting.results.study_result import StudyResult


#: fewest rows of a measured curve
FEWEST = 3

#: most times that the true model is run at the best setting, the emulator learning from each
ROUNDS = 4

#: rows below which nothing is said of their correlation
_TOO_FEW = 8


def invert(  # noqa: PLR0913  # the public face: one keyword for each thing that may be asked
    path: str | Path | StudyResult,
    to: str | Path,
    *,
    at: Mapping[str, Setting] | None = None,
    columns: Sequence[str] = ("displacement_mm", "force_N"),
    in_units: Sequence[str] = ("mm", "N"),
    within: str | None = None,
    decimal: str = ".",
    results: str | Path = RESULTS,
    confirming: bool = True,
    permission: Permission | None = None,
) -> Inverted:
    """Find all inputs of a study of simulations whose curve agrees with a measured one.

    The curves of the runs are emulated; the emulator's best setting is run by the true model,
    from which the emulator learns, until the two agree there.

    Parameters
    ----------
    path : str, Path or StudyResult
        Results folder, design file, name of the study, or the study itself.
    to : str or Path
        CSV of the measured curve, one row a point, displacements increasing.
    at : mapping, optional
        Settings of the inputs that are known, as for :func:`study.predict`; a factor that is no
        number needs one.
    columns, in_units : sequence of str
        Columns of displacement and force, and their units.
    within : str, optional
        What an agreeing curve may miss, root mean square over that of the measured force:
        ``"2 %"``. Without it the joint 95 % region of least squares is taken.
    decimal : {".", ","}
        Decimal mark of the CSV.
    results : Path
        Folder of the results, where ``path`` is a name.
    confirming : bool
        Whether the true model is run; the runs join the study's surfaces.
    permission : Permission, optional
        What the runs may use.

    Returns
    -------
    Inverted
        The set, what is determined of it, and the true model's runs.

    Raises
    ------
    InputError
        If a factor or the CSV cannot be read, or nothing is asked for.
    RefusedError
        If the emulator does not predict left-out curves (a Q2 below .9), or no curve agrees.
    """
    study = api.load(path, results) if isinstance(path, str | Path) else path
    given = _known(study, dict(at or {}))
    curve, notes = _read(Path(to), columns, in_units, decimal), []
    more = joined(study.design, Store(study.folder), study.manifest)
    every = [*study.records, *more.records]
    here = [
        record for record in every if all(record.levels[n] == v for n, v in given.labels.items())
    ]
    records = [
        record
        for record in here
        if record.converged and not is_repeat(record.extra) and record.first_prediction()
    ]
    curve, cut = _covered(curve, records, Path(to))
    notes += cut
    answer, runs, said = _solved(
        study, given, curve, records, _share(within), confirming, permission
    )
    return _told(study, given, curve, answer, runs, [*notes, *said])


@dataclass(frozen=True)
class _Known:
    """Inputs that are known: ranges in their units, labels of the others."""

    numbers: Mapping[str, float]
    labels: Mapping[str, str]


@dataclass(frozen=True)
class _Found:
    """A set, and the emulator that it comes from."""

    model: CurveEmulator
    set: InversionAgreement
    residual: Array


def _share(within: str | None) -> float | None:
    if within is None:
        return None
    with units.naming("--within"):
        share = units.parse(within, "ratio")
    if not share > 0:
        raise InputError(Fault("--within", f"must be more than zero, got {within!r}", "say 2 %"))
    return share


def _known(study: StudyResult, at: Mapping[str, Setting]) -> _Known:
    """Read the inputs that are known, and check that something is asked for."""
    design, factors = study.design, {factor.name: factor for factor in study.design.factors}
    ranges = [n for n, f in factors.items() if f.span is not None]
    if not ranges:
        rule = "has no numeric factor: there is nothing to be found"
        mend = 'write { low = "5 kPa", high = "15 kPa" } and [design] kind = "latin-hypercube"'
        raise InputError(Fault(design.name, rule, mend))
    faults = unknown_factors(at, list(factors))
    for name, factor in factors.items():
        if factor.span is None and str(at.get(name, "")) not in factor.labels:
            rule = "is no number: say at which of its levels the test was made"
            faults.append(Fault(name, rule, f"--at {name}={factor.labels[0]}"))
    if len([n for n in ranges if n not in at]) == 0:
        faults.append(Fault("--at", "holds every number", "leave those out that are asked for"))
    if any(record.block is not None for record in study.records):
        rule = "is a study with measurements: its constants come from fits"
        faults.append(Fault(design.name, rule, "use study calibrate, or a study of simulations"))
    if faults:
        raise InputError(faults)
    numbers = {n: float(number_in_unit(factors[n], at[n])[0]) for n in ranges if n in at}
    return _Known(numbers, {n: str(at[n]) for n, f in factors.items() if f.span is None})


def _read(source: Path, columns: Sequence[str], in_units: Sequence[str], decimal: str) -> Curve:
    """Read a measured curve."""
    if len(columns) != 2 or len(in_units) != 2:
        rule = "needs two names each: displacement and force"
        raise InputError(Fault("--columns, --units", rule, "write --columns d,f --units mm,N"))
    table = tabular.read_csv(source, required=columns, numbers=columns, decimal=decimal)
    with units.naming("--units"):
        displacement = table.numbers(columns[0]) * units.unit_factor(in_units[0], "length")
        force = table.numbers(columns[1]) * units.unit_factor(in_units[1], "force")
    falls = np.flatnonzero(np.diff(displacement) <= 0)
    if falls.size:
        rule = "displacements must increase from row to row"
        mend = "keep the loading of one test, or average repeats"
        raise InputError(Fault(table.place(int(falls[0]) + 1, columns[0]), rule, mend))
    if displacement.size < FEWEST or displacement[0] < 0:
        rule = f"needs at least {FEWEST} rows, with displacements from 0 on"
        raise InputError(Fault(str(source), rule))
    return Curve(displacement, force)


def _covered(curve: Curve, records: Sequence[Record], source: Path) -> tuple[Curve, list[str]]:
    """Rows that every run reaches, and what is to be said of the others."""
    ends = [
        float(curve_of_run.displacement_mm[-1])
        for r in records
        if (curve_of_run := r.first_prediction())
    ]
    if not ends:
        raise InputError(Fault(str(source), "no run has a curve to compare with"))
    inside = curve.displacement_mm <= min(ends) * (1 + 1e-9)
    if int(inside.sum()) < FEWEST:
        rule = f"has {int(inside.sum())} rows up to {min(ends):.4g} mm, where the runs end"
        mend = "give the study a longer test.displacement"
        raise InputError(Fault(str(source), rule, mend))
    lost = int((~inside).sum())
    lines = [f"{lost} rows beyond {min(ends):.4g} mm are left out: the runs end there"]
    return Curve(curve.displacement_mm[inside], curve.force_N[inside]), lines if lost else []


def _runs(study: StudyResult, records: Sequence[Record]) -> Runs:
    """Coded settings of runs."""
    more = joined(study.design, Store(study.folder), study.manifest)
    factors = ranges_of(more.design)
    coded = coded_settings(more.design, factors, [record.levels for record in records])
    return Runs("force", factors, coded, np.zeros(len(records)))


def _fitted(
    study: StudyResult,
    given: _Known,
    curve: Curve,
    records: Sequence[Record],
    share: float | None,
) -> _Found:
    """Emulate the curves, and find the set."""
    runs = _runs(study, records)
    curves = np.array([c.force_at(curve.displacement_mm) for r in records
                       if (c := r.first_prediction())])  # fmt: skip
    model = fit_curves(runs, curves, study.design.seed)
    held = np.array([runs.coded_inside(n, given.numbers[n]) if n in given.numbers else np.nan
                     for n in runs.names])  # fmt: skip
    size = float(np.sqrt(np.mean(curve.force_N**2)))
    largest = None if share is None else share * size
    solutions = agreeing(model, curve.force_N, held, largest=largest)
    residual = np.asarray(curve.force_N - model.value(solutions.at[None, :])[0])
    if share is None and residual.size >= _TOO_FEW:
        square = float(residual @ residual)
        worth = effective_rows(
            residual.size, float(residual[1:] @ residual[:-1]) / square if square > 0 else 0.0
        )
        solutions = agreeing(model, curve.force_N, held, rows_worth=worth)
    return _Found(model, solutions, residual)


def _solved(
    study: StudyResult,
    given: _Known,
    curve: Curve,
    records: list[Record],
    share: float | None,
    confirming: bool,
    permission: Permission | None,
) -> tuple[_Found, tuple[Checked, ...], list[str]]:
    """Let the true model run at the best setting until the emulator says the same there."""
    allowed = permission or Permission()
    answer = _fitted(study, given, curve, records, share)
    if not confirming:
        _check_agrees(answer, curve, share)
        return answer, (), []
    run, notes = None, list[str]()
    for _ in range(ROUNDS):
        run, record = _run(study, given, curve, answer, answer.set.at, allowed)
        if record is None:
            break
        force = _force(record, curve)
        missed = force - answer.model.value(_runs(study, [*records, record]).coded[-1:])[0]
        if record.case_id not in {earlier.case_id for earlier in records}:
            records.append(record)
            answer = _fitted(study, given, curve, records, share)
        if (apart := float(np.sqrt(np.mean(missed**2)))) <= answer.model.loo_rms:
            break
    else:
        notes.append(
            f"after {ROUNDS} runs at the best setting the emulator still misses the true model "
            f"there by {apart:.3g} N, more than its own error of {answer.model.loo_rms:.3g} N: add "
            "runs near that setting to the study"
        )
    _check_agrees(answer, curve, share)
    ends = []
    if answer.set.combinations or answer.set.open_low.any() or answer.set.open_high.any():
        ends = [_run(study, given, curve, answer, at_end, allowed)[0] for at_end in answer.set.ends]
    first = [] if run is None else [_judged(run, answer)]
    return answer, (*first, *(_judged(checked, answer) for checked in ends)), notes


def _judged(run: Checked, answer: _Found) -> Checked:
    # settings of a run are rounded to a ten-thousandth of their range
    return Checked(run.settings, run.rms, bool(run.rms <= 1.02 * answer.set.limit))


def _check_agrees(answer: _Found, curve: Curve, share: float | None) -> None:
    if share is None or answer.set.rms <= answer.set.limit:
        return
    best = answer.set.rms / float(np.sqrt(np.mean(curve.force_N**2)))
    rule = f"no curve inside of what was run agrees within {100 * share:.3g} %: the best misses"
    mend = "widen the ranges, ask for less, or look for what the model lacks"
    raise RefusedError(str(Fault("invert", f"{rule} {100 * best:.3g} %", mend)))


def _run(
    study: StudyResult,
    given: _Known,
    curve: Curve,
    answer: _Found,
    at: Array,
    permission: Permission,
) -> tuple[Checked, Record | None]:
    """Run the true model at a setting."""
    settings = answer.model.runs.settings(at)
    records = confirm(study, settings, given.labels, permission)
    record = records[0] if records and records[0].converged else None
    levels = dict(records[0].levels) if records else {}
    if record is None:
        return Checked(levels, float("nan"), False), None
    rms = float(np.sqrt(np.mean((_force(record, curve) - curve.force_N) ** 2)))
    return Checked(levels, rms, False), record


def _force(record: Record, curve: Curve) -> Array:
    predicted = record.first_prediction()
    if predicted is None:
        raise RefusedError("a confirming run has no curve")
    return predicted.force_at(curve.displacement_mm)


def _told(
    study: StudyResult,
    given: _Known,
    curve: Curve,
    answer: _Found,
    runs: Sequence[Checked],
    notes: Sequence[str],
) -> Inverted:
    own, result = answer.model.runs, answer.set
    units_of = {f.name: f.span.unit for f in study.design.factors if f.span is not None}
    ends = [own.settings(point) for point in (result.at, result.low, result.high)]
    inputs = tuple(
        InputSet(n, units_of[n], ends[0][n], ends[1][n], ends[2][n],
                 bool(result.open_low[j]), bool(result.open_high[j]))
        for j, n in enumerate(own.names) if n not in given.numbers
    )  # fmt: skip
    combinations = tuple(
        Determined({n: float(e) for n, e in zip(own.names, pair.exponents, strict=True) if e},
                   pair.value, pair.ratio)
        for pair in result.combinations
    )  # fmt: skip
    notes_of = [*notes]
    if runs and not all(run.agrees for run in runs):
        notes_of.append("a run of the true model does not agree: add runs to the study")
    size = float(np.sqrt(np.mean(curve.force_N**2)))
    members = tuple(own.settings(point) for point in result.points)
    return Inverted(
        inputs, combinations, {**given.labels, **given.numbers}, units_of, result.rms, result.limit,
        result.rms / size, curve.force_N.size, answer.model.q2, members,
        runs[0] if runs else None, tuple(runs[1:]), tuple(notes_of),
    )  # fmt: skip
