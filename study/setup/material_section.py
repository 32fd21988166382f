"""Section ``[material]``: an energy, its constants as far as they are given, compressibility."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, cast

from pydantic import Field

from study.errors import Fault, InputError
from study.material.material import Material
from study.material.registry import constant_names
from study.setup.quantity import Pressure, number
from study.setup.section import Bad, Reads, section, section_of
from study.setup.text import flag


def _poisson_ratio(value: object) -> float:
    if value == 0.5 and not isinstance(value, bool):
        raise Bad("must be below 0.5, got 0.5", "write incompressible = true")
    return number(-1.0, 0.5)(value)


@section
class Compressibility:
    """How a material resists a change of volume; one of the three."""

    poisson_ratio: Annotated[float, Reads(_poisson_ratio, "number")] | None = None
    bulk_modulus_MPa: Pressure | None = Field(default=None, validation_alias="bulk_modulus")
    incompressible: Annotated[bool, Reads(flag)] = False


@dataclass(frozen=True)
class MaterialSection:
    """A material whose constants may have to be calibrated.

    Parameters
    ----------
    model : str
        Name of the energy.
    order : int or None
        Number of terms; None for an energy that has no choice.
    constants : mapping of str to float
        In MPa, exponents plain; empty where a calibration finds them.
    compressibility : Compressibility
        Of the material.
    """

    model: str
    order: int | None
    constants: Mapping[str, float]
    compressibility: Compressibility

    @classmethod
    def of(cls, resolved: Mapping[str, object]) -> MaterialSection:
        """Material of its resolved table, in internal units."""
        resistance = section_of("material", Compressibility, resolved)
        order = cast("int | None", resolved.get("order"))
        constants = cast("Mapping[str, float]", resolved.get("constants") or {})
        return cls(str(resolved["model"]), order, constants, resistance)

    @property
    def calibrated_names(self) -> tuple[str, ...]:
        """Names of the constants that a calibration of this material finds."""
        return tuple(self.constants or constant_names(self.model, self.order))

    def material(self, constants: Mapping[str, float] | None = None) -> Material:
        """Material with numbers.

        Parameters
        ----------
        constants : mapping of str to float, optional
            In MPa, instead of those of the section.

        Raises
        ------
        InputError
            If there are none.
        """
        values = self.constants if constants is None else constants
        if not values:
            mend = "give them or calibrate"
            raise InputError(Fault("material", "the constants are not known yet", mend))
        volume = self.compressibility
        return Material(
            model=self.model,
            constants=dict(values),
            bulk_modulus=volume.bulk_modulus_MPa,
            poisson_ratio=volume.poisson_ratio,
            incompressible=volume.incompressible,
        )
