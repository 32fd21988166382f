"""Measured tests on one grid of displacements, and the averages taken from them.

Repeats on one specimen are nested in it: they are averaged, never counted as independent
(pseudo-replication; Hurlbert 1984, Ecol. Monogr. 54, 187).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from study.ground.arrays import Array
from study.ground.curve import Curve
from study.ground.errors import Fault, InputError, nearest
from study.mechanics.material.homogeneous import LOADINGS
from study.mechanics.measurement.measurement_section import Labels, MeasurementSpec
from study.mechanics.measurement.phases import RowCount, SpecimenRows
from study.mechanics.setup.geometry import Cone, Enclosed, Flat, Indenter, Sphere
from study.mechanics.setup.setup import Setup

#: labels that are wanted of grouping columns; a number stands for the text that a file has of it
Label = Labels | float | Sequence[str | float]
Selection = Mapping[str, Label]


#: displacements at which repeats are averaged whose rows lie at others in each
AVERAGED_POINTS = 200


@dataclass(frozen=True, eq=False)
class SingleTest:
    """Curve of one test on the grid of its rules, shape (points,), and what was done to its rows.

    ``recorded`` holds the rows in the range that it was interpolated from, ``specimen`` all rows.
    ``offset`` is the force of the unloaded specimen over the largest one, where that is no zero and
    no rule asks for it.
    """

    displacement_mm: Array
    force_N: Array
    recorded: Curve
    specimen: SpecimenRows
    #: Rows within the range.
    rows: int
    counts: Counter[str] = field(default_factory=Counter)
    zero_N: float = 0.0
    toe_mm: float = 0.0
    offset: float | None = None
    #: Standard error of the contact from which displacement counts; 0 where it was not found here.
    contact_error_mm: float = 0.0

    @property
    def groups(self) -> Mapping[str, str]:
        """Labels of the grouping columns."""
        return self.specimen.recording.groups


@dataclass(frozen=True)
class MeasuredTest:
    """Average of the repeats that a selection matches."""

    #: Mean force at the even displacements of the range, with the recorded rows of every test.
    curve: Curve
    #: shape (points,); standard deviation of the repeats at each point; None for a single test.
    scatter_N: Array | None
    #: Every test averaged, in both of its stages.
    tests: tuple[SingleTest, ...]
    #: What became of the rows of its block, those of tests that were not chosen too.
    rows: RowCount

    @property
    def n_repeats(self) -> int:
        """Number of tests averaged."""
        return len(self.tests)

    @property
    def directions(self) -> int:
        """2 where rows of a second direction follow those of the first."""
        return self.tests[0].specimen.recording.directions


@dataclass(frozen=True)
class Measurements:
    """All tests of a study, on one grid of displacements."""

    #: Every test, in the order of the files.
    tests: tuple[SingleTest, ...]
    #: shape (points,); the common grid.
    displacement_mm: Array
    #: What was read: columns of blocks and repeats, and what gives constants and responses.
    spec: MeasurementSpec
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
        block = self.spec.block
        return () if block is None else self.groups[block]

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
        first = chosen[0].groups
        differing = [n for n, v in first.items() if any(t.groups[n] != v for t in chosen)]
        loose = [n for n in differing if n not in self.spec.average]
        if loose:
            values = ", ".join(dict.fromkeys(t.groups[loose[0]] for t in chosen))
            rule = f"several tests match {_words(block, where)}: {loose[0]} = {values}"
            mend = f"name {loose[0]!r} in `fit` and `score`, or in `average` if its tests are "
            raise InputError(Fault("measurements", rule, f"{mend}repeats on one specimen"))
        places, forces, time = self._rows_of(chosen)
        scatter = forces.std(axis=0, ddof=1) if len(chosen) > 1 else None
        recorded = tuple(test.recorded for test in chosen)
        curve = Curve(places, forces.mean(axis=0), time_s=time, recorded=recorded)
        return MeasuredTest(curve, scatter, tuple(chosen), self._row_count(block, chosen))

    def _rows_of(self, chosen: Sequence[SingleTest]) -> tuple[Array, Array, Array | None]:
        """Displacements, forces and times of tests that are averaged."""
        # Shapes: returns (points,), (tests, points), (points,).
        rows = [test.recorded for test in chosen]
        if not self.own_rows:
            forces = np.array([test.force_N for test in chosen])
            return self.displacement_mm.copy(), forces, self.time_s
        first = rows[0]
        if all(
            row.places.shape == first.places.shape
            and np.allclose(row.places, first.places, rtol=1e-9, atol=0)
            for row in rows
        ):
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
            rows = test.specimen.count
            aside = {"of tests that were not chosen": rows.read}
            counts.append(rows if test in chosen else RowCount(rows.read, 0, aside))
        return RowCount.sum_of(counts)

    def pairs(self, block: str | None = None) -> list[tuple[MeasuredTest, MeasuredTest]]:
        """Pair fit with score for a block: one pair, or two where they also change places.

        Made once for all the materials that are fitted to them.
        """
        if block not in self._paired:
            fit, score = (self.curve(block, **dict(side or {})) for side in self.sides[0])
            self._paired[block] = [(fit, score), (score, fit)] if self.spec.swap else [(fit, score)]
        return self._paired[block]

    @property
    def sides(self) -> list[tuple[Selection | None, Selection | None]]:
        """What is fitted and what is scored, in the order of :meth:`pairs`."""
        fit, score = self.spec.fit, self.spec.score or self.spec.fit
        return [(fit, score), (score, fit)] if self.spec.swap else [(fit, score)]

    def _matching(self, block: str | None, where: Selection) -> list[SingleTest]:
        chosen_labels = {name: _labels(value) for name, value in where.items()}
        if self.spec.block is not None and block is not None:
            chosen_labels[self.spec.block] = (block,)
        for name in chosen_labels:
            if name not in self.tests[0].groups:
                rule = f"there is no grouping column {name!r}"
                raise InputError(Fault("measurements", rule, nearest(name, self.tests[0].groups)))
        chosen = [t for t in self.tests if all(t.groups[n] in v for n, v in chosen_labels.items())]
        if not chosen:
            raise InputError(self._nothing(block, chosen_labels))
        return chosen

    def _nothing(self, block: str | None, chosen_labels: Mapping[str, Sequence[str]]) -> Fault:
        mends = (
            f"{name}: " + nearest(value, self.groups[name][:50])
            for name, values in chosen_labels.items()
            for value in values
            if value not in self.groups[name]
        )
        mend = next(mends, "this combination is missing from the data")
        return Fault("measurements", f"no test matches {_words(block, chosen_labels)}", mend)


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


# Measured forces that no soft material gives: a unit or a size may be wrong.
#
# The modulus behind a curve is estimated from one point in the middle of it: nominal stress over
# nominal strain where plates load a specimen, and the half-spaces of Boussinesq (flat), Hertz
# (sphere) and Love (cone) where an indenter does (Sneddon 1965, Int. J. Eng. Sci. 3, 47, with
# Poisson's ratio 1/2). A specimen that is bonded or thin is some times stiffer than that; a window
# of five decades does not mind.

#: Young's moduli of tissue, gels, silicone and rubber, MPa: 0.1 kPa to 30 MPa
SOFT_MPA = (1e-4, 30.0)
#: 1 - nu^2 of what keeps its volume
_PLANE = 0.75
_THOUSAND = 1000.0

#: how a note of this module can be told from others
IMPLAUSIBLE = "no soft material"


def apparent_modulus(setup: Setup, displacement_mm: float, force_N: float) -> float | None:  # noqa: N803
    """Young's modulus in MPa that one point of a curve speaks for."""
    indenter = setup.test.indenter
    if indenter is not None:
        return force_N * _PLANE / _half_space(indenter, displacement_mm)
    if setup.height_mm is None or isinstance(setup.specimen, Enclosed):
        return None
    if LOADINGS[setup.kind.mode].is_volumetric:
        return None  # a bulk modulus, which soft materials have in gigapascals
    strain = displacement_mm / setup.height_mm
    return force_N / setup.specimen.area_mm2 / strain


