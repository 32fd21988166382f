"""From the rows of one measured test to a curve on an even grid, by stated rules.

The rules are applied in this order, and every row they drop or change is counted:

1. ``displacement_zero`` and ``direction``: the recorded coordinate becomes the displacement of
   the specimen;
2. sign: force, and displacement where it runs the other way, made positive into the specimen;
   a force that falls with displacement, or that is there before displacement zero, is refused;
   branch: of a test that was loaded and unloaded, once or in cycles, the first loading is kept,
   or what ``branch`` and ``cycle`` say (:mod:`study.mechanics.measurement.phases`);
3. ``zero``: the load cell's reading without load is subtracted (``first``: the first row;
   ``fit``: the start of a straight line through the first tenth of the travel);
4. sorting by displacement; equal displacements averaged; a non-monotone force is kept;
5. ``toe``: displacement counts from where the force passes this load for good;
6. resampling by linear interpolation at ``points`` displacements even over the range; or, for
   ``raw``, the rows within the range as they are.
"""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from study.ground.arrays import Array, Ints
from study.ground.curve import Curve
from study.ground.errors import Fault, InputError
from study.mechanics.measurement.measured_test import IMPLAUSIBLE, SingleTest
from study.mechanics.measurement.measurement_section import MeasurementSpec
from study.mechanics.measurement.phases import NO_FORCE, Phase, SpecimenRows, counted, phases_of
from study.mechanics.measurement.recording import Recording

ZERO_FIT_SHARE = 0.1
MIN_ROWS = 3
EQUAL_MM = 1e-9
#: force of the unloaded specimen over the largest one, from which a zero is asked for
OFFSET_SHARE = 0.02
#: standard errors of the line through the first rows beyond which its start is none of noise
_BEYOND_ERROR = 2.5
#: share of the range by which raw rows may end before it without a word
_SHORT = 0.02
#: times that a test may go further than its range and still be a test for it
_SAME_SIZE = 5.0

#: a rule that a user is warned of: it may mean that the file holds something else
SORTED = "rows out of order sorted by displacement"
#: the other one: a test that was also unloaded has two forces at every displacement
UNLOADED = "rows after the first loading left out: the loading branch is used"
#: a specimen that was held at every displacement
RELAXED = "test whose force falls by"
#: share of the displacements at which it falls, at least
_MOSTLY = 0.8
#: share of the force by which it falls, at least
_RELAXED = 0.02
#: and one that asks for a rule
OFFSET = "a load-cell offset?"
#: and one that asks for a unit
PERCENT = "is it in per cent?"
#: and one that the file and the design size differently
SIZE_ABOVE = "a line above the rows says"
_CAUTIONS = (SORTED, UNLOADED, OFFSET, IMPLAUSIBLE, PERCENT, RELAXED, SIZE_ABOVE)


@dataclass(frozen=True)
class Rules:
    """How the rows of every test of a study become a curve, and where they end."""

    spec: MeasurementSpec
    #: Range of displacement that is kept.
    low_mm: float
    high_mm: float
    #: Height of the specimen, for messages in percent.
    height_mm: float | None = None
    #: Whether rows on both sides of zero belong to one test, and no range says which are meant.
    is_signed: bool = False
    #: Whether a specimen that is not loaded at first is a fault: not where contact is fitted.
    judges_slack: bool = False
    #: Power of the displacement from contact with which the force begins.
    onset_power: float = 1.0
    #: How far from the recorded zero the fitted one may lie.
    zero_within_mm: float = 0.0

    @property
    def is_raw(self) -> bool:
        """Whether rows stay as they were measured."""
        return self.spec.points == "raw"

    @property
    def turn(self) -> float:
        """Factor that makes a force that resists positive."""
        return -1.0 if self.spec.sign == "negative" else 1.0

    @property
    def other_sign(self) -> str:
        """What to write where the declared sign is the wrong one."""
        return f'sign = "{"negative" if self.spec.sign == "positive" else "positive"}"'

    @property
    def counts_from(self) -> str | float | None:
        """``"first row"``, ``"contact"``, or mm; None where the zero of the file counts."""
        is_displacement = self.spec.columns.kinematic == "displacement"
        return self.spec.displacement_zero if is_displacement else 0.0

    def grid(self) -> Array:
        """Displacements in mm at which the force is taken, shape (points,)."""
        return np.linspace(self.low_mm, self.high_mm, int(self.spec.points))


