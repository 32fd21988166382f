"""The key ``material.relaxation``: terms by which the stress fades, or a grid of their times."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated

from pydantic import Field

from study.design.diagnostics import Faults, Table, read_table
from study.material.relaxation import MOST_TERMS
from study.setup.material_section import RelaxationKey
from study.setup.quantity import integer, number, quantity, shown
from study.setup.section import Bad, Reads, section

_MEND = 'write [{ share = 0.3, time = "2 s" }], or { from = "0.1 s", to = "100 s", terms = 4 }'
_TIME = quantity("time")

#: shares from 0 to 1, each of the stress that a load has at once
_SHARE = number(0, 1, closed=True)


def _time(value: object) -> tuple[float, float]:
    """Read a time, or two between which it is to be found."""
    ends = value if isinstance(value, list) else [value, value]
    if len(ends) != 2:
        raise Bad(f"must be a time or two of them, got {shown(value)}", '["0.5 s", "20 s"]')
    low, high = (_TIME(one) for one in ends)
    if isinstance(value, list) and not low < high:
        raise Bad(f"must rise, got {shown(value)}", '["0.5 s", "20 s"]')
    return low, high


@section
class TermTable:
    """One term.

    Parameters
    ----------
    share : float, optional
        Of the instantaneous stress; left out where a calibration is to find it.
    time : str or list of str
        After which it has faded to 1/e, or two times between which a calibration finds it.
    """

    time: Annotated[object, Reads(_time, mend='time = "2 s", or time = ["0.5 s", "20 s"]')]
    share: Annotated[float | None, Reads(_SHARE)] = None


@section
class GridTable:
    """Times that a calibration is to find the shares of, even on a logarithmic scale."""

    to: Annotated[float, Reads(_TIME, "time", 'to = "100 s"')]
    terms: Annotated[int, Reads(integer(2, MOST_TERMS), mend="terms = 4")]
    first: Annotated[float, Reads(_TIME, "time", 'from = "0.1 s"')] = Field(validation_alias="from")


def relaxation_from(value: object, faults: Faults, path: str) -> tuple[RelaxationKey, ...]:
    """Read how the stress of a material fades.

    Parameters
    ----------
    value
        As written; None where the key is left out.
    faults : Faults
        Where faults go.
    path : str
        Of the key.
    """
    if value is None:
        return ()
    if isinstance(value, Mapping):
        return _grid(value, faults, path)
    if not isinstance(value, list) or not 1 <= len(value) <= MOST_TERMS:
        faults.add(path, f"must be a list of 1 to {MOST_TERMS} terms, got {shown(value)}", _MEND)
        return ()
    found = [_term(one, faults, f"{path}[{k}]") for k, one in enumerate(value)]
    given = math.fsum(term.share or 0.0 for term in found)
    if given >= 1:
        rule = f"the shares add up to {given:g}: nothing of the stiffness would be left"
        faults.add(path, rule, "the sum of all shares must stay below 1")
    return tuple(found)


def _term(value: object, faults: Faults, path: str) -> RelaxationKey:
    known = len(faults)
    found = read_table(TermTable, value, path, faults)
    if len(faults) > known or not isinstance(found.time, tuple):
        return RelaxationKey(None, 1.0)
    low, high = found.time
    middle = math.sqrt(low * high) if low < high else low
    return RelaxationKey(found.share, middle, (low, high) if low < high else None)


def _grid(value: Table, faults: Faults, path: str) -> tuple[RelaxationKey, ...]:
    known = len(faults)
    found = read_table(GridTable, value, path, faults)
    if len(faults) > known:
        return ()
    if not found.first < found.to:
        rule = f"must be later than {found.first:g} s, got {found.to:g} s"
        faults.add(f"{path}.to", rule, "the grid runs from the shortest to the longest time")
        return ()
    step = (found.to / found.first) ** (1 / (found.terms - 1))
    return tuple(RelaxationKey(None, found.first * step**k) for k in range(found.terms))
