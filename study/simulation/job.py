"""The jobs of a study: its measurements, cases and fits, as values that know what they need."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Literal

from study.external.forward_model import ForwardCell
from study.ground.canonical import digest
from study.ground.curve import Curve
from study.ground.errors import Fault, InputError
from study.mechanics.forward.closed_form import height_and_area
from study.mechanics.forward.finite_element import Anchor
from study.mechanics.measurement.conditioning import is_caution
from study.mechanics.measurement.measured_test import MeasuredTest, Measurements, Selection, checked
from study.mechanics.measurement.measurement_section import MeasurementSpec
from study.mechanics.measurement.reading import read_measurements
from study.mechanics.measurement.recording import Gauge, Recordings, read_recordings
from study.mechanics.setup.calibration_table import NOTHING as calibration_NOTHING
from study.mechanics.setup.setup import Setup
from study.record.record import Record, ResponseDocument
from study.simulation.cell import Case, Cell, CellProblem, Config, case_id, tested
from study.simulation.fit_problem import FitProblem, FitResult, fit_key, start_problem, together
from study.simulation.provenance import versions

# A case as it goes to a worker: what is known of its record, its problem, its fits.

#: role of a direction that gives the constants of a specimen where its score is held out
CONSTANTS = "constants"

#: Where the predicted curve of a case comes from: the last solution of its fit, a closed form,
#: a solution of its own, or one by another program.
Forward = Literal["fit", "closed-form", "simulation", "external"]


@dataclass(frozen=True)
class Origin:
    """Why a case is computed besides the cells of the design; its record says so."""

    #: Number among the cases that repeat a cell on other meshes, with resampled residuals, or with
    #: other seeds of a stochastic simulation.
    mesh_seed: int | None = None
    noise_seed: int | None = None
    replicate: int | None = None
    #: What it serves beside the study's own answer.
    purpose: Literal["refinement", "input"] | None = None
    #: Id of the case that it is compared with.
    of: str | None = None
    #: How often the mesh was refined.
    level: int | None = None
    #: Key of the input that was moved.
    input: str | None = None

    @property
    def predicts(self) -> bool:
        """Whether its curve is wanted: a fit to resampled residuals has constants alone."""
        return not self.noise_seed

    def to_json(self) -> dict[str, object]:
        """Plain data without what does not apply."""
        return {name: value for name, value in vars(self).items() if value is not None}


#: ends in the name of the file that says how virtual measurements were made
TRUTH_SUFFIX = ".virtual.json"


def gauge_of(setup: Setup) -> Gauge | None:
    """Return what turns recorded strain and stress into displacement and force."""
    if setup.height_mm is None:
        return None
    height, area = height_and_area(setup.specimen)
    power, indenter = 1.0, setup.test.indenter
    if indenter is not None:
        # the slope of the force is in proportion to the radius of contact (Sneddon 1965)
        shallow = 0.1 * (setup.test.displacement_mm or height)
        radii = [indenter.contact_radius_mm(depth) for depth in (shallow, 2 * shallow)]
        power += math.log2(radii[1] / radii[0])
    return Gauge(area, height, setup.kind.mode, setup.kind.sense, setup.is_homogeneous, power)


class DataCache:
    """Measured tests of a study."""

    def __init__(self, root: Path, tests: Sequence[ForwardCell] = ()) -> None:
        self.root, self.tests = root, tests
        self._read: dict[str, Measurements] = {}
        self._recorded: dict[str, Recordings] = {}
        # what was asked for already, by the problems themselves, which are kept so that their
        # identity stays their own
        self._asked: dict[int, tuple[ForwardCell, Measurements]] = {}

    def calibrated(self, cell: Cell) -> Measurements | None:
        """Measurements that only the calibration uses."""
        other = cell.fitted_elsewhere
        if other is None or other.measurements == cell.problem.measurements:
            return None
        return self.scored(other)

    def notes(self) -> tuple[str, ...]:
        """Count what every rule did to the data, each once."""
        return tuple(dict.fromkeys(n for measured in self._read.values() for n in measured.notes))

    def cautions(self) -> tuple[str, ...]:
        """List what was done to the data that may not be what it seems."""
        return tuple(note for note in self.notes() if is_caution(note))

    def files(self) -> dict[str, str]:
        """Name of each file read and its sha256."""
        return {name: sha for data in self._read.values() for name, sha in data.files.items()}

    def scored(self, problem: ForwardCell) -> Measurements | None:
        """Measurements that a case is scored on."""
        spec = problem.measurements
        if spec is None or not isinstance(problem, CellProblem):
            return None
        if id(problem) not in self._asked:  # one problem for all blocks of a cell
            setup = problem.setup
            height, depth, gauge = setup.height_mm, setup.test.displacement_mm, gauge_of(setup)
            key = digest([spec.as_dict(), height, depth, None if gauge is None else asdict(gauge)])
            if key not in self._read:
                rows = self._recordings(spec)
                measurements = read_measurements(spec, self.root, height, depth, gauge, rows)
                self._read[key] = checked(measurements, setup)
            self._asked[id(problem)] = problem, self._read[key]
        return self._asked[id(problem)][1]

    def _recordings(self, spec: MeasurementSpec) -> Recordings:
        """Rows of the files, read once for all ranges that are cut out of them."""
        rules = ("range", "points", "sign", "zero", "toe", "displacement_zero", "direction",
                 "branch", "cycle")  # fmt: skip
        key = digest({k: v for k, v in spec.as_dict().items() if k not in rules})
        if key not in self._recorded:
            self._recorded[key] = read_recordings(spec, self.root)
        return self._recorded[key]


@dataclass(frozen=True)
class FitJob:
    """One fit: its problem, its data, and the fit that gives its start values."""

    problem: FitProblem
    #: The averaged curves that it is fitted to.
    measured: tuple[Curve, ...]
    #: Outcome of the fit that starts it, or whose residuals are resampled, once that is done.
    begun: FitResult | None = None
    #: Seed and number of a fit to the resampled residuals of its start.
    noise: tuple[int, int] | None = None
    start: FitJob | None = None
    label: str = ""
    key: str = ""
    #: Fits to the specimens of a block, which begin with one solution and stay with one worker;
    #: empty in closed form, and of resampled residuals, which may be too many for one.
    group: str = ""

    @property
    def needs(self) -> tuple[str, ...]:
        """Key of the fit that it waits for."""
        return () if self.start is None else (self.start.key,)

    def sent(self, outcomes: Mapping[str, FitResult]) -> FitJob:
        """Copy for a worker, complete in itself."""
        return replace(self, start=None, begun=next(iter(outcomes.values()), None))

    def resampled(self, seed: int, number: int) -> FitJob:
        """Make the fit to resampled residuals of this one."""
        key = digest([self.key, "noise", seed, number], 32)
        return replace(self, key=key, start=self, noise=(seed, number), group="")

    @property
    def chain(self) -> tuple[FitJob, ...]:
        """The fits before this one, the first one first, and itself."""
        return (self,) if self.start is None else (*self.start.chain, self)


@dataclass(frozen=True)
class ScorePair:
    """What is fitted and what is scored; with ``swap`` a case has two, each other's reverse."""

    #: Which of the block's curves is scored, for example ``"B"``.
    label: str
    #: The scored curve; None in a study of simulations alone.
    measured: Curve | None
    #: The fit that gives the constants; None where they are given.
    fit: FitJob | None
    #: ``"score"``, ``"fit"`` where the scored curve is the fitted one, or ``"constants"`` where
    #: nothing is scored: the fit to the specimen's own curve, whose score is held out.
    role: str = "score"
    fit_label: str = ""
    #: Standard deviation of the averaged repeats at each point.
    scatter_N: tuple[float, ...] | None = None  # noqa: N815
    #: Displacement of the test where nothing was measured.
    pressed_mm: float = 0.0

    @property
    def fit_key(self) -> str | None:
        """Name of the fit that gives the constants."""
        return None if self.fit is None else self.fit.key

    @property
    def depth_mm(self) -> float:
        """How far the curve is predicted: to the largest measured displacement."""
        if self.measured is None:
            return self.pressed_mm
        return float(self.measured.displacement_mm.max())

    @property
    def identity(self) -> list[object]:
        """Plain values that decide what the prediction is compared with."""
        against = self.measured
        if against is None:
            return [self.label, self.pressed_mm]
        return [self.label, self.fit_label, self.fit_key, against.name]


