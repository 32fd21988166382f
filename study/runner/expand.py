"""A design and its data -> every computation that is needed, each once, with its name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from study.curve import Curve
from study.design import Case, Design, MeasurementSpec, case_id, cases, plain, treatments
from study.errors import Fault, InputError
from study.record import SORTED, MeasuredTest, Measurements, is_repeat, read_measurements
from study.runner import build, surfaces
from study.runner.cells import anchored
from study.runner.execute import Direction
from study.runner.fits import FitProblem, fit_key, fit_problem, start_problem
from study.runner.identity import code_version, digest
from study.runner.leave_out import LeftOut, distinct_tests, left_out
from study.runner.replicates import mesh_seeded, resampled
from study.runner.scoring import UNITS, is_plain

Config = Mapping[str, Any]

#: ends in the name of the file that says how virtual measurements were made
TRUTH_SUFFIX = ".virtual.json"


@dataclass(frozen=True)
class FitJob:
    """One fit: its problem, its data, and the fit that gives its start values.

    ``noise`` is the seed and the number of a fit to the resampled residuals of its start.
    """

    key: str
    problem: FitProblem
    measured: tuple[Curve, ...]
    start: str | None = None
    label: str = ""
    noise: tuple[int, int] | None = None


@dataclass(frozen=True)
class CaseJob:
    """One case and the fits that it needs.

    ``group`` names the cell whose cases share a solution to start from, and ``anchor`` the fit
    that gives the constants of that one (see :mod:`study.runner.anchors`).
    """

    case: Case
    directions: tuple[Direction, ...]
    input_hash: str
    extra: Mapping[str, Any] = field(default_factory=dict)
    group: str = ""
    anchor: str | None = None

    @property
    def depth_mm(self) -> float:
        """Largest measured displacement of its directions."""
        return max(float(d.measured.displacement_mm.max()) for d in self.directions)

    @property
    def needs(self) -> tuple[str, ...]:
        """Keys of its fits."""
        keys = (self.anchor, *(d.fit_key for d in self.directions))
        return tuple(dict.fromkeys(key for key in keys if key))


@dataclass(frozen=True)
class Work:
    """Everything that a study computes.

    Parameters
    ----------
    design : Design
        The study.
    jobs : tuple of CaseJob
        One for every case, in the order of the design.
    fits : mapping of str to FitJob
        Every fit, by key, start fits included.
    responses : mapping of str to str
        Unit of every response that a record holds.
    blocks : tuple of str
        Labels of the blocks.
    data : DataCache
        The measurements, each specification read once.
    """

    design: Design
    jobs: tuple[CaseJob, ...]
    fits: Mapping[str, FitJob]
    responses: Mapping[str, str]
    blocks: tuple[str, ...]
    data: DataCache

    @property
    def notes(self) -> tuple[str, ...]:
        """What was done to the measurements."""
        return self.data.notes()

    @property
    def cautions(self) -> tuple[str, ...]:
        """What was done to measurements and surfaces that may not be what they seem."""
        mended = surfaces.surface_notes([job.case.config for job in self.jobs])
        return (*(note for note in self.notes if SORTED in note), *mended)

    @property
    def files(self) -> dict[str, str]:
        """Name of each measurement file and its sha256."""
        return self.data.files()

    @property
    def virtual(self) -> bool:
        """Whether the measurements were generated."""
        return any((self.data.root / f"{name}{TRUTH_SUFFIX}").is_file() for name in self.files)

    def plain(self) -> Work:
        """Leave the replicates out: the first mesh of a cell, the curve as measured."""
        return replace(self, jobs=tuple(job for job in self.jobs if not is_repeat(job.extra)))

    @property
    def input_hashes(self) -> dict[str, str]:
        """Case id -> hash of everything that decides its record."""
        return {job.case.case_id: job.input_hash for job in self.jobs}


def expand(design: Design, data_root: Path) -> Work:
    """List every case and every fit of a design.

    Raises
    ------
    InputError
        If data are missing or malformed, or the blocks differ between treatments.
    """
    data = DataCache(data_root, distinct_tests([t.config for t in treatments(design)]))
    found = _blocks(design, data)
    all_cases = mesh_seeded(_distinct(cases(design, found)), design)
    places = surfaces.folders(design.source, data_root)
    all_cases = [(_located(case, places), extra) for case, extra in all_cases]
    fits: dict[str, FitJob] = {}
    responses = _responses(design)
    jobs = anchored([case_job(case, data, fits, responses, extra) for case, extra in all_cases])
    jobs += resampled(jobs, design, fits)
    return Work(design, jobs, fits, responses, found, data)


def _located(case: Case, places: Sequence[Path]) -> Case:
    return replace(case, config=surfaces.located(case.config, places))


def _distinct(found: Sequence[Case]) -> list[Case]:
    """Give cells of equal content names of their own, so that none hides the other's record."""
    seen: set[str] = set()
    out = []
    for case in found:
        if case.case_id in seen:
            case = replace(case, case_id=case_id([case.case_id, case.levels]))
        seen.add(case.case_id)
        out.append(case)
    return out


def case_job(
    case: Case,
    data: DataCache,
    fits: dict[str, FitJob],
    responses: Mapping[str, str],
    extra: Mapping[str, Any] | None = None,
) -> CaseJob:
    """Directions of one case; its fits are added to ``fits``."""
    problem = fit_problem(case.config)
    directions = tuple(_directions(case, problem, data, fits))
    identity = [
        case.case_id,
        sorted(responses),
        [
            [d.label, d.fit_label, d.fit_key, d.measured.displacement_mm.tolist(),
             d.measured.force_N.tolist()]
            for d in directions
        ],
        code_version(),
        *surfaces.fingerprints(case.config),
    ]  # fmt: skip
    return CaseJob(case, directions, digest(identity), dict(extra or {}))


