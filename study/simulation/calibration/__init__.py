"""Calibration of one material from several tests: search, resampling, nuisance, next test."""
