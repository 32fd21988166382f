"""Figures of curves: predictions on measurements in small multiples, and fits."""
