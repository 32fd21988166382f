"""Materials: energies declared once, their closed-form tests, conversions, stability."""

from study.material.energies import ENERGIES, MODELS, Energy, constant_names
from study.material.material import Material

__all__ = [
    "ENERGIES",
    "MODELS",
    "Energy",
    "Material",
    "constant_names",
]
