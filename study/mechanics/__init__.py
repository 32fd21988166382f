"""A material, a setup, a curve, a fit: usable without any design of experiments."""
