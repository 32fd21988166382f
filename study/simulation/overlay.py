"""Tables that cells may vary: that of a material, and dotted keys, how one is laid over a file.

Which constants there are says the energy of a material; all other keys are declared.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated

from study.external.forward_model import ForwardModel, is_parameter
from study.ground.declaration import (
    MAX_NAME,
    AsWritten,
    Bad,
    Faults,
    Field,
    Reads,
    Table,
    choice,
    integer,
    keys_of,
    noted,
    number,
    quantity,
    read_table,
    section,
    shown,
    written_keys,
)
from study.ground.errors import InputError, nearest
from study.ground.units import INTERNAL
from study.mechanics.material.energy import Compressibility, CompressibleEnergy, Energy
from study.mechanics.material.material import (
    ENERGIES,
    MODELS,
    constant_names,
    is_constant_key,
    is_dimensionless,
)
from study.mechanics.material.relaxation import MOST_TERMS
from study.mechanics.measurement.measurement_section import MarkerSpec, MeasurementSpec
from study.mechanics.setup.calibration_table import Calibration
from study.mechanics.setup.geometry import INDENTERS, SPECIMENS, FaceMotion, Gravity
from study.mechanics.setup.material_section import MaterialSection, RelaxationKey
from study.mechanics.setup.setup import Model
from study.mechanics.setup.test_kind import Test

# The key ``material.relaxation``: terms by which the stress fades, or a grid of their times.

_MEND = 'write [{ share = 0.3, time = "2 s" }], or { from = "0.1 s", to = "100 s", terms = 4 }'
_TIME = quantity("time")
#: shares from 0 to 1, each of the stress that a load has at once
_SHARE = number(0, 1, closed=True)


def _time(value: object) -> tuple[float, float]:
    """Read a time, or two between which it is to be found."""
    ends = value if isinstance(value, list) else [value, value]
    if len(ends) != 2:
        raise Bad(f"must be a time or two of them, got {shown(value)}", '["0.5 s", "20 s"]')
    low, high = (_TIME(end) for end in ends)
    if isinstance(value, list) and not low < high:
        raise Bad(f"must rise, got {shown(value)}", '["0.5 s", "20 s"]')
    return low, high


@section
class TermTable:
    """One term."""

    #: After which it has faded to 1/e, or two times between which a calibration finds it.
    time: Annotated[object, Reads(_time, mend='time = "2 s", or time = ["0.5 s", "20 s"]')]
    #: Of the instantaneous stress; left out where a calibration is to find it.
    share: Annotated[float | None, Reads(_SHARE)] = None


@section
class GridTable:
    """Times that a calibration is to find the shares of, even on a logarithmic scale."""

    to: Annotated[float, Reads(_TIME, "time", 'to = "100 s"')]
    terms: Annotated[int, Reads(integer(2, MOST_TERMS), mend="terms = 4")]
    first: Annotated[float, Reads(_TIME, "time", 'from = "0.1 s"')] = Field(validation_alias="from")


def relaxation_from(value: object, faults: Faults, path: str) -> tuple[RelaxationKey, ...]:
    """Read how the stress of a material fades."""
    if value is None:
        return ()
    if isinstance(value, Mapping):
        return _grid(value, faults, path)
    if not isinstance(value, list) or not 1 <= len(value) <= MOST_TERMS:
        faults.add(path, f"must be a list of 1 to {MOST_TERMS} terms, got {shown(value)}", _MEND)
        return ()
    terms = [_term(term, faults, f"{path}[{k}]") for k, term in enumerate(value)]
    given = math.fsum(term.share or 0.0 for term in terms)
    if given >= 1:
        rule = f"the shares add up to {given:g}: nothing of the stiffness would be left"
        faults.add(path, rule, "the sum of all shares must stay below 1")
    return tuple(terms)


def _term(value: object, faults: Faults, path: str) -> RelaxationKey:
    before = faults.mentions
    section = read_table(TermTable, value, path, faults)
    if faults.mentions > before or not isinstance(section.time, tuple):
        return RelaxationKey(None, 1.0)
    low, high = section.time
    if low < high:
        return RelaxationKey(section.share, math.sqrt(low * high), (low, high))
    return RelaxationKey(section.share, low)


def _grid(value: Table, faults: Faults, path: str) -> tuple[RelaxationKey, ...]:
    before = faults.mentions
    section = read_table(GridTable, value, path, faults)
    if faults.mentions > before:
        return ()
    if not section.first < section.to:
        rule = f"must be later than {section.first:g} s, got {section.to:g} s"
        faults.add(f"{path}.to", rule, "the grid runs from the shortest to the longest time")
        return ()
    step = (section.to / section.first) ** (1 / (section.terms - 1))
    return tuple(RelaxationKey(None, section.first * step**k) for k in range(section.terms))


#: keys of which a material has one
_COMPRESSIBILITY = written_keys(Compressibility)
#: value of a constant that could not be read: mu0 and all that follows from it are unknown then
_UNREAD = math.nan
_MOST_TERMS = 9


@section
class MaterialTable:
    """Keys of a material that do not depend on its energy."""

    model: Annotated[str, Reads(choice(*MODELS), mend=f"one of {', '.join(MODELS)}")]
    order: Annotated[int | None, Reads(integer(1, 9))] = None
    #: As written; see :func:`study.simulation.overlay.relaxation_from`.
    relaxation: AsWritten = None


def material_from(table: object, faults: Faults, path: str = "material") -> MaterialSection:
    """Read a material in MPa, exponents plain."""
    written: Table = table if isinstance(table, Mapping) else {}
    named = written.get("model")
    energy = ENERGIES.get(named) if isinstance(named, str) else None
    constants = [k for k in written if (energy.has_key if energy else is_constant_key)(k)]
    examples = energy.constant_names(3 if energy.has_order else 1) if energy else ()
    listed = energy.list_keys if energy else ()
    also = (*_COMPRESSIBILITY, *constants, *(listed or examples))
    section = read_table(MaterialTable, table, path, faults, also)
    volume = _compressibility(written, faults, path)
    if energy is None:
        return MaterialSection("", None, {}, volume)
    read = _terms if listed else _moduli
    values = read(energy, {key: written[key] for key in constants}, faults, path)
    order = _order(energy, section.order, values, faults, path)
    where = f"{path}.relaxation"
    fading = relaxation_from(section.relaxation, faults, where)
    if fading and (energy.small_strain or not energy.splits):
        rule = f"is one of an isochoric energy, which {energy.name} is not"
        mend = 'write model = "neo-hookean", or another energy with an isochoric part'
        faults.add(where, rule, mend)
    if isinstance(energy, CompressibleEnergy) and volume.poisson_ratio is None:
        fault = energy.without_poisson_ratio()
        faults.add(f"{path}.poisson_ratio", fault.rule, fault.mend)
    return MaterialSection(energy.name, order, values, volume, fading)


def _compressibility(written: Table, faults: Faults, path: str) -> Compressibility:
    volume = {key: value for key, value in written.items() if key in _COMPRESSIBILITY}
    given = [key for key, value in volume.items() if value is not False]
    mend = f"give one of {', '.join(_COMPRESSIBILITY)}"
    if not given:
        faults.add(f"{path}.poisson_ratio", "is missing", mend)
    first, *others = [key for key in _COMPRESSIBILITY if key in given] or [""]
    if others:
        faults.add(f"{path}.{first}", f"stands beside {' and '.join(others)}", mend)
    return read_table(Compressibility, volume, path, faults)


def _moduli(energy: Energy, given: Table, faults: Faults, path: str) -> dict[str, float]:
    """Constants of every energy but Ogden's; all of them, or none where they are calibrated."""
    modulus = quantity("pressure", 0.0 if energy.small_strain else -math.inf)
    moduli = {}
    for key in energy.ordered(given):
        read = number() if energy.is_dimensionless(key) else modulus
        value = noted(read, given[key], f"{path}.{key}", faults)
        moduli[key] = _UNREAD if value is None else value
    return moduli


