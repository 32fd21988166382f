"""Numerical, input and validation uncertainty of a study."""
