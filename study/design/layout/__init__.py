"""Which combinations of levels are run."""
