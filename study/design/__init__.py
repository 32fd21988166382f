"""Designs: TOML files become validated studies, cells and cases."""
