"""Responses over numeric factors: quadratic surfaces and Gaussian-process emulators."""
