"""Two studies or runs: what differs, which conclusions hold; why a case is as it is."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from study.api.opened_study import load as load_study
from study.ground.canonical import Keyed
from study.ground.errors import Fault, InputError, MissingDataError, nearest
from study.harness.design.load import RESULTS, design_root, load, loads, results_folder
from study.harness.runner.batch import expand, manifest_of, read_truths
from study.record.record import ManifestDocument, Record
from study.record.store import Store, differences
from study.reporting.content.comparison_content import summary
from study.reporting.results import study_answers
from study.reporting.results.study_answers import Beside, Change, Conclusion, OnlyInOne
from study.simulation.job import externals
from study.simulation.provenance import versions
from study.statistics.analysis.simple_effects import MATTERS, NO_DIFFERENCE

if TYPE_CHECKING:
    from study.api.assemble import Study
    from study.reporting.results.study_result import ResponseAnalysis
    from study.statistics.analysis.analysis_result import AnalysisResult
    from study.statistics.analysis.anova_table import Effect


_HOLDS = {MATTERS: study_answers.MATTERS, NO_DIFFERENCE: study_answers.NO_DIFFERENCE}


@dataclass(frozen=True)
class StudyComparison(Keyed):
    """Two opened studies and what they say beside each other."""

    studies: tuple[Study, Study]
    beside: Beside

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of both studies and of the comparison."""
        named = zip(self.beside.names, self.studies, strict=True)
        each = [f"{name}: {message}" for name, study in named for message in study.warnings]
        return (*self.beside.warnings, *each)

    def keyed(self) -> dict[str, object]:
        """Give what stands under every key: the studies, and what they say together."""
        studies = [
            {"name": name, "study": s.design.name, "folder": str(s.folder), "cases": s.cases}
            for name, s in zip(self.beside.names, self.studies, strict=True)
        ]
        return {"studies": studies, **self.beside.keyed(), "warnings": self.warnings}


def diff(
    first: str | Path, second: str | Path, *, results: str | Path = RESULTS
) -> StudyComparison:
    """Compare two finished studies: which of their conclusions hold under both."""
    folders = [results_folder(path, results) for path in (first, second)]
    studies = load_study(folders[0], results), load_study(folders[1], results)
    return StudyComparison(studies, compare(*studies))


def compare(first: Study, second: Study) -> Beside:
    """Set two opened studies beside each other."""
    if first.folder.resolve() == second.folder.resolve():
        mend = "name two different studies, for example results/NAME and results/OTHER"
        raise InputError(Fault(str(second.folder), "is the same study as the other one", mend))
    studies = (first, second)
    names = first.design.name, second.design.name
    if names[0] == names[1]:  # told apart by their folders
        names = f"{names[0]} in {first.folder.parent}", f"{names[1]} in {second.folder.parent}"
    analyzed = _analyzed(first), _analyzed(second)
    pairs = [
        (analysis, analyzed[1][name])
        for name, analysis in analyzed[0].items()
        if name in analyzed[1]
    ]
    only = [
        *_only_responses(studies, names), *(o for pair in pairs for o in _only_terms(pair, names))
    ]  # fmt: skip
    conclusions = tuple(
        _conclusion(response, (effect, others[key]), names)
        for (response, result), (_, other) in pairs
        for others in (_effects(other),)
        for key, effect in _effects(result).items()
        if key in others
    )
    if not conclusions:
        raise InputError(_nothing(studies, names))
    comparison = Beside(
        names,
        changes(first, second),
        conclusions,
        tuple(dict.fromkeys(only)),
        tuple(_warnings(studies, names, pairs)),
        alphas=(pairs[0][0][1].request.alpha, pairs[0][1][1].request.alpha),
    )
    return replace(comparison, summary=summary(comparison))


_Studies = tuple["Study", "Study"]


#: a response and its analysis, and those of one response in both studies
_Analyzed = tuple["ResponseAnalysis", "AnalysisResult"]
_Pair = tuple[_Analyzed, _Analyzed]


def _analyzed(study: Study) -> dict[str, _Analyzed]:
    return {
        a.name: (a, a.result) for a in study.analyses if a.result is not None and a.result.effects
    }


def _effects(result: AnalysisResult) -> dict[str, Effect]:
    """Effects by term, whatever the order in which a study names its factors."""
    return {":".join(sorted(effect.term.split(":"))): effect for effect in result.effects}


