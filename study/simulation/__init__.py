"""A test of a specimen as a case of a study: its tables, problem, fit, prediction, refinement."""
