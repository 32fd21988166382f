"""The verb invert: all inputs of a study whose curve agrees with a measured one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from study.api.fitting_surfaces import at_levels, coded_settings, ranges_of
from study.api.folders import RESULTS
from study.api.predicting import (
    Permission,
    confirm,
    given,
    joined,
    opened,
)
from study.ground import tabular, units
from study.ground.curve import Curve
from study.ground.errors import Fault, InputError, RefusedError
from study.harness.record.record import is_repeat
from study.harness.record.store import Store
from study.mechanics.calibration.serial_correlation import effective_rows
from study.reporting.results.study_answers import Checked, InputSet, Inverted
from study.statistics.surfaces.surface_factors import Runs, never_run
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
    study = opened(path, results)
    numbers, labels = _known(study, dict(at or {}))
    whole = _read(Path(to), columns, in_units, decimal)
    _, more = joined(study.design, Store(study.folder), study.manifest)
    records = [
        record
        for record in at_levels([*study.records, *more], labels)
        if record.converged and not is_repeat(record.extra) and record.first_prediction()
    ]
    curve, notes = _covered(whole, records, Path(to))
    question = _Inversion(study, numbers, labels, curve, _share(within))
    if not confirming:
        return question.told(question.checked(question.fitted(records)), (), notes)
    return _confirmed(question, records, permission or Permission(), notes)


@dataclass(frozen=True)
class _Answer:
    """A set, and the emulator that it comes from."""

    model: CurveEmulator
    set: InversionAgreement

    def judged(self, run: Checked) -> Checked:
        """Say whether a run agrees; its settings are rounded to a ten-thousandth of their range."""
        return replace(run, agrees=bool(run.rms <= 1.02 * self.set.limit))


def _share(within: str | None) -> float | None:
    if within is None:
        return None
    with units.naming("--within"):
        share = units.parse(within, "ratio")
    if not share > 0:
        raise InputError(Fault("--within", f"must be more than zero, got {within!r}", "say 2 %"))
    return share


def _known(
    study: StudyResult, at: Mapping[str, Setting]
) -> tuple[dict[str, float], dict[str, str]]:
    """Read the inputs that are known, and check that something is asked for."""
    design, factors = study.design, {factor.name: factor for factor in study.design.factors}
    ranges = [n for n, f in factors.items() if f.span is not None]
    if not ranges:
        rule = "has no numeric factor: there is nothing to be found"
        mend = 'write { low = "5 kPa", high = "15 kPa" } and [design] kind = "latin-hypercube"'
        raise InputError(Fault(design.name, rule, mend))
    if any(record.block is not None for record in study.records):
        rule = "is a study with measurements: its constants come from fits"
        mend = "use study calibrate, or a study of simulations"
        raise InputError(Fault(design.name, rule, mend))
    rule = "is no number: say at which of its levels the test was made"
    numbers, labels = given(design, at, {
        n: Fault(n, rule, f"--at {n}={f.labels[0]}") for n, f in factors.items() if f.span is None
    })  # fmt: skip
    if len(numbers) == len(ranges):
        mend = "leave those out that are asked for"
        raise InputError(Fault("--at", "holds every number", mend))
    return {n: float(values[0]) for n, values in numbers.items()}, labels


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


@dataclass(frozen=True)
class _Inversion:
    """A measured curve, and the study whose inputs are to be found."""

    study: StudyResult
    #: Known inputs: ranges in their units, labels of the others.
    numbers: Mapping[str, float]
    labels: Mapping[str, str]
    curve: Curve
    #: What an agreeing curve may miss, over the measured one; None for the region of least squares.
    share: float | None

    def runs(self, records: Sequence[Record]) -> Runs:
        """Coded settings of runs."""
        study = self.study
        design, _ = joined(study.design, Store(study.folder), study.manifest)
        factors = ranges_of(design)
        coded = coded_settings(design, factors, [record.levels for record in records])
        return Runs("force", factors, coded, np.zeros(len(records)))

    @property
    def size(self) -> float:
        """Root mean square of the measured force in N."""
        return float(np.sqrt(np.mean(self.curve.force_N**2)))

    def fitted(self, records: Sequence[Record]) -> _Answer:
        """Emulate the curves, and find the set."""
        runs, curve = self.runs(records), self.curve
        curves = np.array([c.force_at(curve.displacement_mm) for r in records
                           if (c := r.first_prediction())])  # fmt: skip
        model = fit_curves(runs, curves, self.study.design.seed)
        held = np.array([runs.coded_inside(n, self.numbers[n]) if n in self.numbers else np.nan
                         for n in runs.names])  # fmt: skip
        largest = None if self.share is None else self.share * self.size
        solutions = agreeing(model, curve.force_N, held, largest=largest)
        residual = np.asarray(curve.force_N - model.value(solutions.at[None, :])[0])
        if self.share is None and residual.size >= _TOO_FEW:
            square = float(residual @ residual)
            worth = effective_rows(
                residual.size, float(residual[1:] @ residual[:-1]) / square if square > 0 else 0.0
            )
            solutions = agreeing(model, curve.force_N, held, rows_worth=worth)
        return _Answer(model, solutions)

    def checked(self, answer: _Answer) -> _Answer:
        """Refuse an answer whose best curve misses more than it may."""
        if self.share is None or answer.set.rms <= answer.set.limit:
            return answer
        rule = (
            f"no curve inside of what was run agrees within {100 * self.share:.3g} %: the best "
            f"misses {100 * answer.set.rms / self.size:.3g} %"
        )
        mend = "widen the ranges, ask for less, or look for what the model lacks"
        raise RefusedError(str(Fault("invert", rule, mend)))

    def run(
        self, answer: _Answer, at: Array, permission: Permission
    ) -> tuple[Checked, Record | None]:
        """Run the true model at a setting."""
        settings = answer.model.runs.settings(at)
        records = confirm(self.study, settings, self.labels, permission)
        levels = dict(records[0].levels) if records else {}
        if not records or not records[0].converged:
            return Checked(levels, float("nan"), False), None
        missed = _force(records[0], self.curve) - self.curve.force_N
        return Checked(levels, float(np.sqrt(np.mean(missed**2))), False), records[0]

    def told(self, answer: _Answer, runs: Sequence[Checked], notes: Sequence[str]) -> Inverted:
        """Say the answer in the units of the inputs."""
        coded, result = answer.model.runs, answer.set
        units_of = {f.name: f.span.unit for f in self.study.design.factors if f.span is not None}
        best, low, high = (coded.settings(point) for point in (result.at, result.low, result.high))
        inputs = tuple(
            InputSet(n, units_of[n], best[n], low[n], high[n],
                     bool(result.open_low[j]), bool(result.open_high[j]))
            for j, n in enumerate(coded.names) if n not in self.numbers
        )  # fmt: skip
        disagree = "a run of the true model does not agree: add runs to the study"
        return Inverted(
            inputs, result.combinations, {**self.labels, **self.numbers}, units_of, result.rms,
            result.limit, result.rms / self.size, self.curve.force_N.size, answer.model.q2,
            tuple(coded.settings(point) for point in result.points),
            runs[0] if runs else None, tuple(runs[1:]),
            (*notes, *never_run(coded, result.points),
             *([] if all(run.agrees for run in runs) else [disagree])),
        )  # fmt: skip


def _confirmed(
    question: _Inversion, records: list[Record], permission: Permission, notes: Sequence[str]
) -> Inverted:
    """Let the true model run at the best setting until the emulator says the same there."""
    answer, run, notes = question.fitted(records), None, [*notes]
    for _ in range(ROUNDS):
        run, record = question.run(answer, answer.set.at, permission)
        if record is None:
            break
        emulated = answer.model.value(question.runs([*records, record]).coded[-1:])[0]
        missed = _force(record, question.curve) - emulated
        if record.case_id not in {earlier.case_id for earlier in records}:
            records.append(record)
            answer = question.fitted(records)
        if (apart := float(np.sqrt(np.mean(missed**2)))) <= answer.model.loo_rms:
            break
    else:
        notes.append(
            f"after {ROUNDS} runs at the best setting the emulator still misses the true model "
            f"there by {apart:.3g} N, more than its own error of {answer.model.loo_rms:.3g} N: add "
            "runs near that setting to the study"
        )
    found = question.checked(answer).set
    ends = []
    if found.combinations or found.open_low.any() or found.open_high.any():
        ends = [question.run(answer, at_end, permission)[0] for at_end in found.ends]
    runs = [] if run is None else [answer.judged(one) for one in (run, *ends)]
    return question.told(answer, runs, notes)


def _force(record: Record, curve: Curve) -> Array:
    predicted = record.first_prediction()
    if predicted is None:
        raise RefusedError("a confirming run has no curve")
    return predicted.force_at(curve.displacement_mm)
