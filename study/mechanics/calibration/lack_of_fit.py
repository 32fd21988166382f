"""What the residuals say about the model: adequacy, lack of fit, pattern, choice between energies.

The points of one test are not independent of each other: a load cell drifts, a contact
settles. Nothing in a single test tells how many independent errors it holds, so every
verdict is given for both ends: as many as points, and one a curve.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from study.ground.arrays import Array
from study.ground.canonical import Keyed
from study.ground.curve import Curve
from study.ground.errors import Fault, InputError, RefusedError
from study.ground.noncentral_f import noncentral_f_sf
from study.ground.units import p_phrase, times
from study.mechanics.calibration.fit import Fit
from study.mechanics.calibration.fit_influence import recorded_rows
from study.mechanics.calibration.residual_function import MeasuredCurve
from study.mechanics.calibration.serial_correlation import (
    FEWEST_ROWS,
    Mixture,
    RowNoise,
    Series,
    row_noise,
    trend,
)
from study.mechanics.material.material import is_dimensionless

ALPHA = 0.05


@dataclass(frozen=True)
class LackOfFit:
    """Comparison of what the model misses with what repeats scatter."""

    #: F: mean square of the misses over the mean square of pure error.
    statistic: float
    #: Degrees of freedom where every point is an independent error.
    df: int
    df_error: int
    #: p where every point is one, and where every curve is one.
    p_independent: float
    p_dependent: float
    #: ``lack-of-fit``, ``adequate``, or ``undecided`` where the two disagree.
    verdict: Literal["lack-of-fit", "adequate", "undecided"]


@dataclass(frozen=True)
class ResidualPattern:
    """Order in the residuals along the curves."""

    #: Correlation of neighboring residuals; near 0 where only noise is left.
    lag1: float
    #: Runs of equal sign, and how many independent residuals would show.
    runs: int
    expected_runs: float
    #: Two-sided p of the runs test (Wald and Wolfowitz 1940), normal approximation.
    p: float


def lack_of_fit(curves: Sequence[tuple[Array, Array, int]], parameters: int) -> LackOfFit | None:
    """F test of lack of fit against the pure error of repeats (Draper and Smith 1998, 2.1).

    Of each averaged curve: residual of the mean, standard deviation of the repeats times the same
    weights, both of shape (n,), and how many were averaged, at least two.
    """
    df = sum(left.size for left, _, _ in curves) - parameters
    df_error = sum(left.size * (repeats - 1) for left, _, repeats in curves)
    missed = sum(repeats * float(left @ left) for left, _, repeats in curves)
    pure = sum((repeats - 1) * float(scatter @ scatter) for _, scatter, repeats in curves)
    if df <= 0 or df_error <= 0 or pure <= 0:
        return None
    from scipy.special import fdtrc

    statistic = (missed / df) / (pure / df_error)
    many = float(fdtrc(df, df_error, statistic))
    few = float(fdtrc(len(curves), sum(repeats - 1 for *_, repeats in curves), statistic))
    clear: Literal["lack-of-fit", "adequate"] = "lack-of-fit" if many < ALPHA else "adequate"
    agree = (many < ALPHA) == (few < ALPHA)
    return LackOfFit(statistic, df, df_error, many, few, clear if agree else "undecided")


def pattern(residuals: Sequence[Array]) -> ResidualPattern | None:
    """Pattern of the residuals along each curve; None below eight points."""
    series = [r for r in residuals if r.size > 1]
    n = sum(r.size for r in series)
    power = sum(float(r @ r) for r in series)
    if n < 8 or power == 0:
        return None
    lag1 = sum(float(r[1:] @ r[:-1]) for r in series) / power
    runs, expected, variance = 0, 0.0, 0.0
    for above in (r > 0 for r in series):
        size, plus = above.size, int(np.count_nonzero(above))
        both = 2 * plus * (size - plus)
        runs += int(np.count_nonzero(above[1:] != above[:-1])) + 1
        expected += 1 + both / size
        variance += both * (both - size) / (size * size * (size - 1))
    from scipy.special import erfc

    p = float(erfc(abs(runs - expected) / math.sqrt(2 * variance))) if variance > 0 else math.nan
    return ResidualPattern(lag1, runs, expected, p)


# Whether a model describes the rows that it was fitted to, beside the optimizer's word. Misfit is a
# trend that no drift explains, a root mean square beyond what neighboring rows scatter by, or a
# row far from its neighbors. Error rates by simulation: tests/calibration/test_adequacy.py.

Verdict = Literal["describes", "doubtful", "does not describe"]
_GRADES: tuple[Verdict, ...] = ("describes", "doubtful", "does not describe")
#: misfit to be named, as a share of the root mean square force
_NAMED = 0.01
#: misfit that condemns where it is a trend, as a share of the same
_TREND = 0.1
#: root mean square error that condemns where rows scatter less, as a share of the same
_LARGE_ERROR = 0.15
#: root mean square error over the scatter of rows from which it is no noise
_BEYOND_NOISE = 2.0
#: p below which a trend, or a lack of fit, is named
_CLEAR = 0.001
#: p below which it condemns
_CLEARER = 0.0005
#: coefficients of a trend (Legendre polynomials) at least
_FEWEST_TERMS = 3
#: coefficients of a trend at most
_MOST_TERMS = 4
#: the same of a biaxial test, both directions together
_STATE_TERMS = 12
#: rows for each coefficient of a trend
_ROWS_A_TERM = 5
#: share of the largest force by which a single row must be off to be named
_OFF = 0.02
#: rows on either side of a step at least; levels are medians of twice as many
_SIDE = 3
#: the same of a drift over the recording
_DRIFTS = 0.02
#: sums of neighboring rows in which a step must show, too
_LEVELS = 15
#: rows among which a step can be told from a bend, places at which it is looked for at most, and
#: shares of the rows over which it comes about
_STEP_ROWS = 20
_MOST_PLACES = 200
_SLIPS_OVER = (0.0, 0.1, 0.2, 0.3)
#: share of a column beside those of the constants below which it is rounding
_ROUNDING = 1e-6
#: a repeat whose forces differ from the median by this factor is taken for another specimen's
_REPEATS_APART = 1.5
#: the same of specimens of one test
_SPECIMENS_APART = 4.0
#: the same over the scatter of their logarithms (1.48 times the median distance)
_BEYOND_OTHERS = 6.0
#: factor from which the scatter of all, which is hardly known of few, is no excuse, but that of the
#: others times this is
_FAR_APART = 6.0
_BEYOND_REST = 3.5


@dataclass(frozen=True)
class SuspectRow:
    """A row that the fit does not describe, or that is far from its neighbors."""

    label: str
    #: Its number among the rows used, from 1.
    row: int
    displacement_mm: float
    force_N: float  # noqa: N815
    predicted_N: float  # noqa: N815


@dataclass(frozen=True)
class Adequacy(Keyed):
    """Whether the model describes its data, and what to do where it does not."""

    KEYS = "verdict sentence reasons rows"

    verdict: Verdict
    #: Each with what to do, the worst first; empty where the model describes.
    reasons: tuple[str, ...] = ()
    rows: tuple[SuspectRow, ...] = ()

    @property
    def describes(self) -> bool:
        """Whether constants may be recommended, if with doubt."""
        return self.verdict != "does not describe"

    @property
    def sentence(self) -> str:
        """The verdict in words: the same in every output."""
        verdict = {
            "describes": "the model describes the data",
            "doubtful": "it is doubtful that the model describes the data",
            "does not describe": "the model does not describe the data: use no constant of it",
        }[self.verdict]
        return ": ".join([verdict, "; ".join(self.reasons)]) if self.reasons else verdict


@dataclass(frozen=True)
class _Recording:
    """Residuals of the rows of one recording."""

    fit: Fit
    label: str
    test: int
    weight: Array
    rows: Curve
    predicted_N: Array  # noqa: N815
    slopes: Array
    #: Whether single rows count for little.
    is_robust: bool = False
    #: shape (n, 3); direction (0 or 1) of a biaxial row, its elongation and that across it; none
    #: where there is one direction.
    states: Array | None = None

    @cached_property
    def parts(self) -> tuple[_Recording, ...]:
        """Recordings of each direction: only their rows follow each other."""
        if self.states is None:
            return (self,)
        return tuple(
            replace(self._at(rows), label=f"{self.label}, direction {k}", states=None)
            for k, rows in enumerate(self.places_by_direction, 1)
        )

    @property
    def places_by_direction(self) -> list[NDArray[np.intp]]:
        """Places of the rows of each direction."""
        if self.states is None:
            return [np.arange(self.residual.size)]
        return [np.flatnonzero(self.states[:, 0] == k) for k in (0, 1)]

    def trend_columns(self, most: int) -> Array:
        """Columns of a smooth misfit, shape (n, m): over the rows, or over both stretches.

        Rows of a biaxial test may come in any order of the stretches, in which a misfit looks like
        noise: it is a polynomial of the first degree in both, of the second where rows are many,
        for each direction.
        """
        n = self.residual.size
        if self.states is None:
            return np.asarray(np.polynomial.legendre.legvander(np.linspace(-1, 1, n), most - 1))
        direction, *stretched = self.states.T
        middle = [np.ptp(x) / 2 + x.min() for x in stretched]
        x, y = (x - at for x, at in zip(stretched, middle, strict=True))
        columns = [np.ones(n), x, y]
        if n >= _ROWS_A_TERM * _STATE_TERMS:
            columns += [x * x, x * y, y * y]
        both = np.hstack([np.column_stack(columns) * (direction == k)[:, None] for k in (0, 1)])
        return np.asarray(both[:, np.linalg.norm(both, axis=0) > 0])

    @property
    def residual(self) -> Array:
        return np.asarray(self.predicted_N - self.rows.force_N)

    @cached_property
    def noise(self) -> RowNoise | None:
        return row_noise(self.residual, self.rows.places, self.predicted_N)

    @property
    def weighted_force(self) -> Array:
        return np.asarray(self.weight * self.rows.force_N)

    @cached_property
    def by_noise(self) -> tuple[Array, Series] | None:
        """Factor by which the rows count in a trend, and residuals times it."""
        free, noise = np.isfinite(self.fit.standard_error), self.noise
        if self.residual.size < FEWEST_ROWS or not free.any():
            return None
        # half of the growth: rows of small force would hide a misfit of the larger ones
        grows = noise is not None and noise.power > 0
        size = self.weight if noise is None or not grows else 1 / np.sqrt(noise.relative)
        jacobian = size[:, None] * self.slopes[:, free]
        if not np.all(np.linalg.norm(jacobian, axis=0) > 0):
            return None
        return size, Series(size * self.residual, jacobian, jacobian.T)

    @cached_property
    def far(self) -> NDArray[np.intp]:
        """Places of rows far from their neighbors."""
        if self.states is not None:
            pairs = zip(self.parts, self.places_by_direction, strict=True)
            return np.concatenate([rows[part.far] for part, rows in pairs])
        if (noise := self.noise) is None:
            return np.zeros(0, dtype=int)
        size = np.abs(noise.distance * noise.deviation)
        # of few rows growth with the force is seldom significant, and makes large forces look far
        grown = noise.grown(self.predicted_N)
        distance = size / np.maximum(noise.deviation, grown.deviation)
        # above the 99.9 % point of the largest distance in simulated noise: 14.3 of 8 rows, 9.6 of
        # 10, 6.7 of 20, 5.3 of 50 and 5.1 of 100 (2,000 to 6,000 draws each)
        is_far = distance > 6.0 + 400 / size.size**1.8
        return np.flatnonzero(is_far & (size > _OFF * float(np.abs(self.predicted_N).max())))

    def without_far(self) -> _Recording:
        """Copy without them."""
        return self._at(np.delete(np.arange(self.residual.size), self.far))

    def _at(self, rows: NDArray[np.intp]) -> _Recording:
        """Copy of some of the rows, given by their places."""
        return replace(
            self,
            rows=self.rows.at_points(rows),
            predicted_N=self.predicted_N[rows],
            weight=self.weight[rows],
            slopes=self.slopes[rows],
            states=None if self.states is None else self.states[rows],
        )


_Finding = tuple[int, str, tuple[SuspectRow, ...]]


def adequacy(
    fit: Fit,
    measured: Sequence[MeasuredCurve],
    *,
    tests: Sequence[int] = (),
    lack: LackOfFit | None = None,
    more: Sequence[tuple[Verdict, str]] = (),
) -> Adequacy:
    """Judge whether a fit describes the data that it was made to.

    ``tests`` numbers the test of every curve: curves of one test are repeats or specimens, and
    their differences are noise. ``more`` are reasons that others have, with their verdicts.
    """
    if not fit.status.usable:
        return Adequacy("does not describe", (f"the search has no minimum: {fit.message}",))
    findings: list[_Finding] = [(_GRADES.index(grade), why, ()) for grade, why in more]
    findings += _of_bounds(fit)
    numbers = tests or range(len(measured))
    recordings = [
        _Recording(fit, test.label, number, weight, rows, force, slopes, test.loss != "linear",
                   test.states if len(rows) == len(test.curve) else None)
        for test, curve, number in zip(measured, fit.curves, numbers, strict=True)
        for weight, rows, force, slopes in recorded_rows(test, curve, fit.names)
    ]  # fmt: skip
    # a robust loss may leave out single rows, and no line that they follow
    judged = [r.without_far() if r.is_robust else r for r in recordings]
    groups = [[r for r in judged if r.test == t] for t in dict.fromkeys(r.test for r in judged)]
    findings += _of_strays(fit, measured, numbers)
    findings += _of_size(fit, groups)
    for recording in recordings:
        for part in recording.parts:
            findings += _of_rows(part)
    findings += _of_trend(groups)
    findings += _of_conflict(fit, groups)
    # what specimens of one test differ by is no lack of fit of each
    is_pooled = len(set(numbers)) < len(numbers)
    if lack and not is_pooled and max(lack.p_independent, lack.p_dependent) < _CLEAR:
        why = f"repeats scatter less than the model misses them ({p_phrase(lack.p_dependent)})"
        findings.append((1, f"{why}: take an energy with more constants", ()))
    if not findings:
        return Adequacy("describes")
    findings.sort(key=lambda finding: -finding[0])
    rows = {(row.label, row.row): row for _, _, suspects in findings for row in suspects}
    return Adequacy(
        _GRADES[findings[0][0]],
        tuple(dict.fromkeys(why for _, why, _ in findings)),
        tuple(rows.values()),
    )


def _of_strays(
    fit: Fit, measured: Sequence[MeasuredCurve], tests: Sequence[int]
) -> Iterator[_Finding]:
    """Find repeats, and specimens of one test, whose forces are a multiple of the others'."""
    specimens: dict[int, dict[str, float]] = {}
    for test, predicted, number in zip(measured, fit.curves, tests, strict=True):
        expected = predicted.force_at(test.curve.displacement_mm)
        share = expected / float(expected @ expected)
        repeats = {
            f"{test.label}, repeat {repeat}": float(
                share @ np.interp(test.curve.places, rows.places, rows.force_N)
            )
            for repeat, rows in enumerate(test.curve.recorded, 1)
        }
        yield from apart(repeats, _REPEATS_APART)
        specimens.setdefault(number, {})[test.label] = float(share @ test.curve.force_N)
    for scales in specimens.values():
        yield from apart(scales, _SPECIMENS_APART if len(scales) > 2 else _FAR_APART)


