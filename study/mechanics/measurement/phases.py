"""Loadings and unloadings of a recorded test, the branch that counts, and what became of each row.

A soft material gives less force on the way back (hysteresis), and less again in a second cycle
(Mullins 1969, Rubber Chem. Technol. 42, 339). Rows of several branches, sorted by displacement,
would be a curve that nobody measured.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from study.ground.arrays import Array, Ints
from study.ground.errors import Fault, InputError
from study.mechanics.measurement.measurement_section import MeasurementSpec
from study.mechanics.measurement.recording import Recording

#: share of the travel by which a machine must go back to have turned; less is jitter
TURN = 0.1
#: rows that a branch has at least: fewer are rows out of order, not a way that a machine went
BRANCH_ROWS = 3
#: share of the largest force below which rows carry none
NO_FORCE = 0.05


@dataclass(frozen=True)
class Phase:
    """Consecutive rows on which the displacement goes one way."""

    kind: Literal["loading", "unloading", "hold"]
    #: Number of the loading that it is, or follows; 0 where the recording begins with the way back.
    cycle: int
    #: First and last row, from 0.
    first: int
    last: int

    @property
    def rows(self) -> slice:
        """Rows of the phase."""
        return slice(self.first, self.last + 1)

    @property
    def words(self) -> str:
        """How a sentence calls it."""
        return (
            f"{self.kind} of cycle {self.cycle}" if self.cycle else "unloading before any loading"
        )


def phases_of(displacement_mm: Array) -> tuple[Phase, ...]:
    """Phases of a recording; one that holds all rows where they stand in no order.

    Shapes: displacement_mm (rows,), positive into the specimen and negative on the approach.
    """
    d = displacement_mm
    least, end = TURN * float(np.ptp(d)), d.size - 1
    turns = [row for row in _turns(d, least) if 0 < row < end]
    if turns and abs(d[turns[0]] - d[0]) < least:
        del turns[0]  # the recording begins with the way back
    ends = [-1, *turns, end]
    if not turns or min(np.diff([0, *turns])) < BRANCH_ROWS:
        return _held(Phase("loading", 1, 0, end), d)
    phases: list[Phase] = []
    cycle = 0
    for before, last in zip(ends[:-1], ends[1:], strict=True):
        is_loading = bool(d[last] > d[max(before, 0)])
        cycle += is_loading
        phase = Phase("loading" if is_loading else "unloading", cycle, before + 1, last)
        if phases and not is_loading:
            *held, phase = _held(phases.pop(), d, phase)
            phases += held
        phases.append(phase)
    return (*phases[:-1], *_held(phases[-1], d))


#: share of the travel within which a machine stands
_STANDS = 1e-3
#: share of the rows of a last loading that stand at its end, at least
_HELD_AT_END = 0.01
#: the same of a loading with a way back: of a sine, 4 % stand where it turns
_HELD_AT_TURN = 0.1


def _held(phase: Phase, d: Array, back: Phase | None = None) -> tuple[Phase, ...]:
    """Part a loading, and the way back, from rows on which its end is held; a stress relaxes."""
    both = (phase,) if back is None else (phase, back)
    rows = slice(phase.first, both[-1].last + 1)
    travel = d[rows]
    stands = travel >= travel.max() - _STANDS * float(np.ptp(d[phase.rows]))
    first = int(np.argmax(stands))
    beyond = np.flatnonzero(~stands[first:])
    last = travel.size - 1 if not beyond.size else first + int(beyond[0]) - 1
    share = _HELD_AT_END if back is None else _HELD_AT_TURN
    least = max(BRANCH_ROWS, share * (last + 1))
    is_end = phase.kind == "loading" and (back is not None or last == travel.size - 1)
    if not is_end or first < BRANCH_ROWS or last - first < least:
        return both
    repeats = np.unique(travel[:first], return_counts=True)[1].max()
    if 3 * repeats > last - first:
        return both
    hold = replace(phase, kind="hold", first=phase.first + first + 1, last=phase.first + last)
    loading = replace(phase, last=phase.first + first)
    return (loading, hold) if back is None else (loading, hold, replace(back, first=hold.last + 1))


def _turns(d: Array, least: float) -> list[int]:
    """Rows at which the displacement turns, by at least so much."""
    turns: list[int] = []
    start, sense = 0, 1.0
    while True:
        way = sense * d[start:]
        furthest = np.maximum.accumulate(way)
        back = np.flatnonzero(furthest - way > least)
        if not back.size:
            return turns
        row = int(back[0])
        # of rows that stand at the turn together, the first belongs to the branch that ends here
        turns.append(start + int(np.flatnonzero(way[:row] == furthest[row])[0]))
        start, sense = start + row, -sense


def counted(
    phases: Sequence[Phase],
    spec: MeasurementSpec,
    displacement_mm: Array,
    force_N: Array,  # noqa: N803
    where: str,
    *,
    is_signed: bool,
) -> tuple[Phase, ...]:
    """Phases that count of a test. Shapes: displacement_mm, force_N (rows,), both positive."""
    if spec.branch == "all" or (len(phases) == 1 and spec.branch == "auto"):
        return tuple(phases)
    if spec.branch != "auto":
        kind = spec.cycle if isinstance(spec.branch, int) else spec.branch
        number = spec.branch if isinstance(spec.branch, int) else None
        fitting = [p for p in phases if p.kind == kind and number in (None, p.cycle)]
        if fitting:
            return (fitting[0],)
        of = "" if number is None else f" of cycle {number}"
        held = ", ".join(p.words for p in phases[:6])
        more = f" and {len(phases) - 6} more" if len(phases) > 6 else ""
        rule = f"the recording has no {kind}{of}: it holds {held}{more}"
        raise InputError(Fault(where, rule, "write the branch that it has, in measurements"))
    # the only loading: of a specimen that was unloaded before it, and is not loaded backwards
    loadings = [p for p in phases if p.kind == "loading"]
    largest = float(np.abs(force_N).max())
    start = displacement_mm[0] - TURN * float(np.ptp(displacement_mm))
    beyond = force_N[displacement_mm < start]
    is_reversed = is_signed and beyond.size > 0 and beyond.min() < -NO_FORCE * largest
    idle = phases[0].kind == "loading" or (
        float(np.abs(force_N[phases[0].rows]).max()) < NO_FORCE * largest
    )
    if loadings and idle and not is_reversed:
        return (loadings[0],)
    readings = "; ".join(
        f"{p.words}, {displacement_mm[p.first]:.4g} to {displacement_mm[p.last]:.4g} mm and "
        f"{force_N[p.first]:.4g} to {force_N[p.last]:.4g} N in {p.last - p.first + 1} rows"
        for p in phases[:4]
    )
    rule = f"which of its branches is meant is open: {readings}"
    mend = 'write branch = "loading", "unloading", "all", or the number of a cycle'
    raise InputError(Fault(where, rule, mend))


@dataclass(frozen=True)
class RowCount:
    """How many rows were read, how many are used, and why the others are not."""

    read: int = 0
    used: int = 0
    #: Number of rows by the reason.
    aside: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def sum_of(cls, counts: Iterable[RowCount]) -> RowCount:
        """Add up the rows of several tests."""
        every = list(counts)
        aside = sum((Counter(count.aside) for count in every), Counter[str]())
        return cls(sum(c.read for c in every), sum(c.used for c in every), dict(aside))

    def as_dict(self) -> dict[str, object]:
        """Key ``rows`` of the documents in JSON."""
        why = [{"rows": n, "why": reason} for reason, n in self.aside.items()]
        return {"read": self.read, "used": self.used, "set_aside": why}

    @property
    def sentence(self) -> str:
        """What a report says of it."""
        counted = f"{self.read} rows read, {self.used} used"
        reasons = ", ".join(f"{n} {reason}" for reason, n in self.aside.items())
        return counted + (f", {self.read - self.used} set aside: {reasons}" if reasons else "")


@dataclass(frozen=True)
class SpecimenRows:
    """Second stage of a test: every recorded row in the coordinates of the specimen, in its order.

    The first stage is :class:`study.mechanics.measurement.recording.Recording`, whose rows these
    are, one for one.
    """

    #: shape (rows,); positive where the specimen resists.
    displacement_mm: Array
    force_N: Array
    phases: tuple[Phase, ...]
    #: shape (rows,); why a row does not count, as a place in ``reasons``; 0 where it does.
    fate: Ints
    #: The first is empty.
    reasons: tuple[str, ...]
    #: The rows as the file has them.
    recording: Recording

    @property
    def count(self) -> RowCount:
        """Rows by what became of them."""
        directions = self.recording.directions
        numbers = np.bincount(self.fate, minlength=len(self.reasons)) // directions
        used, *others = numbers.tolist()
        aside = {r: n for r, n in zip(self.reasons[1:], others, strict=True) if n}
        return RowCount(int(self.fate.size) // directions, used, aside)
