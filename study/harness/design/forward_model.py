"""What the harness asks of a forward model: the interface, and what a refinement of it is.

A cell of a design holds one such object, made of the tables of its file. The built-in mechanics
(:class:`study.harness.design.cell.CellProblem`) is one; a program or a function of parameters alone
(:class:`study.harness.design.parameters.ParameterProblem`) is another. Whoever expands, prices,
refines or reports a case asks the object, and needs to know none of its tables.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from study.harness.design.forward_section import ForwardModel
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

    def size(self, document: Mapping[str, object]) -> float:
        """Value of the parameter in the document of a case, in its own unit."""
        return float(_parameters(document)[self.name])  # type: ignore[arg-type]

    def refined(self, document: Mapping[str, object], size: float) -> dict[str, object]:
        """Copy of a document with another value."""
        return {**document, "parameters": {**_parameters(document), self.name: size}}

    def without(self, document: Mapping[str, object]) -> dict[str, object]:
        """Copy of a document without the parameter: cases that differ in it alone have one."""
        left = {k: v for k, v in _parameters(document).items() if k != self.name}
        return {**document, "parameters": left}


def _parameters(document: Mapping[str, object]) -> Mapping[str, object]:
    values = document["parameters"]
    if not isinstance(values, Mapping):
        raise TypeError("the document of a case has no table of parameters")
    return values


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
        """Plain values in internal units: what is hashed and handed to a worker."""

    def physical(self) -> dict[str, object]:
        """Part of the document that can change an answer: of a stranger's program all of it."""
        return self.document()

    def faults_in_design(self) -> Sequence[tuple[str, str, str]]:
        """Where, rule and mend of what has no place in a design of experiments."""
        return ()
