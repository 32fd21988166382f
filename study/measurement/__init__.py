"""Measured files become curves."""
