"""Meshes of a setup: structured, graded, and inside a surface."""
