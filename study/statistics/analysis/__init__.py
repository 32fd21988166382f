"""Analysis of a table: linear model, error strata, effects, assumptions, verdicts."""
