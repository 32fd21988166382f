"""The measured tests of a calibration: read, weighted, chosen, and made into parts of a fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from study.ground.arrays import Array, gathered
from study.ground.curve import Curve
from study.ground.errors import Fault, InputError
from study.ground.units import times
from study.mechanics.calibration.residual_function import LOSS_LIMIT, MeasuredCurve
from study.mechanics.calibration.serial_correlation import row_noise
from study.mechanics.forward.contact_law import Layer
from study.mechanics.indentation.indentation_modulus import IndentationTest
from study.mechanics.measurement.measured_test import MeasuredTest, checked
from study.mechanics.measurement.reading import read_measurements
from study.mechanics.setup.calibration_table import Fitting, Loss
from study.mechanics.setup.geometry import Block, Cylinder, Sphere
from study.simulation.calibration.calibration_file import (
    OFFSET,
    CalibratedTest,
    NuisanceInput,
    Role,
)
from study.simulation.fit_task import FitPart
from study.simulation.job import fitted_test
from study.simulation.response import CURVE_RESPONSES, residual_N

#: ratio of the largest forces of two fitted tests from which equal weights hide the smaller
_UNEVEN = 5.0


@dataclass(frozen=True, kw_only=True)
class FitCurve(MeasuredCurve):
    """One measured curve of a calibration, with its prediction where there is a fit."""

    #: Place of its test among those of the calibration.
    test: int
    file: str
    #: Label of the specimen, where the file has several.
    specimen: str | None
    #: Mean and scatter of its repeats.
    measured: MeasuredTest
    role: Role
    #: None where the model has no answer.
    predicted: Curve | None = None
    message: str = ""

    def as_dict(self) -> dict[str, object]:
        """Errors of the prediction in N, in % of the RMS force and as R2; rows."""
        names = ("rms_force_error", "relative_rms_force_error", "r_squared")
        errors: dict[str, float | None] = dict.fromkeys(names)
        if self.predicted is not None:
            for name in names[:2]:
                errors[name] = CURVE_RESPONSES[name](self.predicted, self.curve)
            force, left = self.curve.force_N, residual_N(self.predicted, self.curve)
            total = float(((force - force.mean()) ** 2).sum())
            errors["r_squared"] = 1 - float(left @ left) / total if total > 0 else None
        return {
            "file": self.file,
            "specimen": self.specimen,
            "role": self.role,
            "repeats": self.measured.n_repeats,
            **errors,
            "rows": self.measured.rows.as_dict(),
            "message": self.message,
        }


def read_tests(
    tests: Sequence[CalibratedTest], root: Path, loss: Loss = "linear"
) -> tuple[list[FitCurve], tuple[str, ...]]:
    """Read the curves of every test."""
    curves: list[FitCurve] = []
    notes: list[str] = []
    for number, test in enumerate(tests):
        problem, offset = test.problem, test.nuisance.get(OFFSET)
        data = checked(read_measurements(
            test.measurements, root, problem.height_mm, problem.depth_mm, problem.gauge,
            own_rows=True, zero_within_mm=None if offset is None else offset.reach,
        ), problem.setup)  # fmt: skip
        notes += [f"{test.file}: {note}" if len(tests) > 1 else note for note in data.notes]
        for specimen in data.blocks or (None,):
            mean = data.curve(specimen, **dict(data.spec.fit or {}))
            weight = _weight(test.weight, mean, f"tests[{number}]")
            label = test.file if specimen is None else f"{test.file}, {specimen}"
            curve = FitCurve(
                label, mean.curve, weight, directions=mean.directions,
                test=number, file=test.file, specimen=specimen, measured=mean, role=test.role,
            )  # fmt: skip
            curves.append(_with_loss(curve, loss))
    return curves, tuple(dict.fromkeys(notes))


def with_contact_offsets(
    tests: Sequence[CalibratedTest], curves: Sequence[FitCurve]
) -> tuple[CalibratedTest, ...]:
    """Let each curve whose contact was found in its rows have an offset, within that error.

    Of 20 tests with .3 % noise 18 intervals that took a contact found for exact missed the truth.
    """
    out = []
    for number, test in enumerate(tests):
        in_rows = [c for c in curves if c.test == number and c.curve.time_s is None]
        errors = [single.contact_error_mm for c in in_rows for single in c.measured.tests]
        if OFFSET not in test.nuisance and max(errors, default=0.0) > 0:
            # rows beyond contact told it and enter the fit, too: each tells it half
            error = math.sqrt(2.0) * max(errors)
            offset = NuisanceInput(error, 0.0, treat="fitted", each="curve")
            test = replace(test, nuisance={**test.nuisance, OFFSET: offset})
        out.append(test)
    return tuple(out)


def _weight(weight: float | str, measured: MeasuredTest, where: str) -> float | Array:
    """Weight of a curve: a number, or one over the noise of its points."""
    if weight == "equal":
        return 1.0
    if not isinstance(weight, str):
        return float(weight)
    noise = noise_of(measured, grows=0.0 if weight == "relative" else math.inf)
    if noise is None:
        rule = "fewer than 8 rows, or rows without noise, say nothing of their scatter"
        raise InputError(Fault(f"{where}.weight", rule, "write weight = 'equal' or a number"))
    if weight == "scatter" and measured.scatter_N is not None:
        # repeats meet by chance at some points, which must not count for everything
        floor = max(0.1 * float(np.median(measured.scatter_N)), 1e-9)
        noise = np.maximum(measured.scatter_N, floor) / math.sqrt(measured.n_repeats)
    return np.asarray(1 / noise)


def _with_loss(curve: FitCurve, loss: Loss) -> FitCurve:
    """Fitted curve whose residuals count by a loss, in units of the noise of its points."""
    if loss == "linear" or curve.role == "held-out":
        return curve
    noise = noise_of(curve.measured)
    if noise is None:
        rule = f"{curve.label}: fewer than 8 rows, or rows without noise, give the loss no limit"
        raise InputError(Fault("calibration.loss", rule, 'write loss = "linear"'))
    return replace(curve, loss=loss, limit_N=LOSS_LIMIT * noise)


def noise_of(measured: MeasuredTest, grows: float = math.inf) -> Array | None:
    """Noise of the points of a curve from differences of neighboring rows, N, shape (n,).

    It grows with a power of the force that is estimated, where that is ``grows`` standard errors
    above zero. Mean of all repeats; None where they say nothing.
    """
    recorded, deviations = measured.curve.recorded, []
    for rows in recorded:
        noise = row_noise(rows.force_N, rows.places, rows.force_N, grows=grows)
        if noise is not None:
            deviations.append(np.interp(measured.curve.places, rows.places, noise.deviation))
    return np.sqrt(np.mean(np.square(deviations), axis=0) / len(recorded)) if deviations else None


def parts_of(tests: Sequence[CalibratedTest], curves: Sequence[FitCurve]) -> list[FitPart]:
    """Parts of a fit to the given curves, one for each test that has any."""
    of_tests = sorted(gathered((curve.test, curve) for curve in curves).items())
    return [
        replace(fitted_test("auto", tests[number].problem), measured=tuple(measured))
        for number, measured in of_tests
    ]


def in_order(curves: Sequence[FitCurve]) -> list[FitCurve]:
    """Fitted curves in the order in which :func:`parts_of` gives them to the fit."""
    return sorted((c for c in curves if c.role == "fit"), key=lambda c: c.test)


def left_out(curves: Sequence[FitCurve], kind: str) -> list[tuple[str, list[FitCurve]]]:
    """Every way to leave one specimen or one test out."""
    fitted = [c for c in curves if c.role == "fit"]

    def unit(curve: FitCurve) -> str:
        return f"tests[{curve.test}]" if kind == "test" else str(curve.specimen)

    labels = list(dict.fromkeys(unit(c) for c in fitted))
    if len(labels) < 2:
        mend = "give a second [[tests]] table with role = 'fit'"
        if kind == "specimen":
            mend = "name the column of the specimens in measurements.block"
        rule = f"leaves one {kind} out, but there is only one"
        raise InputError(Fault("calibration.leave_out", rule, mend))
    return [
        (label, [replace(c, role="held-out") if unit(c) == label else c for c in fitted])
        for label in labels
    ]


def of_specimens(curves: Sequence[FitCurve]) -> dict[str, list[FitCurve]]:
    """Fitted curves of every specimen."""
    return gathered((str(c.specimen), c) for c in curves if c.role == "fit" and c.specimen)


def warnings_of(curves: Sequence[FitCurve]) -> list[str]:
    """Say where equal weights hide a test."""
    peaks = {
        c.label: float(np.max(np.abs(c.weight * c.curve.force_N)))
        for c in curves
        if c.role == "fit"
    }
    is_by_row = any(isinstance(c.weight, np.ndarray) for c in curves)
    if len(peaks) < 2 or is_by_row or max(peaks.values()) <= _UNEVEN * min(peaks.values()):
        return []
    small, large = min(peaks, key=peaks.__getitem__), max(peaks, key=peaks.__getitem__)
    ratio = peaks[large] / max(peaks[small], 1e-300)
    return [
        f"the forces of {large} are {times(ratio)} those of {small}, which hardly count at "
        "these weights: write weight = 'scatter' or a number"
    ]


def machine_notes(tests: Sequence[CalibratedTest], curves: Sequence[FitCurve]) -> list[str]:
    """Say from which stiffness on a machine in series would lower the moduli of a test by 1 %.

    A machine of stiffness K takes F / K of the displacement d, so that F(d - F / K) is fitted: to
    first order, least squares lower a modulus by the mean of F^2 dF/dd over K times that of F^2.
    """
    least: dict[str, float] = {}
    for curve in curves:
        is_machine = tests[curve.test].measurements.columns.kinematic == "displacement"
        if curve.predicted is None or curve.role != "fit" or not is_machine:
            continue
        if curve.curve.time_s is not None:  # a course that may stand still has no slope
            continue
        d = curve.curve.displacement_mm
        force = curve.predicted.force_at(d)
        slope = np.gradient(force, d)
        stiffness = float(force**2 @ slope / (force @ force))
        least[curve.file] = max(100 * stiffness, least.get(curve.file, 0.0))
    plain = partial(np.format_float_positional, precision=3, fractional=False, trim="-")
    return [
        f"{file}: displacement counts as the specimen's: frame, load cell and grips of "
        f"{plain(stiffness)} N/mm in series with it would lower moduli by 1 %, which residuals "
        "hardly show"
        for file, stiffness in least.items()
        if stiffness > 0
    ]


def indentation_test(test: CalibratedTest, fitting: Fitting, where: str) -> IndentationTest:
    """Gather what the closed form needs of one test."""
    setup = test.problem.setup
    specimen, pressed = setup.specimen, setup.test.indenter
    if not setup.kind.takes_indenter or pressed is None:
        rule = f"analytic is for indentation, got {setup.test.kind}"
        mend = 'leave calibration.method out: "auto" knows the closed form of the other tests'
        raise InputError(Fault(f"{where}.test.kind", rule, mend))
    if not isinstance(specimen, (Cylinder, Block)):
        rule = f"analytic needs a cylinder or block, got {specimen.shape}"
        raise InputError(Fault(f"{where}.specimen", rule, "its height is that of the layer"))
    if setup.test.interface == "bonded":
        rule = "analytic takes the indenter for frictionless, got bonded"
        mend = 'write interface = "frictionless", or leave calibration.method out'
        raise InputError(Fault(f"{where}.test.interface", rule, mend))
    if fitting.theory == "dimitriadis" and not isinstance(pressed, Sphere):
        rule = f"dimitriadis is a series for spheres, got {pressed.shape}"
        mend = 'write theory = "integral-equation"'
        raise InputError(Fault("calibration.theory", rule, mend))
    volume = test.problem.material.compressibility
    nu = 0.5 if volume.incompressible else volume.poisson_ratio
    if nu is None:
        rule = "the closed form needs Poisson's ratio, got bulk_modulus"
        mend = "write poisson_ratio = ..., or incompressible = true"
        raise InputError(Fault("material.bulk_modulus", rule, mend))
    return IndentationTest(
        indenter=pressed,
        layer=Layer(specimen.height_mm, nu, setup.test.base == "bonded"),
        area_mm2=specimen.area_mm2,
        spec=test.measurements,
        displacement_mm=setup.test.displacement_mm,
        theory=fitting.theory,
        paraboloid=fitting.profile == "paraboloid",
        find_contact=fitting.contact == "fitted",
        depth_limit_mm=fitting.depth_limit,
    )
