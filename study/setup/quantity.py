"""Quantities of a study file: numbers with a unit, and plain numbers, each with its range."""

from __future__ import annotations

import math
from collections.abc import Callable
from numbers import Real
from typing import Annotated

from study import units
from study.errors import UnitError
from study.setup.section import Bad, Reads

#: largest and smallest size of a quantity in internal units (mm, N, MPa, s): the fourth power of
#: a length still is a double
LARGEST = 1e12
SMALLEST = 1e-12


def shown(value: object) -> str:
    """Value as a message shows it, cut short.

    Parameters
    ----------
    value
        Anything; its ``repr`` is cut to 60 characters.
    """
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def quantity(
    dimension: str, low: float = 0.0, high: float = math.inf, *, closed: bool = False
) -> Callable[[object], float]:
    """Reader of a value with its unit, within a range.

    Parameters
    ----------
    dimension : str
        One of :data:`study.units.INTERNAL`.
    low, high : float
        Range in internal units; ``high`` is excluded, and ``low`` unless ``closed``.
    closed : bool
        Whether ``low`` itself is allowed.

    Returns
    -------
    callable
        Takes a text such as ``"5 mm"``, returns the number in internal units. It raises
        :class:`Bad` outside the range or for a size that no test has, and UnitError for a text
        that is no quantity of this dimension.
    """

    def read(value: object) -> float:
        number = units.parse(value, dimension)
        unit = units.INTERNAL[dimension]
        if number < low or (number == low and not closed):
            bound = "at least" if closed else "above"
            raise Bad(f"must be {bound} {low:g} {unit}, got {value!r}")
        if number >= high:
            raise Bad(f"must be below {high:g} {unit}, got {value!r}")
        if number and not SMALLEST <= abs(number) <= LARGEST:
            kind = "large" if abs(number) > LARGEST else "small"
            raise Bad(f"is too {kind} for any test, got {value!r}", "check its unit and exponent")
        return number

    return read


def measured(
    dimension: str,
    low: float = 0.0,
    high: float = math.inf,
    *,
    closed: bool = False,
    mend: str = "",
) -> Reads:
    """Declare a quantity: with its unit in a file, a number in internal units in Python.

    Parameters
    ----------
    dimension : str
        One of :data:`study.units.INTERNAL`.
    low, high : float
        Range in internal units; ``high`` is excluded, and ``low`` unless ``closed``.
    closed : bool
        Whether ``low`` itself is allowed.
    mend : str
        What to write where the key is missing.
    """
    return Reads(quantity(dimension, low, high, closed=closed), dimension, mend, finite)


def finite(value: object) -> float:
    """Take a number given in Python; a problem checks the range that it needs.

    Parameters
    ----------
    value
        As given, in internal units.

    Raises
    ------
    Bad
        If it is no finite real number.
    """
    if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(value):
        raise Bad(f"must be a finite number, got {shown(value)}")
    return float(value)


def number(
    low: float = -math.inf, high: float = math.inf, *, closed: bool = False, mend: str = ""
) -> Callable[[object], float]:
    """Reader of a finite plain number within a range.

    Parameters
    ----------
    low, high : float
        Ends of the range, both excluded unless ``closed``.
    closed : bool
        Whether both ends are allowed.
    mend : str
        What to write instead of a faulty value.

    Returns
    -------
    callable
        Raw value to float; raises :class:`Bad` for anything else, a text and a boolean included.
    """

    def read(value: object) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            hint = "it has no unit and no quotes" if isinstance(value, str) else ""
            raise Bad(f"must be a plain number, got {shown(value)}", mend or hint)
        if abs(value) > 1e300 or not math.isfinite(value):
            raise Bad(f"must be a finite number, got {shown(value)}")
        inside = low <= value <= high if closed else low < value < high
        if not inside:
            ends = "from {:g} to {:g}" if closed else "between {:g} and {:g} (excluded)"
            raise Bad(f"must be {ends.format(low, high)}, got {value!r}", mend)
        return float(value)

    return read


def integer(low: int, high: int) -> Callable[[object], int]:
    """Reader of a whole number within a range.

    Parameters
    ----------
    low, high : int
        Ends of the range, both allowed.

    Returns
    -------
    callable
        Raw value to int (``3.0`` is 3); raises :class:`Bad` for anything else.
    """

    def read(value: object) -> int:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise Bad(f"must be a whole number, got {shown(value)}")
        if not math.isfinite(value) or value != int(value):
            raise Bad(f"must be a whole number, got {shown(value)}")
        if not low <= value <= high:
            raise Bad(f"must be a whole number from {low} to {high}, got {shown(value)}")
        return int(value)

    return read


def unit_of_length(value: object) -> str:
    """Read the name of a unit of length.

    Parameters
    ----------
    value
        Raw value, such as ``"mm"``.

    Raises
    ------
    Bad
        If it is no text or no unit of length.
    """
    if not isinstance(value, str):
        raise Bad(f"must be a text, got {shown(value)}", 'for example unit = "mm"')
    try:
        units.parse(f"1 {value}", "length")
    except UnitError:
        raise Bad(f"is no unit of length: {shown(value)}", 'for example unit = "mm"') from None
    return value.strip()


#: a length above 0
Length = Annotated[float, measured("length")]
#: a length that may be 0, as that of a rounding
LengthOrZero = Annotated[float, measured("length", closed=True)]
#: a coordinate, of either sign
Coordinate = Annotated[float, measured("length", -math.inf)]
Pressure = Annotated[float, measured("pressure")]
Duration = Annotated[float, measured("time")]
Force = Annotated[float, measured("force")]
