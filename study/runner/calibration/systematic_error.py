"""Errors that all points of one test share, as changes of the constants that it gives.

A fit's covariance knows the scatter of its points alone. A load cell's zero and the mesh shift
a whole curve, and with it the constants, by more than that scatter admits.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from study.arrays import Array
from study.calibration.fit import Fit
from study.design.sections.calibration_design import CalibrationDesign
from study.errors import Fault, InputError, RefusedError
from study.runner.calibration.calibrate import calibrate
from study.runner.calibration.measured_tests import in_order, problem_of, read_tests
from study.runner.calibration.result import CalibrationResult
from study.runner.fitting.staged_fit import Progress
from study.runner.tables import on_mesh

#: of the mesh sizes of neighboring names, and of the meshes whose constants are compared
_RATIO = 1.5


def zero_error(config: CalibrationDesign, root: Path, found: Fit, zero: float) -> Array:
    """Change of the constants by a shift of all forces of one test.

    Parameters
    ----------
    config : CalibrationDesign
        Calibration of this test alone.
    root : Path
        Data root.
    found : Fit
        Its converged fit.
    zero : float
        Standard uncertainty of the force's zero, over the largest force.

    Returns
    -------
    ndarray, shape (p,)
        MPa (exponents plain); first order, at the fitted constants.
    """
    curves = in_order(read_tests(config.tests, root)[0])
    rows, shifts = [], []
    for measured, predicted in zip(curves, found.curves, strict=True):
        curve, weight = measured.measured.curve, np.asarray(measured.weight)
        slopes = predicted.gradients_at(found.names, curve.displacement_mm)
        rows.append((weight * slopes.T).T)
        shifts.append(weight * np.full(len(curve), zero * np.abs(curve.force_N).max()))
    jacobian = np.concatenate(rows)
    scale = np.linalg.norm(jacobian, axis=0)
    shift = np.linalg.lstsq(jacobian / scale, np.concatenate(shifts), rcond=None)[0]
    return np.asarray(shift / scale)


def mesh_error(
    config: CalibrationDesign,
    root: Path,
    found: CalibrationResult,
    progress: Progress | None = None,
) -> Array:
    """Error that the mesh leaves in the constants of one test, from a second, coarser mesh.

    Constants move with the first power of the mesh size where an edge or a bonded corner makes
    the stress singular, so that of the change between two meshes of ratio r, change / (r - 1) is
    left; for smooth solutions that is more than there is.

    Parameters
    ----------
    config : CalibrationDesign
        Calibration of this test alone.
    root : Path
        Data root.
    found : CalibrationResult
        Its converged fit.
    progress : callable, optional
        Gets every accepted iteration.

    Returns
    -------
    ndarray, shape (p,)
        MPa (exponents plain); zero where the test is answered in closed form.

    Raises
    ------
    InputError
        If the mesh is the coarsest there is.
    RefusedError
        If the coarser mesh gives no constants.
    """
    coarser = _coarser(config)
    if coarser is None:
        return np.zeros_like(found.fit.values)
    # from the same minimum: the distance to another one is no error of the mesh
    other = calibrate(coarser, root, progress=progress, begin=found.fit.constants())
    if not other.converged:
        raise RefusedError("a coarser mesh gives no constants to tell the mesh's error from: "
                           "take a finer mesh")  # fmt: skip
    return np.asarray((found.fit.values - other.fit.values) / (_RATIO - 1))


def _coarser(config: CalibrationDesign) -> CalibrationDesign | None:
    """Calibration of one test on a mesh that is coarser; None where there is no mesh."""
    (test,) = config.tests
    if problem_of(test.tables).method != "inverse-fem":
        return None
    coarser = test.setup.model.coarser(_RATIO)
    if coarser is None:
        mend = 'write mesh = "medium" or "fine" in [model]'
        raise InputError(Fault("model.mesh", "none is coarser, to tell its error from", mend))
    mesh = {"mesh": coarser.mesh, "mesh_size_mm": coarser.mesh_size_mm}
    return replace(config, tests=(replace(test, tables=on_mesh(test.tables, **mesh)),))
