"""Tests: a compression between plates or an indentation, as a section and as a value."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import Field

from study.errors import Fault, InputError
from study.setup.geometry import Flat, Indenter
from study.setup.quantity import Length, integer
from study.setup.section import Reads, section
from study.setup.text import word

Kind = Literal["compression", "indentation"]
Interface = Literal["frictionless", "bonded"]

_CONDITIONS = "frictionless", "bonded"
_SYNONYMS = {"lubricated": "frictionless"}


@section
class TestSection:
    """How a specimen is loaded, as far as the file says it.

    Parameters
    ----------
    kind : {"compression", "indentation"}
        Between plates, or by a rigid body.
    interface : {"frictionless", "bonded"}
        What holds the specimen where it is loaded.
    base : {"frictionless", "bonded"}, optional
        What holds it below: as above in compression, bonded in indentation, unless given.
    displacement_mm : float, optional
        Final displacement; the end of the measured range may give it.
    steps : int
        Displacements at which the force is asked for.
    indenter : Flat, Cone or Sphere, optional
        Of an indentation.
    """

    __test__ = False  # not a pytest class

    kind: Annotated[Kind, word("compression", "indentation", mend="compression, ...")]
    interface: Annotated[
        Interface, word(*_CONDITIONS, synonyms=_SYNONYMS, mend="frictionless or bonded")
    ] = "frictionless"
    base: Annotated[Interface, word(*_CONDITIONS, synonyms=_SYNONYMS)] | None = None
    displacement_mm: Length | None = Field(default=None, validation_alias="displacement")
    steps: Annotated[int, Reads(integer(1, 10_000))] = 10
    indenter: Annotated[Any, Reads(lambda table: table)] = None

    @property
    def held_below(self) -> Interface:
        """Condition of the base, also where the file leaves it to the kind of the test."""
        if self.base is not None:
            return self.base
        return "bonded" if self.kind == "indentation" else self.interface

    def to_depth(self, displacement_mm: float | None = None) -> Test:
        """Test with its displacement.

        Parameters
        ----------
        displacement_mm : float, optional
            Where the section has none.

        Raises
        ------
        InputError
            If neither gives one.
        """
        depth = displacement_mm if self.displacement_mm is None else self.displacement_mm
        if depth is None:
            mend = "give it, or a measurements.range that ends where the test should"
            raise InputError(Fault("test.displacement", "the test needs a displacement", mend))
        pressed: Indenter | None = self.indenter if self.kind == "indentation" else None
        return Test(self.kind, float(depth), self.interface, self.held_below, self.steps, pressed)


@dataclass(frozen=True)
class Test:
    """How the specimen is loaded; the displacement is positive into the specimen."""

    __test__ = False  # not a pytest class

    kind: Kind
    displacement_mm: float
    interface: Interface = "frictionless"
    base: Interface = "frictionless"
    steps: int = 10
    indenter: Indenter | None = None

    @property
    def holds_face(self) -> bool:
        """Whether a flat indenter sticks: it has hold of all that it will hold at once."""
        return self.interface == "bonded" and isinstance(self.indenter, Flat)
