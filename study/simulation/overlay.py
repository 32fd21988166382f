"""Dotted keys of a file: which exist, what dimension they have, how one is laid over a file."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from study.external.forward_model import ForwardModel
from study.external.parameters import is_parameter
from study.ground.declaration import MAX_NAME, keys_of, written_keys
from study.ground.diagnostics import Table
from study.ground.errors import nearest
from study.ground.units import INTERNAL
from study.mechanics.material.energy import Compressibility
from study.mechanics.material.material import ENERGIES, is_constant_key, is_dimensionless
from study.mechanics.measurement.measurement_section import MarkerSpec, MeasurementSpec
from study.mechanics.setup.calibration_table import Calibration
from study.mechanics.setup.geometry import INDENTERS, SPECIMENS, FaceMotion, Gravity
from study.mechanics.setup.setup import Model
from study.mechanics.setup.test_kind import Test
from study.simulation.material_table import MaterialTable


@dataclass(frozen=True)
class Place:
    """A table whose keys may differ between the cells of a design."""

    #: Every section that may stand there.
    sections: tuple[type, ...]
    #: Key that decides which others the table may have: a shape, or an energy.
    ruling: str = ""
    #: Keys of which the table may have one; laying one over it takes the others away.
    alternatives: tuple[str, ...] = ()
    #: Keys that may differ; all that the sections declare if it is empty.
    varying: tuple[str, ...] = ()

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys that may differ."""
        declared = (key for kind in self.sections for key in written_keys(kind))
        return self.varying or tuple(dict.fromkeys(declared))


_COMPRESSIBILITY = written_keys(Compressibility)
_MEASURED = ("file", "files", "range", "points", "zero", "toe", "sign", "displacement_zero",
             "direction", "branch", "cycle")  # fmt: skip
#: keys of the constants that the energies declare, those of two terms where there is a choice;
#: a key of one letter is near to every misspelt one, and is not suggested
_CONSTANTS = tuple(
    dict.fromkeys(
        key
        for energy in ENERGIES.values()
        for key in energy.list_keys or energy.constant_names(2 if energy.has_order else 1)
        if len(key) > 1
    )
)
_SHAPES: Mapping[str, Mapping[str, type]] = {"specimen": SPECIMENS, "test.indenter": INDENTERS}
#: every such table by its dotted name
PLACES: Mapping[str, Place] = {
    "specimen": Place(tuple(SPECIMENS.values()), "shape"),
    "test": Place((Test,)),
    "test.indenter": Place(tuple(INDENTERS.values()), "shape"),
    "test.motion": Place((FaceMotion,)),
    "test.gravity": Place((Gravity,)),
    "material": Place((MaterialTable, Compressibility), "model", _COMPRESSIBILITY),
    "model": Place((Model,), alternatives=("mesh", "mesh_size")),
    "measurements": Place((MeasurementSpec,), "", ("file", "files"), _MEASURED),
    "markers": Place((MarkerSpec,), varying=("plate",)),
    "calibration": Place((Calibration,), varying=("method",)),
    "forward": Place((ForwardModel,)),
}
#: tables that a preset set may be named after
TABLES = (*(name for name in PLACES if "." not in name), "parameters")
#: keys whose value is a table as a whole, with names that are no keys of ours
WHOLE = ("forward.files", "forward.curve", "forward.values")
#: dimension of a key of ``[parameters]``, which may have any unit
ANY = "parameter"
#: keys that may differ between the cells of a design, as they are suggested
VARYING = (
    *(f"{name}.{key}" for name, varying in PLACES.items() for key in varying.keys),
    *(f"material.{key}" for key in _CONSTANTS),
)
_REPLACED = r"calibration\.problem\."
#: what the value of a key measures, as its declaration says
_DIMENSIONS = {
    key.written: key.reads.dimension
    for name, varying in PLACES.items()
    if name != "measurements"  # how a file is read is no input with an uncertainty
    for table in varying.sections
    for key in keys_of(table)
    if key.reads is not None and key.reads.dimension
}


def may_vary(key: str) -> bool:
    """Whether a dotted key may be a factor or stand in a preset."""
    plain = re.sub(f"^{_REPLACED}", "", key)
    table, _, name = plain.partition(".")
    return plain in VARYING or (table == "material" and is_constant_key(name)) or is_parameter(key)


