"""A study opened, and what a report reads of it."""
