"""The jobs of a study: cases and fits, as values that cross to a worker."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from study.canonical import digest
from study.curve import Curve
from study.design.spec import Case, Design
from study.measurement.conditioning import SORTED
from study.measurement.measured_test import Measurements
from study.measurement.reading import read_measurements
from study.measurement.section import MeasurementSpec
from study.record.table import is_repeat
from study.runner import provenance
from study.runner.fitting.fit_task import FitProblem
from study.setup.setup import known_height_mm

Config = Mapping[str, Any]

#: ends in the name of the file that says how virtual measurements were made
TRUTH_SUFFIX = ".virtual.json"


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
        height, depth = known_height_mm(specimen), test.get("displacement_mm")
        made = spec if isinstance(spec, MeasurementSpec) else MeasurementSpec.from_dict(spec)
        key = digest([made.as_dict(), height, depth])
        if key not in self._read:
            self._read[key] = read_measurements(made, self.root, height, depth)
        return self._read[key]


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
    that gives the constants of that one (see :mod:`study.forward.finite_element`).
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
        mended = provenance.surface_notes([job.case.config for job in self.jobs])
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


@dataclass(frozen=True)
class Direction:
    """One way of fitting and scoring; with ``swap`` there are two, each other's reverse.

    Parameters
    ----------
    label : str
        Which of the block's curves is scored, for example ``"B"``.
    fit_label : str
        Which gave the constants.
    measured : Curve
        The scored curve.
    fit_key : str or None
        Name of the fit that gives the constants; None where they are given.
    role : str
        ``"score"``, or ``"fit"`` where the scored curve is the fitted one.
    scatter_N : list of float or None
        Standard deviation of the averaged repeats at each point.
    """

    label: str
    measured: Curve
    fit_key: str | None
    role: str = "score"
    fit_label: str = ""
    scatter_N: Sequence[float] | None = None

    def payload(self, fit: Mapping[str, Any] | None) -> dict[str, Any]:
        """Plain values for the worker."""
        return {
            "label": self.label,
            "fit_label": self.fit_label,
            "role": self.role,
            "measured": self.measured.as_dict(),
            "scatter_N": None if self.scatter_N is None else list(self.scatter_N),
            "fit_key": self.fit_key,
            "fit": None if fit is None else dict(fit),
        }
