"""Rigid registration, fitted spheres, distances to a surface, agreement of two methods."""
