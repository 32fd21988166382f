"""Stored records and analyses -> the values that a report shows."""

from __future__ import annotations

import math
import platform
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from study.ground.arrays import gathered
from study.ground.canonical import plain
from study.ground.curve import Curve
from study.ground.declaration import dump_toml, flatten, parse_toml, table_of
from study.ground.errors import Fault, InputError, nearest
from study.harness.design.load import demo_design
from study.harness.design.overview import calibration_factors, equivalent_groups
from study.harness.design.spec import Design, ResponseSpec
from study.harness.runner import record_analysis
from study.harness.runner.record_analysis import fates, unit_of
from study.harness.runner.study_refinement import stored_convergence
from study.mechanics.material.material import is_dimensionless
from study.mechanics.measurement.measured_test import IMPLAUSIBLE
from study.record.record import Record, are_imported, is_repeat, table
from study.reporting import content
from study.reporting.content.analysis_content import contrasts
from study.reporting.content.blocks import Block, Sentence, Verbatim
from study.reporting.content.comparison_content import conclusion_lines
from study.reporting.content.report_facts import facts
from study.reporting.content.sentences import would_change
from study.reporting.content.text import (
    THIN,
    case_counts,
    count,
    listing,
    name_of,
    percent,
    quantity,
)
from study.reporting.output.page import Shown
from study.reporting.results.study_result import (
    ANY,
    FITS_DESCRIBE,
    PLAUSIBLE,
    Check,
    CurvePair,
    Findings,
    FittedConstant,
    RefinedSize,
    ReportData,
)
from study.simulation.response import response_unit
from study.statistics.analysis.failures import FailurePattern, failure_pattern
from study.statistics.analysis.simple_effects import CANNOT_TELL, NOT_RESOLVED, claim

if TYPE_CHECKING:
    import pandas as pd

    from study.reporting.figures.axes import Drawing
    from study.statistics.analysis.analysis_request import AnovaOptions
    from study.statistics.analysis.analysis_result import AnalysisResult
    from study.statistics.analysis.anova_table import Effect


#: cells that must agree physically may differ by the tolerance of the solver, besides the error of
#: interpolation between load steps that their records state
CONTROL_TOLERANCE = 1e-5

#: sentences about aliases that a report holds
ALIASES = 6
_HIDDEN = ("schema", "study", "presets", "factors", "exclude", "response", "analysis", "report",
           "measurements", "markers", "calibration", "converge", "uncertainty", "replicates",
           "execution", "constraint",
           "expected")  # fmt: skip