def _half_space(indenter: Indenter, depth_mm: float) -> float:
    """Force over plane-strain modulus at a depth, mm^2."""
    if isinstance(indenter, Flat):
        return 2 * indenter.radius_mm * depth_mm
    if isinstance(indenter, Sphere):
        return 4 / 3 * math.sqrt(indenter.radius_mm * depth_mm**3)
    if isinstance(indenter, Cone):
        return 2 / math.pi * math.tan(math.radians(indenter.half_angle_deg)) * depth_mm**2
    raise TypeError(f"no half-space is known for {type(indenter).__name__}")


def checked(measurements: Measurements, setup: Setup) -> Measurements:
    """Copy measurements with a note on every test whose modulus no soft material has."""
    low, high = SOFT_MPA
    block = measurements.spec.block
    odd: list[tuple[float, float, float]] = []
    named: dict[str, None] = {}
    for test in measurements.tests:
        rows = test.recorded if measurements.own_rows else measurements
        middle = len(rows.displacement_mm) // 2
        d, force = float(rows.displacement_mm[middle]), float(test.force_N[middle])
        modulus = apparent_modulus(setup, d, force) if d > 0 and force > 0 else None
        if modulus is not None and not low <= modulus <= high:
            odd.append((d, force, modulus))
            named |= dict.fromkeys([test.groups[block]] if block else [])
    if not odd:
        return measurements
    d, force, modulus = odd[0]
    factor = _THOUSAND if modulus < low else 1 / _THOUSAND
    likely = low <= modulus * factor <= high
    size = "1000 times larger" if factor > 1 else "1000 times smaller"
    hint = f"; a force {size} would be one of a soft material" if likely else ""
    # where all are, the unit of the file is wrong, not that of a specimen
    several = len(measurements.tests) > len(odd)
    which = f", of {block} {', '.join(named)}" if several and named else ""
    sentence = (
        f"{', '.join(sorted(measurements.files)[:2])}: {force:.4g} N at {d:.4g} mm means a "
        f"Young's modulus of about {_in_words(modulus)}, that of {IMPLAUSIBLE} ("
        f"{_in_words(low)} to {_in_words(high)}; in {len(odd)} of {len(measurements.tests)} "
        f"tests{which}){hint}: check "
        "measurements.units and the size of the specimen"
    )
    return replace(measurements, notes=(*measurements.notes, sentence))


def _in_words(modulus_MPa: float) -> str:  # noqa: N803
    if modulus_MPa >= 1:
        return f"{modulus_MPa:.3g} MPa"
    return f"{modulus_MPa * 1e3:.3g} kPa" if modulus_MPa >= 1e-4 else f"{modulus_MPa * 1e6:.3g} Pa"