def apart(scales: Mapping[str, float], most: float) -> list[_Finding]:
    """Name those whose size is a multiple of the others', beyond what these scatter by."""
    sizes = np.array(list(scales.values()))
    # of two, nothing tells which is right
    usual = 0.0 if sizes.size < 2 else float(sizes[0] if sizes.size == 2 else np.median(sizes))
    if not usual > 0:
        return []
    logarithms = np.log(np.maximum(sizes / usual, _ROUNDING))
    scatter = 0.0 if sizes.size == 2 else 1.48 * float(np.median(np.abs(logarithms)))
    others = [np.delete(logarithms, k) for k in range(sizes.size)]
    rest = np.array([np.std(each, ddof=1) if each.size > 1 else 0.0 for each in others])
    excused = np.maximum(math.log(_FAR_APART), _BEYOND_REST * rest)
    limit = np.maximum(math.log(most), np.minimum(_BEYOND_OTHERS * scatter, excused))
    mend = "check units, sign and specimen of its rows, or leave it out"
    return [
        (1, f"{label}: its forces are {times(size / usual, 2)} the others': {mend}", ())
        for label, size, is_off in zip(scales, sizes, np.abs(logarithms) > limit, strict=True)
        if is_off
    ]


def _of_bounds(fit: Fit) -> list[_Finding]:
    held = [
        f"{name} ended at its bound ({value:.6g}{'' if is_dimensionless(name) else ' MPa'})"
        for name, value, error in zip(fit.names, fit.values, fit.standard_error, strict=True)
        if fit.converged and math.isnan(error)
    ]
    mend = "widen calibration.bounds, or take an energy with fewer constants"
    return [(1, f"{', '.join(held)}: {mend}", ())] if held else []


