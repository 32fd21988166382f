"""Constants of one test to first order around those of all tests (Rao's form of a test).

Where an exponent is hardly known from one test alone, its sum of squares is no parabola: slopes
at that test's own minimum are not those at the truth, and Wald's statistic rejects the same
material too often. If one set of constants explains all tests, then the common estimate is near
the truth, and so are the slopes there (Rao 1948, Proc. Camb. Phil. Soc. 44, 50). One step of
Gauss and Newton from it is a fit of the model made linear there, with that fit's covariance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from study.arrays import Array
from study.calibration.fit import Fit, fit
from study.calibration.influence import with_serial_correlation
from study.curve import Curve
from study.design.sections.calibration_design import CalibrationDesign
from study.runner.calibration.measured_tests import in_order, parts_of, read_tests
from study.runner.fitting import fit_task


def linearized_fit(config: CalibrationDesign, root: Path, common: Mapping[str, float]) -> Fit:
    """Fit one test with the slopes at the constants that all tests share.

    Parameters
    ----------
    config : CalibrationDesign
        Calibration of this test alone.
    root : Path
        Data root.
    common : mapping of str to float
        Constants of all tests, MPa (exponents plain).

    Returns
    -------
    Fit
        Constants to first order around the common ones, with errors from the recorded rows.

    Raises
    ------
    EvaluationFailed
        If the model has no answer at the common constants.
    """
    names, center = tuple(common), np.array(list(common.values()), float)
    parts = parts_of(config.tests, in_order(read_tests(config.tests, root)[0]))
    measured = [one for part in parts for one in part.measured]
    base = [
        _at_points(curve, one.curve, names)
        for part in parts
        for curve, one in zip(
            fit_task.model(part.method, part.tables, [m.curve for m in part.measured], names)(
                center
            ),
            part.measured,
            strict=True,
        )
    ]

    def predict(values: Array) -> list[Curve]:
        moved = dict(zip(names, values - center, strict=True))
        return [
            replace(one, force_N=one.force_N + sum(moved[n] * one.force_gradient[n] for n in names))
            for one in base
        ]

    return with_serial_correlation(fit(predict, measured, names, center), measured)


def _at_points(predicted: Curve, measured: Curve, names: tuple[str, ...]) -> Curve:
    """Force and gradient at the measured points, where a line is all that is needed."""
    d = measured.displacement_mm
    slopes = dict(zip(names, predicted.gradients_at(names, d).T, strict=True))
    return Curve(d, predicted.force_at(d), force_gradient=slopes, time_s=predicted.time_s)
