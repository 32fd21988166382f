"""Tests: a compression between plates or an indentation, as values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from study.setup.geometry import Flat, Indenter, Interface


@dataclass(frozen=True)
class Test:
    """How the specimen is loaded; the displacement is positive into the specimen."""

    __test__ = False  # not a pytest class

    kind: Literal["compression", "indentation"]
    displacement_mm: float
    interface: Interface = "frictionless"
    base: Interface = "frictionless"
    steps: int = 10
    indenter: Indenter | None = None

    @property
    def holds_face(self) -> bool:
        """Whether a flat indenter sticks: it has hold of all that it will hold at once."""
        return self.interface == "bonded" and isinstance(self.indenter, Flat)
