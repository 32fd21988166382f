"""Measured force-displacement curves: read, conditioned and judged."""