def _only_responses(studies: _Studies, names: tuple[str, str]) -> Iterator[OnlyInOne]:
    """Responses that one study lacks, or that could not be analyzed."""
    declared = [{a.name: a for a in study.analyses} for study in studies]
    analyzed = [_analyzed(study) for study in studies]
    for which in (0, 1):
        for name in declared[which]:
            here, there = name in analyzed[which], name in analyzed[1 - which]
            if here and not there:
                missing = declared[1 - which].get(name)
                why = "" if missing is None else f"not analyzed in the other: {_reason(missing)}"
                yield OnlyInOne("response", name, names[which], why)
            elif not here and not there:
                why = f"not analyzed: {_reason(declared[which][name])}"
                yield OnlyInOne("response", name, names[which], why)


def _reason(analysis: ResponseAnalysis) -> str:
    return analysis.refused or "no effect could be estimated"


def _only_terms(pair: _Pair, names: tuple[str, str]) -> Iterator[OnlyInOne]:
    """Terms of one study alone, and levels of the factors that both have."""
    effects = first, second = _effects(pair[0][1]), _effects(pair[1][1])
    shared = [key for key in first if key in second and ":" not in key]
    for which, name in enumerate(names):
        for key, effect in effects[which].items():
            if key not in effects[1 - which]:
                yield OnlyInOne("factor" if ":" not in key else "term", effect.term, name)
        for factor in shared:
            levels = [set(effect[factor].levels) for effect in effects]
            for level in sorted(levels[which] - levels[1 - which]):
                yield OnlyInOne("level", f"{factor} = {level}", name)


def _conclusion(
    response: ResponseAnalysis, effects: tuple[Effect, Effect], names: tuple[str, str]
) -> Conclusion:
    """Judge one term: the verdicts, and for a factor which level leads."""
    main = ":" not in effects[0].term
    end = ("lowest" if response.better == "lower" else "highest") if main else ""
    shared = set(effects[0].levels) & set(effects[1].levels) if main else set()
    (first, with_first), (second, with_second) = (_leading(e, end, shared) for e in effects)
    same = bool(with_first & with_second) if with_first and with_second else None
    conclusion, holds = _judge(effects, (first, second), names, end, same)
    ratio = effects[0].scale == "ratio"
    return Conclusion(
        response.name, effects[0].term, response.unit, conclusion, holds, effects, ratio,
        end or None, same, (first, second),
    )  # fmt: skip


def _judge(
    effects: tuple[Effect, Effect],
    best: tuple[str, str],
    names: tuple[str, str],
    end: str,
    same: bool | None,
) -> tuple[str, bool | None]:
    """Conclusion in words, and whether it holds in both."""
    verdicts = [effect.strength for effect in effects]
    unknown = [verdict not in _HOLDS for verdict in verdicts]
    if all(unknown):
        return study_answers.NONE_CAN_TELL, None
    if any(unknown):
        return study_answers.ONE_CANNOT_TELL, None
    if verdicts[0] != verdicts[1]:
        how = "; ".join(f"{v} under {name}" for v, name in zip(verdicts, names, strict=True))
        return f"{study_answers.DIFFERS}: {how}", False
    if verdicts[0] == MATTERS and same is False:
        lead = " and ".join(
            f"{level} under {name}" for level, name in zip(best, names, strict=True)
        )
        return f"{study_answers.DIFFERS}: matters in both, but the {end} is with {lead}", False
    return _HOLDS[verdicts[0]], True


def _leading(effect: Effect, end: str, levels: set[str]) -> tuple[str, set[str]]:
    """Leading one of some levels, and those within what matters of it, itself among them."""
    pairs = zip(effect.levels, effect.mean, strict=True)
    means = {level: mean for level, mean in pairs if mean is not None and level in levels}
    if not means:
        return "", set()
    leader = (min if end == "lowest" else max)(means, key=means.__getitem__)
    best = means[leader]
    ratio = effect.scale == "ratio"
    limit = effect.practical if effect.practical is not None else float(ratio)
    if ratio:
        return leader, {k for k, v in means.items() if max(v, best) <= limit * min(v, best)}
    return leader, {k for k, v in means.items() if abs(v - best) <= limit}


def _warnings(studies: _Studies, names: tuple[str, str], pairs: Sequence[_Pair]) -> Iterator[str]:
    """Say what makes the comparison weaker than it looks."""
    for name, study in zip(names, studies, strict=True):
        if study.failed:
            cases = "1 case" if study.failed == 1 else f"{study.failed} cases"
            yield f"{cases} of {name} failed: its conclusions leave out what failed"
    for (first, _), (second, _) in pairs:
        if first.transform != second.transform:
            yield (
                f"{first.name}: transform is {first.transform!r} under {names[0]} and "
                f"{second.transform!r} under {names[1]}, so its effects are on different scales"
            )
        if (first.practical, first.relative) != (second.practical, second.relative):
            yield (
                f"{first.name}: the smallest difference that matters is not the same in both, so "
                "verdicts may differ without any change of the numbers"
            )


