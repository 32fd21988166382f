"""Constants of a material from measured tests."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from study.api.folders import data_root
from study.design.load import load_calibration
from study.errors import Fault, InputError
from study.record.atomic_files import write_atomic
from study.reporting.figure.curves.fit import FitPanel, fit_figure
from study.runner import provenance
from study.runner.calibration.calibrate import calibrate as run_calibration
from study.runner.calibration.model_selection import choose

if TYPE_CHECKING:
    from study.runner.calibration.model_selection import EnergyChoice
    from study.runner.calibration.result import CalibrationResult
    from study.runner.fitting.staged_fit import Step


def calibrate(
    source: str | Path,
    *,
    data: str | Path | None = None,
    overrides: Sequence[str] = (),
    results: Path | None = None,
    progress: Callable[[Step], None] | None = None,
    profiles: bool = False,
) -> CalibrationResult:
    """Find material constants from one or several measured tests.

    Parameters
    ----------
    source : str or Path
        Calibration file.
    data : str or Path, optional
        Folder of the measurements.
    overrides : sequence of str
        ``key=value`` each, laid over the file before it is validated.
    results : Path, optional
        Where accepted iterations are kept while it runs (an interrupted calibration goes on
        from there), and the document and the figure in the end; nothing is written without.
    progress : callable, optional
        Gets every accepted iteration.
    profiles : bool
        Whether profile-likelihood intervals are computed.

    Returns
    -------
    CalibrationResult
        Constants with intervals, stability, residuals and how the search ended.

    Raises
    ------
    InputError
        For a faulty file or faulty data.
    """
    config = load_calibration(source, overrides)
    if config["calibration"]["method"] == "analytic":
        rule = "analytic gives one modulus a curve, not the constants of an energy"
        raise InputError(Fault("calibration.method", rule, "call study.indentation_modulus"))
    config = provenance.located(config, provenance.folders(source, data_root(source, data)))
    folder = None if results is None else results / config["name"]
    found = run_calibration(
        config, data_root(source, data), progress=progress, profiles=profiles, folder=folder
    )
    if folder is not None:
        save_calibration(found, folder)
    return found


def choose_energy(
    source: str | Path,
    *,
    data: str | Path | None = None,
    overrides: Sequence[str] = (),
    progress: Callable[[Step], None] | None = None,
) -> EnergyChoice:
    """Fit every energy to the tests of a calibration and weigh them by AICc.

    Raises
    ------
    InputError
        For a faulty file or faulty data.
    """
    config = load_calibration(source, overrides)
    return choose(config, data_root(source, data), progress=progress)


def save_calibration(found: CalibrationResult, folder: Path) -> tuple[Path, Path]:
    """Write the document and the figure of a calibration; returns both paths."""
    folder.mkdir(parents=True, exist_ok=True)
    document, figure = folder / "calibration.json", folder / "calibration.svg"
    text = json.dumps(found.to_json(), indent=2, allow_nan=False)
    write_atomic(document, text.encode())
    write_atomic(figure, calibration_figure(found).encode())
    return document, figure


def calibration_figure(found: CalibrationResult) -> str:
    """Every measured curve with its fit, as SVG."""
    panels = [
        FitPanel(
            curve.file if curve.specimen is None else f"{curve.file}, {curve.specimen}",
            curve.role == "fit",
            curve.measured.curve.displacement_mm,
            curve.measured.curve.force_N,
            None
            if curve.predicted is None
            else curve.predicted.force_at(curve.measured.curve.displacement_mm),
            curve.measured.scatter_N,
        )
        for curve in found.curves
    ]
    return fit_figure(panels, f"{found.name}: {found.model}, {found.status}")
