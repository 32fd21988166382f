"""Effects of factors: estimates, comparisons of levels, power."""