@dataclass(frozen=True)
class CaseJob:
    """One case and the fits that it needs."""

    case: Case
    directions: tuple[ScorePair, ...]
    #: Name of everything that decides the record.
    input_hash: str
    #: Where the predicted curves come from.
    forward: Forward = "simulation"
    #: Why it is computed besides the cells of the design.
    origin: Origin = field(default_factory=Origin)
    #: Cell whose cases share a solution to start from; empty where none is shared.
    group: str = ""
    #: The fit that gives the constants of that solution (see ``finite_element``).
    anchor: FitJob | None = None

    #: Name of the study, and unit of every response that the record holds.
    study: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    #: Outcomes of its fits by their keys, once they are done.
    outcomes: Mapping[str, FitResult] = field(default_factory=dict)

    def sent(self, outcomes: Mapping[str, FitResult]) -> CaseJob:
        """Copy for a worker, complete in itself: it needs of each fit its name and outcome."""

        def bare(fit: FitJob | None) -> FitJob | None:
            return fit and replace(fit, measured=(), start=None)

        pairs = tuple(replace(pair, fit=bare(pair.fit)) for pair in self.directions)
        return replace(self, directions=pairs, anchor=bare(self.anchor), outcomes=outcomes)

    @property
    def scored(self) -> tuple[ScorePair, ...]:
        """Directions whose curves are predicted and scored."""
        return tuple(pair for pair in self.directions if pair.role != CONSTANTS)

    @property
    def identified(self) -> tuple[ScorePair, ...]:
        """Directions that give the constants: the specimen's own where its score is held out."""
        apart = tuple(pair for pair in self.directions if pair.role == CONSTANTS)
        return apart or self.directions

    @property
    def depth_mm(self) -> float:
        """Largest measured displacement of its directions."""
        return max(pair.depth_mm for pair in self.directions)

    @property
    def fits(self) -> tuple[FitJob, ...]:
        """The fits that it waits for, each once."""
        every = (self.anchor, *(pair.fit for pair in self.directions))
        return tuple({fit.key: fit for fit in every if fit is not None}.values())

    @property
    def needs(self) -> tuple[str, ...]:
        """Keys of these fits."""
        return tuple(fit.key for fit in self.fits)

    def outcome(self, pair: ScorePair) -> FitResult | None:
        """Outcome of the fit of a direction; None where the constants are given."""
        return None if pair.fit is None else self.outcomes[pair.fit.key]

    @property
    def shared(self) -> Anchor | None:
        """Name of the shared solution and its constants; None where they could not be fitted."""
        if not self.group or self.anchor is None:
            return Anchor(self.group) if self.group else None
        fit = self.outcomes[self.anchor.key]
        return Anchor(self.group, fit.constants) if fit.usable else None

    def record(
        self,
        status: str,
        message: str = "",
        responses: Mapping[str, ResponseDocument] = MappingProxyType({}),
        extra: Mapping[str, object] = MappingProxyType({}),
        seconds: Mapping[str, float] = MappingProxyType({}),
    ) -> Record:
        """Record of the case: of its responses those that are given, the others missing."""
        case = self.case
        lacking: dict[str, ResponseDocument] = {
            name: {"value": None, "unit": unit} for name, unit in self.units.items()
        }
        return Record(
            case.case_id, self.study, case.levels, case.block, status, message,
            {name: responses.get(name, none) for name, none in lacking.items()},
            timings=seconds, versions=versions(), input_hash=self.input_hash,
            extra={**self.origin.to_json(), **extra},
        )  # fmt: skip