def _of_size(fit: Fit, groups: Sequence[Sequence[_Recording]]) -> Iterator[_Finding]:
    """Find a root mean square error beyond the scatter of rows, repeats and specimens."""
    if fit.r_squared < 0:
        why = f"the mean force describes the rows better (R2 = {fit.r_squared:.2f})"
        yield 2, f"{why}: check displacement_zero, sign, range and units of the columns", ()
    for group in groups:
        squares = sum(float(np.sum((r.weight * r.residual) ** 2)) for r in group)
        force = sum(float(np.sum(r.weighted_force**2)) for r in group)
        error, scatter = math.sqrt(squares / force), math.sqrt(_scatter(group) / force)
        if error > _LARGE_ERROR and error > _BEYOND_NOISE * scatter:
            why = (
                f"{_labels(group)}: the RMS error is {100 * error:.3g} % of the RMS force, and "
                f"rows scatter by {100 * scatter:.2g} %: check units, range and single rows, then "
                "the energy"
            )
            yield 2, why, ()


def _labels(group: Sequence[_Recording]) -> str:
    return ", ".join(dict.fromkeys(r.label for r in group[:3]))


def _scatter(group: Sequence[_Recording]) -> float:
    """Sum of squares that rows and the differences of recordings leave, weighted."""
    total = sum(
        float(np.sum((r.weight * r.noise.deviation) ** 2)) for r in group if r.noise is not None
    )
    if len(group) > 1:
        grid, rows = _on_one_grid(group)
        apart = rows - rows.mean(axis=0)
        share = sum(recording.rows.places.size for recording in group) / grid.size / len(group)
        total += share * float(np.sum(apart**2)) * len(group) / (len(group) - 1)
    return total


