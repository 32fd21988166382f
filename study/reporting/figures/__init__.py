"""Figures: each computes a frame and draws it."""
