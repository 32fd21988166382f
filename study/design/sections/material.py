"""The table ``[material]``: an energy, its constants as far as given, compressibility, relaxation.

Which constants there are says the energy; all other keys are declared here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Annotated

from study.design.diagnostics import Faults, Table, noted, read_table
from study.design.sections.relaxation import relaxation_from
from study.errors import InputError
from study.material.energy import CompressibleEnergy, Energy
from study.material.registry import ENERGIES, MODELS, constant_names, is_constant_key
from study.setup.material_section import Compressibility, MaterialSection
from study.setup.quantity import integer, number, quantity
from study.setup.section import AsWritten, Reads, section, written_keys
from study.setup.text import choice

#: keys of which a material has one
_COMPRESSIBILITY = written_keys(Compressibility)
#: value of a constant that could not be read: mu0 and all that follows from it are unknown then
_UNREAD = math.nan
_MOST_TERMS = 9


@section
class MaterialTable:
    """Keys of a material that do not depend on its energy.

    Parameters
    ----------
    model : str
        Name of the energy.
    order : int, optional
        Number of its terms.
    relaxation
        As written; see :func:`study.design.sections.relaxation.relaxation_from`.
    """

    model: Annotated[str, Reads(choice(*MODELS), mend=f"one of {', '.join(MODELS)}")]
    order: Annotated[int | None, Reads(integer(1, 9))] = None
    relaxation: AsWritten = None


def material_from(table: object, faults: Faults, path: str = "material") -> MaterialSection:
    """Read a material in MPa, exponents plain.

    Parameters
    ----------
    table : mapping
        The table as written.
    faults : Faults
        Where faults go.
    path : str
        Of the table.

    Returns
    -------
    MaterialSection
        ``model`` is empty where it is faulty, and constants are nan.
    """
    written: Table = table if isinstance(table, Mapping) else {}
    named = written.get("model")
    energy = ENERGIES.get(named) if isinstance(named, str) else None
    constants = [k for k in written if (energy.has_key if energy else is_constant_key)(k)]
    examples = energy.constant_names(3 if energy.has_order else 1) if energy else ()
    listed = energy.list_keys if energy else ()
    also = (*_COMPRESSIBILITY, *constants, *(listed or examples))
    found = read_table(MaterialTable, table, path, faults, also)
    volume = _compressibility(written, faults, path)
    if energy is None:
        return MaterialSection("", None, {}, volume)
    read = _terms if listed else _moduli
    values = read(energy, {key: written[key] for key in constants}, faults, path)
    order = _order(energy, found.order, values, faults, path)
    where = f"{path}.relaxation"
    fading = relaxation_from(found.relaxation, faults, where)
    if fading and (energy.small_strain or not energy.splits):
        rule = f"is one of an isochoric energy, which {energy.name} is not"
        mend = 'write model = "neo-hookean", or another energy with an isochoric part'
        faults.add(where, rule, mend)
    if isinstance(energy, CompressibleEnergy) and volume.poisson_ratio is None:
        fault = energy.without_poisson_ratio()
        faults.add(f"{path}.poisson_ratio", fault.rule, fault.mend)
    return MaterialSection(energy.name, order, values, volume, fading)


def _compressibility(written: Table, faults: Faults, path: str) -> Compressibility:
    own = {key: value for key, value in written.items() if key in _COMPRESSIBILITY}
    given = [key for key, value in own.items() if value is not False]
    mend = f"give one of {', '.join(_COMPRESSIBILITY)}"
    if not given:
        faults.add(f"{path}.poisson_ratio", "is missing", mend)
    first, *others = [key for key in _COMPRESSIBILITY if key in given] or [""]
    if others:
        faults.add(f"{path}.{first}", f"stands beside {' and '.join(others)}", mend)
    return read_table(Compressibility, own, path, faults)


def _moduli(energy: Energy, given: Table, faults: Faults, path: str) -> dict[str, float]:
    """Constants of every energy but Ogden's; all of them, or none where they are calibrated."""
    modulus = quantity("pressure", 0.0 if energy.small_strain else -math.inf)
    found = {}
    for key in energy.ordered(given):
        read = number() if energy.is_dimensionless(key) else modulus
        value = noted(read, given[key], f"{path}.{key}", faults)
        found[key] = _UNREAD if value is None else value
    return found


def _terms(energy: Energy, given: Table, faults: Faults, path: str) -> dict[str, float]:
    """Constants of Ogden's energy: two lists with an entry for every term."""
    mu = _entries(given, "mu", quantity("pressure", -math.inf), faults, path)
    alpha = _entries(given, "alpha", number(-30, 30, closed=True), faults, path)
    missing = [key for key in energy.list_keys if key not in given]
    if given and missing:
        faults.add(
            f"{path}.{missing[0]}", "is missing", "give both lists, one entry for every term"
        )
    if len(mu) != len(alpha) and mu and alpha:
        rule = f"has {len(alpha)} entries, mu has {len(mu)}"
        faults.add(f"{path}.alpha", rule, "one for every term")
    for i, value in enumerate(alpha, 1):
        if value == 0:
            rule = f"must not be zero (term {i})"
            faults.add(f"{path}.alpha", rule, "its energy has no such term")
    found: dict[str, float] = {}
    for i, (modulus, exponent) in enumerate(zip(mu, alpha, strict=False), 1):
        found |= {f"mu{i}": modulus, f"alpha{i}": exponent}
    return found


def _entries(
    given: Table, key: str, read: Callable[[object], float], faults: Faults, path: str
) -> list[float]:
    values = given.get(key, [])
    if not isinstance(values, list) or len(values) > _MOST_TERMS or (key in given and not values):
        mend = 'mu = ["5 kPa"], alpha = [2.0]'
        faults.add(f"{path}.{key}", f"must be a list of 1 to {_MOST_TERMS} entries", mend)
        return []
    found = [noted(read, value, f"{path}.{key}[{i}]", faults) for i, value in enumerate(values)]
    return [_UNREAD if value is None else value for value in found]


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
    for name in names:
        if name not in constants:
            faults.add(f"{path}.{name}", "is missing", f"{energy.name} takes {', '.join(names)}")
