"""Surfaces over numeric factors: of a table, of a study, at levels of other factors, their page."""
