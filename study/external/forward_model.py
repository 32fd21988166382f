"""What the harness asks of a forward model: the interface, and what a refinement of it is.

A cell of a design holds one such object, made of the tables of its file. The built-in mechanics
(:class:`study.simulation.cell.CellProblem`) is one; a program or a function of parameters alone
(:class:`study.external.parameters.ParameterProblem`) is another. Whoever expands, prices,
refines or reports a case asks the object, and needs to know none of its tables.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from study.external.forward_section import ForwardModel
    from study.mechanics.measurement.measurement_section import MarkerSpec, MeasurementSpec

#: value of a parameter: a number in the unit of its key, a text or a flag
Value = float | str | bool


@dataclass(frozen=True)
class Refinement:
    """The parameter that is the mesh size, step or tolerance of a stranger's solver."""

    #: Of the table ``[parameters]``.
    name: str
    #: Order in it that the solver promises; None where nobody says.
    formal_order: float | None = None

    def size(self, problem: ForwardCell) -> float:
        """Value of the parameter in a problem, in its own unit."""
        return float(problem.parameters[self.name])


@dataclass(frozen=True)
class PlacedFile:
    """A file that a case reads, as it was found on this machine."""

    path: str
    sha256: str
    #: Of the body that a surface encloses; other files have none.
    height_mm: float | None = None

    def document(self) -> dict[str, object]:
        """Plain values; the path names nothing, the sha256 does."""
        return {key: value for key, value in vars(self).items() if value is not None}


@dataclass(frozen=True, kw_only=True)
class ForwardCell(ABC):
    """What a cell computes, whatever computes it; a class of its own says what differs."""

    #: Program or function that predicts; None for the built-in model.
    forward: ForwardModel | None = None
    #: Values of the table ``[parameters]``, and the units of those that have one.
    parameters: Mapping[str, Value] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    #: Where measured curves are, and markers inside a specimen.
    measurements: MeasurementSpec | None = None
    markers: MarkerSpec | None = None
    #: File of the markers; None where nobody has looked for it.
    marker_file: PlacedFile | None = None
    #: The parameter that refines it; None where its mesh does, or nothing.
    refinement: Refinement | None = None

    @property
    def has_closed_form(self) -> bool:
        """Whether a closed form is its answer."""
        return False

    @property
    def calibrated_names(self) -> tuple[str, ...]:
        """Names of the constants that a fit may find; also responses."""
        return ()

    @property
    def depth_mm(self) -> float | None:
        """How far its test goes; None where that is open, or there is no test."""
        return None

    @property
    def is_homogeneous(self) -> bool:
        """Whether its answer has no numerical error that a refinement would show."""
        return self.refinement is None

    @property
    @abstractmethod
    def discretization(self) -> str:
        """Name of what its numerical error depends on: cells that share it share an order."""

    @abstractmethod
    def document(self) -> dict[str, object]:
        """Plain values in internal units: what is hashed, and read back from a disk."""

    def own_tables(self) -> dict[str, object]:
        """Tables of the user's own that go to a program: parameters and their units.

        A whole number has no decimals, in a template as in a function.
        """
        whole = {
            name: int(value)
            for name, value in self.parameters.items()
            if isinstance(value, float) and value.is_integer() and abs(value) < 2**53
        }
        return {"parameters": {**self.parameters, **whole}, "units": dict(self.units)}

    def with_parameter(self, name: str, value: Value) -> Self:
        """Copy with another value of one parameter."""
        return replace(self, parameters={**self.parameters, name: value})

    def value_at(self, key: str) -> float | None:
        """Return the number under a dotted key of the file, in internal units; None without one."""
        table, _, name = key.partition(".")
        value = self.parameters.get(name) if table == "parameters" else None
        return float(value) if type(value) in (int, float) else None  # type: ignore[arg-type]

    def with_value(self, key: str, value: float) -> Self:
        """Copy with another number under a dotted key that has one."""
        return self.with_parameter(key.partition(".")[2], value)

    def physical(self) -> dict[str, object]:
        """Part of the document that can change an answer: of a stranger's program all of it."""
        return self.document()