def condition(
    displacement_mm: Array, force_N: Array, rules: Rules, recording: Recording
) -> SingleTest:
    """Apply the rules of this module to one test.

    Shapes: displacement_mm, force_N (rows,).
    """
    where = recording.where
    counts: Counter[str] = Counter()
    every_d, every_f = _turned(displacement_mm, force_N, rules, where, counts)
    phases = phases_of(every_d)
    chosen = counted(phases, rules.spec, every_d, every_f, where, is_signed=rules.is_signed)
    loadings = [p for p in phases if p.kind == "loading"] or list(phases)
    first = chosen if rules.spec.branch == "auto" else loadings[:1]
    before = _rows_of(first, every_d, every_f)
    far = int(np.argmax(np.abs(displacement_mm)))
    way_in = math.copysign(1.0, float(displacement_mm[far] * every_d[far]))
    _check_begin(*before, way_in, rules, where)
    if rules.low_mm >= 0 and _is_through_zero(*before, rules):
        rules = replace(rules, low_mm=-np.inf)
    d, f = _rows_of(chosen, every_d, every_f)
    if len(chosen) == 1 and (chosen[0].kind == "unloading" or (np.diff(d) < 0).all()):
        d, f = d[::-1], f[::-1]
    _check_torn(d, f, rules, where)
    _check_saturated(d, f, rules, where)
    zero, offset = _zero(*before, rules), _offset(*before, rules)
    if rules.spec.branch == "auto" and d.size < every_d.size:
        counts[UNLOADED] += every_d.size - d.size
    early = int(np.count_nonzero(d < -_slack(rules))) if rules.low_mm >= 0 else 0
    if early:
        counts["rows before displacement zero set aside"] += early
    d, f = _sorted_unique(d, f - zero, counts)
    d, f, toe = _toe(d, f, rules, where, counts)
    fate, reasons = _fates(every_d - toe, phases, chosen, rules)
    specimen = SpecimenRows(every_d - toe, every_f - zero, phases, fate, reasons, recording)
    within = (d >= rules.low_mm - _slack(rules)) & (d <= rules.high_mm + _slack(rules))
    inside = int(np.count_nonzero((d >= rules.low_mm) & (d <= rules.high_mm)))
    recorded = Curve(d[within], f[within])
    if rules.is_raw:
        if inside < MIN_ROWS:
            raise InputError(_too_few(inside, rules, where, float(d[-1])))
        if np.isfinite(rules.high_mm) and d[-1] < (1 - _SHORT) * rules.high_mm:
            counts[f"rows end at {_place(d[-1], rules)}, before the end of the range"] += 1
        places, force = recorded.displacement_mm, recorded.force_N
    else:
        places, force = rules.grid(), _resample(d, f, rules, where, counts)
    # the specimen was met before it carried the toe
    slope = _start(d, f)[3] if rules.spec.toe else 0.0
    toe_way = rules.spec.toe / slope if rules.spec.toe and slope > 0 else 0.0
    return SingleTest(places, force, recorded, specimen, inside, counts, zero, toe, offset, toe_way)


def _rows_of(phases: Sequence[Phase], d: Array, f: Array) -> tuple[Array, Array]:
    """Rows of some phases, in order."""
    rows = np.concatenate([np.arange(p.first, p.last + 1) for p in phases])
    return d[rows], f[rows]


def _fates(
    d: Array, phases: Sequence[Phase], chosen: Sequence[Phase], rules: Rules
) -> tuple[Ints, tuple[str, ...]]:
    """Say of every row whether it counts, and the reasons why not. Shapes: d (rows,)."""
    fate = np.zeros(d.size, dtype=int)
    reasons = ["", "before displacement zero" if rules.spec.toe is None else "before contact (toe)"]
    fate[d < -_slack(rules)] = 1 if rules.low_mm >= 0 else 0
    reasons.append("outside the range" if rules.low_mm > 0 else "beyond the end of the test")
    outside = (d < rules.low_mm - _slack(rules)) | (d > rules.high_mm + _slack(rules))
    fate[outside & (fate == 0)] = 2
    for phase in phases:
        if phase not in chosen:
            reasons.append(phase.words)
            fate[phase.rows] = len(reasons) - 1
    return fate, tuple(reasons)


