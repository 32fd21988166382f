"""The verb optimize: the best setting among choices, within limits, and a run that confirms it."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from study.api.fitting_surfaces import fit_surface
from study.api.folders import RESULTS, is_table
from study.api.predicting import (
    Permission,
    confirm,
    given,
    opened,
    surfaces_of,
    unknown_factors,
)
from study.ground import units
from study.ground.errors import Fault, InputError, RefusedError, UnitError, nearest
from study.harness.design import overlay
from study.harness.design.questions import usual_value
from study.reporting.results.study_answers import Bound, Confirmed, Recommendation
from study.statistics.surfaces.surface_factors import never_run
from study.statistics.surfaces.surface_optimum import (
    Goal,
    ResponseLimit,
    check_carries,
    optimum,
    spread_over,
)

if TYPE_CHECKING:
    from study.api.fitting_surfaces import Surface
    from study.api.predicting import Setting
    from study.reporting.results.study_result import StudyResult
    from study.statistics.surfaces.surface_result import SurfaceAnalysis


#: ``stiffness_at >= 0.3 N/mm``
_LIMIT = re.compile(r"\s*(?P<name>[^<>=]+?)\s*(?P<sign><=|>=)\s*(?P<value>[^<>=]+?)\s*")


@dataclass(frozen=True)
class _Question:
    """What is asked for, and of what."""

    goal: Goal
    response: str
    bounds: tuple[Bound, ...]
    units: Mapping[str, str]
    #: settings of ranges that are held, in their units
    held: Mapping[str, float]
    #: ranges and lists that may not be chosen, and are not given either
    open_numbers: tuple[str, ...] = ()


def optimize(  # noqa: PLR0913  # the public face: one keyword for each thing that may be asked
    path: str | Path | StudyResult,
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
    path : str, Path or StudyResult
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
    if isinstance(path, str | Path) and is_table(path):
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
    question = _Question(goal, name, bounds, dict.fromkeys(names, ""), held)
    models = {response: fit(response) for response in (name, *(b.response for b in bounds))}
    recommended = _best(models, question, "", {}, {})
    run = ", ".join(
        f"{n} = {v:.4g}" for n, v in recommended.settings.items() if not isinstance(v, str)
    )
    note = f"confirm it by a run at {run}, and add the run to the table"
    notes = dict.fromkeys([*surface_of_goal.notes, *recommended.notes, note])
    return replace(recommended, notes=tuple(notes))


def _best(
    models: Mapping[str, SurfaceAnalysis],
    question: _Question,
    unit: str,
    chosen: Mapping[str, str],
    fixed: Mapping[str, str],
) -> Recommendation:
    """Optimize over the ranges that are free, at labels that are chosen or fixed."""
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
            setting = question.held[factor.name]
            if factor.name in question.open_numbers:
                # nobody asked for this very setting: the nearest one that was run will do
                column = runs.coded[:, j]
                held[j] = np.clip(factor.coded(np.array(setting)), column.min(), column.max())
            else:
                held[j] = runs.coded_inside(factor.name, setting)
    best = optimum(goal_surface.model, question.goal, limits, held)
    others = [runs.names.index(name) for name in question.open_numbers]
    settings = runs.settings(best.at)
    return Recommendation(
        question.goal,
        question.response,
        unit,
        {**chosen, **{n: v for n, v in settings.items() if n not in question.held}},
        {**fixed, **{n: settings[n] for n in question.held}},
        question.units,
        best.value,
        best.value - best.half_width,
        best.value + best.half_width,
        question.bounds,
        tuple((v, v - h, v + h) for v, h in best.limited),
        best.assurance,
        tuple(runs.names[j] for j in best.on_boundary),
        spread_over(goal_surface.model, limits, best, others),
        notes=tuple(never_run(runs, best.at[None, :])),
    )


def _of_study(
    study: StudyResult,
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
    factors = {factor.name: factor for factor in design.factors}
    numbers, labels = given(design, at)
    at = {**numbers, **labels}
    free = [n for n in factors if design.roles[n] == "choice" and n not in at]
    if not free:
        roles = ", ".join(f"{n}: {role}" for n, role in design.roles.items())
        rule = f"no factor is a choice that is left to make ({roles}; held: {', '.join(at) or '-'})"
        mend = 'say which are yours to choose: [analysis] roles = { FACTOR = "choice" }'
        raise InputError(Fault("optimize", rule, mend))
    ranges = {n: f.span for n, f in factors.items() if f.span is not None}
    open_numbers = tuple(n for n in ranges if n not in free and n not in at)
    held = {n: float(values[0]) for n, values in numbers.items()}
    held |= {n: usual_value(n, overlay.dimension(n) or "number", ranges[n], design.config)
             for n in open_numbers}  # fmt: skip
    span_units = {n: span.unit for n, span in ranges.items()}
    question = _Question(goal, name, bounds, span_units, held, open_numbers)
    lists = [n for n, f in factors.items() if f.span is None]
    open_labels = {n: (labels[n],) if n in labels else factors[n].labels
                   for n in lists if n not in free}  # fmt: skip
    places = [
        dict(zip(open_labels, combination, strict=True))
        for combination in itertools.product(*open_labels.values())
    ]
    chosen = [n for n in lists if n in free]
    return tuple(_at(study, question, fixed, chosen) for fixed in places)


def _at(
    study: StudyResult, question: _Question, fixed: Mapping[str, str], chosen: Sequence[str]
) -> Recommendation:
    """Compare the levels of the choices that are no numbers, at some levels of the others."""
    factors = {factor.name: factor for factor in study.design.factors}
    candidates: list[Recommendation] = []
    notes: list[str] = []
    refused: RefusedError | None = None
    for levels in itertools.product(*(factors[n].labels for n in chosen)):
        labels_here = dict(zip(chosen, levels, strict=True))
        try:
            models, unit = _models(study, question, {**fixed, **labels_here})
            candidates.append(_best(models, question, unit, labels_here, fixed))
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
        key=lambda candidate: (candidate.assurance == "predicted", sign * candidate.value),
    )
    rivals = tuple(
        ({n: str(candidate.settings[n]) for n in chosen}, candidate.value)
        for candidate in ranked[1:]
    )
    return replace(ranked[0], rivals=rivals, notes=(*ranked[0].notes, *notes))


def _models(
    study: StudyResult, question: _Question, labels: Mapping[str, str]
) -> tuple[dict[str, SurfaceAnalysis], str]:
    """Surfaces of the responses that are asked for, at some levels, and the goal's unit."""
    surfaces_of: dict[str, SurfaceAnalysis] = {}
    unit = ""
    responses_needed = {question.response, *(bound.response for bound in question.bounds)}
    for fitted in study.surfaces:
        if fitted.response not in responses_needed or dict(fitted.labels) != dict(labels):
            continue
        if fitted.found is None:
            raise RefusedError(f"{fitted.response} has no surface: {fitted.refused}")
        surfaces_of[fitted.response] = fitted.found
        unit = fitted.unit if fitted.response == question.response else unit
    return surfaces_of, unit


def _confirmed(
    study: StudyResult, recommended: Recommendation, permission: Permission
) -> Recommendation:
    """Run the true model at a recommended setting."""
    every = {**recommended.held, **recommended.settings}
    numbers = {n: v for n, v in every.items() if not isinstance(v, str)}
    labels = {n: v for n, v in every.items() if isinstance(v, str)}
    records = confirm(study, numbers, labels, permission)
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