def _nothing(studies: _Studies, names: tuple[str, str]) -> Fault:
    """Say why there is nothing to compare, and what each study has."""
    has = []
    for name, study in zip(names, studies, strict=True):
        responses = ", ".join(_analyzed(study)) or "that were analyzed: none"
        factors = ", ".join(f.name for f in study.design.factors if len(f.levels) > 1)
        has.append(f"{name} has responses {responses}; factors {factors or 'none'}")
    refused = [f"{n}: {a.name}: {a.refused}" for n, s in zip(names, studies, strict=True)
               for a in s.analyses if a.refused]  # fmt: skip
    mend = "compare studies that share a [[response]] and a factor by name"
    if refused:
        mend = "run what is missing, for " + "; ".join(refused)
    rule = "they have no analyzed response with a factor in common (" + "; ".join(has) + ")"
    return Fault(f"{names[0]} and {names[1]}", rule, mend)


# Why a case is as it is: its record, and what has changed since it was made.


@dataclass(frozen=True)
class CaseState:
    """A case, whether its result counts, and what changed since it was made."""

    record: Record
    #: A sentence: whether the study as it is now uses the result, and why not.
    use: str
    #: What differs between the run that made it and the study as it is now: keys of the design,
    #: measured files, code.
    changes: tuple[Change, ...] = ()
    #: Libraries that had another version then than they have here now.
    libraries: tuple[Change, ...] = ()


def explain(
    case: str,
    *,
    study: str | Path | None = None,
    results: str | Path = RESULTS,
    data: str | Path | None = None,
) -> CaseState:
    """Record of a case, by the beginning of its id, and what changed since it was made.

    A design file is compared as it stands now, edited or not, whatever was run.
    """
    every = sorted(path.parent for path in Path(results).glob("*/study.json"))
    folders = every if study is None else [results_folder(study, results)]
    store, name = _only_case(case, folders, results)
    manifests = [store.read_unfinished(), store.read_manifest(), *store.read_runs()]
    runs = [run for run in manifests if run is not None and "cases" in run]
    now = _design_now(study, data) or (runs[0] if runs else None)
    record = store.read(name, None if now is None else now["cases"].get(name))
    if record is None:
        raise InputError(Fault("case", f"the record of {name} is damaged; run the study again"))
    libraries = differences(record.versions, versions())
    others = tuple(Change("library", key, pair) for key, pair in libraries.items())
    if now is None or record.extra.get("purpose") is not None:
        return CaseState(record, "it serves the numerical uncertainty of the study", (), others)
    if now["cases"].get(name) == record.input_hash:
        use = "the study uses it" + (", though other libraries made it" if others else "")
        return CaseState(record, use, (), others)
    run_of_record = next((run for run in runs if run["cases"].get(name) == record.input_hash), None)
    if run_of_record is None:
        use = "the study does not use it; the run that made it left no manifest"
        # where nothing else is known the version of the code is compared with today's
        then, today = record.versions.get("study"), versions()["study"]
        code = () if then == today else (Change("code", "version of study", (then, today)),)
        return CaseState(record, use, code, others)
    changes = run_changes(run_of_record, now)
    what = "has this case no more" if name not in now["cases"] else "makes it of other inputs now"
    if not changes and record.solver.get("program"):  # no manifest holds what they contain
        what += ": a program, a file beside it, or the version of the function is another one"
    return CaseState(record, f"the study {what}", changes, others)


def _design_now(study: str | Path | None, data: str | Path | None) -> ManifestDocument | None:
    """Say what a run of a design file would be now; None where no file is given."""
    path = None if study is None else Path(study)
    if path is None or path.suffix != ".toml" or not path.is_file():
        return None
    try:
        design = load(path)
        work = expand(design, design_root(design, data))
    except MissingDataError:
        return None  # it is compared with what was run
    models = externals(job.case.problem for job in work.jobs)
    # nor is a function known here, whose version is part of every input
    return None if any(model.is_function_missing for model in models) else manifest_of(work)


def _only_case(case: str, folders: Sequence[Path], results: str | Path) -> tuple[Store, str]:
    """Store and id of the only case whose id begins so."""
    matches: list[tuple[Store, str]] = []
    names: list[str] = []
    for folder in folders:
        store = Store(folder)
        ids = [path.name for path in sorted((folder / "cases").glob("*")) if os.path.isdir(path)]
        names += ids
        matches += [(store, name) for name in ids if name.startswith(case)]
    if not matches or not case:
        mend = nearest(case, names[:20]) if names else f"there are no records below {results}"
        raise InputError(Fault("case", f"no case has an id that begins with {case!r}", mend))
    if len(matches) > 1:
        listed = ", ".join(name for _, name in matches[:6])
        raise InputError(Fault("case", f"{case!r} begins several ids: {listed}"))
    return matches[0]