@dataclass(frozen=True, repr=False)
class Study(Shown, Findings):
    """What :func:`study.run` and :func:`study.report` return: all that its records tell."""

    design: Design
    folder: Path
    #: One a case, in the order of the design; cases not computed yet are absent.
    records: tuple[Record, ...]
    total: int
    #: What else is stored of the run: blocks, notes, timings, versions.
    manifest: Mapping[str, Any]
    report: Path | None = None
    predicted_seconds: float = 0.0
    #: How far 3D and axisymmetric space differ on a cylinder.
    spaces: tuple[Mapping[str, Any], ...] = ()
    #: What was known with so many cells, where cells were added while it ran.
    adaptive: tuple[Mapping[str, Any], ...] = ()

    @property
    def table(self) -> pd.DataFrame:
        """One tidy row a case, failed ones included."""
        return table(list(self.records))

    @property
    def plain(self) -> tuple[Record, ...]:
        """Records without replicates: one mesh a cell, the curve as measured."""
        return tuple(record for record in self.records if not is_repeat(record.extra))

    @property
    def failed(self) -> int:
        """Number of cases without an answer."""
        return sum(not record.converged for record in self.records)

    @cached_property
    def failure_pattern(self) -> FailurePattern:
        """What the failed cases share."""
        unit = unit_of(self.design, self.manifest)
        return failure_pattern(fates(self.design, self.records), unit, self.design.seed)

    @property
    def cases(self) -> dict[str, int]:
        """Number of cases: in all, done, failed and missing."""
        return {
            "total": self.total,
            "done": len(self.records) - self.failed,
            "failed": self.failed,
            "missing": self.total - len(self.records),
        }

    @property
    def verdicts(self) -> list[dict[str, object]]:
        """One verdict for every response and term."""
        return [
            row | {"scored_on": analysis.scored_on or None}
            for analysis in self.analyses
            if analysis.result is not None
            for row in analysis.result.verdicts()
        ] + [row for surface in self.surfaces for row in surface.verdicts]

    def to_json(self) -> dict[str, object]:
        """Document of ``study run --json``."""
        answer: dict[str, object] = {
            "study": self.design.name,
            "cases": self.cases,
            "predicted_seconds": self.predicted_seconds,
            "report": None if self.report is None else str(self.report),
            "verdicts": self.verdicts,
            "warnings": list(self.warnings),
        }
        where_any = {
            "contrasts": [
                {"response": analysis.name, **plain(contrast)}
                for analysis in self.analyses
                if analysis.result is not None
                for contrast in analysis.result.contrasts
            ],
            "failures": self.failed and plain(self.failure_pattern),
            "surfaces": [surface.to_json() for surface in self.surfaces],
            "adaptive": [dict(step) for step in self.adaptive],
            "beside": self.beside and self.beside.to_json(),
        }
        return answer | {key: value for key, value in where_any.items() if value}

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


def report_data(study: Study) -> ReportData:
    """Everything that the report of a study shows but its analyses by depth, which take longest."""
    design, manifest = study.design, study.manifest
    blocks, spec = tuple(manifest["blocks"]), design.identification.measurements
    markers = design.config.get("markers")
    marked = markers if isinstance(markers, Mapping) else {}
    varied = {key for factor in design.factors for key in factor.keys}
    rows: Sequence[dict[str, Any]] = stored_convergence(
        [row for row in study.numerical if len(row.series) >= 3]  # enough meshes for an order
    )
    table = study.table.copy(deep=False)
    table.attrs = {}  # each step of pandas would copy the units of its columns in depth
    return ReportData(
        name=design.name,
        question=design.question,
        factors={factor.name: factor.labels for factor in design.factors},
        table=table,
        block=unit_of(design, manifest) if blocks else "",
        blocks=blocks,
        # fixed ones by dotted key, as they are written
        inputs={key: str(value) for key, value in _written(design).items() if key not in varied},
        assumed=_assumed(design),
        citation=str(marked.get("citation") or "") if spec is None else spec.citation,
        exclusions=tuple((cell.label, why) for cell, why in design.excluded),
        curves=tuple(_curves(study.plain)),
        fits=tuple(_fits(design, study.plain)),
        markers=tuple(record for record in study.plain if record.markers),
        failures=tuple(record for record in study.records if not record.converged),
        failure_pattern=study.failure_pattern if study.failed else None,
        retried=tuple(record for record in study.records if record.retries),
        checks=tuple(_checks(study)),
        refinement=RefinedSize(
            *_refined(design),
            tuple(
                row | {"levels": {**row["levels"], "response": name_of(row["qoi"])}} for row in rows
            ),
        ),
        controls=(*_controls(design, study.plain), *checks_of_spaces(study.spaces)),
        virtual=manifest["virtual"],
        seed=design.seed,
        alpha=design.analysis.alpha,
        timings=dict(manifest.get("timings", {})),
        provenance=_provenance(study),
        commands=_to_reproduce(study),
        data_notes=tuple(manifest["notes"]),
        design_text=manifest["text"] or manifest["design"],
        scheme=_scheme(study),
        cells=None if design.scheme.rows is None else len(design.treatments),
        roles=design.roles,
        expected=design.expected,
        ranges={
            name: f"{s.low:g} to {s.high:g} {s.unit}".strip() + (" (logarithm)" if s.log else "")
            for name, s in design.ranges.items()
            if study.surfaces
        },
        # a curve, a fitted test or markers stand beside the simulation
        is_measured=design.identification.calibration.problem is not None
        or spec is not None
        or "markers" in design.config,
        **{item.name: getattr(study, item.name) for item in fields(Findings)},
    )


