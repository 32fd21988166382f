"""Responses: one number each from a predicted and a measured curve."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from study.curve import Curve
from study.design.study_file import RESPONSES, SCORED
from study.material.registry import is_dimensionless


def constants_only(extra: Mapping[str, Any]) -> bool:
    """Whether a case is a fit to resampled noise, which predicts nothing."""
    return int(extra.get("noise_seed") or 0) > 0


#: unit of every response that comes from curves
UNITS = {name: RESPONSES[name] for name in SCORED}


def rms_force_error(predicted: Curve, measured: Curve) -> float:
    """Root mean square of the difference in force, N, over the measured points."""
    return float(np.sqrt(np.mean(_residual(predicted, measured) ** 2)))


def relative_rms_force_error(predicted: Curve, measured: Curve) -> float:
    """RMS of the difference over the RMS of the measured force, %.

    Examples
    --------
    >>> measured = Curve(np.array([1.0, 2.0]), np.array([3.0, 4.0]))
    >>> predicted = Curve(np.array([1.0, 2.0]), np.array([3.3, 4.4]))
    >>> round(relative_rms_force_error(predicted, measured), 10)
    10.0
    """
    scale = float(np.sqrt(np.mean(measured.force_N**2)))
    return 100 * rms_force_error(predicted, measured) / scale


def peak_force_error(predicted: Curve, measured: Curve) -> float:
    """Absolute difference of the largest forces, N."""
    forces = predicted.force_at(measured.displacement_mm)
    return float(abs(forces.max() - measured.force_N.max()))


def work_error(predicted: Curve, measured: Curve) -> float:
    """Absolute difference of the work over the measured range, % of the measured work."""
    d = measured.displacement_mm
    work = float(np.trapezoid(measured.force_N, d))
    return 100 * abs(float(np.trapezoid(_residual(predicted, measured), d)) / work)


CURVE_RESPONSES: Mapping[str, Callable[[Curve, Curve], float]] = {
    "relative_rms_force_error": relative_rms_force_error,
    "rms_force_error": rms_force_error,
    "peak_force_error": peak_force_error,
    "work_error": work_error,
}


def constants_in_kPa(fit: Mapping[str, Any]) -> dict[str, tuple[float, str]]:  # noqa: N802
    """mu0 and every constant of a fit with its unit; exponents stay plain."""
    out: dict[str, tuple[float, str]] = {}
    if fit.get("mu0") is not None:
        out["mu0"] = (1000 * float(fit["mu0"]), "kPa")
    for name, value in fit.get("values", {}).items():
        out[name] = (float(value), "") if is_plain(name) else (1000 * float(value), "kPa")
    return out


def is_plain(name: str) -> bool:
    """Whether a constant is an exponent, a number without unit."""
    return is_dimensionless(name)


def averaged(values: Sequence[Mapping[str, tuple[float, str]]]) -> dict[str, dict[str, Any]]:
    """Mean over the directions (fit and score changed places), with units."""
    out: dict[str, dict[str, Any]] = {}
    for name in values[0]:
        numbers = [direction[name][0] for direction in values if name in direction]
        mean = float(np.mean(numbers))
        out[name] = {"value": mean if np.isfinite(mean) else None, "unit": values[0][name][1]}
    return out


def score(predicted: Curve, measured: Curve) -> dict[str, tuple[float, str]]:
    """Every response that comes from a pair of curves, with its unit."""
    return {n: (f(predicted, measured), UNITS[n]) for n, f in CURVE_RESPONSES.items()}


def step_uncertainty(predicted: Curve, measured: Curve) -> dict[str, float]:
    """Change of every response where the curve keeps every other load step only.

    The steps that are left out are twice as many as were solved; what is left of their effect in
    the response itself is a part of this change, since the interpolation between two steps gets
    better by more than twice when they are halved. Zero where the force is known everywhere
    (closed form), and nothing where one step is all there is.
    """
    if predicted.stiffness_N_per_mm is None:
        return dict.fromkeys(CURVE_RESPONSES, 0.0)
    if len(predicted) < 2:
        return {}
    rough = predicted.every_other_point()
    return {
        name: abs(response(predicted, measured) - response(rough, measured))
        for name, response in CURVE_RESPONSES.items()
    }


def _residual(predicted: Curve, measured: Curve) -> np.ndarray[Any, np.dtype[np.float64]]:
    return predicted.force_at(measured.displacement_mm) - measured.force_N