def _on_one_grid(group: Sequence[_Recording]) -> tuple[Array, Array]:
    """Weighted residuals of several recordings at the places of the first, shape (k, n)."""
    grid = group[0].rows.places
    return grid, np.array([np.interp(grid, r.rows.places, r.weight * r.residual) for r in group])


def _of_rows(recording: _Recording) -> Iterator[_Finding]:
    """Single rows far from their neighbors, or a step at which forces jump."""
    noise, places = recording.noise, recording.far
    if noise is None or not places.size:
        return
    largest = float(np.abs(recording.rows.force_N).max())
    size = np.abs(noise.distance * noise.deviation)
    columns = (recording.rows.displacement_mm, recording.rows.force_N, recording.predicted_N)
    rows = tuple(
        SuspectRow(recording.label, int(k) + 1, *(float(column[k]) for column in columns))
        for k in places
    )
    listed = ", ".join(str(row.row) for row in rows[:8]) + (", ..." if len(rows) > 8 else "")
    if steps := _steps(recording.residual, places):
        d, jumps = recording.rows.displacement_mm, np.abs(np.diff(recording.residual)[steps])
        where = "; ".join(
            f"rows {k + 1} and {k + 2}, {d[k]:.4g} and {d[k + 1]:.4g} mm" for k in steps[:4]
        )
        most, first = ("", "it") if len(steps) == 1 else ("up to ", "the first")
        why = (
            f"{recording.label}: the force jumps by {most}{jumps.max():.3g} N between {where}: "
            f"the specimen slipped or tore there: fit only the range before {first}"
        )
        yield 1, why, rows
        return
    gone = float(np.sum(recording.residual[places] ** 2) / np.sum(recording.residual**2))
    mend = 'leave out what was misread, or write calibration.loss = "soft-l1"'
    grade = 2 if gone > 0.5 and size.max() > 0.2 * largest else 1
    if recording.is_robust:
        mend, grade = "the loss lets them count for little", 0
    row, verb = ("row", "is") if places.size == 1 else ("rows", "are")
    shown = f"{100 * gone:.0f}" if gone > 0.1 else f"{100 * gone:.2g}"
    why = (
        f"{recording.label}: {row} {listed} of {recording.rows.places.size} {verb} off by up to "
        f"{size.max():.3g} N where neighbors scatter by "
        f"{float(np.median(noise.deviation)):.2g} N, {shown} % of the sum of squares: {mend}"
    )
    yield grade, why, rows


def _steps(residual: Array, places: NDArray[np.intp]) -> list[int]:
    """Rows after which residuals stay at another level; empty where far rows have another cause.

    A row that was misread is far from both of its sides, one beside a step from one of them alone.
    """
    steps: list[int] = []
    for k in range(_SIDE - 1, residual.size - _SIDE):
        if not {k, k + 1} & set(places.tolist()):
            continue
        before = residual[max(k + 1 - 2 * _SIDE, 0) : k + 1]
        after = residual[k + 1 : k + 1 + 2 * _SIDE]
        jump, level = abs(float(residual[k + 1] - residual[k])), float(np.median(before))
        beyond = float(np.median(after))
        ends = max(abs(float(residual[k]) - level), abs(float(residual[k + 1]) - beyond))
        if abs(beyond - level) > 0.5 * jump and ends < 0.3 * jump:
            steps.append(k)
    is_all = all(any(-_SIDE < row - k <= _SIDE for k in steps) for row in places.tolist())
    return steps if is_all else []


def _of_trend(groups: Sequence[Sequence[_Recording]]) -> list[_Finding]:
    """Residuals that follow a smooth line which no drift of the rows explains."""
    out: list[_Finding] = []
    judged = [(group, *_common_trend(group)) for group in groups if len(group) > 1]
    stepped: list[str] = []
    for group in groups:
        for recording in group:
            step, by_step = _step_of_one(recording)
            if not step and len(group) > 1:
                continue
            p, line, explained = _trend_of_one(recording)
            # what bends smoothly is no step
            if step and by_step > explained:
                stepped.append(step)
            elif len(group) == 1:
                judged.append((group, p, line))
    for group, p, line in judged:
        force = np.concatenate([r.weighted_force for r in group])
        share = math.sqrt(float(np.mean(line**2) / np.mean(force**2))) if line.size else 0.0
        if p >= _CLEAR or share < _NAMED:
            continue
        grade = 2 if p < _CLEARER and share > _TREND else 1
        why = (
            f"{_labels(group)}: the residuals have a trend of {100 * share:.2g} % of the RMS "
            f"force, beyond noise and drift ({p_phrase(p)}): take another energy, or a shorter "
            "range"
        )
        out.append((grade, why, ()))
    # each direction of a biaxial test has a load cell of its own
    alone = [group[0] for group in groups if len(group) == 1 and group[0].states is None]
    drifts = [_shift_of_one(r) for r in alone if not (out or stepped)]
    return [*out, *((1, why, ()) for why in (*stepped, *drifts) if why)]


