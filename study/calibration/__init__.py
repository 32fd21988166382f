"""Calibration: constants from curves, by an optimizer that says how it ended."""

from study.calibration.evaluation import finite_difference
from study.calibration.fit import Fit, MeasuredCurve, aicc, fit, residual_function
from study.calibration.levenberg_marquardt import Iteration, LMResult, levenberg_marquardt
from study.calibration.profile import Profile, profile
from study.calibration.status import EvaluationFailed, Status

__all__ = [
    "EvaluationFailed",
    "Fit",
    "Iteration",
    "LMResult",
    "MeasuredCurve",
    "Profile",
    "Status",
    "aicc",
    "finite_difference",
    "fit",
    "levenberg_marquardt",
    "profile",
    "residual_function",
]
