"""A finished or partial study, opened from its folder."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from study.api.assemble import StudyResult, report_data
from study.ground.errors import Fault, InputError, StudyError, nearest
from study.harness.design.load import RESULTS, dump, finished_manifest, loads, results_folder
from study.harness.design.spec import Analysis, Design, ResponseSpec
from study.harness.runner import record_analysis
from study.harness.runner.adaptive_cells import CONFIRMED, joined
from study.harness.runner.expansion import cases_by_id, relabeled
from study.harness.runner.imported_runs import write_runs
from study.harness.runner.record_analysis import unit_of
from study.mechanics.measurement.conditioning import is_caution
from study.record import document
from study.record.record import Record
from study.record.store import Store
from study.reporting import content
from study.reporting.content.analysis_content import contrasts
from study.reporting.content.blocks import Sentence, Verbatim
from study.reporting.content.comparison_content import conclusion_lines
from study.reporting.content.report_facts import facts
from study.reporting.content.sentences import would_change
from study.reporting.content.text import THIN, case_counts
from study.reporting.output.page import Shown
from study.reporting.results.study_result import (
    FITTED_CURVE,
    OTHER_SPECIMEN,
    OTHER_TEST,
    ResponseAnalysis,
)
from study.simulation.job import held_out
from study.simulation.plausibility import cautions_of
from study.simulation.response import SCORED, response_unit
from study.statistics.analysis.analysis_request import threshold
from study.statistics.analysis.comparisons import FamilyTest, holm_family
from study.statistics.analysis.post_hoc import with_contrasts
from study.statistics.analysis.simple_effects import CANNOT_TELL, NOT_RESOLVED, claim
from study.statistics.convergence.grid_convergence import NumericalUncertainty
from study.statistics.surfaces.surface_fitting import SEE_SURFACE

if TYPE_CHECKING:
    import pandas as pd

    from study.harness.runner.expansion import Work
    from study.reporting.content.blocks import Block
    from study.reporting.figures.axes import Drawing
    from study.reporting.results.study_result import ReportData
    from study.statistics.analysis.analysis_request import AnovaOptions
    from study.statistics.analysis.analysis_result import AnalysisResult
    from study.statistics.analysis.anova_table import Effect


# A study as a notebook shows it: a frame, verdicts in HTML, a figure.


@dataclass(frozen=True, repr=False)
class Study(Shown, StudyResult):
    """What :func:`study.run` and :func:`study.report` return: a study that can be shown."""

    @cached_property
    def _data(self) -> ReportData:
        return report_data(self)

    def analyzed(
        self, response: str | None, factors: Sequence[str], options: AnovaOptions
    ) -> AnalysisResult:
        """Analyze one response, the first by default; what is not said is that of the design."""
        by_name = {r.name: r for r in self.design.responses}
        name = response or next(iter(by_name))
        if not self.records:
            raise InputError(f"{self.folder}: no case is computed yet")
        names = list(self.records[0].responses)
        if name not in names:
            raise InputError(Fault("--response", f"there is no {name!r}", nearest(name, names)))
        declared = by_name.get(name) or ResponseSpec(name, unit=response_unit(name) or "")
        return record_analysis.analyze_records(
            self.design, self.records, declared, self.numerical, factors, options
        )

    @property
    def answers(self) -> tuple[str, ...]:
        """Sentences that answer the question, which cases fail, and what would change them."""
        data, pattern = self._data, self._data.failure_pattern
        all_facts = facts(data)
        failures = () if pattern is None else content.tables.failure_sentences(pattern, data.labels)
        change = f"What would change this? {would_change(data, all_facts)}"
        lines = (*content.sentences.answer(data, all_facts), *failures, change)
        return tuple(line.replace(THIN, " ") for line in lines)

    @property
    def effects(self) -> pd.DataFrame:
        """Verdict of every response and factor with its effect, interval and p, one row each."""
        import pandas as pd

        return pd.DataFrame(self.verdicts)

    def to_frame(self) -> pd.DataFrame:
        """Table of the study, one tidy row a case, failed ones included."""
        return self.table

    def plot(self, response: str | None = None) -> Drawing:
        """Draw the largest difference of every term with its interval against what matters."""
        from study.reporting.figures.effect_figures import shown_effect_sizes

        by_name = {item.name: item for item in facts(self._data)}
        name = response or next(iter(by_name), "")
        if name not in by_name:
            rule = f"there is no response {name!r}"
            raise InputError(Fault("response", rule, nearest(name, by_name)))
        return shown_effect_sizes(by_name[name], self._data.labels)

    def blocks(self) -> Iterator[Block | None]:
        """Answer, verdicts and differences that the design asks for, then surfaces."""
        yield Verbatim(f"\n{self.design.name}: {case_counts(self.cases)}")
        try:
            yield from list(self._verdicts())
        except (KeyError, ValueError, TypeError, AttributeError) as error:
            # the numbers are stored and the report is separate: a table must not end the run
            yield Sentence(f"The verdict table could not be printed: {error}.")
        for fitted in self.surfaces:
            yield from content.surface_content.surface_blocks(fitted, self._data)
        if self.beside is not None:
            yield Verbatim("")
            yield from map(Sentence, conclusion_lines(self.beside))
        if self.report is not None:
            yield Verbatim(f"\nreport: {self.report}")

    def _verdicts(self) -> Iterator[Block]:
        yield from map(Sentence, self.answers)
        all_facts, labels = facts(self._data), self._data.labels
        yield replace(content.tables.verdicts(all_facts, self._data), note="")
        for item in all_facts:
            for effect in item.effects:
                if effect.verdict == NOT_RESOLVED or refused(effect):
                    yield Sentence(content.effect_words.open_verdict(effect, item, labels))
            if (table := contrasts(item)) is not None:
                yield replace(table, name=f"{item.title}: asked for", note="")


def refused(effect: Effect) -> bool:
    """Whether the interval of a difference makes a claim that its verdict does not."""
    ends = (effect.low, effect.high, effect.practical)
    if effect.verdict != CANNOT_TELL or None in ends:
        return False
    low, high, practical = (math.log(x) if effect.is_ratio else x for x in ends if x is not None)
    return bool(claim(low, high, practical))


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


def opened(folder: Path, ended: Work | None = None, *, tell_unfinished: bool = True) -> Study:
    """Open a study; of a run that has just ended neither design nor cases are made again."""
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
    fitted = record_analysis.surfaces(design, [*records, *more], numerical)
    if more:
        warnings.append(f"{len(more)} confirming runs joined those of the surfaces")
    warnings += [f"{surface.response}: {surface.refused}" for surface in fitted if surface.refused]
    warnings += [
        f"{surface.response}: {n}"
        for surface in fitted
        if surface.surface
        for n in surface.surface.notes
    ]
    comparisons = store.read_rows(
        "validation", document.ValidationRow, document.fault_of_comparisons
    )
    return Study(
        design, folder, records, len(manifest["cases"]), manifest,
        analyses=analyses, numerical=numerical, validation=tuple(comparisons), surfaces=fitted,
        spaces=tuple(store.read_rows("spaces", document.SpaceRow)),
        adaptive=tuple(store.read_rows("adaptive", document.AdaptiveStep)),
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


def count_cases(study: Path | StudyResult) -> int:
    """Count the cases of a study before it is opened; 0 where none are known."""
    if isinstance(study, StudyResult):
        return study.total
    manifest = Store(study).read_manifest()
    return 0 if manifest is None else len(manifest["cases"])


def unfinished_note(store: Store, later: document.ManifestDocument) -> str:
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