def fits_of(jobs: Iterable[CaseJob]) -> dict[str, FitJob]:
    """Every fit that some cases need, by its key, with those that give start values first."""
    by_key: dict[str, FitJob] = {}
    for job in jobs:
        for fit in job.fits:
            for link in fit.chain:
                by_key.setdefault(link.key, link)
    starts = {fit.start.key for fit in by_key.values() if fit.start is not None}
    return dict(sorted(by_key.items(), key=lambda item: item[0] not in starts))


def repeated(case: Case, way: Sequence[object], cell: Cell | None = None) -> Case:
    """Copy a case that repeats it in some way; its name is made of the case's and of the way."""
    return replace(case, cell=cell or case.cell, case_id=case_id([case.case_id, *way]))


def varied(case: Case, cell: Cell, purpose: str, named: Config | None = None) -> Case:
    """Copy a case with another cell; its name is made of its document and of the purpose."""
    document = named or cell.document()
    name = case_id({**document, "block": case.block, "purpose": purpose})
    return replace(case, cell=cell, case_id=name)


# Cross-validation: which curve a score is held out from, and the fit that did not see it.
#
# A model with more constants fits the curve that it was fitted to at least as well, whatever the
# truth. Under a truth of two constants a model of five is the better one in 100 % of simulated
# studies that score the curve fitted, and in 11 % of those that score other specimens. A study
# that would score the curve fitted is therefore cross-validated over its blocks (Stone 1974, J. R.
# Stat. Soc. B 36, 111).

