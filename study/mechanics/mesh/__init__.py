"""Meshes of specimens: structured, graded to the contact, and tetrahedra in solids."""
