"""Tables ``[position]``, ``[force]``, ``[requirement]`` of a file for ``study require``."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

from pydantic import Field

from study import units
from study.setup.quantity import integer, measured, number, shown
from study.setup.section import Bad, Reads, section

#: Most multiples of the given errors at which a Monte Carlo simulation is made.
MOST_MULTIPLES = 6


def fraction(value: object) -> float:
    """Read a share that may be zero: a plain number below 1, or percent.

    Parameters
    ----------
    value
        Raw value: a number from 0 to 0.999, or a text from 0 % to below 100 %.

    Raises
    ------
    Bad
        If it is outside, or neither a number nor a text.
    UnitError
        If it is a text that is no percentage.
    """
    if isinstance(value, str):
        share = units.parse_percent(value) / 100
        if not 0 <= share < 1:
            raise Bad(f"must be from 0 % to below 100 %, got {shown(value)}")
        return share
    return float(number(0, 0.999, closed=True, mend='for example "0.5 %"')(value))


def _accuracy(value: object) -> float:
    share = fraction(value)
    if share == 0:
        raise Bad("must be above 0: no sensor reaches it", 'for example "5 %"')
    return share


def _multiples(value: object) -> tuple[float, ...]:
    items = value if isinstance(value, list) else [value]
    if not 0 < len(items) <= MOST_MULTIPLES:
        raise Bad(f"must be 1 to {MOST_MULTIPLES} numbers, got {shown(value)}", "[1, 3]")
    return tuple(dict.fromkeys(number(0, 100)(item) for item in items))


@section
class PositionAccuracy:
    """Errors of a tracker along the axis of the test, as standard uncertainties.

    Parameters
    ----------
    offset_mm : float
        Of its zero, the same in all rows of a test.
    scale : float
        Of its scale, a share of the displacement.
    noise_mm : float
        Of every row on its own.
    """

    offset_mm: Annotated[float, measured("length", closed=True)] = Field(
        default=0.0, validation_alias="offset"
    )
    scale: Annotated[float, Reads(fraction)] = 0.0
    noise_mm: Annotated[float, measured("length", closed=True)] = Field(
        default=0.0, validation_alias="noise"
    )


@section
class ForceAccuracy:
    """Errors of a force sensor, as standard uncertainties.

    Parameters
    ----------
    zero_N : float
        Of its zero, the same in all rows of a test.
    scale : float
        Of its scale, a share of the force.
    noise_N : float
        Of every row on its own.
    """

    zero_N: Annotated[float, measured("force", closed=True)] = Field(
        default=0.0, validation_alias="zero"
    )
    scale: Annotated[float, Reads(fraction)] = 0.0
    noise_N: Annotated[float, measured("force", closed=True)] = Field(
        default=0.0, validation_alias="noise"
    )


@section
class Requirement:
    """What is asked of the constants, and how it is checked.

    Parameters
    ----------
    accuracy : float
        Wanted expanded uncertainty over the value.
    coverage : float
        Coverage factor k: expanded over standard uncertainty (JCGM 100:2008, 6.2).
    points : int
        Rows of the test, even in displacement, that enter the fit with one weight.
    samples : int
        Tests of each Monte Carlo simulation; 0 for none.
    multiples : tuple of float
        Multiples of the given errors at which one is made.
    """

    accuracy: Annotated[float, Reads(_accuracy)] = 0.05
    coverage: Annotated[float, Reads(number(0, 10))] = 2.0
    points: Annotated[int, Reads(integer(2, 100_000))] = 100
    samples: Annotated[int, Reads(integer(0, 1_000_000))] = 200
    multiples: Annotated[tuple[float, ...], Reads(_multiples)] = (1.0, 3.0)


def multiplied(
    position: PositionAccuracy, force: ForceAccuracy, multiple: float
) -> tuple[PositionAccuracy, ForceAccuracy]:
    """Return both sensors with all errors so many times as large.

    Parameters
    ----------
    position, force : PositionAccuracy, ForceAccuracy
        Standard uncertainties of both sensors.
    multiple : float
        Factor of all of them, scales included.
    """
    return (
        replace(
            position,
            offset_mm=multiple * position.offset_mm,
            scale=multiple * position.scale,
            noise_mm=multiple * position.noise_mm,
        ),
        replace(
            force,
            zero_N=multiple * force.zero_N,
            scale=multiple * force.scale,
            noise_N=multiple * force.noise_N,
        ),
    )
