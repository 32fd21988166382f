"""Frozen results of the statistics, with the keys that scripts rely on."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from study.ground.canonical import Keyed, plain

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class ErrorTerm:
    """Where the error of the table comes from and which question its p answers."""

    source: str
    question: str
    df: float | dict[str, float] | None
    reason: str = ""


@dataclass(frozen=True)
class Row:
    """One line of the ANOVA table; what does not apply is None."""

    term: str
    df: float
    ss: float
    ms: float | None = None
    f: float | None = None
    p: float | None = None
    error: str | None = None
    df_error: float | None = None
    epsilon_gg: float | None = None
    p_gg: float | None = None
    omega_sq: float | None = None
    partial_eta_sq: float | None = None
    partial_eta_sq_ci95: tuple[float, float] | None = None
    share: float | None = None

    @property
    def p_deciding(self) -> float | None:
        """Greenhouse-Geisser's p where there is one, else the plain p."""
        return self.p if self.p_gg is None else self.p_gg


@dataclass(frozen=True)
class Anova:
    """ANOVA table of one type, with the corrected total."""

    type: str
    rows: tuple[Row, ...]
    df_total: int | None = None
    ss_total: float | None = None

    def row(self, term: str) -> Row:
        """Row of a term."""
        return next(row for row in self.rows if row.term == term)

    def to_frame(self) -> pd.DataFrame:
        """Table as a frame, one row a term; what does not apply is missing."""
        import pandas as pd

        return pd.DataFrame([plain(row) for row in self.rows])


@dataclass(frozen=True)
class ModelSummary:
    """Residual standard deviation ``s`` and the coefficients of determination of a fit."""

    s: float
    r_sq: float
    r_sq_adj: float
    r_sq_pred: float | None


@dataclass(frozen=True)
class Influential:
    """Largest leverage and Cook's distance, and the rows (from 1) that the fit leans on."""

    max_leverage: float
    max_cook: float | None
    limit: float
    rows: tuple[int, ...]


@dataclass(frozen=True)
class FailureBound:
    """What missing responses could do to one term."""

    term: str
    #: Bounds of the largest difference over all values that the missing responses may take between
    #: the lowest and the highest observed one.
    low: float | None
    high: float | None
    #: Verdicts met: of the rows there are, then with the missing ones at the extremes.
    verdicts: tuple[str, ...]
    #: Smallest and largest deciding p among them.
    p: tuple[float, float] | None
    #: Whether the verdict is the same everywhere.
    holds: bool

    @property
    def can_change_verdict(self) -> bool:
        """Whether the missing responses could change the verdict."""
        return len(self.verdicts) > 1


@dataclass(frozen=True)
class Comparison(Keyed):
    """Difference ``first - second`` (or ratio) of two levels with its simultaneous interval."""

    first: str
    second: str
    difference: float
    lower: float
    upper: float
    factor: str = ""
    #: Adjusted for all that are compared together: below alpha where the interval excludes no
    #: difference. None where it is not asked for, or the error is made of several strata.
    p: float | None = None
    #: What makes interval and p hold for all of them.
    method: str = ""
    #: Whether the interval excludes no difference; None where p says it.
    different: bool | None = None

    def keyed(self) -> dict[str, object]:
        """Give what stands under every key: what is given of it."""
        return {key: value for key, value in vars(self).items() if value not in (None, "")}


@dataclass(frozen=True)
class SimpleEffect:
    """Difference of two levels of a factor at one setting of the others."""

    #: Levels; the difference is first - second.
    first: str
    second: str
    #: Factors that interact with this one, and their levels.
    at: tuple[tuple[str, str], ...]
    #: On the scale of the analysis, as everything here.
    difference: float
    #: Interval of this difference alone, and of all simple effects of the factor together.
    ci: tuple[float, float] | None
    ci_simultaneous: tuple[float, float] | None
    #: Bound of the numerical error; None where it is not known.
    u: float | None
    #: By the simultaneous interval for *matters*, by its own for *no practical difference*.
    verdict: str