def condition_course(
    displacement_mm: Array, force_N: Array, rules: Rules, recording: Recording
) -> SingleTest:
    """Apply the rules that a course in time leaves: sign, and the load cell's first reading.

    Shapes: displacement_mm, force_N (rows,).
    """
    # a shortened specimen is recorded with both signs turned, or with that of the force alone
    backwards = rules.turn < 0 and displacement_mm.min() < -displacement_mm.max()
    d = -displacement_mm if backwards else displacement_mm
    f = rules.turn * force_N
    zero = float(f[0]) if rules.spec.zero == "first" else 0.0
    f = f - zero
    if float(d @ f) <= 0:
        rule = f"the force does not resist with the declared sign ({rules.spec.sign})"
        mend = f"write {rules.other_sign}, or check the columns"
        raise InputError(Fault(recording.where, rule, mend))
    course = Curve(d, f, time_s=recording.time_s)
    rows = SpecimenRows(d, f, phases_of(d), np.zeros(d.size, dtype=int), ("",), recording)
    return SingleTest(d, f, course, rows, d.size // recording.directions, zero_N=zero)


def _slack(rules: Rules) -> float:
    """Return the rounding of the ends of a range, mm."""
    return 1e-9 * (rules.high_mm if np.isfinite(rules.high_mm) else 1.0)


def _too_few(inside: int, rules: Rules, where: str, reached_mm: float) -> Fault:
    rule = (
        f"has {inside} rows between {_place(rules.low_mm, rules)} and "
        f"{_place(rules.high_mm, rules)}, a curve needs at least {MIN_ROWS}"
    )
    mend = "widen the range or record more points" + _other_unit(reached_mm, rules.high_mm)
    return Fault(where, rule, mend)


def _other_unit(reached_mm: float, high_mm: float) -> str:
    """Say where a travel is of the right size but for a factor of 1000."""
    for factor, size in ((1000.0, "small"), (0.001, "large")):
        if high_mm <= reached_mm * factor <= _SAME_SIZE * high_mm:
            return (
                f"; the displacements are 1000 times too {size} for this range: check "
                "measurements.units"
            )
    return ""


#: change of the force, N, below which its squares vanish in a sum
_LEAST_SPAN_N = 1e-30


def _turned(
    d: Array, f: Array, rules: Rules, where: str, counts: Counter[str]
) -> tuple[Array, Array]:
    span = float(np.ptp(f))
    if span <= max(1e-12 * float(np.abs(f).max()), _LEAST_SPAN_N) or np.ptp(d) == 0:
        what = "displacement" if np.ptp(d) == 0 else "force"
        value = d[0] if what == "displacement" else f[0]
        rule = f"the {what} is constant ({value:.6g}): nothing to fit"
        raise InputError(Fault(where, rule, "check the columns and the recording"))
    turn = rules.turn
    f = turn * f
    is_auto = rules.spec.direction == "auto"
    way = _way(d, f)
    backwards = abs(float(d.min())) > abs(float(d.max()))
    usual = -1.0 if backwards and turn < 0 else 1.0
    inside = way * d > 0  # rows on the other side of zero may belong to another test
    grown = f - f[0]
    if MIN_ROWS <= np.count_nonzero(inside) < d.size:
        grown = (f - f[int(np.argmin(np.abs(d)))])[inside]
    pulls = float(grown.max()) < -float(grown.min())
    doubtful = way != usual or (backwards and turn > 0)
    if (pulls and doubtful) if is_auto else way < 0:
        raise InputError(_falls(d, turn * f, rules, where))
    if is_auto and way < 0:
        d = -d
        counts[f"displacement reversed (declared sign {rules.spec.sign})"] += d.size
    return d, f


def _check_begin(d: Array, f: Array, way: float, rules: Rules, where: str) -> None:
    """Refuse rows whose zero is none of the specimen. Shapes: d, f (rows,), first loading."""
    if rules.counts_from is None and rules.spec.direction == "auto" and rules.spec.toe is None:
        _check_zero(d, f, way, rules, where)
        if rules.judges_slack:
            _check_slack(d, f, way, where)
    if _is_through_zero(d, f, rules) and rules.spec.zero != "none":
        rule = "the test runs through zero: neither its first row nor its first tenth is unloaded"
        mend = "subtract the reading of the unloaded load cell in the file, and leave zero out"
        raise InputError(Fault(where, rule, mend))


def _falls(d: Array, f: Array, rules: Rules, where: str) -> Fault:
    way = "falling" if rules.spec.direction == "rising" else "rising"
    either = "" if rules.spec.direction == "auto" else f'direction = "{way}" or '
    mend = f"write {either}{rules.other_sign}, or check the columns"
    rule = (
        f"displacement runs from {d[0]:.4g} to {d[np.argmax(np.abs(d - d[0]))]:.4g} mm and force "
        f"from {f[0]:.4g} to {f[np.argmax(np.abs(f - f[0]))]:.4g} N: with the declared sign "
        f"({rules.spec.sign}) the specimen would pull, not resist"
    )
    return Fault(where, rule, mend)


def _way(d: Array, f: Array) -> float:
    """Sign of the displacement into the specimen: that in which a positive force grows.

    Rows after the largest force say nothing where the specimen tore or was unloaded.
    """
    loading = slice(0, int(np.argmax(f)) + 1)
    ways = [_covariance(d, f)]
    if loading.stop >= MIN_ROWS and np.ptp(d[loading]) > 0:
        ways.append(_covariance(d[loading], f[loading]))
    return math.copysign(1.0, ways[0] if ways[0] >= 0 or len(ways) == 1 else ways[1])


#: share of the largest force that falls away at once, for good, where a specimen tears
_TORN = 0.5
#: share of the rows within which it does
_TEARING = 0.1
#: share of the travel over which a load cell stands at its limit at least, and how many times more
#: rows it does so than at any other force
_SATURATED = 0.02
_STEPS = 3
#: share of its limit within which its readings tremble
_AT_LIMIT = 1e-3
#: share of the travel from zero at which a recording may begin without another look: nearer than
#: half of the rows that tell the slope, a convex law is as flat as a late start
_STARTS_LATE = ZERO_FIT_SHARE / 2
#: the same on the other side of zero
_STARTS_EARLY = 0.02
#: least force of a late start, over that of the straight line from zero to it
_AT_ZERO = 0.05
#: share of the largest force by which the force may rise before zero
_RISEN = 0.02
#: standard errors from which a rise is none of noise
_CLEAR = 4.0
#: an approach fills one of these shares of the travel; its slope over the slope in contact is below
_APPROACHES = (0.1, 0.05, 0.02)
_FLAT = 0.05
#: shares of the travel that a longer approach may fill, and slope of one over that of contact
_LONG_APPROACHES = np.arange(0.15, 0.95, 0.05)
_LEVEL = 0.1
#: steps by which its place is brought to least squares, and share of a row that is rounding
_REFINEMENTS = 4
_ROUNDING = 1e-3
#: share of the way to the next row within which a contact without scatter is that of a row
_AT_ROW = 0.1
#: share of an approach, from contact, of which it is not certain that it is unloaded
_CERTAIN = 0.2
#: constants of a level and a parabola, and the place where they meet
_UNKNOWNS = 4
#: force that scatter may hide over that of the first row in contact, at most
_SHOWN = 0.25
#: share of the travel in which a corner is looked for, and up to which it may lie
_BEGINNING = 0.35
_LONGEST_SLACK = 0.2
#: share of the travel from which slack moves the constants
_SLACK = 0.01
#: slope at the corner over that of the secant to the largest force, at least
_AT_ONCE = 0.3
#: what the corner gains of the likelihood (-2 log): in 5,400 tests without slack of 15 laws, 41 to
#: 400 rows and noise of .05 to 1 %, one such gain; slack of 2 % among 120 rows and noise of .2 %
#: gains it in 60 to 100 %
_CORNER = 15.0
_CORNER_ROWS = 10
_PLACES = 40
_MOST_BINS = 400


def placed(
    displacement_mm: Array, resisted: Array, rules: Rules, where: str
) -> tuple[Array, str, float]:
    """Displacement of the specimen from the recorded one, what was done, and the contact's error.

    Shapes: displacement_mm, resisted (rows,), mm, N or MPa; returns (rows,).
    """
    d, f = displacement_mm, rules.turn * resisted
    if rules.spec.direction == "auto" and rules.counts_from is None:
        return d, "", 0.0
    way = {"rising": 1.0, "falling": -1.0}.get(rules.spec.direction) or _way(d - d[0], f)
    word = "rising" if way > 0 else "falling"
    zero = rules.counts_from or 0.0
    if zero == "first row":
        zero = float(d[0])
    elif isinstance(zero, str):
        zero = _contact(d, f, way, rules.onset_power, where)
    chosen = f" ({rules.counts_from})" if isinstance(rules.counts_from, str) else ""
    error = 0.0
    if rules.counts_from == "contact":
        error = _refined(way * d, f, way * zero, rules.onset_power)[1]
        chosen = f" (contact, standard error {error:.2g} mm)"
    done = f"{where}: displacement counts from {zero:.6g} mm{chosen}, {word}"
    return way * (d - zero) + 0.0, done, error


def _contact(d: Array, f: Array, way: float, power: float, where: str) -> float:
    """Return the recorded displacement at which the force leaves the scatter of the approach."""
    moved, peak = way * d, int(np.argmax(f))
    corner = slack_end(moved, f)
    travel = float(moved[peak] - moved[0])
    flat = next((n for n in _APPROACHES if _is_flat(moved, f, moved[0] + n * travel)), None)
    if flat is None and corner is None:
        rule = "the force rises from the first row on: no row shows the specimen before contact"
        raise InputError(Fault(where, rule, 'write displacement_zero = "first row" or a length'))
    if flat is None:
        return way * _refined(moved, f, float(corner or 0.0), power)[0]
    base = f[: peak + 1][moved[: peak + 1] <= moved[0] + flat * travel]
    hidden = 4.0 * float(base.std())
    last = int(np.flatnonzero(f[: peak + 1] <= float(base.mean()) + hidden)[-1])
    following = min(last + 1, peak)
    row = float(moved[following] - moved[last])
    # scatter hides the first rise: the rows about it tell where it was, unless one shows it clearly
    is_clear = hidden < _SHOWN * float(f[following] - base.mean())
    begun = float(moved[last]) if is_clear or corner is None else corner
    onset, _ = _refined(moved, f, begun, power)
    is_row = is_clear and abs(onset - float(moved[last])) <= _AT_ROW * row
    return float(d[last]) if is_row else way * onset


def _refined(moved: Array, f: Array, onset: float, power: float) -> tuple[float, float]:
    """Place at which a level meets a rise by least squares from a first guess, and its error.

    The rise begins with a power of the displacement; its second term has one more. The error of a
    place that no noise tells is that of a place between two rows.

    Shapes: moved, f (rows,), mm, rising from the first row on, N.
    """
    peak, begun = int(np.argmax(f)), onset
    near = moved[: peak + 1] <= onset + _BEGINNING * float(moved[peak] - onset)
    x, y = moved[: peak + 1][near], f[: peak + 1][near]
    spacing = float(np.ptp(x)) / max(x.size - 1, 1)
    error = spacing / math.sqrt(12.0)
    if x.size <= _UNKNOWNS:
        return begun, error
    for _ in range(_REFINEMENTS):
        beyond = np.maximum(x - onset, 0.0)
        rises = [beyond**power, beyond ** (power + 1)]
        basis = np.column_stack([np.ones_like(x), *rises])
        constants: Array = np.asarray(np.linalg.lstsq(basis, y, rcond=None)[0], dtype=np.float64)
        steeper = power * constants[1] * beyond ** (power - 1)
        slope = -np.where(beyond > 0, steeper + (power + 1) * constants[2] * beyond**power, 0.0)
        across = slope - basis @ np.linalg.lstsq(basis, slope, rcond=None)[0]
        rest = y - basis @ constants
        curvature = float(across @ across)
        if not curvature > 0:
            return begun, error
        noise = math.sqrt(float(rest @ rest) / (x.size - _UNKNOWNS) / curvature)
        onset = float(np.clip(onset + float(across @ rest) / curvature, x[0], x[-1]))
    # a force that sets in without a slope has no corner to be brought to
    secant = float(f[peak] - constants[0]) / max(float(moved[peak] - onset), 1e-300)
    if power == 1.0 and constants[1] < _AT_ONCE * secant:
        return begun, max(noise, error, abs(onset - begun))
    return onset, noise if noise > _ROUNDING * spacing else error


def _is_flat(moved: Array, f: Array, end: float) -> bool:
    """Whether the force up to a place rises by no more than its scatter."""
    peak = int(np.argmax(f))
    first = moved[:peak] <= end
    if np.count_nonzero(first) < MIN_ROWS or f[peak] <= 0:
        return False
    x, y = moved[:peak][first], f[:peak][first]
    slope, scatter = slope_with_error(x, y)
    secant = float(f[peak] - y[-1]) / max(float(moved[peak] - x[-1]), 1e-300)
    return slope - 2.0 * scatter <= _FLAT * secant


def slack_end(moved: Array, f: Array) -> float | None:
    """Displacement at which a specimen that hung loose, or was not met yet, begins to resist.

    Of a longer approach as much is left out as brings the corner among the first rows.

    Shapes: moved, f (rows,), mm, rising from the first row on, N.
    """
    key = hashlib.blake2b(moved.tobytes() + f.tobytes()).digest()
    if key not in _slack_ends:
        if len(_slack_ends) >= _MOST_SLACK_ENDS:
            _slack_ends.clear()
        _slack_ends[key] = _searched_slack_end(moved, f)
    return _slack_ends[key]


#: places by the digest of the rows: they are asked for each range that is cut out of a recording
_slack_ends: dict[bytes, float | None] = {}
_MOST_SLACK_ENDS = 10_000


def _searched_slack_end(moved: Array, f: Array) -> float | None:
    end = _corner_end(moved, f)
    travel = float(moved[int(np.argmax(f))] - moved[0])
    for start in moved[0] + _LONG_APPROACHES * travel:
        if end is None and _is_level(moved, f, start):
            rows = slice(int(np.argmax(moved > start)), None)
            end = _corner_end(moved[rows], f[rows])
    return end


def _is_level(moved: Array, f: Array, end: float) -> bool:
    """Whether the force up to a place rises far less steeply than beyond it, whatever its noise."""
    peak = int(np.argmax(f))
    first = moved[:peak] <= end
    if np.count_nonzero(first) < MIN_ROWS:
        return False
    x, y = moved[:peak][first], f[:peak][first]
    slope, scatter = slope_with_error(x, y)
    secant = float(f[peak] - y.mean()) / max(float(moved[peak] - x[-1]), 1e-300)
    return abs(slope) + 2.0 * scatter <= _LEVEL * secant


def _corner_end(moved: Array, f: Array) -> float | None:
    """Find where a level turns into a rise, within the first fifth of the travel.

    A level and a parabola from its end on are compared with a smooth curve of as many constants
    (a cubic) over the first third of the travel: a law that stiffens is flat at first, too, and
    bends gradually. None where the rows do not show the corner beyond their scatter.

    Shapes: moved, f (rows,), mm, rising from the first row on, N.
    """
    peak = int(np.argmax(f))
    travel = float(moved[peak] - moved[0])
    x = (moved[: peak + 1] - moved[0]) / max(travel, 1e-300)
    near = (x >= 0) & (x <= _BEGINNING)
    x, y = x[near], f[: peak + 1][near]
    if x.size > _MOST_BINS:  # means of neighboring rows
        parts = np.linspace(0, x.size, _MOST_BINS + 1).astype(int)
        x, y = (np.add.reduceat(values, parts[:-1]) / np.diff(parts) for values in (x, y))
    if x.size < _CORNER_ROWS:
        return None

    def corner(places: Array) -> tuple[float, float, float, float]:
        """Least sum of squares over the places of the end of a level, the place, level, slope."""
        beyond = np.maximum(x - places[:, None], 0.0)
        left, constants = _least_squares(np.stack([np.ones_like(beyond), beyond, beyond**2], -1), y)
        best = int(np.argmin(left))
        return float(left[best]), float(places[best]), *constants[best, :2].tolist()

    places = np.linspace(x[1], _LONGEST_SLACK, _PLACES)
    coarse = corner(places)[1]
    if coarse == places[-1]:
        return None  # it lies beyond these places
    step = float(places[1] - places[0])
    finer = np.linspace(max(coarse - step, x[1]), coarse + step, _PLACES // 2)
    left, onset, level, slope = corner(finer)
    smooth = float(_least_squares(x[None, :, None] ** np.arange(4), y)[0][0])
    rounding = x.size * (1e-6 * float(f[peak])) ** 2
    is_corner = x.size * math.log((smooth + rounding) / (left + rounding)) > _CORNER
    secant = (float(f[peak]) - level) / (1 - onset)
    is_late = onset > _SLACK and slope > _AT_ONCE * secant
    return float(moved[0]) + onset * travel if is_corner and is_late else None


def _least_squares(bases: Array, y: Array) -> tuple[Array, Array]:
    """Sum of squares that each basis leaves of ``y``, and its constants, as ``lstsq`` has them.

    Shapes: bases (k, rows, constants), y (rows,); result (k,), (k, constants).
    """
    u, s, v = np.linalg.svd(bases, full_matrices=False)
    is_full = s > np.finfo(np.float64).eps * max(bases.shape[1:]) * s[:, :1]
    shares = np.where(is_full, (y @ u) / np.where(is_full, s, 1.0), 0.0)
    constants = np.asarray((shares[:, None, :] @ v)[:, 0])
    left = y - (bases @ constants[:, :, None])[..., 0]
    return np.asarray((left**2).sum(axis=1)), constants


def _check_slack(d: Array, f: Array, way: float, where: str) -> None:
    """Refuse a specimen that is not loaded for some way from the recorded zero on."""
    order = np.argsort(d, kind="stable")
    order = order[d[order] >= 0]
    end, travel = slack_end(d[order], f[order]) if order.size else None, float(d.max())
    if end is None:
        return
    rule = (
        f"the force stays at {f[order[0]]:.4g} N from 0 to {way * end:.4g} mm "
        f"({100 * end / travel:.2g} % of the travel) and rises at once from there: the specimen "
        "hung loose or was not met yet"
    )
    mend = (
        'write displacement_zero = "contact" to count from there, or "0 mm" if the specimen is '
        "that soft at first"
    )
    raise InputError(Fault(where, rule, mend))


def _check_zero(d: Array, f: Array, way: float, rules: Rules, where: str) -> None:
    """Refuse a recorded displacement whose zero is not that of the specimen.

    A specimen at rest carries no force. One that carries none far from zero, or resists before
    zero, was recorded in coordinates of the machine.

    Shapes: d, f (rows,), mm, N; both positive into the specimen.
    """
    travel, largest = float(np.ptp(d)), float(f.max())
    first, begins, error, slope = _start(d, f)
    is_late = first > _STARTS_LATE * travel and begins + 2.0 * error < _AT_ZERO * slope * first
    at_zero = float(np.interp(0.0, d[order := np.argsort(d, kind="stable")], f[order]))
    is_early = first < -_STARTS_EARLY * travel and _RISEN * largest < min(
        _rises(d[d <= 0], f[d <= 0]), at_zero
    )
    if abs(first) <= rules.zero_within_mm or not (is_late or is_early):
        return
    at = way * float(d[0])
    turned = float((f - f[0]).max()) < -float((f - f[0]).min())
    rule = (
        f"displacement starts at {at:.6g} mm with {abs(f[0]):.4g} N and goes to "
        f"{way * float(d[int(np.argmax(np.abs(d - d[0])))]):.6g} mm: no specimen that is "
        "unloaded at 0 mm gives these forces"
    )
    mend = (
        f'write displacement_zero = "first row" if the specimen is unloaded at {at:.6g} mm, '
        '"contact" if it was met later, or "0 mm" if the recorded zero is that of the specimen'
        + (f"; and {rules.other_sign}" if turned else "")
    )
    raise InputError(Fault(where, rule, mend))


def _rises(d: Array, f: Array) -> float:
    """Force that some rows gain by a straight line; 0 where that may be noise."""
    if d.size < MIN_ROWS or np.ptp(d) == 0:
        return 0.0
    slope, scatter = slope_with_error(d, f)
    return slope * float(np.ptp(d)) if slope > _CLEAR * scatter else 0.0


def slope_with_error(x: Array, y: Array) -> tuple[float, float]:
    """Slope of a straight line and its standard error."""
    x = x - x.mean()
    square = max(float(x @ x), 1e-300)
    slope = float(x @ y) / square
    rest = y - y.mean() - slope * x
    return slope, math.sqrt(float(rest @ rest) / max(x.size - 2, 1) / square)


def _is_through_zero(d: Array, f: Array, rules: Rules) -> bool:
    """Whether one test was loaded both ways, so that rows on either side of zero count."""
    if not rules.is_signed or rules.spec.toe is not None:
        return False
    before = d < -_STARTS_EARLY * float(np.ptp(d))
    return bool(before.any()) and float(f[before].min()) <= -_AT_ZERO * float(f.max())


def _check_torn(d: Array, f: Array, rules: Rules, where: str) -> None:
    """Refuse rows in the range after which the force fell away within a few and stayed away."""
    peak = int(np.argmax(f))
    low_N = (1 - _TORN) * float(f[peak])  # noqa: N806
    down = int(np.flatnonzero(f >= low_N)[-1]) + 1 if low_N > 0 else d.size
    ahead = down < d.size and bool((np.diff(d[peak:]) > 0).all())
    if peak < MIN_ROWS or not ahead or down - peak > max(1.0, _TEARING * d.size):
        return
    if f[peak - 1] < low_N or d[peak + 1] > rules.high_mm:
        return  # a single high row is none of a specimen that tears
    rule = (
        f"the force falls from {f[peak]:.4g} N at {_place(d[peak], rules)} to "
        f"{f[down]:.4g} N at {_place(d[down], rules)} and stays low: the specimen tore, "
        f"slipped or lost contact ({d.size - peak - 1} rows)"
    )
    raise InputError(Fault(where, rule, _rows_before(float(d[peak]), rules)))


def _check_saturated(d: Array, f: Array, rules: Rules, where: str) -> None:
    """Refuse rows in the range on which the load cell shows its largest reading and no more."""
    at_top = f >= (1 - _AT_LIMIT) * f.max()
    ends = np.r_[np.flatnonzero((np.diff(f) != 0) & ~(at_top[1:] & at_top[:-1])), f.size - 1]
    runs = np.diff(ends, prepend=-1)
    longest = int(np.argmax(np.where(at_top[ends], runs, 0)))
    rows, last = int(runs[longest]), int(ends[longest])
    # steps of a coarse converter are as long elsewhere
    usual = int(runs[~at_top[ends]].max(initial=1))
    first = last - rows + 1
    is_long = d[last] - d[first] > _SATURATED * float(np.ptp(d))
    if rows <= max(_STEPS * usual, MIN_ROWS) or not is_long or d[first + 1] > rules.high_mm:
        return
    begin = max(first - rows, 0)
    rises = (f[first] - f[begin]) / max(float(d[first] - d[begin]), 1e-300)
    if np.ptp(f[first : last + 1]) > 0 and rises < _AT_ONCE * f.max() / float(np.ptp(d)):
        return  # a force that passes its maximum, and bends before it
    rule = (
        f"the force stands at {f.max():.4g} N, its largest value, in {rows} rows from "
        f"{_place(d[first], rules)} on: the load cell was at its limit"
    )
    raise InputError(Fault(where, rule, _rows_before(float(d[max(first - 1, 0)]), rules)))


def _rows_before(end_mm: float, rules: Rules) -> str:
    return f'fit the rows before: range = ["{max(rules.low_mm, 0.0):.6g} mm", "{end_mm:.6g} mm"]'


def _covariance(d: Array, f: Array) -> float:
    """Covariance over squares of the largest values, so that it cannot overflow."""
    d, f = d / np.abs(d).max(), f / np.abs(f).max()
    return float(np.mean((d - d.mean()) * (f - f.mean())))


def _zero(d: Array, f: Array, rules: Rules) -> float:
    """Read the load cell without load, in N (d, f in the order of the recording)."""
    if rules.spec.zero != "fit":
        return float(f[0]) if rules.spec.zero == "first" else 0.0
    # where contact was declared, the approach shows it
    approach = f[d < min(_CERTAIN * float(d.min()), 0.0)]
    is_approach = rules.counts_from == "contact" and approach.size >= MIN_ROWS
    return float(approach.mean()) if is_approach else _start(d, f)[1]


def _start(d: Array, f: Array) -> tuple[float, float, float, float]:
    """First displacement of the line through the first rows, its force, error and slope there.

    These are the rows in the first tenth of the travel, at least three.
    """
    count = int(np.count_nonzero(d <= d.min() + ZERO_FIT_SHARE * np.ptp(d)))
    order = np.argsort(d, kind="stable")[: max(count, MIN_ROWS)]
    x, y = d[order], f[order]
    slope, scatter = slope_with_error(x, y)
    arm = float(x[0] - x.mean())
    error = scatter * math.hypot(float(x.std()), arm)
    return float(x[0]), float(y.mean()) + slope * arm, error, slope


def _offset(d: Array, f: Array, rules: Rules) -> float | None:
    """Share of the largest force that is there before the specimen is loaded; None if it is small.

    Both the first reading and the straight line through the first tenth of the travel must say so,
    beyond its error: the one alone may be noise, the other the curvature of a sound test.
    """
    first = int(np.argmin(d))
    if rules.spec.zero != "none" or rules.spec.toe is not None:
        return None
    if abs(float(d[first])) > OFFSET_SHARE * float(np.abs(d).max()):
        return None
    largest = float(np.abs(f).max())
    _, begins, error, _ = _start(d, f)
    shares = sorted((float(f[first]) / largest, begins / largest), key=abs)
    same, is_clear = shares[0] * shares[1] > 0, abs(begins) > _BEYOND_ERROR * error
    return shares[0] if same and is_clear and abs(shares[0]) > OFFSET_SHARE else None


def _sorted_unique(d: Array, f: Array, counts: Counter[str]) -> tuple[Array, Array]:
    out_of_order = int(np.count_nonzero(np.diff(d) < 0))
    if out_of_order:
        counts[SORTED] += out_of_order
        order = np.argsort(d, kind="stable")
        d, f = d[order], f[order]
    places, inverse, repeats = np.unique(
        np.round(d / EQUAL_MM), return_inverse=True, return_counts=True
    )
    if places.size < d.size:
        counts["rows of equal displacement averaged"] += int(repeats[repeats > 1].sum())
        _say_relaxed(f, np.argsort(inverse, kind="stable"), repeats, counts)
        d = np.bincount(inverse, weights=d) / repeats
        f = np.bincount(inverse, weights=f) / repeats
    return d, f


def _say_relaxed(f: Array, order: Ints, repeats: Ints, counts: Counter[str]) -> None:
    """Count rows at one displacement over which the force falls: a specimen that was held."""
    ends = np.cumsum(repeats)
    loaded = np.abs(f[order[ends - repeats]]) > NO_FORCE * np.abs(f).max()
    several = (repeats > 1) & loaded
    if not several.any():
        return
    first, last = f[order[ends - repeats]][several], f[order[ends - 1]][several]
    share = float(np.sum(first - last) / np.sum(np.abs(first)))
    if np.mean(last < first) > _MOSTLY and share > _RELAXED:
        mend = "their mean is neither: leave rows out, or name the column of time"
        fallen = f"{RELAXED} {100 * share:.2g} % over the rows of one displacement"
        counts[f"{fallen}, and {mend}"] += 1


def _toe(
    d: Array, f: Array, rules: Rules, where: str, counts: Counter[str]
) -> tuple[Array, Array, float]:
    """Shift displacement to where the force passes the toe for the last time from below."""
    if rules.spec.toe is None:
        return d, f, 0.0
    below = np.flatnonzero(f <= rules.spec.toe)
    start = int(below[-1]) + 1 if below.size else 0
    if start >= d.size:
        rule = f"the force never stays above the toe of {rules.spec.toe:.4g} N"
        raise InputError(Fault(where, rule, "lower toe"))
    contact = float(d[start])
    if start:
        share = (rules.spec.toe - f[start - 1]) / (f[start] - f[start - 1])
        contact = float(d[start - 1] + share * (d[start] - d[start - 1]))
        counts["rows before contact dropped (toe)"] += start
        d, f = np.r_[contact, d[start:]], np.r_[rules.spec.toe, f[start:]]
    return d - contact, f, contact


def _resample(d: Array, f: Array, rules: Rules, where: str, counts: Counter[str]) -> Array:
    low, high = rules.low_mm, rules.high_mm
    spacing = (high - low) / max(int(rules.spec.points) - 1, 1)
    slack = 1e-9 * high
    if d[-1] < high - slack:
        rule = f"ends at {_place(d[-1], rules)}, the range asks for {_place(high, rules)}"
        mend = "shorten the range or leave this test out" + _other_unit(float(d[-1]), high)
        raise InputError(Fault(where, rule, mend))
    if d[0] > low + slack:
        if d[0] > low + spacing or low < 0:
            rule = f"begins at {_place(d[0], rules)}, the range asks for {_place(low, rules)}"
            raise InputError(Fault(where, rule, "raise the lower end of the range"))
        # the unloaded origin is part of every curve; it bridges less than one grid step here
        counts["tests whose start was joined to the unloaded origin"] += 1
        d, f = np.r_[0.0, d], np.r_[0.0, f]
    inside = int(np.count_nonzero((d >= low - slack) & (d <= high + slack)))
    if inside < MIN_ROWS:
        raise InputError(_too_few(inside, rules, where, float(d[-1])))
    return np.asarray(np.interp(rules.grid(), d, f), dtype=float)


def _place(value_mm: float, rules: Rules) -> str:
    percent = f" ({100 * value_mm / rules.height_mm:.4g} %)" if rules.height_mm else ""
    return f"{value_mm:.4g} mm{percent}"


def is_caution(note: str) -> bool:
    """Whether a note on measurements says that they may not be what they seem."""
    return any(mark in note for mark in _CAUTIONS)
