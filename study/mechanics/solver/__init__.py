"""Equilibrium along a load path: Newton's method, linear solvers, gradients and energy."""