def _terms(energy: Energy, given: Table, faults: Faults, path: str) -> dict[str, float]:
    """Constants of Ogden's energy: two lists with an entry for every term."""
    mu = _entries(given, "mu", quantity("pressure", -math.inf), faults, path)
    alpha = _entries(given, "alpha", number(-30, 30, closed=True), faults, path)
    for key in [key for key in energy.list_keys if given and key not in given][:1]:
        faults.add(f"{path}.{key}", "is missing", "give both lists, one entry for every term")
    if len(mu) != len(alpha) and mu and alpha:
        rule = f"has {len(alpha)} entries, mu has {len(mu)}"
        faults.add(f"{path}.alpha", rule, "one for every term")
    for i, value in enumerate(alpha, 1):
        if value == 0:
            rule = f"must not be zero (term {i})"
            faults.add(f"{path}.alpha", rule, "its energy has no such term")
    constants: dict[str, float] = {}
    for i, (modulus, exponent) in enumerate(zip(mu, alpha, strict=False), 1):
        constants |= {f"mu{i}": modulus, f"alpha{i}": exponent}
    return constants


def _entries(
    given: Table, key: str, read: Callable[[object], float], faults: Faults, path: str
) -> list[float]:
    values = given.get(key, [])
    if not isinstance(values, list) or len(values) > _MOST_TERMS or (key in given and not values):
        mend = 'mu = ["5 kPa"], alpha = [2.0]'
        faults.add(f"{path}.{key}", f"must be a list of 1 to {_MOST_TERMS} entries", mend)
        return []
    items = [noted(read, value, f"{path}.{key}[{i}]", faults) for i, value in enumerate(values)]
    return [_UNREAD if value is None else value for value in items]


def _order(
    energy: Energy, order: int | None, constants: Mapping[str, float], faults: Faults, path: str
) -> int | None:
    """Check the number of terms against the constants; None for energies that have no choice."""
    where = f"{path}.order"
    if not energy.has_order:
        if order not in (None, 1):
            faults.add(where, f"{energy.name} has no order, got {order}", "leave it out")
        _complete(energy, constants, None, faults, path)
        return None
    terms = energy.order_of(constants)
    if order is None and not terms:
        faults.add(where, "is missing", "give it, or the constants themselves")
    elif order is not None and terms and order != terms:
        rule = f"is {order}, but the constants given have {terms} terms ({', '.join(constants)})"
        faults.add(where, rule, "make them agree")
    elif terms:
        _complete(energy, constants, terms, faults, path)
    return order if order is not None else terms or None


def _complete(
    energy: Energy, constants: Mapping[str, float], terms: int | None, faults: Faults, path: str
) -> None:
    """Check that no constant is missing beside those given."""
    if not constants or energy.sparse:
        return
    try:
        names = constant_names(energy.name, terms)
    except InputError as error:
        faults.add(f"{path}.order", error.faults[0].rule)
        return
    for name in [name for name in names if name not in constants]:
        faults.add(f"{path}.{name}", "is missing", f"{energy.name} takes {', '.join(names)}")


# Dotted keys of a file: which exist, what dimension they have, how one is laid over a file.


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
