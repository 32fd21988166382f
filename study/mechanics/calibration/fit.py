"""Fit of material constants to measured curves, with what it knows and what it cannot know."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from study.ground.arrays import Array
from study.ground.curve import Curve
from study.ground.errors import Fault, InputError
from study.mechanics.calibration.covariance import identifiability, influence, uncertainty
from study.mechanics.calibration.levenberg_marquardt import (
    Iteration,
    LeastSquaresSearch,
    Status,
    levenberg_marquardt,
)
from study.mechanics.calibration.residual_function import (
    Bounds,
    EvaluationFailed,
    MeasuredCurve,
    NuisanceEstimate,
    Prior,
    curve_faults,
    pseudo_jacobian,
    pseudo_rows,
)
from study.mechanics.calibration.serial_correlation import SerialCorrelation

Predict = Callable[[Array], Sequence[Curve]]
Progress = Callable[[Iteration], bool | None]


@dataclass(frozen=True)
class Fit:
    """Constants and everything that says how far to trust them."""

    names: tuple[str, ...]
    #: shape (p,); MPa (exponents plain); an error that is not available is NaN.
    values: Array
    standard_error: Array
    #: shape (p, 2); student-t intervals.
    ci95: Array
    #: shape (p, p); the error variance is estimated from the residuals, so only the ratios of
    #: weights matter (a common factor changes nothing).
    covariance: Array
    correlation: Array
    condition: float
    rss: float
    #: Of the fitted points; AICc counts the error variance as one parameter more and is infinite
    #: where there are too few points for it.
    r_squared: float
    aicc: float
    n: int
    identifiable: bool
    #: Why not, or a caution; may be empty.
    reason: str
    #: How the optimizer ended; only ``converged_*`` is a success.
    status: Status
    evaluations: int
    #: shape (n,); weighted, of all fitted curves one after the other.
    residuals: Array
    #: Prediction of every measured curve at the fitted constants.
    curves: tuple[Curve, ...]
    history: tuple[Iteration, ...] = ()
    #: Why the model last had no answer; empty if it always had one.
    failure: str = ""
    #: Where errors, intervals and AICc allow for the correlation of recorded rows
    #: (:func:`study.mechanics.calibration.fit_influence.with_serial_correlation`).
    serial: SerialCorrelation | None = None
    #: Pseudo-observations that were fitted besides; no part of ``rss``, ``n`` and residuals.
    priors: tuple[Prior, ...] = ()
    #: Constants and fitted nuisance parameters together, of which this is the constants' part.
    joint: Fit | None = None
    nuisance: tuple[NuisanceEstimate, ...] = ()

    @property
    def converged(self) -> bool:
        """Whether a minimum was reached."""
        return self.status.converged

    @property
    def message(self) -> str:
        """How the search ended and, where the model failed it, why."""
        failure = self.failure if not self.converged else ""
        return f"{self.status.sentence} ({failure})" if failure else self.status.sentence

    @property
    def degrees_of_freedom(self) -> int:
        """Points and pseudo-observations less parameters."""
        return self.n + len(self.priors) - len(self.names)

    @property
    def penalized_rss(self) -> float:
        """What the search minimized: ``rss`` and the squares of the pseudo-observations."""
        return self.rss + float(np.sum(pseudo_rows(self.priors, self.names, self.values) ** 2))

    def constants(self) -> dict[str, float]:
        """Name -> value."""
        return dict(zip(self.names, self.values.tolist(), strict=True))


def fit(
    predict: Predict,
    measured: Sequence[MeasuredCurve],
    names: Sequence[str],
    start: ArrayLike,
    *,
    bounds: Bounds = None,
    max_evaluations: int = 200,
    ftol: float = 1e-12,
    xtol: float = 1e-12,
    gtol: float = 1e-10,
    edge: float = 0.0,
    callback: Progress | None = None,
    resume: Iteration | None = None,
    priors: Sequence[Prior] = (),
) -> Fit:
    """Fit constants to measured curves. Shapes: start (p,)."""
    _check(measured, names, start)
    model = ResidualFunction(predict, measured, names, priors)
    result = levenberg_marquardt(
        model, start, bounds=bounds, max_evaluations=max_evaluations,
        ftol=ftol, xtol=xtol, gtol=gtol, edge=edge, callback=model.watch(callback), resume=resume,
    )  # fmt: skip
    return _report(result, model)


class ResidualFunction:
    """Weighted residual of the fitted curves and its Jacobian, as the optimizer wants them.

    It remembers the curves of accepted points, so that none is solved twice.
    """

    def __init__(
        self, predict: Predict, measured: Sequence[MeasuredCurve], names: Sequence[str],
        priors: Sequence[Prior] = (),
    ) -> None:  # fmt: skip
        self.predict, self.measured, self.names = predict, tuple(measured), tuple(names)
        self.priors, self.slopes = tuple(priors), pseudo_jacobian(priors, names)
        self.curves_at: dict[bytes, tuple[Curve, ...]] = {}
        self.failure = ""

    def __call__(self, values: Array) -> tuple[Array, Array]:
        """Residual (n,) and its Jacobian (n, p), pseudo-observations at the end."""
        try:
            curves = tuple(self.predict(values))
            self.curves_at[values.tobytes()] = curves
            pairs = zip(self.measured, curves, strict=True)
            residuals, rows = zip(*(self._one(m, c) for m, c in pairs), strict=True)
        except EvaluationFailed as error:
            self.failure = str(error)
            raise
        prior_rows = pseudo_rows(self.priors, self.names, values)
        return np.concatenate([*residuals, prior_rows]), np.concatenate([*rows, self.slopes])

    def _one(self, measured: MeasuredCurve, predicted: Curve) -> tuple[Array, Array]:
        used = measured.weights > 0
        d, weight = measured.curve.displacement_mm[used], measured.weights[used]
        try:
            force = predicted.force_at(d)
        except ValueError as error:  # the solution stopped before the end of the test
            raise EvaluationFailed(str(error)) from error
        slopes = predicted.gradients_at(self.names, d)
        residual = weight * (force - measured.curve.force_N[used])
        if measured.loss == "linear":
            return residual, weight[:, None] * slopes
        robust, slope = measured.robust(residual)
        return robust, (slope * weight)[:, None] * slopes

    def watch(self, callback: Progress | None) -> Progress:
        """Keep the curves of the last accepted point alone."""

        def accepted(iteration: Iteration) -> bool | None:
            key = iteration.x.tobytes()
            self.curves_at = {k: v for k, v in self.curves_at.items() if k == key}
            return callback(iteration) if callback else None

        return accepted


def _report(result: LeastSquaresSearch, model: ResidualFunction) -> Fit:
    fitted = [(m, m.weights > 0) for m in model.measured]
    force = np.concatenate([m.curve.force_N[used] for m, used in fitted])
    weight = np.concatenate([m.weights[used] for m, used in fitted])
    residual = result.residual[: force.size]
    rss = float(residual @ residual) if residual.size else 2 * result.cost
    estimate = replace(
        uncertainty(result.jacobian, result.residual, result.x, ~result.at_bound),
        influence=influence(result.jacobian, weight * force),
    )
    identifiable, reason = False, result.status.sentence
    if result.status.usable:
        identifiable, why = identifiability(model.names, result.x, estimate)
        if result.converged:
            reason = why
        elif why and not identifiable:
            reason = f"{reason}; besides, {why}"
        held = [name for name, at in zip(model.names, result.at_bound, strict=True) if at]
        if held and result.converged:
            reason = f"{', '.join(held)} ended at a bound"
        identifiable = identifiable and result.converged and not held
    if not result.converged:
        none = np.full_like(estimate.covariance, np.nan)
        estimate = replace(
            estimate, covariance=none, standard_error=none[0], ci95=none[:, :1].repeat(2, 1)
        )
    mean = float(weight**2 @ force / (weight @ weight))
    total = float(np.sum((weight * (force - mean)) ** 2))
    return Fit(
        model.names,
        result.x,
        estimate.standard_error,
        estimate.ci95,
        estimate.covariance,
        estimate.correlation,
        estimate.condition,
        rss,
        1 - rss / total if total > 0 else math.nan,
        aicc(rss, force.size, result.x.size),
        force.size,
        identifiable,
        reason,
        result.status,
        result.evaluations,
        residual,
        model.curves_at.get(result.x.tobytes(), ()),
        tuple(result.history),
        model.failure,
        priors=model.priors,
    )


def aicc(rss: float, n: int, parameters: int) -> float:
    """Small-sample Akaike criterion of a least-squares fit (Hurvich and Tsai 1989).

    The error variance counts as a parameter. Infinite where ``n`` is too small for it.
    """
    if not math.isfinite(rss):
        return math.inf
    return small_sample_aic(n * math.log(max(rss, 1e-300) / n), n, parameters + 1)


def small_sample_aic(deviance: float, n: int, k: int) -> float:
    """Criterion of Hurvich and Tsai 1989 from -2 log likelihood of n points and k parameters."""
    if n - k - 1 <= 0:
        return math.inf
    return deviance + 2 * k + 2 * k * (k + 1) / (n - k - 1)


def _check(measured: Sequence[MeasuredCurve], names: Sequence[str], start: ArrayLike) -> None:
    faults = [fault for m in measured for fault in curve_faults(m)]
    size, points = np.size(start), 0
    if size != len(names):
        faults.append(Fault("start", f"{size} values for {len(names)} constants"))
    if not measured:
        faults.append(Fault("tests", "none has the role 'fit'"))
    elif not faults:
        points = sum(int(np.count_nonzero(m.weights > 0)) for m in measured)
        if points < len(names):
            rule = f"{points} points cannot determine {len(names)} constants ({', '.join(names)})"
            faults.append(Fault("measurements", rule, "give more points or a simpler energy"))
    if faults:
        raise InputError(faults)
