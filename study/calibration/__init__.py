"""Calibration: constants from curves, by an optimizer that says how it ended."""

from study.calibration.evaluation import finite_difference
from study.calibration.fit import Fit, MeasuredCurve, aicc, fit, residual_function
from study.calibration.lack_of_fit import (
    LackOfFit,
    Pattern,
    Repeated,
    akaike_weights,
    lack_of_fit,
    pattern,
    same_constants,
)
from study.calibration.levenberg_marquardt import LMResult, levenberg_marquardt
from study.calibration.profile import Profile, profile
from study.calibration.search import Iteration
from study.calibration.status import EvaluationFailed, Status

__all__ = [
    "EvaluationFailed",
    "Fit",
    "Iteration",
    "LMResult",
    "LackOfFit",
    "MeasuredCurve",
    "Pattern",
    "Profile",
    "Repeated",
    "Status",
    "aicc",
    "akaike_weights",
    "finite_difference",
    "fit",
    "lack_of_fit",
    "levenberg_marquardt",
    "pattern",
    "profile",
    "residual_function",
    "same_constants",
]
