"""Numerical uncertainty of a study: refinement, inputs, spaces."""
