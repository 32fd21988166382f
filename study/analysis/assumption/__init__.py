"""Assumptions of the analysis: residuals, normality, equal variances, robustness, missing cases."""
