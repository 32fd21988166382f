"""Reports as files: HTML, CSV, LaTeX, PDF."""
