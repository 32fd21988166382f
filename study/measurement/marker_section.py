"""The table ``[markers]``: marked points inside a specimen, at rest and in the states of a test."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal

from study import units
from study.errors import UnitError
from study.measurement.plain_text import Layout
from study.measurement.section import MAX_SKIPPED, csv_path
from study.setup.quantity import integer, shown, unit_of_length
from study.setup.section import Bad, Reads, keys_of, section
from study.setup.text import choice, name, names, text, word

#: what a plate is taken to do: as it was said to move, any rigid motion, and slip besides
PLATES = ("nominal", "rigid", "slipping")

Axes = tuple[str, str, str]

_STATE = 'for example "5 %" = { columns = ["x1", "y1", "z1"], displacement = "4 mm" }'


@dataclass(frozen=True)
class MarkedState:
    """Where markers were in one state of the test.

    Parameters
    ----------
    label : str
        Of the state.
    columns : tuple of str
        With the coordinates x, y and z.
    displacement_mm : float
        Said motion of the plate.
    """

    label: str
    columns: Axes
    displacement_mm: float


def _axes(value: object) -> Axes:
    found = names(value)
    if not isinstance(value, list) or len(found) != 3:
        mend = 'for example ["x0", "y0", "z0"]'
        raise Bad(f"must be the columns of x, y and z, got {shown(value)}", mend)
    return (found[0], found[1], found[2])


def _states(value: object) -> tuple[MarkedState, ...]:
    """Read every state of the test, by its label."""
    if not isinstance(value, Mapping) or not value:
        raise Bad(f"must be a table of states, got {shown(value)}", _STATE)
    return tuple(_state(name(label), table) for label, table in value.items())


def _state(label: str, table: object) -> MarkedState:
    if not isinstance(table, Mapping) or set(table) != {"columns", "displacement"}:
        raise Bad(f"state {label!r} must have columns and displacement, got {shown(table)}", _STATE)
    try:
        moved = units.parse(table["displacement"], "length")
    except UnitError as error:
        raise Bad(f"state {label!r}: {error.faults[0].rule}", error.faults[0].mend) from error
    if not moved > 0:
        raise Bad(f"state {label!r}: its displacement must be above 0", _STATE)
    return MarkedState(label, _axes(table["columns"]), moved)


def _layers(value: object) -> tuple[str, ...]:
    """Read labels of layers, which may be numbers."""
    items = value if isinstance(value, list) else [value]
    if any(isinstance(one, bool) or not isinstance(one, str | int) for one in items) or not items:
        raise Bad(f"must be labels of layers, got {shown(value)}", "for example fit = [1, 7]")
    return tuple(dict.fromkeys(str(one).strip() for one in items))


@section
class MarkerSpec:
    """Markers inside a specimen: where their places are, and how a plate is fitted to them.

    Parameters
    ----------
    file : str
        Table with one row a marker.
    rest : tuple of str
        Columns of x, y and z in the unloaded specimen.
    states : tuple of MarkedState
        Every state of the test: the same markers, measured again.
    unit : str
        Of the coordinates.
    axis : str
        Axis of the file that points up, from the base to the plate that moves.
    layer : str, optional
        Column that groups the markers.
    fit : tuple of str
        Layers that alone tell how the plate moved, where the others are to be predicted.
    plate : {"nominal", "rigid", "slipping"}
        What the responses take the plate to do.
    skip_lines : int
        Lines before the header.
    decimal : str
        Decimal mark.
    citation : str
        Printed in the report.
    """

    file: Annotated[str, Reads(csv_path, mend='for example file = "markers.csv"')]
    rest: Annotated[Axes, Reads(_axes, mend='for example rest = ["x0", "y0", "z0"]')]
    states: Annotated[tuple[MarkedState, ...], Reads(_states, mend=_STATE)]
    unit: Annotated[str, Reads(unit_of_length)] = "mm"
    axis: Annotated[str, word("z", "-z", "x", "-x", "y", "-y")] = "z"
    layer: Annotated[str | None, Reads(name)] = None
    fit: Annotated[tuple[str, ...], Reads(_layers)] = ()
    plate: Annotated[Literal["nominal", "rigid", "slipping"], word(*PLATES)] = "slipping"
    skip_lines: Annotated[int, Reads(integer(0, MAX_SKIPPED))] = 0
    decimal: Annotated[str, Reads(choice(".", ","))] = "."
    citation: Annotated[str, Reads(text)] = ""

    @property
    def layout(self) -> Layout:
        """How the file differs from plain CSV."""
        return Layout(self.skip_lines)

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the states."""
        return tuple(state.label for state in self.states)

    @property
    def deepest_mm(self) -> float:
        """Largest motion of the plate that was said."""
        return max(state.displacement_mm for state in self.states)

    def state(self, label: str) -> MarkedState:
        """State of a label, which must be one of :attr:`labels`."""
        return self.states[self.labels.index(label)]

    def as_dict(self) -> dict[str, object]:
        """Plain values, for JSON and for the names of cases."""
        return {**asdict(self), "states": [asdict(state) for state in self.states]}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> MarkerSpec:
        """Inverse of :meth:`as_dict`, also after a way through JSON; it may hold more."""
        known = {key.name for key in keys_of(cls)}
        values = {k: v for k, v in data.items() if k in known}
        values["rest"], values["fit"] = tuple(values["rest"]), tuple(values.get("fit") or ())
        values["states"] = tuple(
            MarkedState(s["label"], tuple(s["columns"]), s["displacement_mm"])
            for s in values["states"]
        )
        return cls(**values)
