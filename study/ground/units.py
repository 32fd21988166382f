"""Units at the edge: ``"50 mm"`` and ``"5 kPa"`` become mm, N, MPa (N/mm^2), deg and s.

Common units come from a table of exact decimals, so that ``"5 kPa"`` and ``"0.005 MPa"``
are the same float and loading a design takes milliseconds; anything else is looked up by
pint. Numbers obey one strict grammar: ``float()`` would also take ``nan``, ``1_0`` and
Arabic digits.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from decimal import Decimal
from functools import lru_cache
from typing import Any

from study.ground.errors import Fault, InputError, UnitError, nearest

_D = Decimal
#: what one unit of every dimension is in the internal one, which stands first, as exact decimals
_FACTORS: Mapping[str, Mapping[str, str | Decimal]] = {
    "length": {"mm": "1", "cm": "10", "m": "1000", "um": "1e-3", "in": "25.4"},
    "force": {"N": "1", "mN": "1e-3", "kN": "1000", "gf": "9.80665e-3", "kgf": "9.80665"},
    "pressure": {
        **{"MPa": "1", "kPa": "1e-3", "Pa": "1e-6", "GPa": "1000"},
        **{"N/mm^2": "1", "N/m^2": "1e-6", "bar": "0.1"},
    },
    # pint counts an angle as a plain number and would take "30 %" for one: this table is all
    "angle": {"deg": "1", "degree": "1", "degrees": "1", "rad": repr(180 / math.pi)},
    "time": {"s": "1", "ms": "1e-3", "min": "60", "h": "3600"},
    "speed": {"mm/s": "1", "mm/min": _D(1) / _D(60), "um/s": "1e-3", "cm/s": "10", "m/s": "1000"},
    "stiffness": {"N/mm": "1", "N/m": "1e-3", "kN/m": "1", "kN/mm": "1000"},
    "work": {"N mm": "1", "N*mm": "1", "mJ": "1", "J": "1000"},
    "area": {"mm^2": "1", "cm^2": "100", "m^2": "1e6"},
    # as an angle, a plain number is no business of pint's
    "ratio": {"1": "1", "%": "0.01"},
    "memory": {"MB": "1", "GB": "1000", "MiB": "1.048576", "GiB": "1073.741824"},
    "density": {"kg/m^3": "1", "kg/m3": "1", "g/cm^3": "1000", "g/cm3": "1000", "g/mL": "1000"},
}
_TABLE = {
    name: {unit: _D(size) for unit, size in units.items()} for name, units in _FACTORS.items()
}
#: internal unit of every dimension
INTERNAL: Mapping[str, str] = {name: next(iter(units)) for name, units in _TABLE.items()}
#: dimensions of recorded quantities
RECORDED = ("length", "force", "pressure", "ratio", "time")
_EXAMPLE: Mapping[str, str] = {
    "length": "50 mm",
    "force": "0.02 N",
    "pressure": "5 kPa",
    "angle": "30 deg",
    "time": "60 s",
    "speed": "10 mm/min",
    "stiffness": "2 N/mm",
    "work": "3 N mm",
    "area": "25 mm^2",
    "ratio": "20 %",
    "memory": "20 GB",
    "density": "980 kg/m^3",
}
_NUMBER = re.compile(
    r"[+-]?(?:[0-9]{1,40}(?:\.[0-9]{0,40})?|\.[0-9]{1,40})(?:[eE][+-]?[0-9]{1,4})?"
)
# no unit begins where a number might go on: 12.5 is not 12. with a unit of 5
_QUANTITY = re.compile(rf"({_NUMBER.pattern})(?:[ \t]+|(?![0-9.,]))(\S(?:.*\S)?)", re.ASCII)

# No brackets and one digit of exponent: a unit is never worth an expression.
_WORD = r"[A-Za-z]+(?:(?:\*\*|\^)?-?[1-9])?"
_UNIT = re.compile(rf"{_WORD}(?:[ ]?[*/ ][ ]?{_WORD}){{0,3}}")
MAX_LENGTH = 80
_IN_BRACKETS = re.compile(r"[\[(]\s*([^\[\]()]+?)\s*[\])]$")


@contextmanager
def naming(where: str) -> Iterator[None]:
    """Context in which a fault of a value names the option, key or factor that the value is of."""
    try:
        yield
    except UnitError as error:
        raise InputError([replace(fault, where=where) for fault in error.faults]) from error


def is_unit(word: str) -> bool:
    """Whether a word is a unit of a recorded quantity."""
    for dimension in RECORDED:
        with suppress(UnitError):
            return bool(_factor(word, dimension))
    return False


def parse(text: object, dimension: str) -> float:
    """Value of a text such as ``"50 mm"`` in the internal unit of its dimension.

    Units: returns mm, N, MPa, deg, s, N/mm, N mm.

    Examples
    --------
    >>> parse("5 cm", "length"), parse("5 kPa", "pressure")
    (50.0, 0.005)
    """
    if not isinstance(text, str):
        raise _fault(f"needs a unit, got the bare value {text!r}", _mend(dimension, text))
    stripped = text.strip(" \t")
    if len(stripped) > MAX_LENGTH:
        raise _fault(f"is {len(stripped)} characters long", _mend(dimension))
    if _NUMBER.fullmatch(stripped):
        raise _fault(f"needs a unit, got {text!r}", _mend(dimension, stripped))
    match = _QUANTITY.fullmatch(stripped)
    if match is None:
        raise _fault(f"is not a number with a unit, got {text!r}", _mend(dimension))
    value = float(_D(match[1]) * _factor(match[2], dimension))
    if not math.isfinite(value):
        raise _fault(f"is too large, got {text!r}", _mend(dimension))
    return value


def unit_factor(unit: str, dimension: str) -> float:
    """Return how many internal units one ``unit`` is."""
    return float(_factor(unit, dimension))


def parse_percent(text: str) -> float:
    """Percentage in a text such as ``"1 %"``, in percent."""
    number, unit = split(text)
    if unit != "%":
        raise _fault(f"is not a percentage, got {text!r}", 'write, for example, "20 %"')
    return number


def split(text: str) -> tuple[float, str]:
    """Separate number and unit of a text such as ``5 % of mean``; the unit stays as written."""
    match = _QUANTITY.fullmatch(text.strip(" \t")) if isinstance(text, str) else None
    if match is None or len(text) > MAX_LENGTH or not math.isfinite(float(match[1])):
        raise _fault(f"is not a number with a unit, got {text!r}", 'write, for example, "2 pp"')
    return float(match[1]), " ".join(match[2].split())


def parse_number(text: str) -> float:
    """Finite plain number in a text, by the strict grammar."""
    if _NUMBER.fullmatch(text) and math.isfinite(value := float(text)):
        return value
    raise _fault(f"is not a finite number, got {text[:MAX_LENGTH]!r}", "")


def converted(value: float, unit: str, into: str) -> float:
    """Value of one unit in another of its dimension; ``""`` and ``"1"`` are plain numbers.

    Examples
    --------
    >>> converted(1.5, "kN", "N"), converted(2.0, "g/mL", "kg/m^3"), converted(3.0, "", "")
    (1500.0, 2000.0, 3.0)
    """
    first, second = _plain(unit), _plain(into)
    if first == second or {first, second} <= {"", "1"}:
        return value
    for table in _TABLE.values():
        if first in table and second in table:
            return float(_D(repr(value)) * table[first] / table[second])
    import pint

    for text in (first, second):
        if text and not is_known(text):
            raise _fault(f"has the unknown unit {text!r}", "write a unit such as kg, N/m or Pa s")
    try:
        quantity = _registry().Quantity(value, _registry().parse_units(first or "1"))
        return float(quantity.to(_registry().parse_units(second or "1")).magnitude)
    except pint.PintError as error:
        rule = f"is in {first or 'no unit'}, which is not of the kind of {second or 'no unit'}"
        raise _fault(rule, f"write it in {second or 'a plain number'}") from error


def agree(shown: str, declared: str) -> bool | None:
    """Whether two units are one by value; None where the first is none of the second's kind.

    Examples
    --------
    >>> agree("N/mm2", "MPa"), agree("kN", "N"), agree("tip", "N")
    (True, False, None)
    """
    try:
        return math.isclose(converted(1.0, shown, declared), 1.0, rel_tol=1e-9)
    except UnitError:
        return None


def unit_of_column(name: str) -> str:
    """Find what stands in the brackets that end the name of a column, a unit or not; "" without.

    Examples
    --------
    >>> unit_of_column("Kraft [mN]"), unit_of_column("stress (kPa)"), unit_of_column("y")
    ('mN', 'kPa', '')
    """
    match = _IN_BRACKETS.search(name)
    return "" if match is None else match[1]


@lru_cache(maxsize=256)
def is_known(unit: str) -> bool:
    """Whether a word is a unit of any dimension."""
    plain = _plain(unit)
    if any(plain in table for table in _TABLE.values()):
        return True
    if not _UNIT.fullmatch(plain.removeprefix("1/")):
        return False
    import pint

    try:
        _registry().parse_units(plain)
    except (pint.PintError, ValueError, TypeError, KeyError, AttributeError):
        return False
    return True


@lru_cache(maxsize=256)
def _factor(unit: str, dimension: str) -> Decimal:
    if dimension not in _TABLE:
        raise _fault(f"has no dimension {dimension!r}", nearest(dimension, _TABLE))
    table = _TABLE[dimension]
    plain = _plain(unit)
    factor = table.get(plain)
    if factor is not None:
        return factor
    other = next((d for d, units in _TABLE.items() if plain in units), None)
    if other is not None or dimension in ("angle", "ratio") or not _UNIT.fullmatch(plain):
        what = f"is a {other}" if other else "is no unit"
        raise _fault(f"must be a {dimension}, {unit!r} {what}", _mend(dimension, unit=plain))
    return _from_pint(plain, dimension)


def _plain(unit: str) -> str:
    """Spell a unit as the table above and pint do."""
    return " ".join(unit.split()).replace("²", "^2").replace("mm2", "mm^2")


def _from_pint(unit: str, dimension: str) -> Decimal:
    import pint

    registry = _registry()
    try:
        factor = registry.Quantity(1.0, registry.parse_units(unit)).to(INTERNAL[dimension])
        return _D(repr(float(factor.magnitude)))
    except pint.DimensionalityError as error:
        raise _fault(f"must be a {dimension}, {unit!r} is not", _mend(dimension)) from error
    except (pint.PintError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise _fault(f"has the unknown unit {unit!r}", _mend(dimension, unit=unit)) from error


@lru_cache(maxsize=1)
def _registry() -> Any:
    import pint

    return pint.UnitRegistry()


def _mend(dimension: str, value: object = None, unit: str | None = None) -> str:
    if isinstance(value, (str, int, float)) and not isinstance(value, bool):
        return f'write "{value} {INTERNAL[dimension]}" if it is in {INTERNAL[dimension]}'
    hint = f" ({nearest(unit, _TABLE[dimension])})" if unit else ""
    return f'write, for example, "{_EXAMPLE[dimension]}"{hint}'


def _fault(rule: str, mend: str) -> UnitError:
    return UnitError(Fault("value", rule, mend))


def listed(names: str | Sequence[str] | None) -> list[str]:
    """Names without the blanks around them, of a sequence or of a text with commas."""
    each = names.split(",") if isinstance(names, str) else names or ()
    return [name.strip() for name in each if name.strip()]


def times(ratio: float, digits: int = 3) -> str:
    """Write ``1,230 times`` to some digits, without an exponent below a million."""
    return f"{float(f'{ratio:.{digits}g}'):,.6g} times"


def written_p(p: float) -> str:
    """Write a p-value: three decimals, no leading zero, bounds at the ends."""
    if p < 0.0005:
        return "< .001"
    return "> .999" if p >= 0.9995 else f"{p:.3f}"[1:]


def p_phrase(p: float) -> str:
    """``p = .032`` or ``p < .001`` for a sentence."""
    text = written_p(p)
    return f"p {text}" if text[0] in "<>" else f"p = {text}"