def _directions(
    case: Case, problem: FitProblem, data: DataCache, fits: dict[str, FitJob]
) -> list[Direction]:
    scored = data.scored(case.config)
    if scored is None:
        rule = "the responses of a study compare with measured curves: there is no [measurements]"
        raise InputError(Fault("measurements", rule, "add it, or use `study solve`"))
    if problem.method == "none":
        _, test = scored.pairs(case.block)[0]
        return [_direction(test, scored.score, None, None)]
    if case.config["calibration"].get("leave_out"):
        return [_left_out(one, fits, case) for one in left_out(case, scored, data)]
    own = data.calibrated(case.config)
    if own is not None:
        fitted = own.curve(_block_in(own, case.block), **dict(own.fit or {}))
        key = _add_fit(problem, (fitted.curve,), fits, case)
        _, test = scored.pairs(case.block)[0]
        return [_direction(test, scored.score, key, None)]
    out = []
    sides = [(scored.fit, scored.score or scored.fit)]
    if scored.swap:
        sides.append((sides[0][1], sides[0][0]))
    for (fit, score), (fit_where, score_where) in zip(scored.pairs(case.block), sides, strict=True):
        key = _add_fit(problem, (fit.curve,), fits, case)
        role = "fit" if fit_where == score_where else "score"
        out.append(_direction(score, score_where, key, fit_where, role))
    return out


def _left_out(one: LeftOut, fits: dict[str, FitJob], case: Case) -> Direction:
    key = _add_fit(one.problem, one.measured, fits, case)
    return replace(_direction(one.test, one.score_where, key, None), fit_label=one.label)


def _direction(
    test: MeasuredTest,
    score_where: Mapping[str, Any] | None,
    key: str | None,
    fit_where: Mapping[str, Any] | None,
    role: str = "score",
) -> Direction:
    scatter = None if test.scatter_N is None else [float(v) for v in test.scatter_N]
    return Direction(_label(score_where), test.curve, key, role, _label(fit_where), scatter)


def _label(where: Mapping[str, Any] | None) -> str:
    if not where:
        return "all"
    values = [v if isinstance(v, (list, tuple)) else [v] for v in where.values()]
    return " ".join("+".join(str(item) for item in group) for group in values)


def _add_fit(
    problem: FitProblem, measured: tuple[Curve, ...], fits: dict[str, FitJob], case: Case
) -> str:
    key = fit_key(problem, measured)
    if key not in fits:
        before = start_problem(problem)
        start = None if before is None else _add_fit(before, measured, fits, case)
        fits[key] = FitJob(key, problem, measured, start, case.label)
    return key


def _block_in(found: Measurements, block: str | None) -> str | None:
    return block if found.block is not None else None


class DataCache:
    """Measured tests of a study, each specification read once."""

    def __init__(self, root: Path, tests: Sequence[Config] = ()) -> None:
        self.root, self.tests = root, tests
        self._read: dict[str, Measurements] = {}

    def scored(self, config: Config) -> Measurements | None:
        """Measurements that a configuration is scored on."""
        return self._get(config.get("measurements"), config["specimen"], config["test"])

    def calibrated(self, config: Config) -> Measurements | None:
        """Measurements that only the calibration uses."""
        own = (config.get("calibration") or {}).get("problem") or {}
        if not own or own.get("measurements") == config.get("measurements"):
            return None
        return self._get(own.get("measurements"), own["specimen"], own["test"])

    def notes(self) -> tuple[str, ...]:
        """Count what every rule did to the data, each once."""
        return tuple(dict.fromkeys(n for found in self._read.values() for n in found.notes))

    def files(self) -> dict[str, str]:
        """Name of each file read and its sha256."""
        return {name: sha for found in self._read.values() for name, sha in found.files.items()}

    def _get(self, spec: Any, specimen: Config, test: Config) -> Measurements | None:
        if not spec:
            return None
        height, depth = build.height_mm(specimen), test.get("displacement_mm")
        made = spec if isinstance(spec, MeasurementSpec) else MeasurementSpec.from_dict(spec)
        key = digest([made.as_dict(), height, depth])
        if key not in self._read:
            self._read[key] = read_measurements(made, self.root, height, depth)
        return self._read[key]


def _blocks(design: Design, data: DataCache) -> tuple[str, ...]:
    found: tuple[str, ...] | None = None
    for treatment in treatments(design):
        measured = data.scored(treatment.config)
        own = () if measured is None else measured.blocks
        if found is not None and own != found:
            rule = f"treatments have different blocks: {', '.join(found)} and {', '.join(own)}"
            raise InputError(Fault("measurements.block", rule))
        found = own
    return found or ()


def _responses(design: Design) -> dict[str, str]:
    """Responses of every record: those of a curve, mu0, and what the design asks besides."""
    asked = [response.name for response in design.responses]
    constants = [name for name in asked if name not in UNITS and name not in ("mu0", "seconds")]
    units = {**UNITS, "mu0": "kPa"}
    units |= {name: "" if is_plain(name) else "kPa" for name in constants}
    return units | ({"seconds": "s"} if "seconds" in asked else {})


def for_workers(config: Config) -> dict[str, Any]:
    """Make a configuration plain JSON."""
    made: dict[str, Any] = plain(config)
    return made
