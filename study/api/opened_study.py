"""A finished or partial study, opened from its folder."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from study.api.assemble import Study
from study.ground.errors import StudyError
from study.harness.design.load import RESULTS, dump, finished_manifest, loads, results_folder
from study.harness.design.spec import Analysis, Design
from study.harness.runner import record_analysis
from study.harness.runner.adaptive_cells import CONFIRMED, joined
from study.harness.runner.batch import Work, cases_by_id, relabeled
from study.harness.runner.imported_runs import write_runs
from study.harness.runner.record_analysis import unit_of
from study.mechanics.measurement.conditioning import is_caution
from study.record.record import (
    AdaptiveStep,
    ManifestDocument,
    Record,
    SpaceRow,
    ValidationRow,
    fault_of_comparisons,
)
from study.record.store import Store
from study.reporting.results.study_result import (
    FITTED_CURVE,
    OTHER_SPECIMEN,
    OTHER_TEST,
    ResponseAnalysis,
)
from study.simulation.job import held_out
from study.simulation.plausibility import cautions_of
from study.simulation.response import SCORED
from study.statistics.analysis.analysis_request import threshold
from study.statistics.analysis.comparisons import FamilyTest, holm_family
from study.statistics.analysis.post_hoc import with_contrasts
from study.statistics.convergence.grid_convergence import NumericalUncertainty
from study.statistics.surfaces.surface_fitting import SEE_SURFACE


def load(path: str | Path, results: str | Path = RESULTS, *, tell_unfinished: bool = True) -> Study:
    """Open a study: the stored records of its last finished run, analyzed.

    Parameters
    ----------
    path : str or Path
        Results folder, design file or name of the study.
    results : str or Path
        Folder of the results, where ``path`` is a name.
    tell_unfinished : bool
        Whether a later run that is not finished is a warning.

    Returns
    -------
    Study
        ``answers`` in sentences, ``table`` with one row a case, ``effects`` with one row a
        verdict, ``analyses``, ``surfaces`` and ``records``.

    Raises
    ------
    InputError
        If there are none.
    """
    return opened(results_folder(path, results), tell_unfinished=tell_unfinished)


def opened(
    folder: Path,
    ended: Work | None = None,
    *,
    tell_unfinished: bool = True,
    fits_surfaces: bool = True,
) -> Study:
    """Open a study; of a run that has just ended neither design nor cases are made again.

    Surfaces and their indices are nearly all of the time that this takes, where there are any.
    """
    warnings: list[str] = []
    store = Store(folder, warn=warnings.append)
    manifest = finished_manifest(store)
    if ended is not None and dump(ended.design) == manifest["design"]:
        design = copy.copy(ended.design)  # with its cells, as it would be read
        vars(design).update(source=manifest["source"], text=manifest["design"])
        cases = ended.cases
    else:
        design = loads(manifest["design"], manifest["source"])
        cases = cases_by_id(design, manifest["blocks"])
    stored = store.records(manifest["cases"])
    records = relabeled(stored, design, cases)
    if len(records) < len(stored):
        count = len(stored) - len(records)
        warnings.append(f"{count} records are of no cell of the design: run the design again")
    numerical = record_analysis.stored_numerical(store, manifest["cases"])
    missing = len(manifest["cases"]) - len(records)
    later = store.read_unfinished() if tell_unfinished else None
    if later is not None:
        warnings.append(unfinished_note(store, later))
    problems = () if design.is_alone else (t.cell.problem for t in design.treatments)
    warnings += dict.fromkeys(caution for problem in problems for caution in cautions_of(problem))
    warnings += record_analysis.different_answers(design, records)
    warnings += [note for note in manifest["notes"] if is_caution(note)]
    if missing:
        warnings.append(f"{missing} of {len(manifest['cases'])} cases are not computed yet")
    analyses = _analyses(design, records, numerical, unit_of(design, manifest))
    warnings += [f"{a.name}: {a.refused}" for a in analyses if a.refused not in ("", SEE_SURFACE)]
    has_confirmed = (folder / f"{CONFIRMED}.json").exists()
    more = joined(design, store, manifest) if has_confirmed else ()
    runs = [*records, *more]
    fitted = record_analysis.surfaces(design, runs, numerical) if fits_surfaces else ()
    if more:
        warnings.append(f"{len(more)} confirming runs joined those of the surfaces")
    warnings += [f"{surface.response}: {surface.refused}" for surface in fitted if surface.refused]
    warnings += [
        f"{surface.response}: {n}"
        for surface in fitted
        if surface.surface
        for n in surface.surface.notes
    ]
    comparisons = store.read_rows("validation", ValidationRow, fault_of_comparisons)
    return Study(
        design, folder, records, len(manifest["cases"]), manifest,
        analyses=analyses, numerical=numerical, validation=tuple(comparisons), surfaces=fitted,
        spaces=tuple(store.read_rows("spaces", SpaceRow)),
        adaptive=tuple(store.read_rows("adaptive", AdaptiveStep)),
        warnings=tuple(dict.fromkeys(warnings)),  # with those of what was read just now
    )  # fmt: skip


def import_runs(
    path: str | Path,
    factors: str | Sequence[str],
    responses: str | Sequence[str],
    *,
    numeric: str | Sequence[str] = (),
    failed: str | None = None,
    block: str | None = None,
    name: str | None = None,
    decimal: str = ".",
    practical: str = "",
    results: str | Path = RESULTS,
) -> Study:
    """Make a study of a table of runs, one row a run; rows of equal levels are replicates.

    Columns are a sequence or a text with commas. A response may be ``name=unit``, and
    ``practical`` says which difference of it matters: ``peak=1 N,work=5 % of mean``. Columns of
    ``numeric`` (``speed,temp log``) are factors over the range of their settings: the study gets
    surfaces, which predict, optimize and invert read, in place of tables of levels. The column
    ``failed`` holds a status, a reason, or nothing (also 0, no, false, ok) for runs with an answer.
    """
    return load(write_runs(
        path, factors, responses, numeric=numeric, failed=failed, block=block, name=name,
        decimal=decimal, practical=practical, results=results,
    ))  # fmt: skip


def count_cases(study: Path | Study) -> int:
    """Count the cases of a study before it is opened; 0 where none are known."""
    if isinstance(study, Study):
        return study.total
    manifest = Store(study).read_manifest()
    return 0 if manifest is None else len(manifest["cases"])


def unfinished_note(store: Store, later: ManifestDocument) -> str:
    """Say that what is shown is the last finished run, and how far the later one is."""
    counted = Store(store.path).survey(later["cases"])
    done, total = len(counted.entries), len(later["cases"])
    return (
        f"this is the last finished run; one of an edited design has computed {done} of its "
        f"{total} cases: run {later['source']} again to finish it"
    )


def _analyses(
    design: Design, records: Sequence[Record], numerical: Sequence[NumericalUncertainty], unit: str
) -> tuple[ResponseAnalysis, ...]:
    """Analyze every response of a design; a refusal is kept as its reason."""
    analyses = []
    blocks = len({record.block for record in records} - {None})
    for response in design.responses:
        limit = threshold(response.practical)
        scored, cross_validated = scored_on(design, response.name, blocks)
        result, refused = None, ""
        try:
            if record_analysis.is_numeric(design):
                refused = SEE_SURFACE
            else:
                result = record_analysis.analyze_records(design, records, response, numerical)
                result = with_contrasts(result, design.analysis.contrasts)
        except StudyError as error:
            refused = str(error).replace("'block'", repr(unit))
        better = "lower" if response.name.endswith("_error") or response.name == "seconds" else ""
        analyses.append(
            ResponseAnalysis(
                response.name, response.unit, result, None if limit is None else limit.value,
                limit is not None and limit.relative, response.transform, better, refused=refused,
                scored_on=scored, cross_validated=cross_validated,
            )
        )  # fmt: skip
    return adjusted(analyses, design.analysis)


# Families of tests adjusted together: of one response, of declared tests, of a whole study.


def adjusted(analyses: Sequence[ResponseAnalysis], spec: Analysis) -> tuple[ResponseAnalysis, ...]:
    """Adjust p by Holm's method over the family that a design declares."""
    if spec.family == "response" and not spec.primary:
        return tuple(analyses)
    raw = {
        a.name: {effect.term: effect.p for effect in a.result.effects}
        for a in analyses
        if a.result is not None
    }
    if spec.family == "study":
        tests = list(holm_family(raw, spec.primary))
    else:
        tests = [t for name, p in raw.items() for t in holm_family({name: p}, spec.primary)]
    return tuple(_with(a, [t for t in tests if t.response == a.name], spec) for a in analyses)


