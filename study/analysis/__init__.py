"""Statistics: the error term first, then tables, effects, assumptions and convergence."""