@dataclass(frozen=True)
class Contrast:
    """A named difference with its intervals and its verdict."""

    name: str
    #: In the unit of the response, or a ratio where its log was analyzed; as the intervals.
    difference: float
    #: Of this contrast alone, and of all that were asked for together; None without scatter.
    ci: tuple[float, float] | None
    ci_simultaneous: tuple[float, float] | None
    df: float | None
    #: Of no difference: alone, and adjusted for all that were asked for (Holm 1979).
    p: float | None
    #: Bound of the numerical error; None where it is not known.
    u: float | None
    #: Against the smallest difference that matters.
    verdict: str
    why: str = ""
    p_holm: float | None = None


@dataclass(frozen=True)
class CompleteSettings:
    """Settings of other factors at which all levels of a factor can be compared."""

    #: Factors that interact with it.
    others: tuple[str, ...]
    #: How many settings of theirs are complete, of how many.
    count: int
    total: int


#: between the reason of a claim and the condition that it rests on
ON_CONDITION = "; only "


@dataclass(frozen=True)
class Effect:
    """Size of one term in response units (or as a ratio, for a log response).

    ``range`` is the largest difference between level means of a factor, or between the pure
    interaction components of an interaction (in a two-level design both equal the classical
    effect); ``ci95`` is its simultaneous interval over all pairs. Levels of a factor that share
    one of the ``letters`` are not told apart. ``u_num`` bounds the numerical error of the largest
    difference, ``u_needed`` is what a claim would need; both are in response units, and ``u_unit``
    times them is on the scale that was analyzed. The verdict of a factor is that of its
    ``simple_effects``; ``always`` lists the pairs of levels (larger, smaller) whose difference
    is beyond the practical one at every setting of the other factors. An interaction has no
    verdict; ``of_components`` says what the interval of its largest pure component allows.
    ``lost_without`` names the blocks without which the claim is not made: a fragile one;
    ``withdrawn`` says why claims that the intervals allow are not made.
    """

    term: str
    levels: tuple[str, ...]
    mean: tuple[float | None, ...]
    ci95: tuple[float, float] | None
    range: float | None
    verdict: str
    scale: str = "difference"
    largest: tuple[str, str] | None = None
    #: Of each level; None for both ends where its mean is not estimable.
    mean_ci95: tuple[tuple[float | None, float | None], ...] | None = None
    practical: float | None = None
    u_num: float | None = None
    effect_over_u_num: float | None = None
    resolved: str | None = None
    p: float | None = None
    why: str = ""
    pairs: tuple[Comparison, ...] = ()
    letters: tuple[str, ...] = ()
    p_holm: float | None = None
    u_needed: float | None = None
    u_unit: float = 1.0
    simple_effects: tuple[SimpleEffect, ...] = ()
    always: tuple[tuple[str, str], ...] = ()
    of_components: str = ""
    lost_without: tuple[str, ...] | None = None
    withdrawn: tuple[str, ...] = ()
    #: Where a factor is compared beside empty cells; None where it is at every setting.
    complete: CompleteSettings | None = None

    def to_json(self) -> dict[str, object]:
        """Document of the effect; without a practical difference its verdicts are null."""
        document: dict[str, object] = {**plain(self)}
        del document["complete"]  # the notes of the analysis say it
        if self.practical is None:
            document["verdict"] = None
            every = [{**plain(e), "verdict": None} for e in self.simple_effects]
            document["simple_effects"] = every
        return document

    @property
    def condition(self) -> str:
        """What the claim assumes and the rows hardly tell; empty where there is nothing."""
        return self.why.partition(ON_CONDITION)[2]

    @property
    def is_main(self) -> bool:
        """Whether this is the effect of one factor alone."""
        return ":" not in self.term

    @property
    def strength(self) -> str:
        """Verdict of a factor; of an interaction what its components allow."""
        return self.of_components or self.verdict

    @property
    def is_ratio(self) -> bool:
        """Whether sizes are ratios (1.1 is ten percent), as of a log response."""
        return self.scale == "ratio"

    @property
    def low(self) -> float | None:
        """Lower end of the interval of the largest difference."""
        return self.ci95[0] if self.ci95 and math.isfinite(self.ci95[0]) else None

    @property
    def high(self) -> float | None:
        """Upper end of the interval of the largest difference."""
        return self.ci95[1] if self.ci95 and math.isfinite(self.ci95[1]) else None

    @property
    def highest(self) -> str:
        """Level with the largest mean; where some are not known, that of the largest difference."""
        return self._extreme(0)

    @property
    def lowest(self) -> str:
        """Level with the smallest mean, likewise."""
        return self._extreme(1)

    def _extreme(self, side: int) -> str:
        pairs = list(zip(self.levels, self.mean, strict=False))
        if self.largest is not None and any(mean is None for _, mean in pairs):
            return self.largest[side]
        estimated = [(level, mean) for level, mean in pairs if mean is not None]
        return (min if side else max)(estimated, key=lambda pair: pair[1])[0]

    @property
    def largest_simple(self) -> SimpleEffect | None:
        """Simple effect that is farthest from no difference."""
        return max(self.simple_effects, key=self.distance, default=None)

    @property
    def deciding_simple(self) -> SimpleEffect | None:
        """Largest of the simple effects that have the verdict of the term, if any has it."""
        chosen = [e for e in self.simple_effects if e.verdict == self.verdict]
        return max(chosen, key=self.distance, default=self.largest_simple)

    @property
    def is_partial(self) -> bool:
        """Whether its levels are compared at some settings of the others alone: cells are empty."""
        return self.complete is not None

    @property
    def depends_on_settings(self) -> bool:
        """Whether its simple effects are several, at settings of other factors."""
        return len({e.at for e in self.simple_effects}) > 1

    @property
    def matters_on_average(self) -> bool:
        """Whether the average difference lies beyond what matters, interval and numerics too."""
        if self.low is None or self.practical is None:
            return True
        u = (self.u_num or 0.0) * self.u_unit
        return self._analyzed(self.low) - u > self._analyzed(self.practical)

    def distance(self, simple_effect: SimpleEffect) -> float:
        """How far a simple effect is from no difference, on the scale of the analysis."""
        return abs(self._analyzed(simple_effect.difference))

    def _analyzed(self, size: float) -> float:
        return math.log(size) if self.is_ratio else size


