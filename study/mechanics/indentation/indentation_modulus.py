"""Median over the units of a test, with an interval that assumes no distribution."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.linalg import solve_banded
from scipy.optimize import minimize_scalar
from scipy.special import bdtr, stdtrit

from study.ground.arrays import Array, Flags
from study.ground.canonical import Keyed
from study.ground.errors import Fault, InputError, settled
from study.mechanics.forward.contact_law import (
    ContactForceLaw,
    Layer,
    ValidityLimit,
    caution,
    force_law,
    limits,
)
from study.mechanics.measurement.measured_test import SingleTest
from study.mechanics.measurement.measurement_section import MeasurementSpec
from study.mechanics.measurement.phases import RowCount
from study.mechanics.measurement.reading import first_notes, rules_of, specimens
from study.mechanics.measurement.recording import Recording, read_recordings
from study.mechanics.setup.calibration_table import Theory
from study.mechanics.setup.geometry import Indenter

LEVEL = 0.95
#: units from which order statistics hold the median in 95 %: 1 - 2 / 2^6
_MEDIAN_FROM = 6


@dataclass(frozen=True)
class MedianEstimate:
    """Middle of the moduli of independent units."""

    value_MPa: float
    #: Interval of at least 95 %.
    interval_MPa: tuple[float, float] | None
    kind: str
    units: int
    #: First and third quartile: the scatter between units.
    quartiles_MPa: tuple[float, float]


def median_estimate(
    moduli_MPa: Sequence[float], alone: tuple[float, float] | None = None
) -> MedianEstimate:
    """Median with its interval: by order statistics from six units on, Student's t below."""
    values = np.sort(np.asarray(moduli_MPa, dtype=float))
    n = values.size
    low, middle, high = (float(v) for v in np.quantile(values, [0.25, 0.5, 0.75]))
    interval: tuple[float, float] | None = alone
    kind = "of the only curve: it knows nothing of the scatter between curves"
    if n >= _MEDIAN_FROM:
        # the k-th smallest lies above the median with the chance that fewer than k lie below
        k = int(np.count_nonzero(bdtr(np.arange(n // 2), n, 0.5) <= (1 - LEVEL) / 2))
        interval, kind = (float(values[k - 1]), float(values[n - k])), "of the median"
    elif n > 1:
        half = stdtrit(n - 1, (1 + LEVEL) / 2) * values.std(ddof=1) / np.sqrt(n)
        mean = float(values.mean())
        interval, kind = (mean - float(half), mean + float(half)), "of the mean, by Student's t"
    return MedianEstimate(middle, interval, kind, n, (low, high))


# Young's modulus of one indentation curve: least squares, linear in E*; a depth of contact by
# variable projection (Golub and Pereyra 1973). The variance is that under autoregressive errors
# of first order, whose coefficient is estimated from the residuals and corrected for its bias.

Status = Literal["fitted", "outside", "implausible", "unreadable"]
#: rows in contact and within the limits that a fit needs
MIN_ROWS = 5
#: depths of contact that are tried before the best of them is refined
_TRIED = 41
#: share of the travel up to which contact may begin, and before its start that it may have begun
_LATEST = 0.9
_EARLIEST = -0.2
#: largest correlation of neighboring residuals that is told from a trend
_MOST_CORRELATED = 0.99


@dataclass(frozen=True)
class CurveModulus(Keyed):
    """Modulus of one curve."""

    #: How the fit ended.
    status: Status
    #: Why there is no modulus; empty where there is one.
    message: str = ""
    #: Rows in contact, and how many of them lie beyond a limit.
    rows: int = 0
    rows_outside: int = 0
    #: Young's modulus and its standard error.
    modulus_MPa: float | None = None
    error_MPa: float | None = None
    interval_MPa: tuple[float, float] | None = None
    #: Displacement at contact and its standard error, where it was fitted.
    contact_mm: float | None = None
    contact_error_mm: float | None = None
    correlation: float | None = None
    #: Root mean square of the residuals over that of the forces.
    relative_rms: float | None = None
    recording: Recording | None = None

    @property
    def label(self) -> str:
        """Test of the file."""
        return "" if self.recording is None else self.recording.where

    def keyed(self) -> dict[str, object]:
        """Plain values, moduli in kPa."""
        document = {**vars(self)}
        recording, low_high = document.pop("recording"), document.pop("interval_MPa")
        return {
            "label": self.label,
            "groups": dict(recording.groups),
            "modulus_kPa": _kilo(document.pop("modulus_MPa")),
            "standard_error_kPa": _kilo(document.pop("error_MPa")),
            "ci95_kPa": None if low_high is None else [_kilo(v) for v in low_high],
            **document,
        }


def fit_modulus(
    displacement_mm: Array,
    force_N: Array,
    law: ContactForceLaw,
    *,
    poisson_ratio: float,
    deepest_mm: float,
    find_contact: bool = False,
) -> CurveModulus:
    """Fit Young's modulus to the rows of one curve that lie within the limits."""
    # Shapes: displacement_mm, force_N (n,).
    contact, used = 0.0, displacement_mm <= deepest_mm
    if find_contact:
        contact, used = _contact_and_rows(displacement_mm, force_N, law, deepest_mm)
    rows = _touching(displacement_mm, contact)
    outside = int(np.count_nonzero(~used))
    if _touching(displacement_mm[used], contact) < MIN_ROWS:
        rule = f"{rows - outside} of {rows} rows in contact are within the limits, {MIN_ROWS} must"
        return CurveModulus("outside", rule, rows, outside)
    depth, force = displacement_mm[used] - contact, force_N[used]
    shape = law.force(depth)
    plane_strain = float(shape @ force / (shape @ shape))
    if plane_strain <= 0:
        rule = f"the modulus would be {1e3 * plane_strain:.4g} kPa: check sign and contact"
        return CurveModulus("implausible", rule, rows, outside)
    # the slope of the force enters the covariance where contact was fitted
    columns = [shape, -plane_strain * law.stiffness(depth)] if find_contact else [shape]
    residual = force - plane_strain * shape
    covariance, correlation, freedom = _covariance(np.column_stack(columns), residual)
    scale = 1 - poisson_ratio**2
    value, error = scale * plane_strain, scale * float(np.sqrt(covariance[0, 0]))
    half = float(stdtrit(freedom, 0.975)) * error
    return CurveModulus(
        "fitted",
        "",
        rows,
        outside,
        modulus_MPa=value,
        error_MPa=error,
        interval_MPa=(value - half, value + half),
        contact_mm=contact if find_contact else None,
        contact_error_mm=float(np.sqrt(covariance[1, 1])) if find_contact else None,
        correlation=correlation,
        relative_rms=float(np.sqrt(residual @ residual / (force @ force))),
    )


def _contact_and_rows(
    d: Array, force: Array, law: ContactForceLaw, deepest: float
) -> tuple[float, Flags]:
    """Displacement at contact, and the rows within the limit of depth that give it."""
    # Often no rows give a contact that chooses just them: with one row more contact is so early
    # that this row lies too deep. The choices then come round, for there are no more than rows, and
    # the fewest rows of such a circle are those that are all within the limit.
    choices = [np.ones(d.shape, dtype=bool)]
    while True:
        contact = _contact(d[choices[-1]], force[choices[-1]], law)
        used: Flags = d - contact <= deepest
        if _touching(d[used], contact) < MIN_ROWS or np.array_equal(used, choices[-1]):
            return contact, used
        for k, before in enumerate(choices):
            if np.array_equal(used, before):
                fewest = min(choices[k:], key=np.count_nonzero)
                return _contact(d[fewest], force[fewest], law), fewest
        choices.append(used)


def _touching(displacement: Array, contact: float) -> int:
    return int(np.count_nonzero(displacement > contact))


def _contact(d: Array, force: Array, law: ContactForceLaw) -> float:
    """Displacement at contact that leaves the least sum of squares."""
    span = float(np.ptp(d))
    tried = d[0] + span * np.linspace(_EARLIEST, _LATEST, _TRIED)
    explained = _explained(law.force(d - tried[:, None]), force)
    best = int(np.argmax(explained))
    step = tried[1] - tried[0]

    def loss(contact: float) -> float:
        return -float(_explained(law.force(d - contact)[None, :], force)[0])

    ends = (tried[best] - step, tried[best] + step)
    search = minimize_scalar(loss, bounds=ends, options={"xatol": 1e-6 * span})
    return float(settled(search, "contact of an indentation curve").x)


def _explained(shapes: Array, force: Array) -> Array:
    """Sum of squares that each of several curves in proportion explains, shape (m,)."""
    size = np.maximum(np.einsum("ij,ij->i", shapes, shapes), 1e-300)
    return np.asarray((shapes @ force) * np.abs(shapes @ force) / size)


def _covariance(jacobian: Array, residual: Array) -> tuple[Array, float, float]:
    """Covariance under AR(1) errors, their coefficient, and degrees of freedom."""
    # With R_ij = r^|i-j| and B = (J'J)^-1 J'RJ the expected residual sum of squares is sigma^2 (n -
    # tr B), and the covariance sigma^2 B (J'J)^-1.
    n, p = jacobian.shape
    size = float(residual @ residual)
    lag = float(residual[1:] @ residual[:-1]) / size if size > 0 else 0.0
    # low by about (p + (p + 2) r) / n after a fit of p constants (Kendall 1954 for a mean); half a
    # standard error more, because an interval suffers more from too low an r than from too high
    r = (n * lag + p) / max(n - p - 2, 1)
    r += 0.5 * float(np.sqrt(max(1 - r**2, 0.0) / n))
    r = float(np.clip(r, 0.0, _MOST_CORRELATED))
    # sums over all rows before, r J_(i-1) + r^2 J_(i-2) + ..., from s_i - r s_(i-1) = r J_(i-1)
    bands = np.vstack([np.ones(n), np.full(n, -r)])
    before = solve_banded((1, 0), bands, r * np.vstack([np.zeros((1, p)), jacobian[:-1]]))
    cross = jacobian.T @ before
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    spread = inverse @ (jacobian.T @ jacobian + cross + cross.T)
    left = max(n - float(np.trace(spread)), 1.0)
    freedom = max(n * (1 - r) / (1 + r) - p, 1.0)
    return np.asarray(size / left * spread @ inverse), r, freedom


# Measured indentations, each on its own rows: many curves share no grid.


def read_curves(
    spec: MeasurementSpec, root: Path, height_mm: float | None, displacement_mm: float | None
) -> tuple[list[tuple[Recording, SingleTest | str]], tuple[str, ...]]:
    """Curves of a specification, or why one is of no use, and what was done to the files."""
    columns = (spec.columns.kinematic, spec.columns.kinetic)
    if columns != ("displacement", "force"):
        rule = f"an indentation needs displacement and force, got {' and '.join(columns)}"
        mend = 'columns = { displacement = "...", force = "..." }'
        raise InputError(Fault("measurements.columns", rule, mend))
    rules = rules_of(replace(spec, points="raw"), height_mm, displacement_mm)
    recorded = read_recordings(spec, root)
    curves: list[tuple[Recording, SingleTest | str]] = []
    faults: list[Fault] = []
    lines: list[str] = []
    counts: list[RowCount] = []
    for recording in recorded.tests:
        try:
            test, did = specimens(recording, rules)
        except InputError as error:
            faults += error.faults
            curves.append((recording, str(error)))
            rows = recording.kinetic.size
            counts.append(RowCount(rows, 0, {"of unreadable curves": rows}))
            continue
        lines += did
        counts.append(test.specimen.count)
        curves.append((recording, test))
    if all(isinstance(curve, str) for _, curve in curves):
        raise InputError(faults)
    notes = (*recorded.notes, *first_notes(lines))
    return curves, (*notes, RowCount.sum_of(counts).sentence)


# Moduli of the curves of a test, gathered by unit, and what is wrong with them.


@dataclass(frozen=True)
class IndentationModulus(Keyed):
    """Modulus of one test of a calibration file in closed form."""

    KEYS = (
        "test file indenter theory poisson_ratio height_mm limits youngs_modulus shear_modulus "
        "block units=unit_moduli_kPa curves_read=curves.__len__ curves_fitted=fitted rows "
        "rows_outside curves warnings"
    )

    test: int
    file: str
    #: What was pressed in, and how the support enters.
    indenter: str
    theory: str
    poisson_ratio: float
    height_mm: float
    #: Depths at which assumptions end, the least first; one that was asked for before them.
    limits: tuple[ValidityLimit, ...]
    curves: tuple[CurveModulus, ...]
    #: Column of the units; every curve is one where it is None.
    block: str | None
    #: Median of the curves of every unit.
    unit_moduli_MPa: Mapping[str, float]
    #: Median over units; None where no curve could be fitted.
    estimate: MedianEstimate | None
    warnings: tuple[str, ...]

    @property
    def rows(self) -> int:
        """Rows in contact."""
        return sum(curve.rows for curve in self.curves)

    @property
    def rows_outside(self) -> int:
        """Rows beyond a limit, which no fit uses."""
        return sum(curve.rows_outside for curve in self.curves)

    @property
    def fitted(self) -> int:
        """Curves that have a modulus."""
        return sum(curve.status == "fitted" for curve in self.curves)

    @property
    def unit_moduli_kPa(self) -> dict[str, float | None]:  # noqa: N802
        """Median of the curves of every unit."""
        return {unit: _kilo(modulus) for unit, modulus in self.unit_moduli_MPa.items()}

    def youngs_modulus(self) -> dict[str, object] | None:
        """Median over units with its interval."""
        return self._estimate(1.0)

    def shear_modulus(self) -> dict[str, object] | None:
        """Median over units of the shear modulus, with its interval."""
        return self._estimate(1 / (2 * (1 + self.poisson_ratio)))

    def _estimate(self, factor: float) -> dict[str, object] | None:
        estimate = self.estimate
        if estimate is None:
            return None
        interval = estimate.interval_MPa
        return {
            "median_kPa": _kilo(factor * estimate.value_MPa),
            "ci95_kPa": None if interval is None else [_kilo(factor * v) for v in interval],
            "interval": estimate.kind,
            "units": estimate.units,
            "quartiles_kPa": [_kilo(factor * v) for v in estimate.quartiles_MPa],
        }


@dataclass(frozen=True)
class AnalyticCalibration(Keyed):
    """What ``study calibrate --method analytic`` found."""

    KEYS = "name method tests notes seconds"
    method = "analytic"

    name: str
    tests: tuple[IndentationModulus, ...]
    #: What was done to the files.
    notes: tuple[str, ...]
    #: Time that reading and fitting took.
    seconds: float

    @property
    def is_complete(self) -> bool:
        """Whether every test has a modulus."""
        return all(test.estimate is not None for test in self.tests)


def _kilo(value_MPa: float | None) -> float | None:
    return None if value_MPa is None else 1e3 * value_MPa


# Closed-form modulus of the indentations of one test: curves, limits, median, warnings.

#: share by which the chosen support changes the force before it is said
_SAID = 0.01
#: deepest data over which the law is tabulated: contact may have begun before the recording
_DEEPER = 1.25


@dataclass(frozen=True)
class IndentationTest:
    """What the closed form needs to know of a test."""

    #: What is pressed in, without friction.
    indenter: Indenter
    layer: Layer
    area_mm2: float
    spec: MeasurementSpec
    displacement_mm: float | None = None
    #: {"integral-equation", "dimitriadis", "half-space"}: how the support enters.
    theory: Theory = "integral-equation"
    #: Whether a sphere is taken for a paraboloid, as Hertz did.
    paraboloid: bool = False
    #: Whether the displacement at contact is fitted.
    find_contact: bool = False
    #: Depth up to which rows are fitted; None where the assumptions say it.
    depth_limit_mm: float | None = None

    @property
    def lifted(self) -> tuple[ValidityLimit, ...]:
        """Limit that the user asked for in place of the others."""
        depth = self.depth_limit_mm
        return () if depth is None else (ValidityLimit("calibration.depth_limit", depth),)

    def deepest_mm(self, validity: Sequence[ValidityLimit]) -> float:
        """Depth up to which rows are fitted."""
        return (*self.lifted, *validity)[0].depth_mm


def indentation_modulus(
    test: IndentationTest, root: Path, number: int = 0
) -> tuple[IndentationModulus, tuple[str, ...]]:
    """Young's modulus of every curve of a test and their median, and notes on the files."""
    height = test.layer.height_mm
    curves, notes = read_curves(test.spec, root, height, test.displacement_mm)
    usable_curves = [curve for _, curve in curves if not isinstance(curve, str)]
    deepest = max(float(curve.displacement_mm[-1]) for curve in usable_curves)
    law = force_law(
        test.indenter, test.layer, _DEEPER * deepest, theory=test.theory, paraboloid=test.paraboloid
    )
    series = test.theory == "dimitriadis"
    validity = limits(test.indenter, test.layer, law, area_mm2=test.area_mm2, is_series=series)
    fitted = []
    moduli: dict[str, list[float]] = {}
    for recording, curve in curves:
        if isinstance(curve, str):
            modulus = CurveModulus("unreadable", curve)
        else:
            modulus = fit_modulus(
                curve.displacement_mm, curve.force_N, law,
                poisson_ratio=test.layer.poisson_ratio, deepest_mm=test.deepest_mm(validity),
                find_contact=test.find_contact,
            )  # fmt: skip
        fitted.append(replace(modulus, recording=recording))
        if modulus.modulus_MPa is not None:
            block = test.spec.block
            unit = recording.where if block is None else recording.groups[block]
            moduli.setdefault(unit, []).append(modulus.modulus_MPa)
    units = {unit: float(np.median(values)) for unit, values in moduli.items()}
    intervals = [curve.interval_MPa for curve in fitted if curve.interval_MPa]
    alone = intervals[0] if len(intervals) == 1 else None
    result = IndentationModulus(
        test=number,
        file=str(test.spec.file or test.spec.files),
        indenter=test.indenter.shape,
        theory=test.theory,
        poisson_ratio=test.layer.poisson_ratio,
        height_mm=height,
        limits=(*test.lifted, *validity),
        curves=tuple(fitted),
        block=test.spec.block,
        unit_moduli_MPa=units,
        estimate=median_estimate(list(units.values()), alone) if units else None,
        warnings=tuple(_warnings(test, fitted, validity, law, deepest)),
    )
    return result, notes


def _warnings(
    test: IndentationTest,
    fitted: Sequence[CurveModulus],
    validity: Sequence[ValidityLimit],
    law: ContactForceLaw,
    deepest_mm: float,
) -> list[str]:
    lines = []
    rows = sum(curve.rows for curve in fitted)
    outside = sum(curve.rows_outside for curve in fitted)
    limit_mm, first = test.deepest_mm(validity), validity[0]
    if outside:
        what = (*test.lifted, first)[0].what
        lines.append(
            f"{100 * outside / rows:.3g} % of the rows in contact ({outside} of {rows}) lie deeper "
            f"than {limit_mm:.4g} mm ({what}) and are not fitted"
        )
    if limit_mm > first.depth_mm and deepest_mm > first.depth_mm:
        broken = ", ".join(v.what for v in validity if v.depth_mm < min(limit_mm, deepest_mm))
        lines.append(
            f"calibration.depth_limit lifts the limit from {first.depth_mm:.4g} to {limit_mm:.4g} "
            f"mm: the moduli rest on rows where the closed form does not hold ({broken})"
        )
    for status, count in Counter(curve.status for curve in fitted).items():
        if status != "fitted":
            example = next(curve for curve in fitted if curve.status == status)
            lines.append(f"{count} of {len(fitted)} curves are {status}: {example.label}: "
                        f"{example.message}")  # fmt: skip
    if words := caution(test.indenter):
        lines.append(words)
    return [*lines, *_support(test, law, min(limit_mm, deepest_mm))]


def _support(test: IndentationTest, law: ContactForceLaw, depth_mm: float) -> list[str]:
    """Say by how much another treatment of the support is off at the deepest row that counts."""
    if test.theory == "integral-equation" or depth_mm <= 0:
        return []
    depth = np.array([depth_mm])
    exact = force_law(test.indenter, test.layer, depth_mm, paraboloid=test.paraboloid)
    off = float(exact.force(depth)[0] / law.force(depth)[0]) - 1
    if abs(off) < _SAID:
        return []
    name = "the half-space" if test.theory == "half-space" else "Dimitriadis' series"
    return [
        f"at {depth_mm:.4g} mm the layer resists {100 * off:+.1f} % against {name}, and the "
        "modulus is off by up to as much: write theory = 'integral-equation'"
    ]
