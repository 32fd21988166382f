"""Constants with nuisance parameters: fitted beside them, or propagated to them.

A fitted parameter is one more unknown; what is known of it before is a pseudo-observation, which
counts as much as a standard deviation of the residuals, correlation of rows allowed for, is worth.
Of a propagated one the tests learn nothing: its standard uncertainty u adds u^2 b b' to the
covariance, b the derivative of the estimates by it (JCGM 100:2008, eq. 10). The interval of a
constant holds both; the pseudo-observations' own errors enter it with the size that they are said
to have, not with one that the residuals tell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from study.arrays import Array
from study.calibration.covariance import scaled_inverse
from study.calibration.fit import Fit, fit
from study.calibration.influence import with_serial_correlation
from study.calibration.iteration import Status
from study.calibration.measured_curve import MeasuredCurve
from study.calibration.prior import NuisanceEstimate, Prior, pseudo_jacobian
from study.curve import Curve
from study.design.sections.calibration_design import CalibratedTest
from study.runner.calibration.measured_tests import FitCurve
from study.runner.calibration.nuisance.parameters import (
    OFFSET,
    NuisanceParameter,
    parameters_of,
)
from study.runner.calibration.nuisance.predictions import Predictions, reach_of
from study.runner.fitting.staged_fit import TOLERANCES, Part

#: change of the noise, relative, at which pseudo-observations have their weight
_SETTLED = 1e-3

#: fits in which they find it
_ROUNDS = 8

#: noise over the largest force of data that have none
_NOISELESS = 1e-9


@dataclass(frozen=True)
class _Task:
    """What the fits of one calibration share."""

    predictions: Predictions
    measured: Sequence[MeasuredCurve]
    names: tuple[str, ...]
    bounds: Sequence[tuple[float, float]] | None
    simulated: bool

    def fitted(
        self, asked: Sequence[NuisanceParameter], start: Array, noise: float
    ) -> tuple[Fit, Fit]:
        """Fit constants and some parameters; as least squares gives it, and from its rows."""
        free = (-np.inf, np.inf)
        depth = max(float(m.curve.displacement_mm.max()) for m in self.measured)
        bounds = [*(self.bounds or [free] * len(self.names))]
        for one in asked:
            far = reach_of(one, depth)
            is_offset = one.key == OFFSET
            bounds.append((one.expected - far, one.expected + far) if is_offset else free)
        priors = [
            Prior(one.name, one.expected, one.uncertainty, noise)
            for one in asked
            if one.uncertainty is not None
        ]
        found = fit(
            lambda values: self.predictions(values, asked),
            self.measured,
            (*self.names, *(one.name for one in asked)),
            start,
            bounds=bounds,
            priors=priors,
            **TOLERANCES["inverse-fem" if self.simulated else "closed-form"],
        )
        return found, with_serial_correlation(found, self.measured)


def with_nuisance(
    found: Fit,
    parts: Sequence[Part],
    tests: Sequence[CalibratedTest],
    curves: Sequence[FitCurve],
    bounds: Sequence[tuple[float, float]] | None = None,
) -> Fit:
    """Fit of the constants with what is not known exactly.

    Parameters
    ----------
    found : Fit
        With every nuisance parameter at its expected value; where the search starts.
    parts : sequence of Part
        Tests of the fit.
    tests : sequence of CalibratedTest
        All tests of the calibration.
    curves : sequence of FitCurve
        Fitted, in the order of the parts.
    bounds : sequence of (low, high), optional
        One pair for every constant.

    Returns
    -------
    Fit
        Of the constants; ``joint`` holds the fitted parameters too, ``nuisance`` all of them.
        The same where nothing is declared, or the fit had no success.

    Raises
    ------
    InputError
        If a declared parameter has no meaning in its test.
    """
    parameters = parameters_of(tests, curves)
    if not parameters or not found.converged:
        return found
    own = [tests[number] for number in sorted({c.test for c in curves})]
    predictions = Predictions(parts, own, found.names, parameters)
    measured = [one for part in parts for one in part.measured]
    simulated = any(p.method == "inverse-fem" for p in parts)
    simulated = simulated or any(one.key == "friction" for one in parameters)
    task = _Task(predictions, measured, found.names, bounds, simulated)
    fitted = [one for one in parameters if one.is_fitted]
    plain, joint = _settled(task, fitted, found)
    if not joint.converged:
        names = found.names
        return replace(_part(joint, names), joint=joint)
    carried = [one for one in parameters if not one.is_fitted]
    moved = _moved(task, joint, fitted, carried)
    joint = with_serial_correlation(plain, measured, moved @ moved.T)
    estimates = tuple(
        _estimate(one, joint, task, plain, moved, carried) for one in parameters
    )  # fmt: skip
    return replace(_part(joint, found.names), joint=joint, nuisance=estimates)


def predicted(
    parts: Sequence[Part],
    tests: Sequence[CalibratedTest],
    curves: Sequence[FitCurve],
    names: Sequence[str],
    values: Array,
) -> list[Curve]:
    """Curves of a fit for constants and fitted nuisance parameters.

    Parameters
    ----------
    parts, tests, curves
        As for :func:`with_nuisance`.
    names : sequence of str
        Constants.
    values : ndarray, shape (p + k,)
        Constants in MPa (exponents plain), then the fitted parameters in mm, N, MPa, deg or plain,
        in the order of :func:`parameters_of`. Propagated ones have their expected values.

    Returns
    -------
    list of Curve
        In the order of the parts, each with the unloaded origin and its gradient by all ``values``.
    """
    parameters = parameters_of(tests, curves)
    own = [tests[number] for number in sorted({c.test for c in curves})]
    asked = [one for one in parameters if one.is_fitted]
    return Predictions(parts, own, names, parameters)(values, asked)


def _settled(task: _Task, fitted: Sequence[NuisanceParameter], found: Fit) -> tuple[Fit, Fit]:
    """Fit again until the weight of the pseudo-observations is that of the residuals left."""
    noise = _noise(found, task.measured)
    start = np.r_[found.values, [one.expected for one in fitted]]
    for _ in range(_ROUNDS):
        plain, joint = task.fitted(fitted, start, noise)
        now = _noise(joint, task.measured)
        if not joint.converged or abs(now - noise) <= _SETTLED * noise:
            break
        noise, start = now, plain.values
    else:
        why = f"the weight of the pseudo-observations has not settled in {_ROUNDS} fits"
        plain, joint = (
            replace(one, status=Status.max_evaluations, failure=why) for one in (plain, joint)
        )
    return plain, joint


def _noise(found: Fit, measured: Sequence[MeasuredCurve]) -> float:
    """Give the standard deviation with which independent points would know as little."""
    largest = max(float(np.abs(m.weights * m.curve.force_N).max()) for m in measured)
    own = np.sqrt(found.rss / max(found.degrees_of_freedom, 1))
    if found.serial is not None:
        own *= np.sqrt(found.n / min(found.serial.effective_rows, found.n))
    return max(float(own), _NOISELESS * largest)


def _moved(
    task: _Task,
    joint: Fit,
    fitted: Sequence[NuisanceParameter],
    carried: Sequence[NuisanceParameter],
) -> Array:
    """Change of the estimates by a standard uncertainty of what is propagated, (p, k)."""
    if not carried:
        return np.zeros((joint.values.size, 0))
    values = np.r_[joint.values, [one.expected for one in carried]]
    curves = task.predictions(values, [*fitted, *carried])
    jacobian = _jacobian(task.measured, curves, joint.names)
    full = np.concatenate([jacobian, pseudo_jacobian(joint.priors, joint.names)])
    slopes = _jacobian(task.measured, curves, [one.name for one in carried])
    inverse, _ = scaled_inverse(full)
    steps = np.array([one.step for one in carried])
    return np.asarray(-inverse @ jacobian.T @ slopes * steps)


def _jacobian(
    measured: Sequence[MeasuredCurve], curves: Sequence[Curve], names: Sequence[str]
) -> Array:
    rows = []
    for one, curve in zip(measured, curves, strict=True):
        used = one.weights > 0
        d = one.curve.displacement_mm[used]
        slopes = curve.gradients_at(names, d)
        rows.append(one.weights[used][:, None] * slopes)
    return np.concatenate(rows)


def _part(joint: Fit, names: tuple[str, ...]) -> Fit:
    """Part of a fit that is about some of its parameters, the others still unknown."""
    kept = [joint.names.index(name) for name in names]
    serial = joint.serial
    if serial is not None:
        mixture = None if serial.mixture is None else serial.mixture.of(np.array(kept))
        serial = replace(serial, inflation=serial.inflation[kept], mixture=mixture)
    return replace(
        joint,
        names=names,
        values=joint.values[kept],
        standard_error=joint.standard_error[kept],
        ci95=joint.ci95[kept],
        covariance=joint.covariance[np.ix_(kept, kept)],
        correlation=joint.correlation[np.ix_(kept, kept)],
        serial=serial,
        priors=(),
    )


def _estimate(
    one: NuisanceParameter,
    joint: Fit,
    task: _Task,
    plain: Fit,
    moved: Array,
    carried: Sequence[NuisanceParameter],
) -> NuisanceEstimate:
    kept = [i for i, name in enumerate(joint.names) if name in task.names]
    variance = np.diag(joint.covariance)[kept]
    if one.is_fitted:
        i = joint.names.index(one.name)
        rest = tuple(name for name in joint.names if name != one.name)
        known = _without(plain, rest)
        others = [k for k in range(len(joint.names)) if k != i]
        beside = (moved @ moved.T)[np.ix_(others, others)]
        left = with_serial_correlation(known, task.measured, beside)
        gone = 1 - np.diag(left.covariance)[[rest.index(n) for n in task.names]] / variance
        value, error = float(joint.values[i]), float(joint.standard_error[i])
        interval = (float(joint.ci95[i, 0]), float(joint.ci95[i, 1]))
    else:
        gone = moved[kept, list(carried).index(one)] ** 2 / variance
        value, error = one.expected, one.step
        interval = (value - 1.96 * error, value + 1.96 * error)
    shares = np.clip(np.nan_to_num(gone), 0.0, 1.0)
    return NuisanceEstimate(
        one.name,
        one.key,
        "fitted" if one.is_fitted else "propagated",
        one.expected,
        one.uncertainty,
        value,
        error,
        interval,
        dict(zip(task.names, shares.tolist(), strict=True)),
    )


def _without(plain: Fit, names: tuple[str, ...]) -> Fit:
    """Fit as if the parameters left out were known exactly."""
    priors = tuple(one for one in plain.priors if one.name in names)
    return replace(_part(plain, names), priors=priors)
