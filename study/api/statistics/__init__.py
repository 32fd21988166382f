"""Statistics of a study's records and of any tidy table."""
