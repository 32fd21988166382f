"""Nuisance parameters of a calibration: declared, predicted with, fitted or propagated."""