def _with(
    analysis: ResponseAnalysis, tests: Sequence[FamilyTest], spec: Analysis
) -> ResponseAnalysis:
    if analysis.result is None:
        return analysis
    p = {test.term: test.p_holm for test in tests}
    effects = tuple(replace(e, p_holm=p[e.term]) for e in analysis.result.effects)
    which = f"the primary terms {', '.join(spec.primary)}" if spec.primary else "all terms"
    where = "all responses together" if spec.family == "study" else "this response"
    count = max((test.family for test in tests), default=0)
    note = f"p (Holm) is adjusted for {count} tests: {which} of {where}"
    return replace(analysis, result=replace(analysis.result, effects=effects).warn(note))


# What a response was scored on: the curve that was fitted, or one that the fit never saw.

#: words in the name of a column that tell specimens apart
_SPECIMENS = ("specimen", "sample", "phantom", "subject", "animal", "donor", "batch")


def scored_on(design: Design, response: str, blocks: int) -> tuple[str, bool]:
    """Say what a response was scored on, and whether fits to all others predict each specimen."""
    fitted, measured = design.identification.calibration, design.identification.measurements
    if response not in SCORED or measured is None or fitted.method == "none":
        return "", False
    other = fitted.problem is not None
    kind = held_out(fitted.leave_out, measured.fit, measured.score, blocks, other_test=other)
    if kind is not None:
        return OTHER_SPECIMEN if kind == "specimen" else OTHER_TEST, kind == "specimen"
    if other:
        return OTHER_TEST, False
    fit, score = dict(measured.fit or {}), dict(measured.score or measured.fit or {})
    if fit == score:
        return FITTED_CURVE, False
    changed = [name for name in {**fit, **score} if fit.get(name) != score.get(name)]
    apart = any(word in name.lower() for name in changed for word in _SPECIMENS)
    return OTHER_SPECIMEN if apart else OTHER_TEST, False
