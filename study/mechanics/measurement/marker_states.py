"""Markers inside a block, read and laid into it: places at rest and in every state."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from study.ground.arrays import Array, Flags
from study.ground.errors import Fault, InputError
from study.ground.units import unit_factor
from study.mechanics.measurement.measurement_section import MarkerSpec
from study.mechanics.measurement.recording import read_table
from study.mechanics.setup.geometry import Block

#: fewest markers that can tell seven components of a motion from their own scatter
FEWEST_MARKERS = 12

#: largest displacement of a marker over the height of the specimen: beyond, a unit is wrong
_FARTHEST = 2.0

#: degree of the polynomial that any smooth displacement field is near to
_SMOOTH = 5


@dataclass(frozen=True)
class MarkerStates:
    """Markers of a specimen."""

    #: shape (n, 3); places at rest, mm: x and y from the axis of the specimen, z from its base.
    rest: Array
    #: shape (n, 3); displacements in every state, mm, by its label.
    moved: dict[str, Array]
    #: Layer of every marker; empty where the file has none.
    layers: tuple[str, ...]

    def within(self, labels: tuple[str, ...]) -> Flags:
        """Which markers lie in some layers; all of them where none is named."""
        if not labels:
            return np.ones(len(self.rest), dtype=bool)
        return np.isin(np.array(self.layers), labels)

    def localization_floor(self, label: str) -> float | None:
        """RMS distance of the displacements from a smooth field, mm: what no model can undercut.

        The field is a polynomial of the fifth degree in the places at rest, 56 terms a component,
        whose loss of degrees of freedom is given back.
        """
        scaled = (self.rest - self.rest.mean(axis=0)) / np.abs(np.ptp(self.rest, axis=0)).max()
        powers = [p for p in product(range(_SMOOTH + 1), repeat=3) if sum(p) <= _SMOOTH]
        terms = np.stack([np.prod(scaled ** np.array(p), axis=1) for p in powers], axis=1)
        left = len(self.rest) - len(powers)
        if left < len(powers):
            return None
        field = terms @ np.linalg.lstsq(terms, self.moved[label], rcond=None)[0]
        return float(np.sqrt(((self.moved[label] - field) ** 2).sum() / left))


def read_markers(spec: MarkerSpec, path: Path, specimen: Block) -> MarkerStates:
    """Read markers and lay them into a block, their middle at rest in its middle."""
    from study.mechanics.surface.closed_surface import turned_up

    where = f"markers.file: {path.name}"
    columns = [*spec.rest, *(c for state in spec.states for c in state.columns)]
    required = [*columns, *([spec.layer] if spec.layer else [])]
    table = read_table(path, spec.layout, required, path.name)
    factor = unit_factor(spec.unit, "length")

    def places(axes: tuple[str, str, str]) -> Array:
        numbers = np.column_stack([table.numbers(axis) for axis in axes])
        return turned_up(factor * numbers, spec.axis)

    rest = places(spec.rest)
    if len(rest) < FEWEST_MARKERS:
        rule = f"has {len(rest)} markers, at least {FEWEST_MARKERS} are needed"
        raise InputError(Fault(where, rule, "mark more points"))
    middle = np.array([0.0, 0.0, specimen.height_mm / 2])
    moved = {state.label: places(state.columns) - rest for state in spec.states}
    markers = MarkerStates(
        rest - rest.mean(axis=0) + middle, moved, table.text(spec.layer) if spec.layer else ()
    )
    _check_places(markers, specimen, where)
    _check_layers(markers, spec)
    return markers


def _check_places(markers: MarkerStates, specimen: Block, where: str) -> None:
    half = np.array([specimen.width_mm, specimen.depth_mm, specimen.height_mm]) / 2
    outside = int((np.abs(markers.rest - [0, 0, half[2]]) > half).any(axis=1).sum())
    if outside:
        count = f"{outside} of {len(markers.rest)}"
        rule = f"{count} markers lie outside the block, if their middle is its"
        raise InputError(Fault(where, rule, "check markers.unit, markers.axis and the specimen"))
    for label, moved in markers.moved.items():
        if np.linalg.norm(moved, axis=1).max() > _FARTHEST * specimen.height_mm:
            rule = f"state {label!r}: a marker moved by more than the block is high"
            raise InputError(Fault(where, rule, "check the columns of this state"))


def _check_layers(markers: MarkerStates, spec: MarkerSpec) -> None:
    if not spec.fit:
        return
    layers = tuple(dict.fromkeys(markers.layers))
    unknown = [layer for layer in spec.fit if layer not in layers]
    if unknown:
        rule = f"no marker is of layer {', '.join(unknown)}"
        raise InputError(Fault("markers.fit", rule, f"layers are {', '.join(layers[:30])}"))
    if set(layers) == set(spec.fit):
        rule = "names every layer, so that no marker is left to be predicted"
        raise InputError(Fault("markers.fit", rule, "name fewer layers"))
