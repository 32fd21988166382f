"""Tables of a problem: their dotted keys, how one is laid over a file, and the cell they make.

Which constants there are says the energy of a material; all other keys are declared. Values are
in mm, N, MPa and deg. Tables that cells of a design may vary are read where a cell is resolved;
every fault is noted.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated

from study.external.forward_model import (
    ForwardModel,
    ParameterProblem,
    Refinement,
    is_parameter,
    parameter_key,
    parameters_from,
    stands_alone,
)
from study.ground import units
from study.ground.declaration import (
    MAX_NAME,
    AsWritten,
    Bad,
    Duration,
    Faults,
    Field,
    Kind,
    Length,
    Reads,
    Schema,
    Table,
    all_about,
    choice,
    integer,
    is_known,
    keys_of,
    noted,
    number,
    quantity,
    read_table,
    read_variant,
    section,
    shown,
    slug,
    table_of,
    text,
    texts,
    values_of,
    with_values,
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
from study.mechanics.measurement.measurement_section import (
    KINEMATIC,
    KINETIC,
    SECOND,
    MarkerSpec,
    MeasurementSpec,
    groups_of,
)
from study.mechanics.setup.calibration_table import Calibration
from study.mechanics.setup.geometry import INDENTERS, SPECIMENS, FaceMotion, Gravity, Specimen
from study.mechanics.setup.material_section import MaterialSection, RelaxationKey
from study.mechanics.setup.setup import MESH_LEVELS, Model
from study.mechanics.setup.test_kind import TEST_KINDS, Test
from study.simulation import plausibility
from study.simulation.cell import Cell, CellProblem, folder_name
from study.simulation.response import RESPONSES

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
    #: As written; see :func:`relaxation_from`.
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


def dimension_of(key: str) -> str | None:
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
    unit = INTERNAL.get("time" if key in _TIMES else dimension_of(key) or "")  # none of ANY
    is_bare = isinstance(value, (int, float)) and not isinstance(value, bool)
    return f"{value!r} {unit}" if unit and is_bare else value


QUANTITIES = ("peak_force", "work", "curve_rms", *RESPONSES)
FORMATS = ("html", "pdf", "tex", "csv")


def _assumed(value: object) -> tuple[str, ...]:
    keys = texts("keys", "test.interface")(value)
    for key in keys:
        if key not in TABLES and not may_vary(key):
            raise Bad(f"names no input: {shown(key)}", suggestion(key))
    return keys


_refined_key = partial(parameter_key, 'key = "parameters.h"; [model] is refined without a key')


def _share(value: object) -> float:
    """Read a share: a plain number, or percent."""
    if not isinstance(value, str):
        return number(0, 1, mend='for example "1 %"')(value)
    percent = units.parse_percent(value)
    if 0 < percent < 100:
        return percent / 100
    raise Bad(f"must be between 0 % and 100 %, got {shown(value)}")


def _formats(value: object) -> tuple[str, ...]:
    """Read one format or several."""
    items = value if isinstance(value, list) else [value]
    return tuple(dict.fromkeys(choice(*FORMATS)(item) for item in items)) or ("html",)


@section
class StudyTable:
    """Name, question, seed and what is assumed; the name is by default that of the file."""

    #: Of its folder of results.
    name: Annotated[str, Reads(slug)] = ""
    #: What it is to answer; the report begins with it.
    question: Annotated[str, Reads(text)] = ""
    #: Of every random draw.
    seed: Annotated[int, Reads(integer(0, 2**32 - 1))] = 2011
    #: Inputs that nobody measured, by key.
    assumed: Annotated[tuple[str, ...], Reads(_assumed)] = ()


def default_name(source: str) -> str:
    """Name of a study that has none: that of its file."""
    stem = Path(source).stem if "\0" not in source else ""
    return folder_name(stem, "study")


@section
class Converge:
    """Mesh refinement: ratio, meshes, watched quantity, tolerance (a fraction), time budget."""

    ratio: Annotated[float, Reads(number(1, 10))] = 1.5
    levels: Annotated[int, Reads(integer(2, 10))] = 3
    qoi: Annotated[str, Reads(choice(*QUANTITIES))] = "peak_force"
    tolerance: Annotated[float | None, Reads(_share)] = None
    budget_s: Duration | None = None
    #: Mesh size, step or tolerance of a stranger's solver, and the order that it promises in it.
    key: Annotated[str | None, Reads(_refined_key)] = None
    formal_order: Annotated[float | None, Reads(number(0, 20))] = None


@section
class Report:
    """Formats of the report."""

    format: Annotated[tuple[str, ...], Reads(_formats)] = ("html",)


# ``[virtual]``: how carefully the true curve of virtual specimens is solved.


@section
class Virtual:
    """Discretization of the reference curve that virtual specimens follow."""

    #: Load steps of the curve; between them it is interpolated with its tangent.
    steps: Annotated[int, Reads(integer(1, 1000))] = 12
    #: Of its elements.
    element_order: Annotated[str, Reads(choice("quadratic", "linear"))] = "quadratic"
    #: Named mesh; without one, and without a size, one step finer than the finest of the design.
    mesh: Annotated[str | None, Reads(choice(*MESH_LEVELS))] = None
    #: Element size, instead of a named mesh.
    mesh_size_mm: Length | None = None

    @property
    def chooses_mesh(self) -> bool:
        """Whether the mesh is given here."""
        return self.mesh is not None or self.mesh_size_mm is not None


@section
class ProblemFile:
    """A file for one forward simulation."""

    schema: Schema
    study: StudyTable = StudyTable()
    specimen: AsWritten = None
    test: AsWritten = None
    material: AsWritten = None
    model: AsWritten = None
    converge: Converge = Converge()
    report: Report = Report()
    uncertainty: AsWritten = None


# Tables as written -> the problems of a cell or of a calibration.


#: key of a table, rule and mend
Broken = Iterator[tuple[str, str, str]]


def _sound(
    kind: type[Kind],
    table: object,
    path: str,
    faults: Faults,
    check: Callable[[Table, Kind], Broken],
) -> Kind | None:
    """Read a table and check its keys against one another; None where a fault was found."""
    before = faults.mentions
    section = read_table(kind, table, path, faults)
    for key, rule, mend in check(table, section) if isinstance(table, Mapping) else ():
        faults.add(f"{path}.{key}", rule, mend)
    return None if faults.mentions > before else section


def measurements_from(
    table: object, faults: Faults, path: str = "measurements"
) -> MeasurementSpec | None:
    """Read where measured curves are; None where a fault was found."""
    return _sound(MeasurementSpec, table, path, faults, _measurements_broken)


def _measurements_broken(table: Table, _: MeasurementSpec) -> Broken:
    yield from _columns_broken(table)
    if {"time", *SECOND} & set(columns := table_of(table, "columns")):
        yield from _course_broken(table, columns)
    given = [key for key in ("file", "files") if key in table]
    if len(given) != 1:
        rule = "stands beside file" if given else "is missing"
        yield "file" if not given else "files", rule, "give one of file and files"
    for key, other in (("fit", "score"), ("score", "fit")):
        if key in table and other not in table:
            yield other, f"is missing beside {key}", "give both, or neither"
    if table.get("swap") is True and "fit" not in table:
        yield "swap", "needs fit and score", "say which rows change places"
    block, files = table.get("block"), table.get("files")
    if isinstance(block, str) and isinstance(files, str) and block not in groups_of(files):
        rule = f"{block!r} is no group of the file names {shown(files)}"
        yield "block", rule, f"write {{{block}}} where its label stands"


def _columns_broken(table: Table) -> Broken:
    """One column says how far, one how hard, and each has its unit."""
    columns, units = table.get("columns"), table.get("units")
    no_row = table.get("unit_row") is not True
    if "units" not in table and no_row:
        yield "units", "is missing", 'for example units = { displacement = "mm", force = "N" }'
    if not isinstance(columns, Mapping):
        return
    for quantities, usual in ((KINEMATIC, "displacement"), (KINETIC, "force")):
        given = [key for key in quantities if key in columns]
        if not given:
            yield f"columns.{usual}", "is missing", "displacement and force"
        if len(given) > 1:
            rule = f"stands beside {given[0]}"
            yield f"columns.{given[1]}", rule, f"give one of {', '.join(quantities)}"
        needed = given[0] if given else usual
        if isinstance(units, Mapping) and needed not in units and no_row:
            unit = {**INTERNAL, "pressure": "kPa"}[quantities[needed]]
            yield f"units.{needed}", "is missing", f'for example {needed} = "{unit}"'
    biaxial = (*SECOND, *SECOND.values())
    first = next((key for key in biaxial if key in columns), None)
    for key in biaxial if first else ():
        if key not in columns:
            yield f"columns.{key}", f"is missing beside {first}", "a biaxial test has all four"
    if isinstance(units, Mapping) and "time" in columns and "time" not in units:
        yield "units.time", "is missing", 'for example time = "s"'


def _course_broken(table: Table, columns: Table) -> Broken:
    """Keep rules that take rows out, or move them, from tests whose course in time matters."""
    what = "a column of time" if "time" in columns else "two directions"
    rule = f"has no meaning for a test with {what}, whose rows all count"
    if table.get("points", "raw") != "raw":
        yield "points", rule, 'write points = "raw"'
    for key in ("range", "toe"):
        if key in table:
            yield key, rule, "leave it out"
    if table.get("zero") == "fit" or ("zero" in table and "time" not in columns):
        yield "zero", rule, 'write zero = "first"'


def _markers_broken(table: Table, markers: MarkerSpec) -> Broken:
    if markers.fit and "layer" not in table and set(table) <= set(written_keys(MarkerSpec)):
        yield "layer", "is missing beside fit", "name the column of the layers"


# Specimen, test and discretization of a cell, with the defaults that other tables decide.


def loading_from(table: object, faults: Faults, path: str = "test") -> Test:
    """Read how the specimen is loaded; the measured range may give the displacement later."""
    section = read_table(Test, table, path, faults)
    written: Table = table if isinstance(table, Mapping) else {}
    kind, where = TEST_KINDS.get(section.kind), f"{path}.indenter"
    base = section.base
    if "base" not in written:
        base = section.interface if kind is None else kind.usual_base(section.interface)
    indenter = None
    if kind is not None and kind.takes_indenter:
        if "indenter" in written:
            indenter = read_variant(INDENTERS, "shape", written["indenter"], where, faults)
        else:
            faults.add(where, "is missing", f"{{ shape = ... }} with {'|'.join(INDENTERS)}")
    return with_values(section, base=base, indenter=indenter)


def model_from(
    table: object, faults: Faults, shape: str, ratio: float, path: str = "model"
) -> Model:
    """Read the discretization."""
    section = read_table(Model, table, path, faults)
    written: Table = table if isinstance(table, Mapping) else {}
    if "mesh" in written and "mesh_size" in written:
        faults.add(f"{path}.mesh_size", "stands beside mesh", "give one of the two")
    usual = "axisymmetric" if shape == "cylinder" else "3d"
    space = section.space if "space" in written else usual
    return with_values(section, space=space, mesh_ratio=ratio)


def forward_from(table: object, faults: Faults, path: str = "forward") -> ForwardModel | None:
    """Read what predicts the curves; None for the built-in finite elements."""
    if table is None:
        return None
    section = read_table(ForwardModel, table, path, faults)
    if section.model is None or section.model == "fem":
        return None
    missing = None if section.argv is None else section.fault(path)
    if missing is not None:
        faults.add(missing.where, missing.rule, missing.mend)
    return section


# A cell, and a calibration, of such tables.

_CELL_TABLES = ("specimen", "test", "material", "model", "measurements", "markers", "forward")


def resolve(tables: Table, written: Table, converge: Converge, faults: Faults) -> Cell:
    """Resolve a cell: sections in internal units, the displacement filled from the range.

    ``written`` are the tables of the file, whose parameters say the units of those of the cell.
    """
    if stands_alone(tables):
        return Cell(_of_parameters(tables, written, converge, faults), "none")
    ratio = converge.ratio
    problem = resolve_problem(tables, faults, ratio)
    if "parameters" in tables:
        first = written.get("parameters")
        values, units = parameters_from(tables["parameters"], first, faults)
        problem = replace(problem, parameters=values, units=units)
    calibration = calibration_from(tables, bool(problem.material.constants), faults)
    other = None
    if calibration.problem is not None:
        replaced = {k: v for k, v in values_of(calibration.problem).items() if v is not None}
        places = {k: f"calibration.problem.{k}" for k in replaced}
        other = resolve_problem({**tables, **replaced}, faults, ratio, places)
    cell = Cell(problem, calibration.method or "auto", calibration.leave_out, other)
    if calibration.method is not None:
        _check_method(cell, problem, other or problem, faults)
    return cell


def _of_parameters(
    tables: Table, written: Table, converge: Converge, faults: Faults
) -> ParameterProblem:
    """Resolve a cell of parameters alone, which a program or a function predicts."""
    first = written.get("parameters", tables.get("parameters"))
    values, units = parameters_from(tables.get("parameters", {}), first, faults)
    forward = forward_from(tables.get("forward", {"model": "python"}), faults)
    if forward is None or not forward.is_external:
        if all_about(faults, "parameters"):
            rule = "predicts nothing of parameters alone"
            faults.add("forward.model", rule, 'write model = "command" or model = "python"')
        forward = ForwardModel(model="python")
    for name in ("measurements", "markers", "calibration"):
        if name in tables:
            mend = "leave it out, or describe [specimen], [test], [material] and [model]"
            faults.add(name, "has no meaning for parameters alone, without a material", mend)
    name = (converge.key or "").partition(".")[2]
    size = values.get(name)
    if name and (not isinstance(size, float) or size <= 0):
        rule = f"must be a positive number in every cell, parameters.{name} is {shown(size)}"
        mend = "name the mesh size, step or tolerance of your solver"
        if name not in values:
            rule, mend = f"[parameters] does not have {name!r}", nearest(name, values)
        faults.add("converge.key", rule, mend)
    refinement = Refinement(name, converge.formal_order) if name else None
    return ParameterProblem(parameters=values, units=units, forward=forward, refinement=refinement)


def resolve_problem(
    tables: Table,
    faults: Faults,
    ratio: float = 1.5,
    places: Mapping[str, str] | None = None,
    *,
    all_rows: bool = False,
) -> CellProblem:
    """Resolve specimen, test, material, model and measurements.

    With ``all_rows`` measured rows count as they are, unless a number of points is written.
    """
    at = {name: name for name in _CELL_TABLES} | dict(places or {})
    shaped = tables.get("specimen", {})
    specimen: Specimen = read_variant(SPECIMENS, "shape", shaped, at["specimen"], faults)
    written = tables.get("test", {})
    if specimen.shape == "homogeneous" and isinstance(written, Mapping):
        written = {"interface": "frictionless", **written}  # nothing holds a gauge section
    test = loading_from(written, faults, at["test"])
    material = material_from(tables.get("material", {}), faults, at["material"])
    model = model_from(tables.get("model", {}), faults, specimen.shape, ratio, at["model"])
    spec = None
    if "measurements" in tables:
        spec = measurements_from(tables["measurements"], faults, at["measurements"])
        chosen = "points" in table_of(tables, "measurements")
        if spec is not None and (all_rows or specimen.shape == "homogeneous") and not chosen:
            spec = replace(spec, points="raw")  # every row of a test of material counts
    forward = forward_from(tables.get("forward"), faults, at["forward"])
    marked, markers = tables.get("markers"), None
    if marked is not None:
        markers = _sound(MarkerSpec, marked, at["markers"], faults, _markers_broken)
    problem = CellProblem(
        specimen, test, material, model, measurements=spec, forward=forward, markers=markers
    )
    problem = _with_displacement(problem, tables, faults, at)
    plausibility.check(problem, faults, at)
    return problem


def _with_displacement(
    problem: CellProblem, tables: Table, faults: Faults, at: Mapping[str, str]
) -> CellProblem:
    """Take the end of the range for a displacement left out; both given must agree."""
    where = f"{at['test']}.displacement"
    given, high = problem.test.displacement_mm, _range_end(problem, faults, at)
    if problem.markers is not None:
        high = problem.markers.deepest_mm
    if given is None:
        _check_displacement(problem, tables, high, where, faults)
        return replace(problem, test=with_values(problem.test, displacement_mm=high))
    if high is not None and abs(high - given) > 1e-9 * high:
        source = (
            "the deepest of markers.states is" if problem.markers else "measurements.range ends at"
        )
        rule = f"{given:g} mm, but {source} {high:g} mm"
        faults.add(where, rule, "make them agree, or leave the displacement out")
    return problem


def _check_displacement(
    problem: CellProblem, tables: Table, high: float | None, where: str, faults: Faults
) -> None:
    """Note a displacement that nothing gives, unless what would give it is faulty itself."""
    spec, measured = problem.measurements, "measurements" in tables
    written = "displacement" in table_of(tables, "test")
    unread = measured and (
        spec is None
        or spec.range is not None
        or spec.points == "raw"
        or spec.columns.time is not None
        or spec.columns.is_biaxial
    )
    # markers say it, or are faulty themselves
    if high is None and not written and not unread and "markers" not in tables:
        mend = 'write displacement = "5 mm"' + (", or measurements.range" if measured else "")
        faults.add(where, "is missing", mend)


def _range_end(problem: CellProblem, faults: Faults, at: Mapping[str, str]) -> float | None:
    spec, height = problem.measurements, problem.height_mm
    if spec is None or spec.range is None:
        return None
    if spec.range.kind == "percent" and height is None and problem.specimen.shape != "surface":
        return None  # the height itself is faulty, and reported
    try:
        return spec.range.in_mm(height)[1]
    except InputError as error:
        fault = error.faults[0]
        faults.add(f"{at['measurements']}.range", fault.rule, fault.mend)
        return None


def calibration_from(tables: Table, given: bool, faults: Faults) -> Calibration:
    """Read ``[calibration]``; the method is ``auto`` unless the constants are given."""
    section = read_table(Calibration, tables.get("calibration", {}), "calibration", faults)
    if "method" in table_of(tables, "calibration"):
        return section
    return with_values(section, method="none" if given else "auto")


@dataclass(frozen=True)
class Identification:
    """What a design itself says of measured curves and of constants, before a level is laid."""

    measurements: MeasurementSpec | None = None
    calibration: Calibration = Calibration()


def identification_from(tables: Table) -> Identification:
    """Read the tables of a design; what is faulty in them is told of its cells."""
    given = any(map(is_constant_key, table_of(tables, "material")))
    measured, faults = tables.get("measurements"), Faults()
    return Identification(
        measurements_from(measured, faults) if measured else None,
        calibration_from(tables, given, faults),
    )


def _check_method(cell: Cell, problem: CellProblem, fitted: CellProblem, faults: Faults) -> None:
    material, test = problem.material, fitted.test
    if cell.method == "none":
        if not material.constants and material.model:
            mend = "give them, or let [calibration] find them"
            faults.add("material", "has no constants, and calibration.method is none", mend)
        if any(term.share is None or term.range_s for term in material.relaxation):
            rule = "has shares or times to be found, and calibration.method is none"
            faults.add("material.relaxation", rule, "give them, or let [calibration] find them")
        plausibility.check_stability(problem, faults)
        return
    if fitted.measurements is None:
        if not any("measurements" in f.where for f in faults):
            mend = "add [measurements], or give the constants"
            faults.add("measurements", "is missing: there is nothing to calibrate with", mend)
        return
    readable = is_known(test.kind, test.interface)
    if cell.method == "analytic" and readable and not fitted.is_homogeneous:
        rule = "analytic needs compression of a cylinder or block with both faces frictionless"
        faults.add("calibration.method", rule, 'write method = "auto" or "inverse-fem"')


@dataclass(frozen=True)
class LoadedProblem:
    """What a file of one forward simulation holds."""

    problem: CellProblem
    #: How its mesh is refined.
    converge: Converge = Converge()
