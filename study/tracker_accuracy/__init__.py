"""A tracker against what is known: fixed distances, commanded displacements, a reference."""