def _refined(design: Design) -> tuple[str, str]:
    """Name of what was refined, the mesh or a parameter of a program, and of its size with unit."""
    if (key := design.converge.key) is None:
        return "mesh", "mesh size (mm)"
    unit = design.treatments[0].cell.problem.units.get(key.partition(".")[2])
    return name_of(key), name_of(key) + (f" ({unit})" if unit else "")


def _scheme(study: Study) -> str:
    """Say which cells were run, and how those that were added came about."""
    summary = study.design.scheme.summary
    if not study.adaptive:
        return summary
    last = study.adaptive[-1]
    reached = [f"{name_of(name)} {q2:.3f}" for name, q2 in last["q2"].items() if q2 is not None]
    why = f": {last['stopped']}" if last["stopped"] else ", and is not finished"
    q2_text = f" (Q2: {listing(reached)})" if reached else ""
    return f"{summary}; it ended with {last['cells']} cells{why}{q2_text}"


def _written(design: Design) -> dict[str, object]:
    """Give the inputs of a design by dotted key, in the order of the design that is stored."""
    tables = {name: v for name, v in design.config.items() if name not in _HIDDEN}
    return flatten(parse_toml(dump_toml(tables), design.source))


def _assumed(design: Design) -> dict[str, str]:
    """List the inputs that nobody measured, with what was assumed of them."""
    flat, out = _written(design), {}
    for key in design.assumed:
        values = [str(v) for k, v in flat.items() if f"{k}.".startswith(f"{key}.")]
        levels = [
            str(level.settings[key])
            for factor in design.factors
            for level in factor.levels
            if key in level.settings
        ]
        out[key] = ", ".join(dict.fromkeys(levels or values)) or "default"
    return out


def _curves(records: tuple[Record, ...]) -> Iterator[CurvePair]:
    import numpy as np

    for record in records:
        for fact in record.scores:
            label, scatter, pair = fact["score"], fact.get("scatter_N"), record.pair(fact["score"])
            if pair is None:
                continue
            measured, predicted = pair
            at = measured.displacement_mm
            yield CurvePair(
                record.levels, record.block or "", measured, Curve(at, predicted.force_at(at)),
                label, fact["role"], None if scatter is None else np.asarray(scatter, dtype=float),
                record.case_id,
            )  # fmt: skip


def _fits(design: Design, records: tuple[Record, ...]) -> Iterator[FittedConstant]:
    """Every fit once, with the levels that enter it."""
    entering, seen = calibration_factors(design), set()
    order = {f.name: f.labels for f in design.factors if f.name in entering}
    shared = _levels_of_fits(order, records)
    for record in records:
        for specimen, fit in (record.fit or {}).items():
            if fit["key"] in seen:
                continue
            seen.add(fit["key"])
            levels, rss, n = shared[fit["key"]], fit.get("rss"), fit.get("n")
            for name, value in fit["values"].items():
                plain = is_dimensionless(name)
                error = (fit.get("standard_error") or {}).get(name)
                ends = (fit.get("ci95") or {}).get(name) or (None, None)
                error, low, high = (
                    None if v is None else v if plain else 1000.0 * v for v in (error, *ends)
                )
                yield FittedConstant(
                    levels, record.block or "", name, value if plain else 1000.0 * value,
                    "" if plain else "kPa", error, low, high, bool(fit["identifiable"]),
                    str(fit.get("reason") or ""), "" if specimen == "all" else specimen,
                    _correlated(name, fit),
                    float((rss / n) ** 0.5) if n and rss is not None else None,
                    fit.get("r_squared"),
                )  # fmt: skip


