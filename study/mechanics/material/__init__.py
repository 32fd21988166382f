"""Strain energies, their stresses in homogeneous deformations, relaxation and stability."""
