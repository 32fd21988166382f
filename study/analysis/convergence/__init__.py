"""Mesh convergence: observed order, Richardson extrapolation, grid convergence index."""
