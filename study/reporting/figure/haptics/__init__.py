"""Figures of force laws and of what the sensors of a test must be."""