def suggestion(key: str) -> str:
    """Nearest dotted keys to a wrong one."""
    table = key.partition(".")[0]
    same = [k for k in VARYING if k.startswith(f"{table}.")]
    return nearest(key[:MAX_NAME], same or VARYING)


def dimension(key: str) -> str | None:
    """Dimension of a dotted key, ``"number"`` for a plain one, None where it has no value."""
    last = key.rpartition(".")[2]
    if key in ("measurements.displacement", "measurements.force"):
        return "length" if last == "displacement" else "force"
    if is_parameter(key):
        return ANY
    if not may_vary(key):
        return None
    if is_constant_key(last):
        return "number" if is_dimensionless(last) else "pressure"
    return _DIMENSIONS.get(last)


def lay(tables: Table, settings: Table) -> dict[str, object]:
    """Lay dotted keys over the tables of a file.

    A key takes away what cannot stand beside it: ``mesh`` a ``mesh_size`` (and the other
    ways round), a shape the sizes of another shape, an energy the constants of another.
    """
    merged = {name: _copied(table) for name, table in tables.items()}
    for key, value in settings.items():
        _make_room(merged, key, value)
    for key, value in settings.items():
        *path, last = key.split(".")
        node = merged
        for part in path:
            inner = node.get(part)
            if not isinstance(inner, dict):
                inner = node[part] = {}
            node = inner
        node[last] = _copied(value)
    return merged


def _copied(value: object) -> object:
    """Copy of a value as a file has it, in less than half the time of :func:`copy.deepcopy`."""
    if isinstance(value, dict):
        return {key: _copied(inner) for key, inner in value.items()}
    return [_copied(inner) for inner in value] if isinstance(value, list) else value


def _make_room(merged: dict[str, object], key: str, value: object) -> None:
    table, _, last = key.rpartition(".")
    name = re.sub(f"^{_REPLACED}", "", table)
    varying_table, node = PLACES.get(name), value_at(merged, table)
    if varying_table is None or not isinstance(node, dict):
        return
    if last in varying_table.alternatives:
        for other in varying_table.alternatives:
            node.pop(other, None)
    if last == varying_table.ruling:
        for other in [k for k in node if not _belongs(name, value, k)]:
            del node[other]


def value_at(tables: Table, path: str) -> object:
    """Value at a dotted path of nested tables; None where there is none."""
    node: object = tables
    for part in path.split("."):
        node = node.get(part) if isinstance(node, Mapping) else None
    return node


def _belongs(table: str, ruling: object, key: str) -> bool:
    """Whether a key may stay in a table whose shape or energy becomes ``ruling``."""
    if not isinstance(ruling, str):
        return True
    if table in _SHAPES:
        kind = _SHAPES[table].get(ruling)
        return kind is None or key not in PLACES[table].keys or key in written_keys(kind)
    if ruling not in ENERGIES or not is_constant_key(key):
        return True  # an unknown key stays, to be reported
    return ENERGIES[ruling].has_key(key)


def with_units(tables: Table, path: str = "") -> dict[str, object]:
    """Copy tables whose bare numbers, where a key has a dimension, are in mm, N, MPa, deg and s."""
    return {
        name: _measured(_key_meant(f"{path}{name}"), value, f"{path}{name}.")
        for name, value in tables.items()
    }


def _key_meant(path: str) -> str:
    """Key that the value at a dotted path of a file is one of: of a factor, of a preset, itself."""
    whose, _, rest = path.partition(".")
    if whose == "factors":
        return re.sub(r"\.(low|high)$", "", rest)
    if whose == "presets" and rest.count(".") >= 2:
        table, _, key = rest.split(".", 2)
        return f"{table}.{key}" if table in TABLES else key
    return path


#: times of a relaxation: its terms vary as a whole, so that no key of theirs is declared above
_TIMES = tuple(f"material.relaxation.{key}" for key in ("time", "from", "to"))


def _measured(key: str, value: object, path: str) -> object:
    """Value of a key with the unit that bare numbers have inside the program."""
    if isinstance(value, Mapping):
        return with_units(value, path)
    if isinstance(value, (list, tuple)):
        return [_measured(key, item, path) for item in value]
    value = getattr(value, "item", lambda: value)()  # a number of numpy becomes one of Python
    unit = INTERNAL.get("time" if key in _TIMES else dimension(key) or "")  # none of ANY
    is_bare = isinstance(value, (int, float)) and not isinstance(value, bool)
    return f"{value!r} {unit}" if unit and is_bare else value
