"""Calibration: constants from curves, by an optimizer that says how it ended."""

from study.calibration.levenberg_marquardt import LMResult, levenberg_marquardt
from study.calibration.status import EvaluationFailed, Status

__all__ = ["EvaluationFailed", "LMResult", "Status", "levenberg_marquardt"]