def _of_conflict(fit: Fit, groups: Sequence[Sequence[_Recording]]) -> list[_Finding]:
    """Find tests, or directions of one, that each follow the energy, with constants of their own.

    The trend of a test alone leaves out what its constants explain. Here it is what constants of
    its own explain beside the common ones.
    """
    free = np.isfinite(fit.standard_error)
    if not free.any():
        return []
    if max(map(len, groups)) > 1:
        labels = [_labels(group) for group in groups]
        p, shares = _conflict_of_specimens(groups, free)
    else:
        parts = [part for group in groups for part in group[0].parts]
        labels = [part.label for part in parts]
        p, shares = _conflict_of_rows(parts, free)
    if p >= _CLEAR or max(shares) < _NAMED:
        return []
    named = "; ".join(
        f"{label} {100 * share:.2g} %" for label, share in zip(labels, shares, strict=True)
    )
    compared = "tests" if len(groups) > 1 else "directions"
    mend = "fit each alone, and compare units, zeros and specimens"
    if len(groups) == 1:
        mend = "compare areas, zeros, and the stretches of clamps and specimen"
    why = (
        f"the {compared} ask for different constants ({p_phrase(p)}): those of all miss what each "
        f"alone would follow, by shares of its RMS force of {named}: {mend}; if all are right, "
        "take another energy"
    )
    return [(1, why, ())]


def _conflict_of_rows(
    parts: Sequence[_Recording], free: NDArray[np.bool_]
) -> tuple[float, list[float]]:
    """P that single recordings share their constants, and what each misses over its RMS force.

    Rows count by the noise of their recording.
    """
    from scipy.linalg import block_diag

    deviations = [r.noise.deviation for r in parts if r.noise is not None]
    if not 1 < len(parts) == len(deviations):
        return 1.0, []
    pairs = list(zip(parts, deviations, strict=True))
    jacobians = [r.slopes[:, free] / deviation[:, None] for r, deviation in pairs]
    if not np.linalg.norm(np.concatenate(jacobians), axis=0).all():
        return 1.0, []
    series = [Series(r.residual / s, j, j.T) for (r, s), j in zip(pairs, jacobians, strict=True)]
    blocks = np.asarray(block_diag(*jacobians))
    columns = blocks[:, np.linalg.norm(blocks, axis=0) > 0]
    ends = np.cumsum([deviation.size for deviation in deviations])[:-1]
    p, line = trend(series, np.split(columns, ends))
    return p, [
        math.sqrt(float(np.mean((part * s) ** 2) / np.mean(r.rows.force_N**2)))
        for (r, s), part in zip(pairs, np.split(line, ends), strict=True)
    ]


def _conflict_of_specimens(
    groups: Sequence[Sequence[_Recording]], free: NDArray[np.bool_]
) -> tuple[float, list[float]]:
    """P that tests of several specimens share their constants, and what each misses.

    Means of tests are compared with what their specimens (repeats, where there is one) scatter by,
    which need not be the same in all tests (Brown and Forsythe 1974, Technometrics 16, 129). A test
    of one specimen is taken to scatter as the others do.
    """
    from scipy.special import fdtrc

    shares, slopes = zip(*(_shares_of_slopes(group, free) for group in groups), strict=True)
    number = np.array([len(share) for share in shares])
    freedom = number - 1
    squares = np.array([float(np.sum((share - share.mean(axis=0)) ** 2)) for share in shares])
    if len(groups) < 2 or not squares.any():
        return 1.0, []
    pooled = float(squares.sum() / freedom.sum())
    variance = np.where(freedom > 0, squares / np.maximum(freedom, 1), pooled)
    means, root = [share.mean(axis=0) for share in shares], np.sqrt(number)
    between = np.concatenate([k * mean for k, mean in zip(root, means, strict=True)])
    common = np.concatenate([k * slope for k, slope in zip(root, slopes, strict=True)])
    between = between - common @ np.linalg.lstsq(common, between, rcond=None)[0]
    parts = (1 - number / number.sum()) * variance
    several = freedom > 0
    left = float(parts.sum() ** 2 / np.sum(parts[several] ** 2 / freedom[several]))
    p = float(fdtrc(len(groups) - 1, left, float(between @ between) / float(parts.sum())))
    return p, [float(np.linalg.norm(mean)) for mean in means]