def _levels_of_fits(
    order: Mapping[str, Sequence[str]], records: tuple[Record, ...]
) -> dict[str, dict[str, str]]:
    """Levels of each fit by its key; a fit that several levels share names them all."""
    sharing = gathered((fit["key"], record) for record in records for fit in record.fits)

    def named(name: str, every: Sequence[str], records: Sequence[Record]) -> str:
        some = [level for level in every if any(r.levels[name] == level for r in records)]
        return ANY if len(some) == len(every) > 1 else " or ".join(some)

    return {
        key: {name: named(name, every, sharers) for name, every in order.items()}
        for key, sharers in sharing.items()
    }


def _correlated(name: str, fit: Mapping[str, Any]) -> dict[str, float]:
    """Correlation of a constant with the others of its fit, where it is known."""
    rows = dict(zip(fit.get("names") or (), fit.get("correlation") or (), strict=False))
    pairs = zip(rows, rows.get(name, ()), strict=False)
    return {other: float(r) for other, r in pairs if other != name and r is not None}


def _checks(study: Study) -> Iterator[Check]:
    """Make the checks that need the records."""
    cases, outcome = study.cases, "pass"
    consequence = "no effect rests on a part of the cases"
    if cases["failed"] or cases["missing"]:
        outcome = "caution"
        consequence = "cases that fail are not missing at random: effects may be biased"
    counts = "{done} of {total} cases converged, {failed} failed, {missing} missing"
    yield Check("every case has an answer", outcome, counts.format(**cases), consequence)
    scheme = study.design.scheme
    if scheme.aliases and not study.surfaces:
        mixed = "; ".join(scheme.aliases[:ALIASES])
        if len(scheme.aliases) > ALIASES:
            mixed += f"; and {len(scheme.aliases) - ALIASES} more, which `study plan` lists"
        yield Check("what the chosen cells tell apart", "caution", scheme.summary, mixed)
    for note in study.manifest["notes"]:
        if IMPLAUSIBLE in note:
            use = "constants and errors of these tests may be in another unit"
            yield Check(PLAUSIBLE, "caution", note, use)
    fits = {fit["key"]: fit for record in study.plain for fit in record.fits}
    if fits:
        yield from _checks_of_fits(fits, _names_of_fits(study), _misfits(study))
    yield from checks_of_paths(study.plain, [r.name for r in study.design.responses])


def _names_of_fits(study: Study) -> dict[str, str]:
    """Levels, block and specimen of each fit by its key."""
    entering, spec = calibration_factors(study.design), study.design.identification.measurements
    kind = f"{spec.block} " if spec is not None and spec.block else ""

    def data_of(block: str | None, label: str) -> list[str]:
        if label in (f"all but {block}", f"{block} alone"):
            return [label.replace(str(block), f"{kind}{block}", 1)]
        specimen = [f"specimen {label}"] if label != "all" else []
        return [f"{kind}{block}", *specimen] if block else specimen

    return {
        fit["key"]: ", ".join(
            [*(level for name, level in record.levels.items() if name in entering)]
            + data_of(record.block, label)
        )
        for record in reversed(study.plain)
        for label, fit in (record.fit or {}).items()
    }


def _misfits(study: Study) -> dict[str, str]:
    """Say what each fit misses, by its key; of one to all blocks but one, with their names.

    A fit numbers its curves alone, for its key must not change with the name of a specimen. With
    measurements of its own, a calibration may have other specimens: these keep their numbers.
    """
    design, blocks = study.design, tuple(map(str, study.manifest["blocks"]))
    spec = design.identification.measurements
    kind = "" if spec is None or not spec.block else f"{spec.block} "
    out: dict[str, str] = {}
    for record in study.plain:
        fitted = {
            str(k): f"{kind}{block}"
            for k, block in enumerate((b for b in blocks if b != record.block), 1)
        }
        for label, fit in (record.fit or {}).items():
            parts = re.split(r"\bcurve (\d+)", fit.get("misfit", ""))
            if label == f"{record.block} alone":
                names = {"1": f"{kind}{record.block}"}
            else:
                is_theirs = label == f"all but {record.block}"
                names = (
                    fitted
                    if is_theirs and design.identification.calibration.problem is None
                    else {}
                )
            parts[1::2] = [names.get(number, f"curve {number}") for number in parts[1::2]]
            out[fit["key"]] = "".join(parts)
    return out


