"""The jobs of a study: its measurements, cases and fits, as values that know what they need."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path

from study.canonical import digest
from study.curve import Curve
from study.design.sections.content import case_id
from study.design.spec import Case, Design
from study.measurement import plausibility
from study.measurement.conditioning import is_caution
from study.measurement.measured_test import Measurements
from study.measurement.reading import read_measurements
from study.measurement.recording import Recordings, read_recordings
from study.measurement.section import MeasurementSpec
from study.record.table import is_repeat
from study.runner import provenance
from study.runner.case_task import CONSTANTS, Forward, Origin
from study.runner.fitting.external_model import NOTHING, Allowed
from study.runner.fitting.fit_problem import FitProblem, fit_key
from study.runner.tables import CalibrationTable, gauge_of, measurements_of
from study.setup.setup import Setup, Tables

#: ends in the name of the file that says how virtual measurements were made
TRUTH_SUFFIX = ".virtual.json"


class DataCache:
    """Measured tests of a study.

    Parameters
    ----------
    root : Path
        Folder of the measured files.
    tests : sequence of mapping
        The different specimens, tests and measurements of the study.
    """

    def __init__(self, root: Path, tests: Sequence[Tables] = ()) -> None:
        self.root, self.tests = root, tests
        self._read: dict[str, Measurements] = {}
        self._recorded: dict[str, Recordings] = {}
        # what was asked for already, by the specification itself, which is kept so that its
        # identity stays its own
        self._asked: dict[tuple[object, ...], tuple[object, Measurements]] = {}

    def scored(self, tables: Tables) -> Measurements | None:
        """Measurements that a case is scored on."""
        return self._get(tables)

    def calibrated(self, tables: Tables) -> Measurements | None:
        """Measurements that only the calibration uses."""
        own = CalibrationTable.of(tables).problem
        if not own or own.get("measurements") == tables.get("measurements"):
            return None
        return self._get(own)

    def notes(self) -> tuple[str, ...]:
        """Count what every rule did to the data, each once."""
        return tuple(dict.fromkeys(n for found in self._read.values() for n in found.notes))

    def files(self) -> dict[str, str]:
        """Name of each file read and its sha256."""
        return {name: sha for found in self._read.values() for name, sha in found.files.items()}

    def _get(self, tables: Tables) -> Measurements | None:
        spec, made = tables.get("measurements"), measurements_of(tables)
        if made is None:
            return None
        setup = Setup.of(tables)
        asked = (id(spec), setup.height_mm, setup.test.displacement_mm, gauge_of(setup))
        if asked not in self._asked:
            self._asked[asked] = (spec, self._conditioned(made, setup))
        return self._asked[asked][1]

    def _conditioned(self, made: MeasurementSpec, setup: Setup) -> Measurements:
        height, depth, gauge = setup.height_mm, setup.test.displacement_mm, gauge_of(setup)
        key = digest([made.as_dict(), height, depth, None if gauge is None else asdict(gauge)])
        if key not in self._read:
            rows = self._recordings(made)
            found = read_measurements(made, self.root, height, depth, gauge, rows)
            self._read[key] = plausibility.checked(found, setup)
        return self._read[key]

    def _recordings(self, spec: MeasurementSpec) -> Recordings:
        """Rows of the files, read once for all ranges that are cut out of them."""
        rules = ("range", "points", "sign", "zero", "toe")
        key = digest({k: v for k, v in spec.as_dict().items() if k not in rules})
        if key not in self._recorded:
            self._recorded[key] = read_recordings(spec, self.root)
        return self._recorded[key]


@dataclass(frozen=True)
class FitJob:
    """One fit: its problem, its data, and the fit that gives its start values.

    ``noise`` is the seed and the number of a fit to the resampled residuals of its start.
    """

    key: str
    problem: FitProblem
    measured: tuple[Curve, ...]
    start: FitJob | None = None
    label: str = ""
    noise: tuple[int, int] | None = None

    @classmethod
    def of(
        cls, problem: FitProblem, measured: tuple[Curve, ...], start: FitJob | None, label: str
    ) -> FitJob:
        """Make a fit with the name of its content."""
        return cls(fit_key(problem, measured), problem, measured, start, label)

    def resampled(self, seed: int, number: int) -> FitJob:
        """Make the fit to resampled residuals of this one."""
        key = digest([self.key, "noise", seed, number], 32)
        return replace(self, key=key, start=self, noise=(seed, number))

    @property
    def chain(self) -> tuple[FitJob, ...]:
        """The fits before this one, the first one first, and itself."""
        return (self,) if self.start is None else (*self.start.chain, self)


@dataclass(frozen=True)
class ScorePair:
    """What is fitted and what is scored; with ``swap`` a case has two, each other's reverse.

    Parameters
    ----------
    label : str
        Which of the block's curves is scored, for example ``"B"``.
    measured : Curve or None
        The scored curve; None in a study of simulations alone.
    fit : FitJob or None
        The fit that gives the constants; None where they are given.
    role : str
        ``"score"``, ``"fit"`` where the scored curve is the fitted one, or ``"constants"`` where
        nothing is scored: the fit to the specimen's own curve, whose score is held out.
    fit_label : str
        Which curve gave the constants.
    scatter_N : tuple of float or None
        Standard deviation of the averaged repeats at each point.
    pressed_mm : float
        Displacement of the test where nothing was measured.
    """

    label: str
    measured: Curve | None
    fit: FitJob | None
    role: str = "score"
    fit_label: str = ""
    scatter_N: tuple[float, ...] | None = None  # noqa: N815
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
    """One case and the fits that it needs.

    Parameters
    ----------
    case : Case
        The cell in its block.
    directions : tuple of ScorePair
        What is fitted and scored.
    input_hash : str
        Name of everything that decides the record.
    forward : str
        Where the predicted curves come from.
    origin : Origin
        Why it is computed besides the cells of the design.
    group : str
        Cell whose cases share a solution to start from; empty where none is shared.
    anchor : FitJob or None
        The fit that gives the constants of that solution (see
        :mod:`study.forward.finite_element`).
    """

    case: Case
    directions: tuple[ScorePair, ...]
    input_hash: str
    forward: Forward = "simulation"
    origin: Origin = field(default_factory=Origin)
    group: str = ""
    anchor: FitJob | None = None

    @property
    def predictions(self) -> int:
        """Number of curves that are predicted and scored."""
        return sum(pair.role != CONSTANTS for pair in self.directions)

    @property
    def depth_mm(self) -> float:
        """Largest measured displacement of its directions."""
        return max(pair.depth_mm for pair in self.directions)

    @property
    def fits(self) -> tuple[FitJob, ...]:
        """The fits that it waits for, each once."""
        found = (self.anchor, *(pair.fit for pair in self.directions))
        return tuple({fit.key: fit for fit in found if fit is not None}.values())

    @property
    def needs(self) -> tuple[str, ...]:
        """Keys of its fits."""
        return tuple(fit.key for fit in self.fits)


@dataclass(frozen=True)
class Work:
    """Everything that a study computes.

    Parameters
    ----------
    design : Design
        The study.
    jobs : tuple of CaseJob
        One for every case, in the order of the design.
    responses : mapping of str to str
        Unit of every response that a record holds.
    blocks : tuple of str
        Labels of the blocks.
    data : DataCache
        The measurements, each specification read once.
    allowed : Allowed
        What may be used besides this package.
    """

    design: Design
    jobs: tuple[CaseJob, ...]
    responses: Mapping[str, str]
    blocks: tuple[str, ...]
    data: DataCache
    allowed: Allowed = NOTHING

    @cached_property
    def fits(self) -> dict[str, FitJob]:
        """Every fit by its key, those that give start values included."""
        return fits_of(self.jobs)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was done to the measurements."""
        return self.data.notes()

    @property
    def cautions(self) -> tuple[str, ...]:
        """What was done to measurements and surfaces that may not be what they seem."""
        mended = provenance.surface_notes([job.case.config for job in self.jobs])
        return (*(note for note in self.notes if is_caution(note)), *mended)

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
        own = [job for job in self.jobs if not is_repeat(job.origin.to_json())]
        return replace(self, jobs=tuple(own))

    @property
    def input_hashes(self) -> dict[str, str]:
        """Case id -> hash of everything that decides its record."""
        return {job.case.case_id: job.input_hash for job in self.jobs}


