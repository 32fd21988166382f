"""Designs, cases, runs and records."""
