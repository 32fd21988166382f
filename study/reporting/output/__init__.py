"""Pages, LaTeX, CSV and notebooks."""