def _shares_of_slopes(group: Sequence[_Recording], free: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Give what constants explain of the residuals of specimens, (k, m), and slopes, (m, p).

    Both over the size of the force. Repeats of one specimen are averaged; where there is one
    specimen alone they stand for specimens.
    """
    _, rows = _on_one_grid(group)
    first, labels = group[0], np.array([r.label for r in group])
    jacobian = first.weight[:, None] * first.slopes[:, free]
    left, lengths, _ = np.linalg.svd(jacobian, full_matrices=False)
    basis = left[:, lengths > _ROUNDING * lengths[0]] / np.linalg.norm(first.weighted_force)
    shares, specimens = rows @ basis, dict.fromkeys(labels.tolist())
    if len(specimens) > 1:
        shares = np.array([shares[labels == label].mean(axis=0) for label in specimens])
    return shares, basis.T @ jacobian


def _trend_of_one(recording: _Recording) -> tuple[float, Array, float]:
    """P that one recording holds no trend, the trend, and its sum of squares by noise."""
    if (counted := recording.by_noise) is None:
        return 1.0, np.zeros(0), 0.0
    size, series = counted
    terms = min(_MOST_TERMS, max(_FEWEST_TERMS, size.size // _ROWS_A_TERM))
    columns = size[:, None] * recording.trend_columns(terms)
    places = recording.places_by_direction
    p, line = trend([series.at(rows) for rows in places], [columns[rows] for rows in places])
    return p, recording.weight * line / size, float(line @ line)


def _shift_of_one(recording: _Recording) -> str:
    """Say by how much a drift in proportion to time, or a zero, moves constants beyond an interval.

    Constants take up most of a drift, so that little of it is left in the residuals: with 5 %
    of the largest force and noise of .2 % of it, one constant and 40 rows, it is seen in 7 of 8
    tests (100 rows: in all), beside noise of 1 % in 1 of 80, with two constants and 100 rows in 3
    of 8 (``validation/calibrations.py``).
    """
    if (counted := recording.by_noise) is None:
        return ""
    size, series = counted
    columns = np.linspace(0, 1, size.size), np.ones(size.size)
    changes = [_changed_by(recording, size, series, column) for column in columns]
    if not any(change.share >= _DRIFTS and change.beyond > 1 for change in changes):
        return ""
    p, which = min((_p_of(series, size * column), k) for k, column in enumerate(columns))
    change = changes[which]
    if p >= _CLEAR or change.share < _DRIFTS or not change.beyond > 1:
        return ""
    does, mend = "with a zero that is off", 'write zero = "first" or "fit", or displacement_zero'
    mend = f"{mend} where the specimen was preloaded or met late"
    if which == 0:
        does, mend = "that drifts", "compare the load cell's readings before and after the test"
    return (
        f"{recording.label}: the residuals are those of a force {does} by "
        f"{100 * change.share:.2g} % of its largest value ({p_phrase(p)}), which moves "
        f"{change.constant} by {change.percent:.2g} %, beyond its interval: {mend}, or take "
        "another energy"
    )


@dataclass(frozen=True)
class _ChangedForce:
    """A change of the recorded force, and what it does to the constants."""

    size_N: float  # noqa: N815
    #: Over the largest force.
    share: float
    #: Constant that it moves most, by how much of its value and of half its interval.
    constant: str
    percent: float
    beyond: float


def _changed_by(recording: _Recording, size: Array, series: Series, change: Array) -> _ChangedForce:
    """Fit a change of the force beside the constants; rows count by ``size``."""
    fit = recording.fit
    scale = np.linalg.norm(series.jacobian, axis=0)
    both = np.column_stack([series.jacobian / scale, size * change])
    *shift, size_N = np.linalg.lstsq(both, -series.residual, rcond=None)[0]  # noqa: N806
    (free,) = np.nonzero(np.isfinite(fit.standard_error))
    moved = np.abs(np.array(shift) / scale)
    # exact data have no interval, and no drift
    beyond = 2 * moved / np.maximum(np.diff(fit.ci95[free], axis=1)[:, 0], 1e-300)
    most = int(beyond.argmax())
    percent = 100 * float(moved[most] / abs(fit.values[free[most]]))
    share = abs(float(size_N)) / float(np.abs(recording.rows.force_N).max())
    return _ChangedForce(float(size_N), share, fit.names[free[most]], percent, float(beyond[most]))


def _p_of(series: Series, column: Array) -> float:
    """P that the residuals hold no column, shape (n,), beside the constants and a drift."""
    return trend([series], [column[:, None]], explained=_ROUNDING)[0]


def _step_of_one(recording: _Recording) -> tuple[str, float]:
    """Say where the force changes to another level; and the sum of squares that this explains.

    It changes at once, as where a load cell is set to zero, or over some rows, as where a specimen
    slips. Of all places the one is taken that explains most, for which p counts. Rows drift, too,
    so that p is that of a level beside an autoregression (:func:`trend`).
    """
    none = "", 0.0
    # rows of a biaxial test may come in any order; far rows are named with a step that they show
    is_open = recording.states is None and not recording.far.size
    if not is_open or recording.residual.size < _STEP_ROWS:
        return none
    if (counted := recording.by_noise) is None:
        return none
    size, series = counted
    level, explained = _best_level(size, series)
    if level is None:
        return none
    step = _changed_by(recording, size, series, level)
    if step.share < _NAMED or not (step.share >= _OFF or step.beyond > 1):
        return none
    p_here = min(_p_of(series, size * level), 0.5)
    p = -math.expm1(min(size.size, _MOST_PLACES) * math.log1p(-p_here))
    if p >= _CLEAR or (p := max(p, _p_of_levels(series, size * level))) >= _CLEAR:
        return none
    first, last = np.flatnonzero(level == 0)[-1], np.flatnonzero(level == 1)[0]
    d = recording.rows.displacement_mm
    cause, mend = "slipped, or the load cell was set to zero", ""
    if last - first > _SIDE:
        cause, mend = "slipped gradually, or follows another law", ", or take another energy"
    why = (
        f"{recording.label}: the force changes by {step.size_N:+.3g} N between rows {first + 1} "
        f"and {last + 1}, {d[first]:.4g} and {d[last]:.4g} mm, and stays there ({p_phrase(p)}), "
        f"which moves {step.constant} by {step.percent:.2g} %: the specimen {cause}: fit only the "
        f"range before it{mend}"
    )
    return why, explained


def _p_of_levels(series: Series, column: Array) -> float:
    """P of a column in sums over neighboring rows, in which a slow drift shows beside noise."""
    begins = np.linspace(0, column.size, _LEVELS + 1).astype(int)[:-1]
    root = np.sqrt(np.diff(begins, append=column.size))[:, None]
    both = np.column_stack([series.residual, series.jacobian, column])
    residual, *jacobian, summed = (np.add.reduceat(both, begins) / root).T
    slopes = np.array(jacobian)
    return _p_of(Series(residual, slopes.T, slopes), summed)


def _best_level(size: Array, series: Series) -> tuple[Array | None, float]:
    """Change from 0 to 1, shape (n,), that explains most of the residuals, and how much of them.

    It is looked for in sums over neighboring rows where these are many.
    """
    n, count = size.size, min(size.size, _MOST_PLACES)
    basis, _ = np.linalg.qr(series.jacobian / np.linalg.norm(series.jacobian, axis=0))
    left = series.residual - basis @ (basis.T @ series.residual)
    begins = np.linspace(0, n, count + 1).astype(int)[:-1]
    force, square = np.add.reduceat(size * left, begins), np.add.reduceat(size**2, begins)
    shared = np.add.reduceat(size[:, None] * basis, begins)
    best, at, number = 0.0, (0, 0), np.arange(count)
    for over in sorted({max(round(share * count), 1) for share in _SLIPS_OVER}):
        # one row a place after which the level changes
        after = np.arange(_SIDE - 1, count - _SIDE - over + 1)
        levels = np.clip((number - after[:, None]) / over, 0, 1)
        free = levels**2 @ square - ((levels @ shared) ** 2).sum(axis=1)
        is_free = free > _ROUNDING * float(square.sum())
        gains = np.where(is_free, (levels @ force) ** 2 / np.where(is_free, free, 1.0), 0.0)
        if gains.max(initial=0.0) > best:
            best, at = float(gains.max()), (int(after[gains.argmax()]), over)
    if best == 0:
        return None, 0.0
    # the level of a sum of rows is that of its first one
    first = int(begins[at[0]] if at[1] > 1 else begins[at[0] + 1] - 1)
    last = int(begins[at[0] + at[1]])
    return np.clip((np.arange(n) - first) / (last - first), 0, 1), best


def _common_trend(group: Sequence[_Recording]) -> tuple[float, Array]:
    """P that recordings of one test have no residual in common, and that residual.

    Coefficients of a trend scatter between recordings by whatever these differ by; their mean is
    compared with that (as few degrees of freedom as if all coefficients moved together).
    """
    from scipy.special import fdtrc

    grid, rows = _on_one_grid(group)
    if grid.size < FEWEST_ROWS:
        return 1.0, np.zeros(0)
    left, lengths, _ = np.linalg.svd(group[0].trend_columns(_FEWEST_TERMS), full_matrices=False)
    basis = left[:, lengths > _ROUNDING * lengths[0]]
    shares = rows @ basis
    mean, count = shares.mean(axis=0), len(group)
    within = float(np.sum((shares - mean) ** 2)) / (count - 1)
    statistic = count * float(mean @ mean) / within if within > 0 else math.inf
    return float(fdtrc(1, count - 1, statistic)), basis @ mean


def akaike_weights(aicc: Mapping[str, float]) -> dict[str, float]:
    """Share of the evidence that each model has (Burnham and Anderson 2002, sec. 2.9)."""
    finite = {name: value for name, value in aicc.items() if math.isfinite(value)}
    if not finite:
        return dict.fromkeys(aicc, math.nan)
    best = min(finite.values())
    share = {name: math.exp(-0.5 * (value - best)) for name, value in finite.items()}
    total = sum(share.values())
    return {name: share.get(name, 0.0) / total for name in aicc}


def same_constants(
    pooled_rss: float, own_rss: float, n: float, p: int, groups: int
) -> float | None:
    """P that groups share their constants, by the extra sum of squares.

    (Bates and Watts 1988, sec. 3.10.)
    """
    extra, left = p * (groups - 1), n - p * groups
    if extra <= 0 or left <= 0 or own_rss <= 0:
        return None
    from scipy.special import fdtrc

    return float(fdtrc(extra, left, max(pooled_rss - own_rss, 0.0) / extra / (own_rss / left)))


# Wald test that fits to different data estimate the same constants, and its power (Cochran 1954,
# Biometrics 10, 101; denominator by Fai and Cornelius 1996, J. Stat. Comput. Simul. 54, 363). p
# is averaged over the correlations of rows that each test allows.

WALD_ALPHA = 0.05
#: power that a test should have against a difference that matters (Cohen 1988)
USUAL_POWER = 0.80
#: correlations of its rows that are drawn for each fit
DRAWS = 4000
#: denominator from which F is a chi-square in every digit that is shown
_MANY = 1e5
#: noncentrality beyond which power is 1
_LARGE = 1e3


@dataclass(frozen=True)
class FitAgreement:
    """Test of the hypothesis that all fits estimate the same constants."""

    #: shape (p,); common estimate, weighted by the inverse covariances, MPa (exponents plain).
    common: Array
    #: shape (p, p); of the common estimate.
    covariance: Array
    #: Sum of the weighted squared distances from it (Wald's statistic), by the mean weights.
    statistic: float
    #: Degrees of freedom, p (k - 1).
    df: int
    #: Denominator degrees of freedom, the median over correlations; infinite where the covariances
    #: are known.
    df_error: float
    #: Of F = statistic / df, averaged over the correlations of rows that each fit allows.
    p: float
    #: The same of a chi-square: what is usual, and too small for few points.
    p_chi_square: float
    #: shape (p, p); weights of the fits.
    inverse_covariances: tuple[Array, ...]

    def power(self, differences: Array) -> float:
        """Probability that the test rejects where the fits differ by this much.

        Shapes: differences (k, p), MPa.
        """
        return _power(self._noncentrality(differences), self.df, self.df_error)

    def detectable(self, differences: Array) -> float:
        """Multiple of these differences that is seen with a power of 80 %; differences (k, p)."""
        from scipy.optimize import brentq

        unit = self._noncentrality(differences)
        if unit <= 0 or _power(_LARGE, self.df, self.df_error) < USUAL_POWER:
            return float("inf")

        def short(noncentrality: float) -> float:
            return _power(noncentrality, self.df, self.df_error) - USUAL_POWER

        return float(np.sqrt(brentq(short, 0.0, _LARGE, xtol=1e-9) / unit))

    def _noncentrality(self, differences: Array) -> float:
        weights = np.array(self.inverse_covariances)[:, None]
        return float(_sum(_distances(differences, weights)[0], weights)[0])


def agreement(fits: Sequence[Fit], extra: Sequence[Array] = ()) -> FitAgreement:
    """Test whether fits to different data give the same constants. Shapes: extra (p, p)."""
    from scipy.special import chdtrc, fdtrc

    _comparable(fits)
    values = np.array([fit.values for fit in fits])
    total, from_rows = _drawn(fits, extra)
    inverses = inverse(total)
    statistics = _sum(_distances(values, inverses)[0], inverses)
    df = len(fits[0].names) * (len(fits) - 1)
    freedom = [fit.n - len(fit.names) for fit in fits]
    weights = inverses.mean(axis=1)
    distances, common = _distances(values, weights[:, None])
    df_error = _denominator(total, from_rows, freedom)
    return FitAgreement(
        common=common[0],
        covariance=inverse(weights.sum(axis=0)),
        statistic=float(_sum(distances, weights[:, None])[0]),
        df=df,
        df_error=float(np.median(df_error)),
        p=float(fdtrc(df, df_error, statistics / df).mean()),
        p_chi_square=float(chdtrc(df, statistics).mean()),
        inverse_covariances=tuple(weights),
    )


def _drawn(fits: Sequence[Fit], extra: Sequence[Array]) -> tuple[Array, Array]:
    """Covariances of every fit at drawn correlations of its rows, shape (k, m, p, p), and its own.

    How strongly neighboring rows are correlated is not known, and not the same in every test.
    Each fit's correlations are as often here as they are likely, in an order of their own.
    """
    mixtures = [None if fit.serial is None else fit.serial.mixture for fit in fits]
    lengths = [1 if parts is None else parts.weight.size for parts in mixtures]
    count, random = 1 if max(lengths) == 1 else DRAWS, np.random.default_rng(2011)
    places = (np.arange(count) + 0.5) / count
    total, from_rows = [], []
    for i, (fit, mixture) in enumerate(zip(fits, mixtures, strict=True)):
        more = extra[i] if len(extra) else np.zeros_like(fit.covariance)
        spread = mixture or Mixture(np.ones(1), fit.covariance[None], fit.covariance[None])
        drawn = random.permutation(np.searchsorted(np.cumsum(spread.weight), places))
        drawn = np.minimum(drawn, spread.weight.size - 1)
        total.append(spread.covariance[drawn] + more)
        from_rows.append(spread.from_rows[drawn])
    return np.array(total), np.array(from_rows)


def _comparable(fits: Sequence[Fit]) -> None:
    if len(fits) < 2 or any(fit.names != fits[0].names for fit in fits):
        mend = "give two or more tests of one material"
        raise InputError(Fault("agreement", "needs two or more fits of the same constants", mend))
    if not all(fit.converged and np.all(np.isfinite(fit.covariance)) for fit in fits):
        raise RefusedError(
            "a fit without a covariance cannot be compared with others: "
            "give more points, or an energy with fewer constants"
        )
    if not all(np.all(np.diag(fit.covariance) > 0) for fit in fits):
        raise RefusedError(
            "a constant that ended at a bound has no standard error to compare by: "
            "widen the bounds, or take an energy with fewer constants"
        )


def inverse(matrix: Array) -> Array:
    """Inverse of covariances, scaled: moduli and exponents differ by orders of magnitude."""
    scale = np.sqrt(np.diagonal(matrix, axis1=-2, axis2=-1))
    outer = scale[..., :, None] * scale[..., None, :]
    return np.asarray(np.linalg.inv(matrix / outer) / outer)


def _distances(values: Array, weights: Array) -> tuple[Array, Array]:
    """Distances of the rows of ``values`` from their weighted mean, and the mean."""
    # Shapes: values (k, p); weights (k, m, p, p); returns (k, m, p).
    total = weights.sum(axis=0)
    scale = 1 / np.sqrt(np.diagonal(total, axis1=-2, axis2=-1))
    right = np.einsum("kmij,kj->mi", weights, values) * scale
    scaled = total * scale[..., :, None] * scale[..., None, :]
    common = scale * np.linalg.solve(scaled, right[..., None])[..., 0]
    return values[:, None] - common, common


def _sum(distances: Array, weights: Array) -> Array:
    return np.asarray(np.einsum("kmi,kmij,kmj->m", distances, weights, distances))


def _denominator(total: Array, from_rows: Array, df: Sequence[int]) -> Array:
    """Degrees of freedom of F's denominator, of the contrasts to the last fit, shape (m,).

    The contrasts are turned so that they are uncorrelated; each has Satterthwaite's degrees of
    freedom nu, and F those with the same mean: E = sum nu / (nu - 2),
    2 E / (E - q), with E - q = sum 2 / (nu - 2).

    Shapes: total, own (k, m, p, p).
    """
    k, p = total.shape[0], total.shape[-1]
    scale = np.sqrt(np.diagonal(total, axis1=-2, axis2=-1).min(axis=0))
    outer = scale[..., :, None] * scale[..., None, :]
    contrast = np.kron(np.hstack([np.eye(k - 1), -np.ones((k - 1, 1))]), np.eye(p))
    parts = contrast.reshape(-1, k, p)

    def variances(matrices: Array) -> Array:
        return np.asarray(np.einsum("akp,kmpq,bkq->kmab", parts, matrices / outer, parts))

    d, turn = np.linalg.eigh(variances(total).sum(axis=0))
    turned = np.einsum("mac,kmab,mbc->kmc", turn, variances(from_rows), turn)
    nu = d**2 / (turned**2 / np.array(df)[:, None, None]).sum(axis=0)
    few = (nu <= 2).any(axis=-1)
    # E - q, without the difference of nearly equal numbers
    safe = np.where(few[:, None], 4.0, nu)
    pooled = (safe / (safe - 2)).sum(axis=-1) / (1 / (safe - 2)).sum(axis=-1)
    return np.asarray(np.where(few, nu.min(axis=-1), np.minimum(pooled, _MANY)))


def _power(noncentrality: float, df: int, df_error: float) -> float:
    from scipy.special import fdtri

    if noncentrality <= 0:
        return WALD_ALPHA
    limit = float(fdtri(df, df_error, 1 - WALD_ALPHA))
    return noncentral_f_sf(df, df_error, min(noncentrality, _LARGE), limit)
