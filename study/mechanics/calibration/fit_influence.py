"""Errors of fitted constants from the errors of recorded rows, on any grid of the fit.

A curve that was interpolated at 1,000 displacements from 60 rows holds 60 errors, each of which
moves many of its points. The estimates are linear in the rows to first order; their influence is
followed through weighting, averaging of repeats and interpolation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from study.ground.arrays import Array
from study.ground.curve import Curve
from study.mechanics.calibration.covariance import (
    Uncertainty,
    identifiability,
    influence,
    scaled_inverse,
    student_t,
)
from study.mechanics.calibration.fit import Fit, small_sample_aic
from study.mechanics.calibration.residual_function import (
    MeasuredCurve,
    pseudo_jacobian,
    pseudo_rows,
)
from study.mechanics.calibration.serial_correlation import (
    Pseudo,
    SerialCorrelation,
    Series,
    effective_rows,
    intervals,
    row_noise,
)


def with_serial_correlation(
    fit: Fit, measured: Sequence[MeasuredCurve], extra_covariance: Array | None = None
) -> Fit:
    """Errors, intervals, AICc and verdict of a fit from its recorded rows and their correlation."""
    # Shapes: extra_covariance (p, p).
    free = np.isfinite(fit.standard_error)
    if not fit.converged or not free.any() or fit.rss == 0:
        return fit
    measured = [m.reweighted(c) for m, c in zip(measured, fit.curves, strict=True)]
    names = [name for name, is_free in zip(fit.names, free, strict=True) if is_free]
    series, other_covariance = _series(fit, measured, names)
    if extra_covariance is not None:
        other_covariance = other_covariance + extra_covariance[np.ix_(free, free)]
    priors = [prior for prior in fit.priors if prior.name in names]
    values = np.array([fit.values[fit.names.index(name)] for name in names])
    from_rows = intervals(
        series,
        Pseudo(pseudo_rows(priors, names, values), pseudo_jacobian(priors, names)),
        other_covariance,
    )
    if from_rows is None:
        return fit
    rows = sum(part.residual.size for part in series)
    covariance = np.full_like(fit.covariance, np.nan)
    covariance[np.ix_(free, free)] = from_rows.covariance
    half = np.full(free.size, np.nan)
    half[free] = from_rows.half_width
    freedom = fit.n + len(fit.priors) - int(free.sum())
    independent = student_t(freedom) * fit.standard_error
    rho = from_rows.correlation
    mixture = from_rows.mixture if free.all() else None
    serial = SerialCorrelation(rows, rho, effective_rows(rows, rho), half / independent, mixture)
    error = np.sqrt(np.diag(covariance))
    constants = fit.values.size + 1 + int(math.isfinite(rho))
    corrected = replace(
        fit,
        covariance=covariance,
        standard_error=error,
        ci95=np.stack([fit.values - half, fit.values + half], axis=1),
        correlation=np.asarray(covariance / np.outer(error, error)),
        aicc=small_sample_aic(from_rows.deviance, rows, constants),
        serial=serial,
    )
    if not free.all():
        return corrected
    return judged_again(corrected, rows + len(fit.priors) - free.size, measured)


def judged_again(fit: Fit, degrees_of_freedom: int, measured: Sequence[MeasuredCurve]) -> Fit:
    """Fit with the verdict on its parameters that its new intervals give."""
    pairs = zip(measured, fit.curves, strict=True)
    rows = np.concatenate([m.slopes(c, fit.names) for m, c in pairs])
    force = np.concatenate([m.weights * m.curve.force_N for m in measured])
    estimate = Uncertainty(
        fit.covariance, fit.standard_error, fit.ci95, fit.correlation, fit.condition,
        fit.values.size, degrees_of_freedom, influence(rows, force),
    )  # fmt: skip
    identifiable, reason = identifiability(fit.names, fit.values, estimate)
    return replace(fit, identifiable=identifiable, reason=reason)


def _series(
    fit: Fit, measured: Sequence[MeasuredCurve], names: Sequence[str]
) -> tuple[list[Series], Array]:
    """Every recording with the influence of its rows on the free constants, and that of priors."""
    pairs = list(zip(measured, fit.curves, strict=True))
    rows = [m.slopes(c, names) for m, c in pairs]
    priors = [prior for prior in fit.priors if prior.name in names]
    inverse, _ = scaled_inverse(np.concatenate([*rows, pseudo_jacobian(priors, names)]))
    out = []
    for (test, predicted), jacobian in zip(pairs, rows, strict=True):
        used = test.weights > 0
        # estimates move by minus this times a change of the measured forces at the points, N
        by_point = inverse @ (jacobian * test.weights[used][:, None]).T
        places = test.curve.places[used]
        recorded = recorded_rows(test, predicted, names)
        for weight, rows_used, force, slopes in recorded:
            residual = weight * (force - rows_used.force_N)
            noise = row_noise(residual, rows_used.places, force)
            # rows count in units of a common deviation, in which noise that grows is even
            even = np.ones_like(residual) if noise is None else noise.relative
            by_row = interpolation_transposed(by_point, places, rows_used.places)
            by_row /= len(test.curve.recorded) or 1
            scaled = (weight / even)[:, None] * slopes
            out.append(Series(residual / even, scaled, by_row / weight * even))
    errors = np.array([prior.weight * prior.uncertainty for prior in priors])
    moved = inverse @ (pseudo_jacobian(priors, names).T * errors)
    return out, moved @ moved.T


def recorded_rows(
    measured: MeasuredCurve, predicted: Curve, names: Sequence[str]
) -> list[tuple[Array, Curve, Array, Array]]:
    """Weight, rows in the fitted range, predicted force and slopes of each recording with any."""
    fitted = measured.weights > 0
    recordings = measured.curve.recorded or (measured.curve.at_points(np.flatnonzero(fitted)),)
    places = measured.curve.places[fitted]
    weighted_rows = []
    for recording in recordings:
        inside = (recording.places >= places[0]) & (recording.places <= places[-1])
        if not inside.any():
            continue
        # the mean of k repeats scatters by one over root k of one of them
        weights = np.interp(recording.places, measured.curve.places, measured.weights)
        weights /= math.sqrt(len(recordings))
        used = inside & (weights > 0)
        weighted_rows.append((weights[used], recording.at_points(np.flatnonzero(used))))
    at = [rows.displacement_mm for _, rows in weighted_rows]
    if predicted.time_s is not None or not weighted_rows:  # a course is known at its own rows alone
        predictions = [predicted.smooth_at(names, d) for d in at]
    else:
        ends = np.cumsum([d.size for d in at])[:-1]
        force, slopes = predicted.smooth_at(names, np.concatenate(at))
        predictions = list(zip(np.split(force, ends), np.split(slopes, ends), strict=True))
    return [
        (*weighted, *prediction)
        for weighted, prediction in zip(weighted_rows, predictions, strict=True)
    ]


def interpolation_transposed(by_point: Array, places: Array, rows: Array) -> Array:
    """Influence of rows from that of the points interpolated between them.

    Shapes: by_point (p, m); places (m,), mm; rows (n,); returns (p, n).
    """
    position = np.interp(places, rows, np.arange(rows.size, dtype=float))
    left = np.minimum(position.astype(int), max(rows.size - 2, 0))
    share = position - left
    right = np.minimum(left + 1, rows.size - 1)
    return np.array([
        np.bincount(left, values * (1 - share), rows.size)
        + np.bincount(right, values * share, rows.size)
        for values in by_point
    ])  # fmt: skip


# Specimens as the unit: a constant's mean in the population by Student's t distribution with
# specimens - 1 degrees of freedom, and its range for the next specimen.


@dataclass(frozen=True)
class Population:
    """One constant among specimens; MPa, exponents plain."""

    name: str
    specimens: int
    #: Of their values, each counted once.
    mean: float
    #: Of their values; holds the errors within specimens.
    standard_deviation: float
    #: Standard deviation of the true values: the errors within specimens taken off (by moments,
    #: Hedges 1983, Psychol. Bull. 93, 388); zero where these explain all scatter.
    between: float
    #: 95 % intervals of the population's mean, and of the value found in the next specimen.
    mean_ci95: tuple[float, float]
    next_ci95: tuple[float, float]
    #: Best linear unbiased prediction of each specimen's true value, NaN where its fit has none:
    #: values are shrunk towards the mean by their own errors (Robinson 1991, Stat. Sci. 6, 15).
    shrunk: tuple[float, ...] = ()


def population(fits: Sequence[Fit]) -> tuple[Population, ...]:
    """Mean, scatter and intervals of every constant from fits to one specimen each."""
    out = []
    for k, name in enumerate(fits[0].names if fits else ()):
        errors = np.array([f.standard_error[k] if f.converged else math.nan for f in fits])
        used = [i for i, error in enumerate(errors) if not math.isnan(error)]
        n = len(used)
        if n < 2:
            continue
        every = np.array([fit.values[k] for fit in fits])
        within = float(np.mean(errors[used] ** 2))
        mean, deviation = float(every[used].mean()), float(every[used].std(ddof=1))
        t = student_t(n - 1)
        of_mean, of_next = t * deviation / math.sqrt(n), t * deviation * math.sqrt(1 + 1 / n)
        between = max(deviation**2 - within, 0.0)
        shrunk = [
            mean + between / (between + error**2) * (float(value) - mean)
            for value, error in zip(every, errors, strict=True)
        ]
        out.append(Population(
            name, n, mean, deviation, math.sqrt(between), (mean - of_mean, mean + of_mean),
            (mean - of_next, mean + of_next), tuple(map(float, shrunk)),
        ))  # fmt: skip
    return tuple(out)