def _checks_of_fits(
    fits: Mapping[str, Mapping[str, Any]], names: Mapping[str, str], misfits: Mapping[str, str]
) -> Iterator[Check]:
    """Say how many fits describe their rows, determine their constants, and are stable."""
    of, every = f"of {len(fits)} calibrations", fits.values()
    bad, doubtful = (
        [fit for fit in every if fit.get("verdict") == verdict]
        for verdict in ("does not describe", "doubtful")
    )
    if bad or doubtful:
        first = (bad or doubtful)[0]
        name = names[first["key"]]
        use = f"check {count(len(doubtful), 'doubtful fit')}"
        if bad:
            missed = f"{count(len(bad), 'fit')} that missed the data"
            use = f"use no constant of {missed}{name and f', such as {name}'}"
        counts = [f"{len(fits) - len(bad) - len(doubtful)} {of} describe their data"]
        counts += [count(len(doubtful), "is doubtful", "are doubtful")] * bool(doubtful)
        counts += [count(len(bad), "does not", "do not")] * bool(bad)
        # the counts hold the verdict: reasons of two kinds follow, of several for every curve
        reason = misfits[first["key"]].partition("the data: ")[2]
        kinds: dict[str, str] = {}
        for each in reason.removeprefix("use no constant of it: ").split("; "):
            kinds.setdefault(re.sub(r"[-\d.]+", "", each)[:30], each)
        reason = "; ".join([*kinds.values()][:2])
        where = f", for example that of {name}" if name else ""
        where += ", " if reason.startswith("curve ") else ": "
        finding = f"{listing(counts)}{where}{reason}"
        yield Check(FITS_DESCRIBE, "caution", finding, use)
    vague = [fit for fit in every if not fit["identifiable"]]
    yield Check(
        "constants are identifiable", "caution" if vague else "pass",
        f"{len(fits) - len(vague)} {of} determine every constant",
        "rely on the force curve and the initial shear modulus, not on constants"
        if vague else "each has a meaning of its own",
    )  # fmt: skip
    loose = [fit for fit in every if not fit.get("stable", True)]
    finding = f"{len(fits) - len(loose)} {of} are stable over the range"
    use = "they may be used over the range of their test"
    if loose:
        finding += f"; for example {loose[0].get('stability', 'the first')}"
        use = "do not use the unstable ones beyond the test they were fitted to"
    yield Check("constants are stable", "caution" if loose else "pass", finding, use)


def _controls(design: Design, records: tuple[Record, ...]) -> Iterator[Check]:
    """Cells that must agree physically: how far they differ."""
    groups = [g for g in equivalent_groups(design) if len(g) > 1]
    if not groups:
        return
    worst, compared, good = 0.0, 0, True
    by_cell: dict[tuple[tuple[str, str], ...], dict[str | None, tuple[float, float]]] = {}
    for record in records:
        value = record.value("rms_force_error")
        if record.converged and value is not None:
            key = tuple(sorted(record.levels.items()))
            steps = record.responses["rms_force_error"].get("u_steps") or 0.0
            by_cell.setdefault(key, {})[record.block] = (float(value), steps)
    for group in groups:
        cells = [by_cell.get(tuple(sorted(cell.levels.items())), {}) for cell in group]
        for block in cells[0]:
            values = [cell[block] for cell in cells if block in cell]
            if len(values) > 1:
                (low, low_u), (high, high_u) = min(values), max(values)
                compared, size = compared + 1, max(abs(low), abs(high))
                worst = max(worst, (high - low) / size if size else 0.0)
                good = good and high - low <= CONTROL_TOLERANCE * size + low_u + high_u
    if not compared:
        return
    yield Check(
        "cells that must agree do agree",
        "pass" if good else "fail",
        f"{sum(map(len, groups))} cells in {len(groups)} groups "
        + (
            "agree to rounding"
            if worst < 1e-10
            else f"differ by at most {worst:.1g} of their error"
        ),
        f"{'nothing' if good else 'something'} other than the factors differs between them",
    )


