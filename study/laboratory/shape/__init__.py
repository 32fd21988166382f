"""Deformed shapes: a simulated body against scans and markers."""
