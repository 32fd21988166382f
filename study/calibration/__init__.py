"""Calibration: constants from curves, by an optimizer that says how it ended."""
