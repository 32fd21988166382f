"""Figures of residuals: four in one, against factors, influence."""