def _to_reproduce(study: Study) -> tuple[str, ...]:
    """Lines that a shell in an empty folder takes: they compute the study anew."""
    design, manifest = study.design, study.manifest
    source = str(manifest["source"])
    if source == "demo.toml" and manifest["text"] == demo_design().text:
        return ("study demo",)
    if are_imported(manifest["notes"]):
        return (f"# the runs were made elsewhere: study import reads their table, {source}",)
    name = source if source.endswith(".toml") else f"{design.name}.toml"
    model = table_of(design.config, "forward").get("model")
    lines = [f"# save the design file below as {name}"]
    if manifest["files"]:
        lines.append("# copy the files of measurements (their sha256 is below) to measurements/")
    if model == "command":
        lines.append("# copy its program and templates, as the design names them, beside it")
    if model == "python":
        function = "forward=FUNCTION, version=VERSION"
        return (*lines, f"# in Python, with its function: study.run({name!r}, {function})")
    return (*lines, f"study run {name}{' --allow-commands' * (model == 'command')}")


def _provenance(study: Study) -> dict[str, str]:
    manifest = study.manifest
    out = {f"version of {k}": str(v) for k, v in manifest.get("versions", {}).items()}
    solvers = {str(r.solver.get("name")) for r in study.records if r.solver.get("name")}
    if solvers:
        out["linear solver"] = ", ".join(sorted(solvers))
    if simulations := _simulations(study.plain):
        out["simulations of the calibrations"] = simulations
    out |= {f"sha256 of {name}": sha for name, sha in manifest.get("files", {}).items()}
    out["threads per worker"] = "1"
    out["machine"] = f"{platform.system()} {platform.machine()}"
    return out


def _simulations(records: Sequence[Record]) -> str:
    """Count the simulations that calibrations asked for, and those that they share."""
    fits = {fit["key"]: fit for record in records for fit in record.fits}.values()
    begun = [fit["first_solution"] for fit in fits if fit.get("first_solution")]
    if not begun:
        return ""
    solves, shared = sum(fit.get("solves", 0) for fit in fits), len(begun) - len(set(begun))
    return (
        f"{solves - shared} in the last searches of {len(begun)} calibrations; "
        f"{shared} of these began with the solution of another"
    )


# Checks of spaces: one cylinder in both.

#: 3D and axisymmetric space on one cylinder may differ by so much
SPACES_TOLERANCE = 0.005


def checks_of_spaces(rows: tuple[Mapping[str, Any], ...]) -> Iterator[Check]:
    """One check for every kind of element: 3D equals axisymmetric space on a cylinder."""
    for row in rows:
        kind = listing(list(row["levels"].values())) or "the study's elements"
        name = f"3D equals axisymmetric space on a cylinder ({kind})"
        if row["at_end"] is None or row["largest"] is None:
            yield Check(name, "caution", f"it could not be looked at: {row['message']}")
            continue
        flat, solid = row["unknowns"]
        worst = max(abs(row["at_end"]), abs(row["largest"]))
        good = worst <= SPACES_TOLERANCE
        text = (
            f"the forces on the cylinder of the same cross-section differ by "
            f"{percent(row['at_end'], 2)} at {row['depth_mm']:g} mm and by at most "
            f"{percent(abs(row['largest']), 2)} beyond half the depth "
            f"({solid:,} against {flat:,} unknowns)"
        )
        mend = "an effect of the space is none of the discretization"
        if not good:
            mend = "so much of the effect of the space is that of the discretization"
        yield Check(name, "pass" if good else "caution", text, mend)