# What two studies do not share: keys of their designs, measurements, truths, code.

#: keys that change no number
_WORDS = ("study.name", "study.question", "report.format")

#: digits of a hash that tell two files apart
_DIGITS = 12
_NOT_RECORDED = "not recorded"


def changes(first: Study, second: Study) -> tuple[Change, ...]:
    """Every input that differs, the design's keys first."""
    studies = (first, second)
    return (
        *_differing("design", *(_named_keys(study.design.config) for study in studies)),
        *_differing("extent", *(
            {"cases": str(study.total), "blocks": f"{len(blocks)} ({', '.join(map(str, blocks))})"}
            for study in studies for blocks in [study.manifest["blocks"]]
        )),
        *_differing("measurements", *(
            _sums(study.manifest.get("files", {}))
            | {"kind": "virtual specimens" if study.manifest["virtual"] else "measured"}
            for study in studies
        )),
        *_truths(first, second),
        *_differing("code", *(_code(study.manifest.get("versions", {})) for study in studies)),
    )  # fmt: skip


def run_changes(first: ManifestDocument, second: ManifestDocument) -> tuple[Change, ...]:
    """Every input that differs between two runs of a study, by their manifests."""
    runs = (first, second)
    designs = [loads(run["design"], run["source"]).config for run in runs]
    return (
        *_differing("design", *(_named_keys(design) for design in designs)),
        *_differing("measurements", *(_sums(run.get("files", {})) for run in runs)),
        *_differing("truth", *(dict(_leaves(run.get("truths", {}), "truth")) for run in runs)),
        *_differing("code", *(_code(run.get("versions", {})) for run in runs)),
    )


def _differing(kind: str, first: Mapping[str, str], second: Mapping[str, str]) -> Iterator[Change]:
    for key in dict.fromkeys([*first, *second]):
        values = first.get(key), second.get(key)
        if values[0] != values[1]:
            yield Change(kind, key, values)


def _named_keys(config: Mapping[str, object]) -> dict[str, str]:
    return {k: v for k, v in _leaves(config, "") if k not in _WORDS}


def _leaves(value: Any, key: str) -> Iterator[tuple[str, str]]:
    if isinstance(value, Mapping):
        for name, item in value.items():
            yield from _leaves(item, f"{key}.{name}" if key else str(name))
    elif isinstance(value, list) and value and all(isinstance(v, Mapping) for v in value):
        for number, item in enumerate(value, 1):
            name = item.get("name")
            rest = {k: v for k, v in item.items() if k != "name"} if name else item
            yield from _leaves(rest or "present", f"{key}.{name or number}")
    else:
        yield key, _text(value)


def _text(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(_text(item) for item in value)
    if isinstance(value, Mapping):
        return ", ".join(f"{k} = {_text(v)}" for k, v in value.items())
    return str(value).lower() if isinstance(value, bool) else str(value)


def _sums(files: Mapping[str, str]) -> dict[str, str]:
    return {f"sha256 of {name}": str(sha)[:_DIGITS] for name, sha in files.items()}


def _code(versions: Mapping[str, str]) -> dict[str, str]:
    return {f"version of {name}": str(value) for name, value in versions.items()}


def _truths(first: Study, second: Study) -> Iterator[Change]:
    """Compare how virtual specimens were made; a single file may have any name."""
    if not (first.manifest["virtual"] or second.manifest["virtual"]):
        return
    truths = [_truth(study) for study in (first, second)]
    if all(truths):
        yield from _differing("truth", truths[0], truths[1])
        return
    states = [
        "of virtual specimens" if keys
        else _NOT_RECORDED if study.manifest["virtual"] else "measured, not generated"
        for study, keys in zip((first, second), truths, strict=True)
    ]  # fmt: skip
    if states[0] != states[1] or _NOT_RECORDED in states:
        yield Change("truth", "truth of the specimens", (states[0], states[1]))


def _truth(study: Study) -> dict[str, str]:
    """Keys of the truth of a study's specimens; empty where it is measured or unknown."""
    recorded = study.manifest.get("truths")
    if recorded is None:
        recorded = read_truths(study.folder / "measurements", study.manifest.get("files", {}))
    sources = dict(recorded)
    first = next(iter(sources.values()), None)
    if first is not None and all(truth == first for truth in sources.values()):
        return dict(_leaves(first, "truth"))
    return {k: v for name, truth in sources.items() for k, v in _leaves(truth, f"truth of {name}")}
