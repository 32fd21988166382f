"""The table ``[nuisance]`` of a calibration file: what moves the constants and is none of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Annotated

from study import units
from study.design.diagnostics import Faults, entries, noted, read_table
from study.errors import nearest
from study.setup.quantity import number, shown
from study.setup.section import AsWritten, Bad, Reads, section, written_keys
from study.setup.text import choice

OFFSET = "displacement_offset"
ZERO = "force_zero"
FRICTION = "friction"

#: dimension of the parameters that are no input of the simulation, and whether every curve has
#: its own unless the file says otherwise
_OWN = {OFFSET: ("length", "curve"), ZERO: ("force", "curve"), FRICTION: ("number", "all")}

#: tables whose numbers may be uncertain
_TABLES = ("specimen", "test.indenter", "material")

_EXAMPLE = '{ uncertainty = "0.1 mm" }'


@dataclass(frozen=True)
class NuisanceInput:
    """A nuisance parameter of one test, in internal units.

    Parameters
    ----------
    value : float or None
        What is expected; None for an input of the simulation, which has its value elsewhere.
    uncertainty : float or None
        Standard uncertainty before the fit; None where nothing is known.
    relative : bool
        Whether the uncertainty is a share of the value.
    treat : {"fitted", "propagated"}
        Whether the tests may move it.
    each : {"curve", "test", "all"}
        What has a value of its own.
    """

    value: float | None
    uncertainty: float | None
    relative: bool
    treat: str
    each: str


@section
class NuisanceTable:
    """One entry of ``[nuisance]``.

    Parameters
    ----------
    uncertainty
        Standard uncertainty before the fit, or a share of the value; without one nothing is known.
    value
        What is expected, where the file does not say it elsewhere.
    treat : {"fitted", "propagated"}, optional
        By default offset, zero and friction are fitted and inputs propagated.
    each : {"curve", "test", "all"}, optional
        What has a value of its own: every curve, every test, or none.
    """

    uncertainty: AsWritten = None
    value: AsWritten = None
    treat: Annotated[str | None, Reads(choice("fitted", "propagated"))] = None
    each: Annotated[str | None, Reads(choice("curve", "test", "all"))] = None


def nuisance_from(
    table: object, dimension: Callable[[str], str | None], path: str, faults: Faults
) -> dict[str, NuisanceInput]:
    """Read the declarations of nuisance parameters, by key.

    Parameters
    ----------
    table : mapping or None
        As written: the key and ``{ uncertainty, value, treat, each }`` or the uncertainty alone.
    dimension : callable
        Dimension of a dotted key of the file, None where it has no value.
    path : str
        Of the table.
    faults : Faults
        Where faults go.

    Returns
    -------
    dict of str to NuisanceInput
        Every parameter that is declared, by its dotted key.
    """
    found: dict[str, NuisanceInput] = {}
    for key, raw in _flat(entries(table, path, faults)).items():
        where = f"{path}.{key}"
        measured = noted(_dimension(dimension), key, where, faults)
        written = raw if isinstance(raw, Mapping) else {"uncertainty": raw}
        asked = read_table(NuisanceTable, written, where, faults)
        if measured is None:
            continue
        reader = _uncertainty(measured, key)
        uncertainty, relative = (
            (None, False)
            if asked.uncertainty is None
            else noted(reader, asked.uncertainty, f"{where}.uncertainty", faults) or (None, False)
        )
        value = _value(key, asked.value, measured, where, faults)
        usual, each = ("fitted", _OWN[key][1]) if key in _OWN else ("propagated", "all")
        treat = asked.treat or usual
        if asked.uncertainty is None and treat == "propagated":
            rule = "is propagated, which needs an uncertainty"
            faults.add(where, rule, f'write {_EXAMPLE}, or treat = "fitted"')
        found[key] = NuisanceInput(value, uncertainty, relative, treat, asked.each or each)
    return found


def of_test(
    shared: Mapping[str, NuisanceInput], own: Mapping[str, NuisanceInput]
) -> dict[str, NuisanceInput]:
    """Nuisance parameters of one test: its own, and those of the file that it does not replace.

    What all tests share is common to the tests that take it from the file; a test's own
    parameter is at most common to its curves.

    Parameters
    ----------
    shared, own : mapping of str to mapping
        Parameters of the file and of the test, by key, as :func:`nuisance_from` returns them.
    """
    within = {
        key: replace(one, each="curve" if one.each == "curve" else "test")
        for key, one in own.items()
    }
    return {**shared, **within}


def _flat(table: Mapping[str, object]) -> dict[str, object]:
    """Keys as they are dotted in the file: TOML nests ``specimen.height`` without quotes."""
    out: dict[str, object] = {}
    own = set(written_keys(NuisanceTable))
    for key, value in table.items():
        nested = isinstance(value, Mapping) and value and not own & set(value)
        if nested and isinstance(value, Mapping):
            out |= {f"{key}.{inner}": one for inner, one in _flat(value).items()}
        else:
            out[key] = value
    return out


def _dimension(of: Callable[[str], str | None]) -> Callable[[object], str]:
    def read(key: object) -> str:
        name = str(key)
        if name in _OWN:
            return _OWN[name][0]
        table = name.rpartition(".")[0]
        known = of(name) if table in _TABLES else None
        is_input = table != "material" or name.endswith((".poisson_ratio", ".bulk_modulus"))
        if known is None or not is_input:
            usual = (*_OWN, "specimen.height", "specimen.radius", "specimen.area",
                     "specimen.length", "material.poisson_ratio",
                     "material.bulk_modulus")  # fmt: skip
            raise Bad("is no nuisance parameter", nearest(name[:80], usual))
        return known

    return read


def _uncertainty(dimension: str, key: str) -> Callable[[object], tuple[float, bool]]:
    """Reader of a standard uncertainty: its value, and whether it is a share of the value."""

    def read(value: object) -> tuple[float, bool]:
        share = isinstance(value, str) and value.strip().endswith("%")
        if dimension == "number" and not share:
            return number(0.0)(value), False
        size = units.parse(value, "ratio" if share else dimension)
        if size <= 0:
            raise Bad(f"must be above 0, got {shown(value)}")
        if share and key in (OFFSET, ZERO):
            raise Bad(f"cannot be a share, got {shown(value)}", 'for example "0.02 N" or "0.1 mm"')
        return size, share

    return read


def _value(key: str, raw: object, dimension: str, where: str, faults: Faults) -> float | None:
    if key not in _OWN:
        if raw is not None:
            rule = "stands beside the input itself"
            faults.add(f"{where}.value", rule, f"leave it out, and change {key}")
        return None
    if key == FRICTION:
        mend = "0 as frictionless plates, 1 as bonded ones"
        if raw is None:
            faults.add(f"{where}.value", "is missing", mend)
            return None
        return noted(number(0, 1, closed=True, mend=mend), raw, f"{where}.value", faults)
    if raw is None:
        return 0.0

    def read(value: object) -> float:
        return units.parse(value, dimension)

    return noted(read, raw, f"{where}.value", faults)
