"""A finished or partial study, opened from its folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from study.analysis.convergence.grid_convergence import NumericalUncertainty
from study.analysis.request import threshold
from study.api.folders import RESULTS, finished_manifest, results_folder
from study.api.statistics.confirmation import joined
from study.api.statistics.contrast import with_contrasts
from study.api.statistics.family import adjusted
from study.api.statistics.records import analyze_records
from study.api.statistics.scoring import cross_validated, scored_on
from study.api.statistics.surface.study_surface import SEE_SURFACE, is_numeric, surfaces
from study.api.study_notebook import Study
from study.api.uncertainty.numerical import stored_numerical
from study.design.load import loads
from study.design.plausibility import cautions
from study.design.spec import Design
from study.errors import StudyError
from study.measurement.conditioning import is_caution
from study.record.document import AdaptiveStep, ManifestDocument, SpaceRow, ValidationRow
from study.record.document_checks import fault_of_comparisons
from study.record.record import Record
from study.record.store import Store
from study.runner.expansion import cases_by_id, relabeled
from study.study_result.report_data import ResponseAnalysis
from study.study_result.study_result import StudyResult


def open_study(
    path: str | Path, results: str | Path = RESULTS, *, tell_unfinished: bool = True
) -> Study:
    """Open the stored records of a study and analyze them: those of its last finished run.

    Parameters
    ----------
    path : str or Path
        Results folder, design file or name of the study.
    results : str or Path
        Folder of the results, where ``path`` is a name.
    tell_unfinished : bool
        Whether a later run that is not finished is a warning.

    Raises
    ------
    InputError
        If there are none.
    """
    folder = results_folder(path, results)
    warnings: list[str] = []
    store = Store(folder, warn=warnings.append)
    manifest = finished_manifest(store)
    design = loads(manifest["design"], manifest["source"])
    known = cases_by_id(design, manifest["blocks"])
    found = store.records(manifest["cases"])
    records = relabeled(found, design, known)
    if len(records) < len(found):
        count = len(found) - len(records)
        warnings.append(f"{count} records are of no cell of the design: run the design again")
    numerical = stored_numerical(store, manifest["cases"])
    missing = len(manifest["cases"]) - len(records)
    later = store.read_unfinished() if tell_unfinished else None
    if later is not None:
        warnings.append(unfinished_note(store, later))
    problems = [one.cell.problem for one in design.treatments]
    warnings += dict.fromkeys(
        said for problem in problems for said in cautions(problem.setup, problem.material)
    )
    warnings += [note for note in manifest["notes"] if is_caution(note)]
    if missing:
        warnings.append(f"{missing} of {len(manifest['cases'])} cases are not computed yet")
    analyses = _analyses(design, records, numerical)
    warnings += [f"{a.name}: {a.refused}" for a in analyses if a.refused not in ("", SEE_SURFACE)]
    more = joined(design, store, manifest)
    fitted = surfaces(more.design, [*records, *more.records], numerical)
    if more.records:
        warnings.append(f"{len(more.records)} confirming runs joined those of the surfaces")
    warnings += [f"{one.response}: {one.refused}" for one in fitted if one.refused]
    warnings += [f"{one.response}: {n}" for one in fitted if one.found for n in one.found.notes]
    comparisons = store.read_rows("validation", ValidationRow, fault_of_comparisons)
    spaces, steps = store.read_rows("spaces", SpaceRow), store.read_rows("adaptive", AdaptiveStep)
    return Study(
        design, folder, records, len(manifest["cases"]), analyses, numerical, manifest,
        tuple(dict.fromkeys(warnings)),
        validation=tuple(comparisons),
        spaces=tuple(spaces), surfaces=fitted, adaptive=tuple(steps),
    )  # fmt: skip


def count_cases(known: Path | StudyResult) -> int:
    """Count the cases of a study before it is opened; 0 where none are known.

    Parameters
    ----------
    known : Path or StudyResult
        Folder of its results, or a study that is open already.
    """
    if isinstance(known, StudyResult):
        return known.total
    manifest = Store(known).read_manifest()
    return 0 if manifest is None else len(manifest["cases"])


def unfinished_note(store: Store, later: ManifestDocument) -> str:
    """Say that what is shown is the last finished run, and how far the later one is.

    Parameters
    ----------
    store : Store
        Results of the study.
    later : mapping
        Manifest of the run that is not finished.
    """
    counted = Store(store.path).survey(later["cases"])
    done, total = len(counted.done) + len(counted.failed), len(later["cases"])
    return (
        f"this is the last finished run; one of an edited design has computed {done} of its "
        f"{total} cases: run {later['source']} again to finish it"
    )


def _analyses(
    design: Design, records: Sequence[Record], numerical: Sequence[NumericalUncertainty]
) -> tuple[ResponseAnalysis, ...]:
    """Analyze every response of a design; a refusal is kept as its reason."""
    found = []
    blocks = len({record.block for record in records} - {None})
    unit = "block" if design.measurements is None else design.measurements.block or "block"
    for response in design.responses:
        limit = threshold(response.practical)
        result, refused = None, ""
        try:
            if is_numeric(design):
                refused = SEE_SURFACE
            else:
                result = analyze_records(design, records, response, numerical)
                result = with_contrasts(result, design.analysis.contrasts)
        except StudyError as error:
            refused = str(error).replace("'block'", repr(unit))
        better = "lower" if response.name.endswith("_error") or response.name == "seconds" else ""
        found.append(
            ResponseAnalysis(
                response.name,
                response.unit,
                result,
                None if limit is None else limit.value,
                limit is not None and limit.relative,
                response.transform,
                None if result is None else result.detection.u_num,
                better,
                refused=refused,
                scored_on=scored_on(design, response.name, blocks),
                cross_validated=cross_validated(design, response.name, blocks),
            )
        )
    return adjusted(found, design.analysis)