def fits_of(jobs: Iterable[CaseJob]) -> dict[str, FitJob]:
    """Every fit that some cases need, by its key, with those that give start values first.

    Parameters
    ----------
    jobs : iterable of CaseJob
        Cases; the fits of their anchors and the start of each fit count too.
    """
    found: dict[str, FitJob] = {}
    for job in jobs:
        for fit in job.fits:
            for one in fit.chain:
                found.setdefault(one.key, one)
    starts = {fit.start.key for fit in found.values() if fit.start is not None}
    return dict(sorted(found.items(), key=lambda item: item[0] not in starts))


def repeated(case: Case, way: Sequence[object], tables: Tables | None = None) -> Case:
    """Copy a case that repeats it in some way; its name is made of the case's and of the way.

    Parameters
    ----------
    case : Case
        What is repeated.
    way : sequence
        Plain values for the name, such as ``["noise", 1]``.
    tables : mapping, optional
        Document that is computed; by default that of the case. It does not enter the name.
    """
    config = case.config if tables is None else dict(tables)
    return replace(case, config=config, case_id=case_id([case.case_id, *way]))


def varied(case: Case, tables: Tables, purpose: str) -> Case:
    """Copy a case with other tables; its name is made of them and of the purpose.

    Parameters
    ----------
    case : Case
        Where the copy has its treatment and its block from.
    tables : mapping
        Document that is computed.
    purpose : {"refinement", "input"}
        As of :class:`study.runner.case_task.Origin`.
    """
    name = case_id({**tables, "block": case.block, "purpose": purpose})
    return replace(case, config=dict(tables), case_id=name)
