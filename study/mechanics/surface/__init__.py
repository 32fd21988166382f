"""Closed triangulated surfaces: read, checked and made."""
