"""Differences: which two sets of cells a text compares, and which size of one matters.

``"material=ogden-1, range=60 % - material=neo-hookean, range=60 %"`` is the mean over all cells
of the first kind less that of the second; a factor that a side leaves out is averaged over.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from study.ground.errors import Fault, InputError, nearest

#: level of every factor that a side of a contrast names
Setting = Mapping[str, str]


def sides_of(text: str, levels: Mapping[str, Sequence[str]]) -> tuple[Setting, Setting]:
    """Read the two settings that a contrast such as ``stiff - soft`` compares."""
    parts = re.split(r"\s+[-\N{MINUS SIGN}]\s+", text.strip())
    if len(parts) != 2:
        mend = 'for example "material=stiff - material=soft"'
        raise InputError(Fault(f"contrast {text!r}", "needs two settings with ' - ' between", mend))
    first, second = (_setting(part, levels, text) for part in parts)
    if first == second:
        rule, mend = "compares a setting with itself", "name two settings that differ"
        raise InputError(Fault(f"contrast {text!r}", rule, mend))
    return first, second


def _setting(part: str, levels: Mapping[str, Sequence[str]], text: str) -> Setting:
    chosen: dict[str, str] = {}
    for item in part.split(","):
        named, _, level = (word.strip() for word in item.rpartition("="))
        holding = [
            f for f, its_levels in levels.items() if level in its_levels and named in ("", f)
        ]
        if len(holding) != 1:
            rule = f"{level!r} is a level of several factors" if holding else f"no level {level!r}"
            every = [f"{f}={name}" for f, its_levels in levels.items() for name in its_levels]
            mend = nearest(f"{named}={level}" if named else level, every)
            raise InputError(Fault(f"contrast {text!r}", rule, mend))
        chosen[holding[0]] = level
    return chosen


@dataclass(frozen=True)
class Threshold:
    """Smallest difference that matters: in the response's unit, or a fraction of the mean."""

    value: float
    relative: bool = False


@dataclass(frozen=True)
class Expected:
    """What was expected of a response before the study ran."""

    #: A factor matters, has a larger effect than another one, two interact, a cell (mean over all
    #: other factors) is the best, two cells differ by less than what matters, levels of a factor
    #: score better or need less than its others.
    kind: str
    #: One or two factors.
    factors: tuple[str, ...]
    #: One or two cells: labels by factor, joined by a tab where there are several.
    cells: tuple[Mapping[str, str], ...]
    #: What it is said of, and who said it.
    response: str
    source: str = ""
