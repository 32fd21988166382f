"""What the sensors of a test must be for constants as accurate as wanted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from study.api.folders import REPORTS, data_root
from study.reporting.output.requirement_page import warnings, write_requirement
from study.runner import provenance
from study.runner.tasks import default_jobs
from study.sensors.load import load_requirement
from study.sensors.requirement import SensorRequirement, document, sensor_requirement


@dataclass(frozen=True)
class Required:
    """What the sensors must be, and the page that says so.

    Parameters
    ----------
    requirement : SensorRequirement
        All numbers.
    page : Path
        The report.
    warnings : tuple of str
        Where first order does not hold.
    """

    requirement: SensorRequirement
    page: Path
    warnings: tuple[str, ...]

    def to_json(self) -> dict[str, object]:
        """Document of ``study require --json``."""
        found = document(self.requirement)
        return {**found, "report": str(self.page), "warnings": list(self.warnings)}


def require(
    source: str | Path,
    *,
    overrides: Sequence[str] = (),
    jobs: int | None = None,
    out: str | Path = REPORTS,
    progress: Callable[[str], None] | None = None,
) -> Required:
    """Say how uncertain sensors make constants and force, and what they must be.

    Parameters
    ----------
    source : str or Path
        A problem with its assumed constants, and tables ``[position]``, ``[force]``,
        ``[requirement]`` and ``[predict]``.
    overrides : sequence of str
        ``key=value`` each, laid over the file before it is validated.
    jobs : int, optional
        Workers of the Monte Carlo simulation; one a core by default.
    out : str or Path
        Folder of the page; made where it is missing.
    progress : callable, optional
        Gets a sentence after every part of the simulation.

    Returns
    -------
    Required
        The numbers, and the page that was written.

    Raises
    ------
    InputError
        For a faulty file; nothing is written.
    RefusedError
        If the test does not determine the constants.
    """
    file = load_requirement(source, overrides)
    places = provenance.folders(source, data_root(source))
    file = replace(
        file,
        fitted=provenance.located(file.fitted, places),
        predicted=provenance.located(file.predicted, places),
    )
    found = sensor_requirement(file, jobs or default_jobs(), progress)
    return Required(found, write_requirement(found, out), tuple(warnings(found)))
