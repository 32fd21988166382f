"""Materials: energies declared once, their closed-form tests, conversions, stability."""

from study.material.conversions import CONVENTIONS, Converted, convert
from study.material.energies import ENERGIES, MODELS, Energy, constant_names
from study.material.material import Material
from study.material.stability import StabilityResult, check, stability

__all__ = [
    "CONVENTIONS",
    "ENERGIES",
    "MODELS",
    "Converted",
    "Energy",
    "Material",
    "StabilityResult",
    "check",
    "constant_names",
    "convert",
    "stability",
]
