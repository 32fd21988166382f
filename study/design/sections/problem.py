"""The sections of a problem: specimen, test, material, model, in internal units.

Each function reads one table and returns plain values (mm, N, MPa, deg); None stands where
a fault was found, and every fault is in ``faults``. Checks of one table against another are
in :mod:`study.design.plausibility`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from study.design.diagnostics import Faults, noted, one_of, read_table
from study.design.reader import Section
from study.design.spec import Config
from study.design.study_file import ALTERNATIVES
from study.errors import InputError
from study.material.registry import ENERGIES, MODELS, constant_names, is_constant_key
from study.setup.geometry import INDENTERS, SPECIMENS
from study.setup.material_section import Compressibility
from study.setup.quantity import integer, number, quantity, shown
from study.setup.section import values_of, written_keys
from study.setup.setup import Model
from study.setup.test_section import TestSection
from study.setup.text import choice

PRESSURE = quantity("pressure")


def read_specimen(table: Any, faults: Faults, path: str = "specimen") -> Config:
    """Specimen: its shape and sizes in mm."""
    return _shaped(table, SPECIMENS, faults, path)


def _shaped(table: Any, kinds: Mapping[str, type], faults: Faults, path: str) -> Config:
    """Read a table whose shape says which keys it has."""
    if isinstance(table, Mapping) and "shape" in table:
        shape = noted(one_of(kinds), table["shape"], f"{path}.shape", faults)
        if shape is None:
            return {"shape": None}
        return {"shape": shape, **values_of(read_table(kinds[shape], table, path, faults))}
    if isinstance(table, Mapping):
        faults.add(f"{path}.shape", "is missing", f"one of {', '.join(kinds)}")
    else:
        faults.add(path, f"must be a table, got {shown(table)}", f"write [{path}]")
    return {"shape": None}


def read_test(table: Any, faults: Faults, path: str = "test") -> Config:
    """Read how the specimen is loaded; the displacement may be None, for the range to give it."""
    found = read_table(TestSection, table, path, faults)
    written = table if isinstance(table, Mapping) else {}
    pressed = found.kind == "indentation"
    out: Config = values_of(found)
    del out["indenter"]
    if "base" not in written:
        out["base"] = found.held_below
    if pressed and "indenter" not in written:
        faults.add(f"{path}.indenter", "is missing", "{ shape = ... } with flat|cone|sphere")
    if pressed and "indenter" in written:
        out["indenter"] = _shaped(written["indenter"], INDENTERS, faults, f"{path}.indenter")
    return out


def read_model(
    table: Any, faults: Faults, shape: str | None, ratio: float, path: str = "model"
) -> Config:
    """Discretization.

    Parameters
    ----------
    table : mapping
        The table as written.
    faults : Faults
        Where faults go.
    shape : str or None
        Shape of the specimen: a cylinder is axisymmetric unless the file says 3d.
    ratio : float
        Refinement ratio between coarse, medium and fine.
    path : str
        Of the table.
    """
    found = read_table(Model, table, path, faults)
    written = table if isinstance(table, Mapping) else {}
    usual = "axisymmetric" if shape == "cylinder" else "3d"
    out: Config = {
        "space": found.space if "space" in written else usual,
        "element_order": found.element_order,
        "element_shape": found.element_shape,
        "formulation": found.formulation,
    }
    if "mesh" in written and "mesh_size" in written:
        faults.add(f"{path}.mesh_size", "stands beside mesh", "give one of the two")
    named = {"mesh": found.mesh, "mesh_ratio": ratio}
    return out | (named if found.mesh_size_mm is None else {"mesh_size_mm": found.mesh_size_mm})


def read_material(table: Any, faults: Faults, path: str = "material") -> Config:
    """Energy, its constants in MPa as far as given, and the compressibility."""
    section = Section(table, path, faults)
    name = section.take("model", choice(*MODELS), mend=f"one of {', '.join(MODELS)}")
    order = section.take("order", integer(1, 9), None)
    section.take("mu", lambda value: value, None)
    section.take("alpha", lambda value: value, None)
    compressibility = _compressibility(section)
    if name is None:
        section.known += [key for key in section.table if is_constant_key(key)]
        section.finish()
        return {"model": None, "order": None, "constants": {}, **compressibility}
    constants = _ogden(section) if ENERGIES[name].list_keys else _moduli(section, name)
    order = _order(section, name, order, constants)
    return {"model": name, "order": order, "constants": constants, **compressibility}


def _compressibility(section: Section) -> Config:
    keys = written_keys(Compressibility)
    section.known += keys
    own = {key: value for key, value in section.table.items() if key in keys}
    found = read_table(Compressibility, own, section.path, section.faults)
    given = [k for k in ALTERNATIVES["material"] if k in section and section.table[k] is not False]
    listed = ", ".join(ALTERNATIVES["material"])
    if len(given) > 1:
        section.fault(given[0], f"stands beside {' and '.join(given[1:])}", f"give one of {listed}")
    if not given:
        section.fault("poisson_ratio", "is missing", f"give one of {listed}")
    if found.incompressible:
        return {"incompressible": True}
    if found.poisson_ratio is None and found.bulk_modulus_MPa is not None:
        return {"bulk_modulus_MPa": found.bulk_modulus_MPa}
    return {"poisson_ratio": found.poisson_ratio}


def _moduli(section: Section, name: str) -> dict[str, float]:
    """Constants of every energy but Ogden's; all of them, or none where they are calibrated."""
    declared = ENERGIES[name]
    read = PRESSURE if declared.small_strain else quantity("pressure", -math.inf)
    found = [k for k in section.table if declared.has_constant(k)]
    plain = number(-math.inf, math.inf)
    constants = {
        key: section.take(key, plain if declared.is_dimensionless(key) else read)
        for key in sorted(found, key=_rank)
    }
    for key in ("mu", "alpha"):
        section.known.remove(key)
    examples = constant_names(name, 3 if declared.has_order else None)
    section.finish(examples)
    return constants


