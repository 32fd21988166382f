"""Figures of effects: their sizes, the means of levels and of cells, and interactions."""