# Checks of what lies between the load steps: energy, and the interpolation of the curve.

#: Largest share of the stored energy by which the work of a test may be off without a snap.
MISMATCH = 0.002

#: Largest change of a response in per cent where every other load step is left out, in
#: percentage points; a difference that matters to anybody is ten times larger.
STEP_CHANGE_PP = 0.05

#: Below this a change is one of rounding, in the unit of the response.
NOTHING = 1e-12


def checks_of_paths(records: Sequence[Record], responses: Sequence[str]) -> Iterator[Check]:
    """Check energy balance and load steps of every case that was simulated."""
    solved = [r for r in records if r.converged and "energy_mismatch" in r.solver]
    if solved:
        yield _energy(solved)
    steps = [
        (name, u, entry["unit"])
        for record in solved
        for name, entry in record.responses.items()
        if (u := entry.get("u_steps")) is not None and name in responses
    ]
    if steps:
        yield _load_steps(steps)


def _energy(solved: Sequence[Record]) -> Check:
    """Compare the work of the test with the energy stored."""
    name = "work of the test equals stored energy"
    snapped = [r for r in solved if r.solver.get("snaps_mm")]
    smooth = [r.solver["energy_mismatch"] for r in solved if not r.solver.get("snaps_mm")]
    worst = max(smooth, default=0.0)
    held = max(r.solver.get("stabilization_share", 0.0) for r in solved)
    finding = (
        f"the two differ by {_at_most(worst)} of the largest energy where nothing snaps; the "
        f"stabilization of the elements holds {_at_most(held)} of it"
    )
    if not snapped:
        good = worst <= MISMATCH
        mend = "the load path is followed closely enough"
        if not good:
            mend = "raise test.steps: the force between the load steps is not certain"
        return Check(name, "pass" if good else "caution", finding, mend)
    first = snapped[0]
    snaps = ", ".join(f"{d:.3g}" for d in first.solver["snaps_mm"])
    finding += (
        f"; in {count(len(snapped), 'case')} the surface snaps to another equilibrium, for "
        f"example past {snaps} mm in {' / '.join(first.levels.values())}"
    )
    mend = "the force beyond a snap depends on the mesh; look at a finer one"
    return Check(name, "caution", finding, mend)


def _at_most(fraction: float) -> str:
    r"""Write an upper bound of a share.

    Examples
    --------
    >>> [_at_most(share).replace("\xa0", " ") for share in (0.004, 0.0001, 0.0)]
    ['at most 0.40 %', 'less than 0.1 %', 'none']
    """
    if fraction == 0:
        return "none"
    shown = percent(fraction, 2)
    return shown.replace("< ", "less than ") if shown.startswith("<") else f"at most {shown}"


def _load_steps(steps: Sequence[tuple[str, float, str]]) -> Check:
    """Say what every other load step changes, response by response."""
    worst: dict[str, tuple[float, str]] = {}
    for name, u, unit in steps:
        if u >= worst.get(name, (0.0, ""))[0]:
            worst[name] = u, "pp" if unit == "%" else unit
    parts = [
        f"{name_of(name)} {quantity(u if u > NOTHING else 0.0, unit, 2)}"
        for name, (u, unit) in worst.items()
    ]
    finding = (
        "with every other load step left out, each response changes by no more than this: "
        f"{listing(parts)}; it is part of the numerical uncertainty"
    )
    name = "responses do not depend on the load steps"
    if all(u <= STEP_CHANGE_PP for u, unit in worst.values() if unit == "pp"):
        return Check(name, "pass", finding, "more load steps would change nothing that counts")
    return Check(name, "caution", finding, "raise test.steps")
