"""The effect of a term, as a report reads it from an analysis."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

MATTERS = "matters"
NO_DIFFERENCE = "no practical difference"
NOT_RESOLVED = "not resolved by the mesh"
CANNOT_TELL = "cannot tell"


@dataclass(frozen=True)
class Simple:
    """Difference (or ratio) of two levels at one setting of the other factors.

    ``interval`` is that of this one alone, ``simultaneous`` that of all of its factor together,
    ``u_num`` the bound of its numerical error.
    """

    first: str
    second: str
    at: tuple[tuple[str, str], ...]
    difference: float
    interval: tuple[float, float] | None
    simultaneous: tuple[float, float] | None
    u_num: float | None
    verdict: str


@dataclass(frozen=True)
class Effect:
    """A term's level means, and the largest difference between two of them.

    With ``ratio`` the difference, its interval and ``practical`` are ratios (1.1 is ten
    percent); otherwise they are in the response's unit. The interval is simultaneous.
    """

    term: str
    levels: tuple[str, ...]
    means: tuple[float | None, ...]
    difference: float | None
    low: float | None
    high: float | None
    practical: float | None
    verdict: str
    p: float | None = None
    u_num: float | None = None
    over_u_num: float | None = None
    resolved: str = ""
    why: str = ""
    ratio: bool = False
    pair: tuple[str, str] | None = None
    mean_intervals: tuple[tuple[float, float], ...] = ()
    p_holm: float | None = None
    u_needed: float | None = None
    simple: tuple[Simple, ...] = ()
    always: tuple[tuple[str, str], ...] = ()

    @property
    def largest_simple(self) -> Simple | None:
        """Simple effect with the largest difference, among those that matter if some do."""
        chosen = [e for e in self.simple if e.verdict == self.verdict] or list(self.simple)
        if not chosen:
            return None
        return max(chosen, key=self._distance)

    def _distance(self, one: Simple) -> float:
        return abs(math.log(one.difference) if self.ratio else one.difference)

    @property
    def depends_on_settings(self) -> bool:
        """Whether its simple effects are several, at settings of other factors."""
        return len({e.at for e in self.simple}) > 1

    @property
    def matters_on_average(self) -> bool:
        """Whether the interval of the average difference lies beyond what matters."""
        return self.low is None or self.practical is None or self.low > self.practical

    @property
    def is_main(self) -> bool:
        """Whether this is the effect of one factor alone."""
        return ":" not in self.term

    @property
    def highest(self) -> str:
        """Level with the largest mean."""
        return max(self._known, key=lambda pair: pair[1])[0]

    @property
    def lowest(self) -> str:
        """Level with the smallest mean."""
        return min(self._known, key=lambda pair: pair[1])[0]

    @property
    def _known(self) -> list[tuple[str, float]]:
        pairs = zip(self.levels, self.means, strict=False)
        return [(level, mean) for level, mean in pairs if mean is not None]


def effect_of(item: Mapping[str, Any], factors: Mapping[str, Sequence[str]]) -> Effect:
    """Read one effect from the document of an analysis."""
    low, high = item.get("ci95") or (None, None)
    pair = item.get("largest")
    levels, means, ends = _as_designed(item, factors)
    return Effect(
        term=str(item["term"]),
        levels=levels,
        means=means,
        difference=item.get("range"),
        low=low,
        high=high,
        practical=item.get("practical"),
        verdict=str(item.get("verdict") or CANNOT_TELL),
        p=item.get("p"),
        u_num=item.get("u_num"),
        over_u_num=item.get("effect_over_u_num"),
        resolved=str(item.get("resolved") or ""),
        why=str(item.get("why") or ""),
        ratio=item.get("scale") == "ratio",
        pair=None if not pair else (str(pair[0]), str(pair[1])),
        mean_intervals=ends,
        p_holm=item.get("p_holm"),
        u_needed=item.get("u_needed"),
        simple=tuple(_simple(one) for one in item.get("simple_effects") or ()),
        always=tuple((str(a), str(b)) for a, b in item.get("always") or ()),
    )


def _interval(ends: Sequence[float] | None) -> tuple[float, float] | None:
    return None if ends is None else (float(ends[0]), float(ends[1]))


def _simple(item: Mapping[str, Any]) -> Simple:
    return Simple(
        str(item["first"]),
        str(item["second"]),
        tuple((str(name), str(level)) for name, level in item["at"]),
        float(item["difference"]),
        _interval(item["ci"]),
        _interval(item["ci_simultaneous"]),
        item["u"],
        str(item["verdict"]),
    )


def _as_designed(
    item: Mapping[str, Any], factors: Mapping[str, Sequence[str]]
) -> tuple[tuple[str, ...], tuple[float | None, ...], tuple[tuple[float, float], ...]]:
    """Levels, means and intervals of a factor in the order of its design."""
    levels = [str(level) for level in item.get("levels") or ()]
    means = list(item.get("mean") or ())
    ends = [(pair[0], pair[1]) for pair in item.get("mean_ci95") or ()]
    wanted = [levels.index(v) for v in factors.get(str(item["term"]), ()) if v in levels]
    if len(wanted) != len(levels):
        wanted = list(range(len(levels)))
    ordered = tuple(levels[i] for i in wanted)
    return (
        ordered,
        tuple(means[i] for i in wanted if i < len(means)),
        tuple(ends[i] for i in wanted if i < len(ends)),
    )
