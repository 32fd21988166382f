"""Calibration of one material, choice between energies, and their files."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from study.api.places import data_root

if TYPE_CHECKING:
    from study.runner.calibration_result import CalibrationResult
    from study.runner.energies import EnergyChoice
    from study.runner.staged import Step


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
    results : Path, optional
        Where accepted iterations are kept while it runs (an interrupted calibration goes on
        from there), and the document and the figure in the end; nothing is written without.
    progress : callable, optional
        Gets every accepted iteration.
    profiles : bool
        Whether profile-likelihood intervals are computed.

    Raises
    ------
    InputError
        For a faulty file or faulty data.
    """
    from study.design import load_calibration
    from study.runner import surfaces
    from study.runner.calibrate import calibrate as run_calibration

    config = load_calibration(source, overrides)
    config = surfaces.located(config, surfaces.folders(source, data_root(source, data)))
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
    from study.design import load_calibration
    from study.runner.energies import choose

    config = load_calibration(source, overrides)
    return choose(config, data_root(source, data), progress=progress)


def save_calibration(found: CalibrationResult, folder: Path) -> tuple[Path, Path]:
    """Write the document and the figure of a calibration; returns both paths."""
    from study.record.files import write_atomic

    folder.mkdir(parents=True, exist_ok=True)
    document, figure = folder / "calibration.json", folder / "calibration.svg"
    text: Any = json.dumps(found.to_json(), indent=2, allow_nan=False)
    write_atomic(document, text.encode())
    write_atomic(figure, calibration_figure(found).encode())
    return document, figure


def calibration_figure(found: CalibrationResult) -> str:
    """Every measured curve with its fit, as SVG."""
    from study.reporting.figures_fit import FitPanel, fit_figure

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
