"""Curves of a calibration as the panels of its figure."""

from __future__ import annotations

from study.reporting.figure.curves.fit import FitPanel
from study.runner.calibration.result import CalibrationResult


def panels_of(found: CalibrationResult) -> list[FitPanel]:
    """Every measured curve with its prediction.

    Parameters
    ----------
    found : CalibrationResult
        With its curves.
    """
    return [
        FitPanel(
            curve.file if curve.specimen is None else f"{curve.file}, {curve.specimen}",
            curve.role == "fit",
            curve.measured.curve.places,
            curve.measured.curve.force_N,
            None
            if curve.predicted is None
            else curve.predicted.force_at(curve.measured.curve.displacement_mm),
            curve.measured.scatter_N,
            curve.measured.curve.time_s is not None,
        )
        for curve in found.curves
    ]