#: fewest blocks of which one is held out: of two, one specimen would stand for all others
FEWEST_BLOCKS = 3


def held_out(
    leave_out: str | None,
    fit: Selection | None,
    score: Selection | None,
    blocks: int,
    *,
    other_test: bool,
) -> str | None:
    """Say what is left out of the fit that a curve is scored with."""
    if leave_out is not None:
        return None if leave_out == calibration_NOTHING else leave_out
    sees_the_scored = not other_test and dict(fit or {}) == dict(score or fit or {})
    return "specimen" if sees_the_scored and blocks >= FEWEST_BLOCKS else None


def _without_specimen(
    case: Case, problem: FitProblem, scored: Measurements, data: DataCache
) -> list[ScorePair]:
    """Every scored curve of a specimen, with the fit to all other specimens."""
    calibrated = data.calibrated(case.cell)
    fitted = scored if calibrated is None else calibrated
    others = [block for block in fitted.blocks if block != case.block]
    if not others or case.block is None:
        rule = "leaves one specimen out, but the measurements have fewer than two blocks"
        mend = "name the column of the specimens in measurements.block"
        raise InputError(Fault("calibration.leave_out", rule, mend))
    pairs = []
    for fit_where, score_where in scored.sides:
        where = fit_where if calibrated is None else calibrated.spec.fit
        curves = [_test(fitted, block, where).curve for block in others]
        test = _test(scored, case.block, score_where)
        pairs.append(_pair(case, problem, test, score_where, curves, f"all but {case.block}"))
    return pairs


def _without_test(case: Case, scored: Measurements, data: DataCache) -> ScorePair:
    """Scored curve of a test, with the fit to all other tests of the study."""
    name = case.problem.test_name
    others = [tested(test) for test in data.tests if test.test_name != name]
    if not others:
        rule = "leaves one test out, but the design has only one"
        mend = "make the tests a factor: presets with test and measurements"
        raise InputError(Fault("calibration.leave_out", rule, mend))
    curves = []
    for other in others:
        measured = data.scored(other)
        if measured is None:
            raise InputError(Fault("measurements", "are missing for one of the tests"))
        curves.append(_test(measured, case.block, measured.spec.fit).curve)
    where = scored.spec.score or scored.spec.fit
    test = _test(scored, case.block, where)
    return _pair(case, together(case.cell, others), test, where, curves, "all other tests")


