"""Documents of problems: what stands in one is read as values, and copies with other values.

A document is what is hashed and what a worker gets; :class:`study.mechanics.setup.setup.Setup`,
:class:`study.mechanics.setup.material_section.MaterialSection` and the functions here read it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from study.mechanics.forward.closed_form import height_and_area
from study.mechanics.measurement.measurement_section import MeasurementSpec
from study.mechanics.measurement.recording import Gauge
from study.mechanics.setup.declaration import table_of, with_table
from study.mechanics.setup.material_section import MaterialSection
from study.mechanics.setup.setup import Problem, Setup, Tables

#: tables that make a problem; ``forward`` stands there where another program predicts
PROBLEM = ("specimen", "test", "material", "model", "forward")


def calibrated_test(tables: Tables) -> Tables:
    """Document of the test whose curve gives the constants; empty where it is the case's own."""
    return table_of(table_of(tables, "calibration"), "problem")


def method_of(tables: Tables) -> str:
    """How the constants are found; without a word of it that is left to the program."""
    return str(table_of(tables, "calibration").get("method") or "auto")


def with_both(tables: Tables, name: str, **changes: object) -> dict[str, object]:
    """Copy a document with other values in one table, in the problem of the calibration too."""
    made, problem = with_table(tables, name, **changes), calibrated_test(tables)
    if problem and table_of(problem, name):
        made = with_table(made, "calibration", problem=with_table(problem, name, **changes))
    return made


#: Seed of the other mesh of a surface, whose difference tells how far a choice of meshes moves it.
OTHER_MESH = 1


def on_mesh(tables: Tables, **changes: object) -> dict[str, object]:
    """Copy a document with other keys of ``model``, in the problem of the calibration too.

    Examples
    --------
    >>> on_mesh({"model": {"space": "3d"}, "test": {}}, mesh_seed=1)
    {'model': {'space': '3d', 'mesh_seed': 1}, 'test': {}}
    """
    return with_both(tables, "model", **changes)


def with_placeholder(
    tables: Tables,
    depth_mm: float | None = None,
    *,
    C10_MPa: float = 1.0,  # noqa: N803
) -> Problem:
    """Problem with a neo-Hookean material in place of one that has yet to be found."""
    section = replace(MaterialSection.of(tables), model="neo-hookean", order=None, constants={})
    return Setup.of(tables).problem(section.material({"C10": C10_MPa}), depth_mm)


#: ends of keys in a document, which say the unit that a file leaves to its value
_SUFFIXES = ("", "_mm", "_mm2", "_MPa", "_deg", "_N", "_s", "_mm_per_s", "_kg_m3")


def value_named(table: Mapping[str, object], key: str) -> tuple[str, float] | None:
    """Return the number that a file has under a key, and its name in a document.

    Examples
    --------
    >>> value_named({"area_mm2": 100.0, "height_mm": 10.0}, "area")
    ('area_mm2', 100.0)
    """
    for name in (key, "height" if key == "length" else key):
        for suffix in _SUFFIXES:
            value = table.get(name + suffix)
            if isinstance(value, (int, float)) and not isinstance(value, bool):
                return name + suffix, float(value)
    return None


def measurements_of(tables: Tables) -> MeasurementSpec | None:
    """Where the measured curves of a problem are."""
    spec = tables.get("measurements")
    return spec if isinstance(spec, MeasurementSpec) else None


def own_tables(tables: Tables) -> dict[str, object]:
    """Tables of the user's own that go to a program: parameters and their units."""
    return {name: dict(table_of(tables, name)) for name in ("parameters", "units")}


def gauge_of(setup: Setup) -> Gauge | None:
    """Return what turns recorded strain and stress into displacement and force."""
    if setup.height_mm is None:
        return None
    height, area = height_and_area(setup.specimen)
    return Gauge(area, height, setup.kind.mode, setup.kind.sense, setup.is_homogeneous)
