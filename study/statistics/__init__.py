"""A table, an analysis, a response surface, a convergence series: no simulation in sight."""
