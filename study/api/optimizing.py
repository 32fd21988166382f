"""The verbs optimize and invert: settings that are best, or whose curve is a measured one."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from study.api.predicting import (
    Permission,
    Setting,
    fit_surface,
    given,
    opened,
    surfaces_of,
    unknown_factors,
)
from study.ground import tabular, units
from study.ground.curve import Curve
from study.ground.errors import Fault, InputError, RefusedError, UnitError, nearest
from study.harness.design.load import RESULTS
from study.harness.design.spec import usual_value
from study.harness.runner.adaptive_cells import joined
from study.harness.runner.record_analysis import at_levels, coded_settings
from study.mechanics.calibration.serial_correlation import (
    FEWEST_ROWS,
    Series,
    effective_rows,
    row_noise,
    trend,
)
from study.mechanics.measurement.written_units import contradicts, word_of_unit
from study.record.record import Record, is_same_run
from study.record.store import Store
from study.reporting.results.study_answers import (
    Agreement,
    Bound,
    Checked,
    Confirmed,
    InputSet,
    Inverted,
    OtherChoice,
    Recommendation,
)
from study.statistics.surfaces.surface_factors import Runs, never_run
from study.statistics.surfaces.surface_optimum import (
    Goal,
    InversionAgreement,
    NearestCurves,
    ResponseLimit,
    agreeing,
    check_carries,
    fit_curves,
    optimum,
    spread_over,
)

if TYPE_CHECKING:
    from study.api.assemble import Study
    from study.ground.arrays import Array
    from study.statistics.surfaces.surface_fitting import Surface
    from study.statistics.surfaces.surface_result import SurfaceAnalysis


#: ``stiffness_at >= 0.3 N/mm``
_LIMIT = re.compile(r"\s*(?P<name>[^<>=]+?)\s*(?P<sign><=|>=)\s*(?P<value>[^<>=]+?)\s*")


def optimize(  # noqa: PLR0913  # the public face: one keyword for each thing that may be asked
    path: str | Path | Study,
    *,
    minimize: str | None = None,
    maximize: str | None = None,
    subject_to: str | Sequence[str] = (),
    at: Mapping[str, Setting] | None = None,
    numeric: Sequence[str] = (),
    surface: Surface = "auto",
    decimal: str = ".",
    results: str | Path = RESULTS,
    confirming: bool = True,
    permission: Permission | None = None,
) -> tuple[Recommendation, ...]:
    """Find the best setting among the choices of a study, or of a table.

    Conditions and unknowns are never recommended: they are held where ``at`` says, else at the
    value that the design's file gives, and it is said what they do over their ranges.

    Parameters
    ----------
    path : str, Path or Study
        Results folder, design file, name of the study, the study itself; or a CSV with one row a
        run.
    minimize, maximize : str
        Response that is to be small or large; one of the two.
    subject_to : str or sequence of str
        Limits of other responses: ``"stiffness_at >= 0.3 N/mm"``; a name may be shortened as long
        as one response alone begins with it.
    at : mapping, optional
        Settings of factors that are held, as for :func:`study.predict`.
    numeric : sequence of str
        For a CSV: the columns of the factors, as for :func:`study.fit_surface`.
    surface : {"auto", "quadratic", "emulator"}
        For a CSV: what is fitted.
    decimal : {".", ","}
        For a CSV: its decimal mark.
    results : Path
        Folder of the results, where ``path`` is a name.
    confirming : bool
        Whether the true model is run at the recommended setting; the run joins the study's
        surfaces. A table names it only.
    permission : Permission, optional
        What the run may use.

    Returns
    -------
    tuple of Recommendation
        One for every combination of the levels of conditions and unknowns that are not numbers.

    Raises
    ------
    InputError
        If a response, a factor or a limit cannot be read, or nothing is a choice.
    RefusedError
        If a surface does not predict well enough (a Q2 below .9, of a quadratic below .8), or no
        setting keeps the limits.
    """
    if (minimize is None) == (maximize is None):
        rule = "say what is to be best: one response to be small, or one to be large"
        raise InputError(Fault("--minimize or --maximize", rule, "for example --minimize force"))
    goal: Goal = "minimize" if minimize is not None else "maximize"
    name = str(minimize if minimize is not None else maximize)
    limits_typed = [subject_to] if isinstance(subject_to, str) else [*subject_to]
    if isinstance(path, str | Path) and tabular.is_table(path):
        table = Path(path)
        fit = cache(lambda y: fit_surface(table, y, numeric, surface=surface, decimal=decimal))
        return (_of_table(fit, goal, name, limits_typed, dict(at or {})),)
    if numeric:
        rule = "names columns of a table: the factors of a study are known"
        raise InputError(Fault("--numeric", rule, "leave it out"))
    study = opened(path, results)
    recommendations = _of_study(study, goal, name, limits_typed, dict(at or {}))
    if not confirming:
        return recommendations
    return tuple(
        _confirmed(study, recommended, permission or Permission())
        for recommended in recommendations
    )


def _named(word: str, names: Sequence[str], where: str) -> str:
    """Find a response by its name, or by the only one that begins so."""
    begins = [name for name in names if name.startswith(word)]
    if word in names or len(begins) == 1:
        return word if word in names else begins[0]
    rule = f"{word!r} begins several responses" if begins else f"there is no response {word!r}"
    raise InputError(Fault(where, rule, nearest(word, names)))


def _bound(text: str, units_of: Mapping[str, str]) -> Bound:
    """Read a limit; the unit must be that of the response, or one of its dimension."""
    parts = _LIMIT.fullmatch(text)
    if parts is None:
        mend = "write 'stiffness >= 0.3 N/mm', with >= or <="
        raise InputError(Fault("--subject-to", f"cannot read {text!r}", mend))
    name = _named(parts["name"], list(units_of), "--subject-to")
    with units.naming(f"--subject-to {name}"):
        value = _in_unit(parts["value"], units_of[name])
    return Bound(name, units_of[name], 1 if parts["sign"] == ">=" else -1, value)


def _in_unit(text: str, unit: str) -> float:
    """Read a value in a unit: a quantity of its dimension, or a number where it has none."""
    if not unit:
        return units.parse_number(text)
    for dimension in units.INTERNAL:
        try:
            factor = units.unit_factor(unit, dimension)
        except UnitError:
            continue
        return units.parse(text, dimension) / factor
    value, unit_typed = units.split(text)
    if unit_typed != unit:
        raise UnitError(Fault("", f"must be in {unit}, got {text!r}", f"write it in {unit}"))
    return value


def _of_table(
    fit: Callable[[str], SurfaceAnalysis],
    goal: Goal,
    name: str,
    limits_typed: Sequence[str],
    at: Mapping[str, Setting],
) -> Recommendation:
    surface_of_goal = fit(name)
    names = surface_of_goal.runs.names
    if faults := unknown_factors(at, names):
        raise InputError(faults)
    held = {}
    for n, setting in at.items():
        with units.naming(f"--at {n}"):
            held[n] = units.parse_number(str(setting))
    if len(held) == len(names):
        raise InputError(Fault("--at", "holds every factor", "leave those out that are choices"))
    columns = [_LIMIT.fullmatch(text) for text in limits_typed]
    units_of = {column["name"]: "" for column in columns if column is not None}
    bounds = tuple(_bound(text, units_of) for text in limits_typed)
    question = Recommendation(goal, name, "", {}, held, dict.fromkeys(names, ""), bounds=bounds)
    models = {response: fit(response) for response in (name, *(b.response for b in bounds))}
    recommended = _best(models, question, {}, {}, ())
    run = ", ".join(
        f"{n} = {v:.4g}" for n, v in recommended.settings.items() if not isinstance(v, str)
    )
    note = f"confirm it by a run at {run}, and add the run to the table"
    notes = dict.fromkeys([*surface_of_goal.notes, *recommended.notes, note])
    return replace(recommended, notes=tuple(notes))


def _best(
    models: Mapping[str, SurfaceAnalysis],
    question: Recommendation,
    chosen: Mapping[str, str],
    fixed: Mapping[str, str],
    open_numbers: Sequence[str],
) -> Recommendation:
    """Optimize over the ranges that are free, at labels that are chosen or fixed.

    The question holds numbers alone; open ones are those that nobody chooses or has given.
    """
    goal_surface = models[question.response]
    runs = goal_surface.runs
    every = [goal_surface, *(models[bound.response] for bound in question.bounds)]
    for surface_checked in every:
        check_carries(surface_checked.model)
    limits = [ResponseLimit(m.model, bound.sign, bound.value)
              for m, bound in zip(every[1:], question.bounds, strict=True)]  # fmt: skip
    held = np.full(len(runs.factors), np.nan)
    for j, factor in enumerate(runs.factors):
        if factor.name in question.held:
            setting = float(question.held[factor.name])
            if factor.name in open_numbers:
                # nobody asked for this very setting: the nearest one that was run will do
                column = runs.coded[:, j]
                held[j] = np.clip(factor.coded(np.array(setting)), column.min(), column.max())
            else:
                held[j] = runs.coded_inside(factor.name, setting)
    best = optimum(goal_surface.model, question.goal, limits, held)
    others = [runs.names.index(name) for name in open_numbers]
    settings = runs.settings(best.at)
    return replace(
        question,
        settings={**chosen, **{n: v for n, v in settings.items() if n not in question.held}},
        held={**fixed, **{n: settings[n] for n in question.held}},
        value=best.value,
        low=best.value - best.half_width,
        high=best.value + best.half_width,
        limited=tuple((v, v - h, v + h) for v, h in best.limited),
        limits_hold=best.assurance or None,
        at_end=tuple(runs.names[j] for j in best.on_boundary),
        spread=spread_over(goal_surface.model, limits, best, others),
        notes=tuple(never_run(runs, best.at[None, :])),
    )


def _of_study(
    study: Study,
    goal: Goal,
    word: str,
    limits_typed: Sequence[str],
    at: Mapping[str, Setting],
) -> tuple[Recommendation, ...]:
    """Recommend at every combination of the levels that nobody chooses."""
    design = study.design
    units_of = {fitted.response: fitted.unit for fitted in surfaces_of(study)}
    name = _named(word, list(units_of), f"--{goal}")
    bounds = tuple(_bound(text, units_of) for text in limits_typed)
    numbers, labels = given(design, at)
    at = {**numbers, **labels}
    free = [n for n, role in design.roles.items() if role == "choice" and n not in at]
    if not free:
        roles = ", ".join(f"{n}: {role}" for n, role in design.roles.items())
        rule = f"no factor is a choice that is left to make ({roles}; held: {', '.join(at) or '-'})"
        mend = 'say which are yours to choose: [analysis] roles = { FACTOR = "choice" }'
        raise InputError(Fault("optimize", rule, mend))
    ranges, lists = design.ranges, design.lists
    open_numbers = tuple(n for n in ranges if n not in free and n not in at)
    held = {n: float(values[0]) for n, values in numbers.items()}
    held |= {n: usual_value(n, ranges[n], design.config) for n in open_numbers}
    span_units = {n: span.unit for n, span in ranges.items()}
    question = Recommendation(goal, name, units_of[name], {}, held, span_units, bounds=bounds)
    open_labels = {n: (labels[n],) if n in labels else every
                   for n, every in lists.items() if n not in free}  # fmt: skip
    places = [
        dict(zip(open_labels, combination, strict=True))
        for combination in itertools.product(*open_labels.values())
    ]
    chosen = [n for n in lists if n in free]
    return tuple(_at(study, question, fixed, chosen, open_numbers) for fixed in places)


def _at(
    study: Study,
    question: Recommendation,
    fixed: Mapping[str, str],
    chosen: Sequence[str],
    open_numbers: Sequence[str],
) -> Recommendation:
    """Compare the levels of the choices that are no numbers, at some levels of the others."""
    lists = study.design.lists
    needed = {question.response, *(bound.response for bound in question.bounds)}
    candidates: list[Recommendation] = []
    notes: list[str] = []
    refused: RefusedError | None = None
    for levels in itertools.product(*(lists[n] for n in chosen)):
        labels_here = dict(zip(chosen, levels, strict=True))
        here = [fitted for fitted in study.surfaces
                if fitted.response in needed
                and dict(fitted.labels) == {**fixed, **labels_here}]  # fmt: skip
        try:
            for fitted in here:
                if fitted.surface is None:
                    raise RefusedError(f"{fitted.response} has no surface: {fitted.refused}")
            models = {
                fitted.response: fitted.surface for fitted in here if fitted.surface is not None
            }
            candidates.append(_best(models, question, labels_here, fixed, open_numbers))
        except RefusedError as error:
            refused = error
            at = ", ".join(f"{n} = {label}" for n, label in labels_here.items())
            notes += [f"not considered, {at}: {error}"] if at else []
    if not candidates:
        raise refused or RefusedError("no combination of levels has a surface")
    sign = 1.0 if question.goal == "minimize" else -1.0
    # where a setting keeps the limits surely, one that is only predicted to is no rival
    ranked = sorted(
        candidates,
        key=lambda candidate: (candidate.limits_hold == "predicted", sign * candidate.value),
    )
    rivals = tuple(
        OtherChoice({n: str(candidate.settings[n]) for n in chosen}, candidate.value)
        for candidate in ranked[1:]
    )
    return replace(ranked[0], rivals=rivals, notes=(*ranked[0].notes, *notes))


def _confirmed(study: Study, recommended: Recommendation, permission: Permission) -> Recommendation:
    """Run the true model at a recommended setting."""
    records = permission.confirm(study, {**recommended.held, **recommended.settings})
    names = [recommended.response, *(bound.response for bound in recommended.bounds)]
    values = {n: float(np.mean([record.response(n) for record in records])) for n in names}
    answered = bool(np.isfinite(list(values.values())).all())
    settings = dict(records[0].levels) if records else {}
    inside = recommended.low <= values[recommended.response] <= recommended.high
    holds = all(bound.sign * (values[bound.response] - bound.value) >= -1e-3 * abs(bound.value)
               for bound in recommended.bounds)  # fmt: skip
    note = "the confirming run joined the study's surfaces: ask again for a setting that knows it"
    if not answered:
        why = "; ".join(dict.fromkeys(record.message for record in records)) or "no answer"
        note = f"the confirming run has no answer ({why}): the recommendation is not confirmed"
    run = Confirmed(settings, values, answered and inside, answered and holds)
    return replace(recommended, confirmed=run, notes=(*recommended.notes, note))


# The verb invert: all inputs of a study whose curve agrees with a measured one.


#: fewest rows of a measured curve
FEWEST = 3

#: most times that the true model is run at the best setting, the emulator learning from each
ROUNDS = 4
#: share of the runs' largest force up to which a measured curve has none
NEGLIGIBLE_FORCE = 1e-9

#: share of the force that the best curve misses along a line, from which it is named; p below
#: which the line is none of noise; and the share that is named where rows scatter half as much
_NAMED = 0.01
_CLEAR = 0.001
_LARGE_ERROR = 0.15


def invert(  # noqa: PLR0913  # the public face: one keyword for each thing that may be asked
    path: str | Path | Study,
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
    path : str, Path or Study
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
    # it rests on an emulator of curves, and on no surface
    study = opened(path, results, fits_surfaces=False)
    numbers, labels = _known(study, dict(at or {}))
    whole = _read(Path(to), columns, in_units, decimal)
    more = joined(study.design, Store(study.folder), study.manifest)
    records = [
        record
        for record in at_levels([*study.records, *more], labels)
        if record.converged and not is_same_run(record.extra) and record.first_prediction()
    ]
    curve, notes = _covered(whole, records, Path(to))
    question = _Inversion(study, numbers, labels, curve, _share(within))
    if not confirming:
        nearest = question.nearest(records)
        return question.inverted(nearest, question.agreeing(nearest), (), notes)
    return _checked_by_runs(question, records, permission or Permission(), notes)


def _share(within: str | None) -> float | None:
    if within is None:
        return None
    with units.naming("--within"):
        share = units.parse(within, "ratio")
    if not share > 0:
        raise InputError(Fault("--within", f"must be more than zero, got {within!r}", "say 2 %"))
    return share


def _known(study: Study, at: Mapping[str, Setting]) -> tuple[dict[str, float], dict[str, str]]:
    """Read the inputs that are known, and check that something is asked for."""
    design = study.design
    if not design.ranges:
        rule = "has no numeric factor: there is nothing to be found"
        mend = 'write { low = "5 kPa", high = "15 kPa" } and [design] kind = "latin-hypercube"'
        raise InputError(Fault(design.name, rule, mend))
    if any(record.block is not None for record in study.records):
        rule = "is a study with measurements: its constants come from fits"
        mend = "use study calibrate, or a study of simulations"
        raise InputError(Fault(design.name, rule, mend))
    rule = "is no number: say at which of its levels the test was made"
    numbers, labels = given(design, at, {
        n: Fault(n, rule, f"--at {n}={labels[0]}") for n, labels in design.lists.items()
    })  # fmt: skip
    if len(numbers) == len(design.ranges):
        mend = "leave those out that are asked for"
        raise InputError(Fault("--at", "holds every number", mend))
    return {n: float(values[0]) for n, values in numbers.items()}, labels


def _read(source: Path, columns: Sequence[str], in_units: Sequence[str], decimal: str) -> Curve:
    """Read a measured curve."""
    if len(columns) != 2 or len(in_units) != 2:
        rule = "needs two names each: displacement and force"
        raise InputError(Fault("--columns, --units", rule, "write --columns d,f --units mm,N"))
    table = tabular.read_csv(
        source, required=columns, numbers=columns, decimal=decimal,
        declared_by=tabular.TYPED_COMMA,
    )  # fmt: skip
    for name, unit, kind in zip(columns, in_units, ("length", "force"), strict=True):
        _, word, is_marked = word_of_unit(name)
        if contradicts(word, unit, kind, is_sure=is_marked):
            rule = f"the name of the column {name!r} says {word}, and it is read in {unit}"
            raise InputError(Fault("--units", rule, "name the unit that the file is in"))
    with units.naming("--units"):
        displacement = table.numbers(columns[0]) * units.unit_factor(in_units[0], "length")
        force = table.numbers(columns[1]) * units.unit_factor(in_units[1], "force")
    falls = np.flatnonzero(np.diff(displacement) <= 0)
    if falls.size:
        rule = "displacements must increase from row to row"
        mend = "keep the loading of one test, or average repeats"
        raise InputError(Fault(table.cell_name(int(falls[0]) + 1, columns[0]), rule, mend))
    if displacement.size < FEWEST or displacement[0] < 0:
        rule = f"needs at least {FEWEST} rows, with displacements from 0 on"
        raise InputError(Fault(str(source), rule))
    return Curve(displacement, force)


def _covered(curve: Curve, records: Sequence[Record], source: Path) -> tuple[Curve, list[str]]:
    """Measured rows inside the range of every run, and warnings about the rows outside."""
    predicted = [curve_of_run for r in records if (curve_of_run := r.first_prediction())]
    if not predicted:
        raise InputError(Fault(str(source), "no run has a curve to compare with"))
    ends = [float(curve_of_run.displacement_mm[-1]) for curve_of_run in predicted]
    largest = float(np.abs(curve.force_N).max())
    of_runs = max(float(np.abs(curve_of_run.force_N).max()) for curve_of_run in predicted)
    if largest <= NEGLIGIBLE_FORCE * of_runs:
        rule = f"its largest force, {largest:.3g} N, is none beside the {of_runs:.3g} N of the runs"
        raise InputError(Fault(str(source), rule, "check --columns and --units"))
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

    study: Study
    #: Known inputs: ranges in their units, labels of the others.
    numbers: Mapping[str, float]
    labels: Mapping[str, str]
    curve: Curve
    #: What an agreeing curve may miss, over the measured one; None for the region of least squares.
    share: float | None

    def runs(self, records: Sequence[Record]) -> Runs:
        """Coded settings of runs."""
        factors = tuple(self.study.design.ranges.values())
        coded = coded_settings(factors, [record.levels for record in records])
        return Runs("force", factors, coded, np.zeros(len(records)))

    @property
    def size(self) -> float:
        """Root mean square of the measured force in N."""
        return float(np.sqrt(np.mean(self.curve.force_N**2)))

    def nearest(self, records: Sequence[Record]) -> NearestCurves:
        """Emulate the curves, and search those that are nearest to the measured one."""
        runs, curve = self.runs(records), self.curve
        curves = np.array([c.force_at(curve.displacement_mm) for r in records
                           if (c := r.first_prediction())])  # fmt: skip
        model = fit_curves(runs, curves, self.study.design.seed)
        held = np.array([runs.coded_inside(n, self.numbers[n]) if n in self.numbers else np.nan
                         for n in runs.names])  # fmt: skip
        return NearestCurves.of(model, curve.force_N, held)

    def agreeing(self, nearest: NearestCurves) -> InversionAgreement:
        """Find the set of agreeing settings; refuse where the best curve misses more than asked."""
        if self.share is None:
            residual, worth = nearest.residual, None
            if residual.size >= FEWEST_ROWS:
                square = float(residual @ residual)
                lagged = float(residual[1:] @ residual[:-1])
                worth = effective_rows(residual.size, lagged / square if square > 0 else 0.0)
            return agreeing(nearest, rows_worth=worth)
        missed = nearest.rms(nearest.minima[0])
        if missed <= self.share * self.size:
            return agreeing(nearest, largest=self.share * self.size)
        rule = (
            f"no curve inside of what was run agrees within {100 * self.share:.3g} %: the best "
            f"misses {100 * missed / self.size:.3g} %"
        )
        mend = "widen the ranges, ask for less, or look for what the model lacks"
        raise RefusedError(str(Fault("invert", rule, mend)))

    def run(
        self, settings: Mapping[str, float], permission: Permission
    ) -> tuple[Checked, list[Record]]:
        """Run the true model at a setting: once, or once a replicate, whose mean curve counts."""
        records = permission.confirm(self.study, {**settings, **self.labels})
        levels = dict(records[0].levels) if records else {}
        answered = [record for record in records if record.converged]
        if not answered:
            return Checked(levels, float("nan"), False), []
        missed = _force(answered, self.curve) - self.curve.force_N
        return Checked(levels, float(np.sqrt(np.mean(missed**2))), False), answered

    def judged(self, nearest: NearestCurves) -> tuple[Agreement, str]:
        """How well the best curve is the measured one, unless a share was asked for; and why."""
        if self.share:
            return "agrees", ""
        residual, at, n = nearest.residual, nearest.minima[0], self.curve.force_N.size
        missed, line, p = nearest.rms(at) / self.size, 0.0, 1.0
        noise = row_noise(residual, np.arange(n, dtype=np.float64), self.curve.force_N)
        slope = np.asarray(nearest.slope(at, nearest.space.free), dtype=np.float64)
        if n >= FEWEST_ROWS and np.linalg.norm(slope, axis=0).all():
            bends = np.polynomial.legendre.legvander(np.linspace(-1, 1, n), 2).astype(np.float64)
            p, along = trend([Series(residual, slope, slope.T)], [bends])
            line = float(np.sqrt(np.mean(along**2))) / self.size
        scatter = 0.0 if noise is None else float(np.sqrt(np.mean(noise.deviation**2))) / self.size
        mend = "check its units, zero and sign, then the ranges and the model"
        if missed > _LARGE_ERROR and missed > 2 * scatter:
            why = f"the best curve misses {100 * missed:.3g} % of the measured force: {mend}"
            return "misses", why
        if p < _CLEAR and line > _NAMED:
            why = (
                f"the best curve misses {100 * line:.2g} % of the measured force along a line that "
                f"no noise makes: {mend}"
            )
            return "doubtful", why
        return "agrees", ""

    def inverted(
        self,
        nearest: NearestCurves,
        result: InversionAgreement,
        runs: Sequence[Checked],
        notes: Sequence[str],
    ) -> Inverted:
        """Say the answer in the units of the inputs."""
        model = nearest.model
        agreement, misfit = self.judged(nearest)
        coded = model.runs
        units_of = {n: span.unit for n, span in self.study.design.ranges.items()}
        best, low, high = (coded.settings(point) for point in (result.at, result.low, result.high))
        inputs = tuple(
            InputSet(n, units_of[n], best[n], low[n], high[n],
                     bool(result.open_low[j]), bool(result.open_high[j]))
            for j, n in enumerate(coded.names) if n not in self.numbers
        )  # fmt: skip
        disagree = "a run of the true model does not agree: add runs to the study"
        return Inverted(
            inputs, result.combinations, {**self.labels, **self.numbers}, units_of, result.rms,
            result.limit, result.rms / self.size, self.curve.force_N.size, model.q2,
            tuple(coded.settings(point) for point in result.points),
            runs[0] if runs else None, tuple(runs[1:]),
            (*([misfit] if misfit else []), *notes, *never_run(coded, result.points),
             *([] if all(run.agrees for run in runs) else [disagree])),
            agreement=agreement,
        )  # fmt: skip


def _checked_by_runs(
    question: _Inversion, records: list[Record], permission: Permission, notes: Sequence[str]
) -> Inverted:
    """Let the true model run at the best setting until the emulator says the same there."""
    nearest, run, notes = question.nearest(records), None, [*notes]
    for _ in range(ROUNDS):
        model = nearest.model
        run, answered = question.run(model.runs.settings(nearest.minima[0]), permission)
        if not answered:
            break
        emulated = model.value(question.runs([*records, *answered]).coded[-1:])[0]
        missed = _force(answered, question.curve) - emulated
        before = {record.case_id for record in records}
        if new := [record for record in answered if record.case_id not in before]:
            records += new
            nearest = question.nearest(records)
        if (apart := float(np.sqrt(np.mean(missed**2)))) <= nearest.model.loo_rms:
            break
    else:
        notes.append(
            f"after {ROUNDS} runs at the best setting the emulator still misses the true model "
            f"there by {apart:.3g} N, more than its own error of {nearest.model.loo_rms:.3g} N: "
            "add runs near that setting to the study"
        )
    agreed, ends = question.agreeing(nearest), []
    if agreed.combinations or agreed.open_low.any() or agreed.open_high.any():
        ends = [question.run(nearest.model.runs.settings(at), permission)[0] for at in agreed.ends]
    # settings of a run are rounded to a ten-thousandth of their range
    runs = [] if run is None else [
        replace(checked, agrees=bool(checked.rms <= 1.02 * agreed.limit))
        for checked in (run, *ends)
    ]  # fmt: skip
    return question.inverted(nearest, agreed, runs, notes)


def _force(records: Sequence[Record], curve: Curve) -> Array:
    """Mean force of some runs at the displacements of the measured curve, N."""
    forces = []
    for record in records:
        if (predicted := record.first_prediction()) is None:
            raise RefusedError("a confirming run has no curve")
        forces.append(predicted.force_at(curve.displacement_mm))
    return np.asarray(np.mean(forces, axis=0))