def _rank(key: str) -> tuple[int, int, str]:
    """Order of polynomial constants: C10, C01, C20, C11, C02, ..."""
    digits = key.removeprefix("C")
    if not digits.isdigit():
        return (0, 0, key)
    i, j = int(digits[:-1]), int(digits[-1])
    return (i + j, j, key)


def _ogden(section: Section) -> dict[str, float]:
    section.finish(("mu", "alpha"))
    mu = _list(section, "mu", quantity("pressure", -math.inf))
    alpha = _list(section, "alpha", number(-30, 30, closed=True))
    if ("mu" in section) != ("alpha" in section):
        missing = "alpha" if "mu" in section else "mu"
        section.fault(missing, "is missing", "give both lists, one entry for every term")
    if len(mu) != len(alpha) and mu and alpha:
        section.fault("alpha", f"has {len(alpha)} entries, mu has {len(mu)}", "one for every term")
    for i, value in enumerate(alpha, 1):
        if value == 0:
            section.fault("alpha", f"must not be zero (term {i})", "its energy has no such term")
    terms = zip(mu, alpha, strict=False)
    return {
        f"{key}{i}": value
        for i, pair in enumerate(terms, 1)
        for key, value in zip(("mu", "alpha"), pair, strict=True)
    }


def _list(section: Section, key: str, read: Any) -> list[Any]:
    values = section.table.get(key, [])
    if not isinstance(values, list) or len(values) > 9 or (key in section and not values):
        section.fault(key, "must be a list of 1 to 9 entries", 'mu = ["5 kPa"], alpha = [2.0]')
        return []
    entry = Section({f"{key}[{i}]": v for i, v in enumerate(values)}, section.path, section.faults)
    return [entry.take(k, read) for k in entry.table]


def _order(
    section: Section, name: str, order: int | None, constants: Mapping[str, float]
) -> int | None:
    """Check the number of terms against the constants; None for energies that have no choice."""
    declared = ENERGIES[name]
    if not declared.has_order:
        if order not in (None, 1):
            section.fault("order", f"{name} has no order, got {order}", "leave it out")
        _complete(section, name, constants, None)
        return None
    terms = declared.order_of(constants)
    if order is None and not terms:
        section.fault("order", "is missing", "give it, or the constants themselves")
    elif order is not None and terms and order != terms:
        rule = f"is {order}, but the constants given have {terms} terms"
        section.fault("order", f"{rule} ({', '.join(constants)})", "make them agree")
    elif terms:
        _complete(section, name, constants, terms)
    return order if order is not None else terms or None


def _complete(
    section: Section, name: str, constants: Mapping[str, float], terms: int | None
) -> None:
    if not constants or ENERGIES[name].sparse:
        return
    try:
        missing = [n for n in constant_names(name, terms) if n not in constants]
    except InputError as error:
        section.fault("order", error.faults[0].rule)
        return
    for key in missing:
        section.fault(key, "is missing", f"{name} takes {', '.join(constant_names(name, terms))}")
