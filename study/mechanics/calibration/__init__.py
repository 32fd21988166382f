"""Least squares of curves: Levenberg-Marquardt, covariance, identifiability, lack of fit."""