def score_pairs(
    case: Case, problem: FitProblem, data: DataCache, with_scores: bool, with_constants: bool
) -> list[ScorePair]:
    """Say what is fitted and what is scored in a case."""
    if not isinstance(case.problem, CellProblem):
        return [ScorePair("all", None, None)]
    cell, scored = case.cell, data.scored(case.problem)
    if scored is None:
        return [_simulated(case, problem)]
    kind = None  # a study of constants alone fits each curve by itself
    if problem.method != "none" and (cell.leave_out is not None or with_scores):
        other = cell.fitted_elsewhere is not None
        kind = held_out(
            cell.leave_out, scored.spec.fit, scored.spec.score, len(scored.blocks), other_test=other
        )
    if kind is None:
        return _fitted_pairs(case, problem, scored, data)
    if kind != "specimen":
        return [_without_test(case, scored, data)]
    pairs = _without_specimen(case, problem, scored, data)
    if with_constants:
        # those of all other specimens would differ less between specimens than these do
        alone = _fitted_pairs(case, problem, scored, data)[0]
        pairs.append(replace(alone, role=CONSTANTS, fit_label=f"{case.block} alone"))
    return pairs


def _simulated(case: Case, problem: FitProblem) -> ScorePair:
    """Prediction that nothing was measured beside."""
    depth, marked = case.problem.depth_mm, case.problem.markers
    if marked is not None and case.block is not None:  # each state is a block
        depth = marked.state(case.block).displacement_mm
    if problem.method != "none" or depth is None:
        rule = "there is none to fit the constants to, nor to say how far the test goes"
        mend = "add it, or give [material] its constants and [test] its displacement"
        raise InputError(Fault("measurements", rule, mend))
    return ScorePair("all", None, None, pressed_mm=float(depth))


def _fitted_pairs(
    case: Case, problem: FitProblem, scored: Measurements, data: DataCache
) -> list[ScorePair]:
    """Pairs whose constants are given, or come from the curves that the study file selects."""
    given, other = problem.method == "none", data.calibrated(case.cell)
    if given or other is not None:
        curves = [] if given or other is None else [_test(other, case.block, other.spec.fit).curve]
        return [_pair(case, problem, scored.pairs(case.block)[0][1], scored.spec.score, curves)]
    out = []  # with ``swap`` fit and score also change places
    pairs = zip(scored.pairs(case.block), scored.sides, strict=True)
    for (fitted, test), (fit_where, score_where) in pairs:
        role, label = "fit" if fit_where == score_where else "score", _label(fit_where)
        out.append(_pair(case, problem, test, score_where, [fitted.curve], label, role))
    return out


def _test(measured: Measurements, block: str | None, where: Selection | None) -> MeasuredTest:
    """Test of a block; the only one where the measurements have none."""
    return measured.curve(None if measured.spec.block is None else block, **dict(where or {}))


def _pair(
    case: Case,
    problem: FitProblem,
    test: MeasuredTest,
    where: Selection | None,
    curves: Sequence[Curve],
    fit_label: str = "all",
    role: str = "score",
) -> ScorePair:
    """Score of a test, with the fit to some curves; without them its constants are given."""
    fit = fit_job(problem, tuple(curves), case.label) if curves else None
    scatter = None if test.scatter_N is None else tuple(test.scatter_N.tolist())
    return ScorePair(_label(where), test.curve, fit, role, fit_label, scatter)


def _label(where: Selection | None) -> str:
    if not where:
        return "all"
    groups = [[v] if isinstance(v, (str, float, int)) else v for v in where.values()]
    return " ".join("+".join(map(str, group)) for group in groups)


def fit_job(problem: FitProblem, measured: tuple[Curve, ...], label: str) -> FitJob:
    """Make a fit and those that give its start values."""
    before = start_problem(problem)
    start = None if before is None else fit_job(before, measured, label)
    key = fit_key(problem, measured)
    simulated = any(test.method == "inverse-fem" for test in problem.tests)
    group = digest([label, [test.name for test in problem.tests]], 32) if simulated else ""
    return FitJob(problem, measured, start=start, label=label, key=key, group=group)
