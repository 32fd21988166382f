"""Finite elements: function spaces, material points, element forms and their assembly."""
