"""Equilibrium: Newton iterations, load steps, linear solvers and sensitivities."""
