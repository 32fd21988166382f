"""Rigid motions between point sets and surfaces, with their covariance."""
