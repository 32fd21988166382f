"""Closed triangulated surfaces: read, checked and oriented."""
