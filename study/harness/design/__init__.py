"""The study file: tables, factors, layouts, cells, checks."""
