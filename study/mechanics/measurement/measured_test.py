"""Measured tests on one grid of displacements, and the averages taken from them.

Repeats on one specimen are nested in it: they are averaged, never counted as independent
(pseudo-replication; Hurlbert 1984, Ecol. Monogr. 54, 187).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from study.ground.arrays import Array
from study.ground.curve import Curve
from study.ground.errors import Fault, InputError, nearest
from study.mechanics.measurement.measurement_section import Labels
from study.mechanics.measurement.phases import RowCount, SpecimenRows

#: labels that are wanted of grouping columns; a number stands for the text that a file has of it
Label = Labels | float | Sequence[str | float]
Selection = Mapping[str, Label]


#: displacements at which repeats are averaged whose rows lie at others in each
AVERAGED_POINTS = 200


@dataclass(frozen=True, eq=False)
class SingleTest:
    """One recorded test on the common grid: its group labels and force, shape (points,).

    ``recorded`` holds the rows that the forces were interpolated from.
    """

    groups: Mapping[str, str]
    force_N: Array
    notes: tuple[str, ...] = ()
    recorded: Curve | None = None
    #: All of its rows, as the file has them and in the coordinates of the specimen.
    specimen: SpecimenRows | None = None


@dataclass(frozen=True)
class MeasuredTest:
    """Average of the repeats that a selection matches."""

    #: Mean force at the even displacements of the range.
    curve: Curve
    #: shape (points,); standard deviation of the repeats at each point; None for a single test.
    scatter_N: Array | None
    n_repeats: int
    #: Labels that all averaged tests share.
    groups: Mapping[str, str] = field(default_factory=dict)
    #: What was done to the rows of these tests.
    notes: tuple[str, ...] = ()
    #: Rows as recorded, of every test averaged.
    recordings: tuple[Curve, ...] = ()
    #: Every test averaged, in both of its stages.
    tests: tuple[SingleTest, ...] = ()
    #: What became of the rows of its block, those of tests that were not chosen too.
    rows: RowCount = field(default_factory=RowCount)


@dataclass(frozen=True)
class Measurements:
    """All tests of a study, on one grid of displacements."""

    #: Every test, in the order of the files.
    tests: tuple[SingleTest, ...]
    #: shape (points,); the common grid.
    displacement_mm: Array
    block: str | None = None
    average: tuple[str, ...] = ()
    #: Selections that give constants and responses.
    fit: Selection | None = None
    score: Selection | None = None
    #: Whether fit and score also change places.
    swap: bool = False
    #: Counted report of every rule that touched the data.
    notes: tuple[str, ...] = ()
    #: Name of each file and its sha256.
    files: Mapping[str, str] = field(default_factory=dict)
    #: shape (points,); common times of the rows, where the tests are courses in time.
    time_s: Array | None = None
    #: Whether every test has its own rows, which no grid is common to.
    own_rows: bool = False
    _paired: dict[str | None, list[tuple[MeasuredTest, MeasuredTest]]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @property
    def blocks(self) -> tuple[str, ...]:
        """Labels of the blocks, in the order of the files; empty without a block column."""
        if self.block is None:
            return ()
        return tuple(dict.fromkeys(test.groups[self.block] for test in self.tests))

    @property
    def groups(self) -> dict[str, tuple[str, ...]]:
        """Labels of every grouping column, in the order of the files."""
        return {
            name: tuple(dict.fromkeys(test.groups[name] for test in self.tests))
            for name in self.tests[0].groups
        }

    def curve(self, block: str | None = None, **where: Label) -> MeasuredTest:
        """Average of the tests of one block that match ``where``."""
        chosen = self._matching(block, where)
        shared = _shared(chosen)
        loose = [n for n in chosen[0].groups if n not in shared and n not in self.average]
        if loose:
            values = ", ".join(dict.fromkeys(t.groups[loose[0]] for t in chosen))
            raise InputError(
                Fault(
                    "measurements",
                    f"several tests match {_words(block, where)}: {loose[0]} = {values}",
                    f"name {loose[0]!r} in `fit` and `score`, or in `average` if its tests are "
                    "repeats on one specimen",
                )
            )
        places, forces, time = self._rows_of(chosen)
        scatter = forces.std(axis=0, ddof=1) if len(chosen) > 1 else None
        recordings = tuple(test.recorded for test in chosen if test.recorded is not None)
        curve = Curve(
            places,
            forces.mean(axis=0),
            time_s=time,
            recorded=recordings,
        )
        notes = tuple(note for test in chosen for note in test.notes)
        rows = self._row_count(block, chosen)
        return MeasuredTest(
            curve, scatter, len(chosen), shared, notes, recordings, tuple(chosen), rows
        )

    def _rows_of(self, chosen: Sequence[SingleTest]) -> tuple[Array, Array, Array | None]:
        """Displacements, forces and times of tests that are averaged."""
        # Shapes: returns (points,), (tests, points), (points,).
        rows = [test.recorded for test in chosen if test.recorded is not None]
        if not self.own_rows or len(rows) < len(chosen):
            forces = np.array([test.force_N for test in chosen])
            return self.displacement_mm.copy(), forces, self.time_s
        first = rows[0]
        same = all(
            row.places.shape == first.places.shape
            and np.allclose(row.places, first.places, rtol=1e-9, atol=0)
            for row in rows
        )
        if same:
            return first.displacement_mm, np.array([row.force_N for row in rows]), first.time_s
        low = max(float(row.displacement_mm[0]) for row in rows)
        high = min(float(row.displacement_mm[-1]) for row in rows)
        if first.time_s is not None or not low < high:
            rule = "repeats on one specimen lie at other times, or have no range in common"
            mend = "write a [[tests]] table for each of them"
            raise InputError(Fault("measurements.average", rule, mend))
        grid = np.linspace(low, high, AVERAGED_POINTS)
        shared = [np.interp(grid, row.displacement_mm, row.force_N) for row in rows]
        return grid, np.array(shared), None

    def _row_count(self, block: str | None, chosen: Sequence[SingleTest]) -> RowCount:
        """Rows of the tests of a block, of which some were chosen."""
        counts = []
        for test in self.tests if block is None else self._matching(block, {}):
            if test.specimen is not None:
                rows = test.specimen.count
                aside = {"of tests that were not chosen": rows.read}
                counts.append(rows if test in chosen else RowCount(rows.read, 0, aside))
        return RowCount.sum_of(counts)

    def curves(
        self, block: str | None = None, **where: Label
    ) -> list[tuple[dict[str, str], Curve]]:
        """Every matching group (labels, averaged curve), repeats averaged."""
        keep: dict[tuple[tuple[str, str], ...], None] = {}
        for test in self._matching(block, where):
            key = tuple((k, v) for k, v in test.groups.items() if k not in self.average)
            keep.setdefault(key)
        out = []
        for key in keep:
            groups = dict(key)
            rest = {k: v for k, v in groups.items() if k != self.block}
            averaged = self.curve(
                groups.get(self.block) if self.block else None, **{**where, **rest}
            )
            out.append((groups, averaged.curve))
        return out

    def pairs(self, block: str | None = None) -> list[tuple[MeasuredTest, MeasuredTest]]:
        """Pair fit with score for a block: one pair, or two where they also change places.

        Made once for all the materials that are fitted to them.
        """
        if block not in self._paired:
            self._paired[block] = self._pairs(block)
        return self._paired[block]

    def _pairs(self, block: str | None) -> list[tuple[MeasuredTest, MeasuredTest]]:
        fit, score = dict(self.fit or {}), dict(self.score or self.fit or {})
        pairs = [(self.curve(block, **fit), self.curve(block, **score))]
        if self.swap:
            pairs.append((pairs[0][1], pairs[0][0]))
        return pairs

    @property
    def sides(self) -> list[tuple[Selection | None, Selection | None]]:
        """What is fitted and what is scored, in the order of :meth:`pairs`."""
        sides = [(self.fit, self.score or self.fit)]
        return [*sides, (sides[0][1], sides[0][0])] if self.swap else sides

    def _matching(self, block: str | None, where: Selection) -> list[SingleTest]:
        chosen_labels = {name: _labels(value) for name, value in where.items()}
        if self.block is not None and block is not None:
            chosen_labels[self.block] = (block,)
        for name in chosen_labels:
            if name not in self.tests[0].groups:
                raise InputError(
                    Fault(
                        "measurements",
                        f"there is no grouping column {name!r}",
                        nearest(name, self.tests[0].groups),
                    )
                )
        chosen = [t for t in self.tests if all(t.groups[n] in v for n, v in chosen_labels.items())]
        if not chosen:
            raise InputError(self._nothing(block, chosen_labels))
        return chosen

    def _nothing(self, block: str | None, chosen_labels: Mapping[str, Sequence[str]]) -> Fault:
        mend = "this combination is missing from the data"
        for name, values in chosen_labels.items():
            labels = self.groups[name]
            unknown = [value for value in values if value not in labels]
            if unknown:
                mend = f"{name}: " + nearest(unknown[0], labels[:50])
                break
        return Fault("measurements", f"no test matches {_words(block, chosen_labels)}", mend)


def _shared(tests: Sequence[SingleTest]) -> dict[str, str]:
    return {n: v for n, v in tests[0].groups.items() if all(t.groups[n] == v for t in tests)}


def _labels(value: Label) -> tuple[str, ...]:
    """Labels wanted, as the text they are in a file (1 and 1.0 are both "1")."""
    values = [value] if isinstance(value, (str, float, int)) else value
    return tuple(
        str(int(v)) if isinstance(v, float) and v.is_integer() else str(v).strip() for v in values
    )


def _words(block: str | None, where: Selection) -> str:
    items = [f"{n} = {', '.join(_labels(v))}" for n, v in where.items()]
    if block is not None and not any(item.endswith(f"= {block}") for item in items):
        items.insert(0, f"block = {block}")
    return ", ".join(items) or "the study"
