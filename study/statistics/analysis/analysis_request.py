"""What is asked of an analysis: response, factors, blocks, model, error and scale, checked once."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypedDict

from study.ground.contrast import Threshold
from study.ground.errors import Fault, InputError, nearest
from study.ground.units import converted, is_known, naming, unit_of_column
from study.statistics.analysis.linear_model import Model
from study.statistics.analysis.simple_effects import Confidence
from study.statistics.convergence.contrast_bound import NumericalBound, OneBound, TermBounds

_TEXT = re.compile(
    r"^\s*(?P<value>(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?)\s*(?P<unit>[^\d\s.,+-].*?)?\s*$"
)


def on_scale(limit: Threshold | None, mean: float, transform: str = "none") -> float | None:
    """Half-width of the practical band on the working scale; None without one.

    Examples
    --------
    >>> round(math.exp(on_scale(Threshold(0.10, relative=True), 25.0, "log")), 10)
    1.1
    """
    if limit is None:
        return None
    if transform == "log":
        return math.log1p(limit.value if limit.relative else limit.value / abs(mean))
    return limit.value * abs(mean) if limit.relative else limit.value


def threshold(practical: Practical, unit: str = "") -> Threshold | None:
    """Read a practical difference, a number or a text, in the unit of its response where known.

    Examples
    --------
    >>> threshold("10 % of mean"), threshold(".5e-3 pp").value, threshold("500 mN", "N").value
    (Threshold(value=0.1, relative=True), 0.0005, 0.5)
    """
    if practical is None or isinstance(practical, Threshold):
        return practical
    if isinstance(practical, str):
        difference = _parse(practical, unit)
    else:
        difference = Threshold(float(practical))
    if not (math.isfinite(difference.value) and difference.value > 0):
        raise InputError(Fault("practical", f"must be a positive difference, got {practical!r}"))
    return difference


def unchecked_unit(practical: Practical, response: str) -> tuple[str, ...]:
    """Say that the unit of a practical difference is not converted: the column names none."""
    match = _TEXT.match(practical) if isinstance(practical, str) else None
    unit = "" if match is None else match["unit"] or ""
    if match is None or not unit or "%" in unit or is_known(unit_of_column(response)):
        return ()
    return (
        f"the practical difference {match[0].strip()} is read as {match['value']} in the unit of "
        f"{response}, whatever that is: nothing is converted until the name of the column ends in "
        f"its unit, such as '{response} [{unit}]'",
    )


def _parse(text: str, response_unit: str) -> Threshold:
    match = _TEXT.match(text)
    if match is None:
        mend = "write '0.5 pp', '0.05 N' or '5 % of mean'"
        raise InputError(Fault("practical", f"cannot read {text!r}", mend))
    value, unit = float(match["value"]), " ".join((match["unit"] or "").split())
    if unit.replace(" ", "") == "%ofmean":
        return Threshold(value / 100, relative=True)
    if unit == "%":
        rule = f"{text!r} can be a share of the mean, or percentage points of a response in %"
        mend = f"write '{match['value']} % of mean' or '{match['value']} pp'"
        raise InputError(Fault("practical", rule, mend))
    # whether a word is a unit is asked last, since pint takes .6 s to import
    if not unit or (unit, response_unit) == ("pp", "%") or not is_known(response_unit):
        return Threshold(value)
    with naming("practical"):
        return Threshold(converted(value, unit, response_unit))


#: Smallest difference that matters, as it may be given; a number is in the unit of the response.
Practical = Threshold | str | float | None
#: Numerical uncertainty as it may be given: of all differences, of single terms, of any contrast.
NumericalUncertainty = float | Mapping[str, float | None] | NumericalBound | None


class AnovaOptions(TypedDict, total=False):
    """Keywords of :func:`study.statistics.analysis.anova.anova`, where they are described."""

    block: str | Sequence[str] | None
    unit: str | None
    whole_plot: str | Sequence[str]
    replicates: str
    copies: str
    type: str
    model: Model
    error: str
    records: bool
    tolerance: float | None
    practical: Practical
    transform: str
    u_num: NumericalUncertainty
    specimens: int | None
    alpha: float
    seed: int
    exact: bool


@dataclass(frozen=True)
class Blocking:
    """What the rows are repeats of."""

    #: Columns of the replicated unit; several cross (a Latin square).
    block: tuple[str, ...] = ()
    #: Column of the unit on which rows are repeated and whose rows are averaged.
    unit: str | None = None
    #: Factors set once per whole plot of a block.
    whole_plot: tuple[str, ...] = ()
    #: {"auto", "runs", "mesh-seeds", "noise"}: what the rows of one cell are.
    replicates: str = "auto"
    #: {"refuse", "independent"}: what rows are that repeat others in every digit.
    copies: str = "refuse"

    def faults(self) -> list[Fault]:
        """List every breach of the rules."""
        faults = _not_one_of("replicates", self.replicates, ("auto", "runs", "mesh-seeds", "noise"))
        faults += _not_one_of("copies", self.copies, ("refuse", "independent"))
        if self.whole_plot and len(self.block) != 1:
            rule = "needs the block in which the plots lie, one column"
            faults.append(Fault("whole plot", rule))
        return faults


@dataclass(frozen=True)
class ResponseScale:
    """Scale on which the response is analyzed, and what counts as a difference on it."""

    #: {"none", "log"}: ``log`` reports effects as ratios.
    transform: str = "none"
    practical: Threshold | None = None
    #: Bound of the numerical error of a difference, in the unit of the response.
    u_num: NumericalUncertainty = None
    #: Solver tolerance in the unit of the response; None for the default.
    tolerance: float | None = None

    @property
    def is_log(self) -> bool:
        """Whether the logarithm of the response is analyzed."""
        return self.transform == "log"

    def faults(self) -> list[Fault]:
        """List every breach of the rules."""
        faults = _not_one_of("transform", self.transform, ("none", "log"))
        if isinstance(self.u_num, Mapping):
            faults += [f for name, u in self.u_num.items() for f in _unusable(f"u_num {name}", u)]
        elif isinstance(self.u_num, int | float):
            faults += _unusable("u_num", self.u_num)
        return faults

    def bound(self, terms: Iterable[str], unit: float) -> NumericalBound | None:
        """Numerical uncertainty of every difference, on the working scale."""
        if not isinstance(self.u_num, Mapping):
            return (
                OneBound(self.u_num * unit) if isinstance(self.u_num, int | float) else self.u_num
            )
        names = list(terms)
        if strange := [name for name in self.u_num if name not in names]:
            raise InputError(
                [Fault("u_num", f"{n!r} is no term", nearest(n, names)) for n in strange]
            )
        return TermBounds({n: u * unit for n, u in self.u_num.items() if u is not None})


#: smallest error probability: quantiles of studentized ranges are integrals, which do not end
#: far below
SMALLEST_ALPHA = 1e-9


def alpha_faults(alpha: float) -> list[Fault]:
    """List what is wrong with an error probability: nothing where it is one."""
    if SMALLEST_ALPHA <= alpha < 1:
        return []
    rule = f"must be between {SMALLEST_ALPHA:g} and 1, got {alpha!r}"
    return [Fault("alpha", rule, "usual are 0.05 and 0.01")]


@dataclass(frozen=True)
class AnalysisRequest:
    """One question to a table; :func:`study.statistics.analysis.anova.analyze` answers it."""

    response: str
    factors: tuple[str, ...]
    layout: Blocking = field(default_factory=Blocking)
    model: Model = "full"
    #: {"auto", "I", "II", "III"}: type of the sums of squares; ``auto`` is II when balanced and III
    #: when not.
    sums: str = "auto"
    #: {"auto", "pooled", "own", "welch"}: how the error is found; see ``error_ledger``.
    error: str = "auto"
    scale: ResponseScale = field(default_factory=ResponseScale)
    #: Whether the rows are records of a deterministic study.
    records: bool = False
    #: Specimens that were measured; None to count the blocks.
    specimens: int | None = None
    alpha: float = 0.05
    seed: int = 2011
    #: Whether to simulate the exact p of Ryan-Joiner, Bartlett and Levene.
    exact: bool = True
    #: Whether simultaneous intervals of simple effects are simulated.
    simulated: bool = True

    @property
    def any_type(self) -> bool:
        """Whether the table decides the type: a study's own "II" is meant for complete ones."""
        return self.sums == "auto" or (self.records and self.sums == "II")

    @property
    def confidence(self) -> Confidence:
        """Level of intervals, with the seed of simultaneous ones where they are simulated."""
        return Confidence(self.alpha, self.seed if self.simulated else None)

    @property
    def is_ordered(self) -> bool:
        """Whether the terms are all those up to an order."""
        return self.model == "full" or isinstance(self.model, int)

    @property
    def lower_order(self) -> int:
        """Highest order of a smaller model, at most two; 0 where none of fewer terms has a name."""
        order = self.model if isinstance(self.model, int) else len(self.factors)
        return min(2, order - 1, len(self.factors) - 1) if self.is_ordered else 0

    def __post_init__(self) -> None:
        faults = [
            *_not_one_of("type", self.sums, ("auto", "I", "II", "III")),
            *_not_one_of("error", self.error, ("auto", "pooled", "own", "welch")),
            *self.layout.faults(),
            *self.scale.faults(),
            *alpha_faults(self.alpha),
        ]
        if self.error == "welch" and (self.layout.block or self.layout.unit):
            rule = "'welch' gives each cell a variance of its own, which needs rows without blocks"
            faults.append(Fault("error", rule, "leave it out: effects over blocks need none"))
        if self.error == "welch" and not self.any_type and self.sums != "III":
            rule = f"'welch' tests each term given all others, which is III, not {self.sums}"
            faults.append(Fault("type", rule, "leave it out"))
        if self.error == "own" and not self.layout.block:
            rule = "'own' tests against interactions with the blocks, but no block is named"
            faults.append(Fault("error", rule, "name the replicated unit with --block"))
        if self.error == "own" and len(self.layout.block) > 1:
            faults.append(Fault("error", "'own' needs one block; several that cross are pooled"))
        if faults:
            raise InputError(faults)


def _not_one_of(name: str, value: str, choices: Sequence[str]) -> list[Fault]:
    if value in choices:
        return []
    listed = f"{', '.join(choices[:-1])} or {choices[-1]}"
    return [Fault(name, f"must be {listed}, got {value!r}")]


def _unusable(where: str, u: float | None) -> list[Fault]:
    if u is None or (math.isfinite(u) and u >= 0):
        return []
    mend = "leave it out where it is not known; 0 means that there is none"
    return [Fault(where, f"must be zero or a positive number, got {u!r}", mend)]