@dataclass(frozen=True)
class BoxCoxResult:
    """Power transformation of the response with its 95 % likelihood interval."""

    exponent: float
    #: Infinite where no exponent that was looked at is excluded.
    ci95: tuple[float, float]


@dataclass(frozen=True)
class AnalysisSensitivity:
    """p of every term in each defensible analysis, and in how many it is below alpha."""

    p: dict[str, dict[str, float | None]]
    agreement: dict[str, str]


@dataclass(frozen=True)
class NaiveTerm:
    """One term with the units as replicates, and as it would look with every row as one."""

    term: str
    f: float
    df: tuple[float, float]
    p: float
    naive_f: float
    naive_df: tuple[float, float]
    naive_p: float


@dataclass(frozen=True)
class NestedUnits:
    """How far rows on one unit are from independent, and what taking them so would claim."""

    unit: str
    #: Number of rows, and of units in cells.
    rows: int
    units: int
    #: Intraclass correlation of two rows on one unit.
    correlation: float
    #: Number of independent rows that tell as much: rows / (1 + (m - 1) correlation).
    effective_rows: float
    #: Width of an honest interval over that of the naive one.
    too_narrow: float
    #: How often the naive 5 % test of a factor would reject a true null.
    naive_size: float
    terms: tuple[NaiveTerm, ...]


@dataclass(frozen=True)
class DepthEffect:
    """Effect of a factor on a response that was scored to a part of the depth of its test."""

    response: str
    depth_mm: float
    effect: Effect


@dataclass(frozen=True)
class PowerRow:
    """Detectable difference of two level means with ``n`` blocks or replicates."""

    n: int
    detectable: float
    df: tuple[int, int]
    cost: float | None = None
