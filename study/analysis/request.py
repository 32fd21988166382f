"""What is asked of an analysis: response, factors, blocks, model, error and scale, checked once."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, TypedDict

from study.analysis.effects.numerical_bound import NumericalBound, bound_of
from study.analysis.linear_model.design_matrix import Model
from study.errors import Fault, InputError, nearest


class PracticalDifference(Protocol):
    """Smallest difference that matters, as a study file declares it."""

    @property
    def value(self) -> float:
        """In ``unit``."""
        ...

    @property
    def unit(self) -> str:
        """Unit of the value; it holds ``%`` for a share of the mean in percent."""
        ...

    @property
    def relative(self) -> bool:
        """Whether the value is a share of the mean."""
        ...


_TEXT = re.compile(r"^\s*(?P<value>\d+(\.\d*)?([eE][+-]?\d+)?|\.\d+)\s*(?P<unit>[^\d\s].*?)?\s*$")


@dataclass(frozen=True)
class Threshold:
    """A practical difference: absolute in the response's unit, or a fraction of the mean."""

    value: float
    relative: bool = False

    def on_scale(self, mean: float, transform: str) -> float:
        """Half-width of the practical band on the working scale.

        Parameters
        ----------
        mean : float
            Mean of the response (geometric for a log response).
        transform : {"none", "log"}
            On the log scale '10 % of mean' is the ratio 1.10, so ln 1.10.

        Examples
        --------
        >>> round(math.exp(Threshold(0.10, relative=True).on_scale(25.0, "log")), 10)
        1.1
        """
        if transform == "log":
            return math.log1p(self.value if self.relative else self.value / abs(mean))
        return self.value * abs(mean) if self.relative else self.value


def threshold(practical: Practical) -> Threshold | None:
    """Read a practical difference: a number, text, or as a study file declares it.

    Parameters
    ----------
    practical : float, str, Threshold, PracticalDifference or None
        A number is in the unit of the response; text is as below, with a share of the mean as
        "% of mean"; None is for no threshold.

    Returns
    -------
    Threshold or None
        A value that is relative is a fraction, 0.1 for 10 %.

    Raises
    ------
    InputError
        If it is not a positive difference.

    Examples
    --------
    >>> threshold("10 % of mean")
    Threshold(value=0.1, relative=True)
    >>> threshold("0.5 pp")
    Threshold(value=0.5, relative=False)
    """
    if practical is None or isinstance(practical, Threshold):
        return practical
    if isinstance(practical, str):
        found = _parse(practical)
    elif isinstance(practical, int | float):
        found = Threshold(float(practical))
    else:
        relative, value = bool(practical.relative), float(practical.value)
        percent = relative and "%" in practical.unit
        found = Threshold(value / 100 if percent else value, relative)
    if not (math.isfinite(found.value) and found.value > 0):
        raise InputError(Fault("practical", f"must be a positive difference, got {practical!r}"))
    return found


def _parse(text: str) -> Threshold:
    match = _TEXT.match(text)
    if match is None:
        raise InputError(
            Fault("practical", f"cannot read {text!r}", "write '0.5 pp', '0.05 N' or '5 % of mean'")
        )
    value, unit = float(match["value"]), " ".join((match["unit"] or "").split())
    if unit.replace(" ", "") == "%ofmean":
        return Threshold(value / 100, relative=True)
    if unit == "%":
        raise InputError(
            Fault("practical", f"{text!r} can mean two things", "write 'pp' or '% of mean'")
        )
    return Threshold(value)


#: Smallest difference that matters, as it may be given; a number is in the unit of the response.
Practical = Threshold | PracticalDifference | str | float | None
#: Numerical uncertainty as it may be given: of all differences, of single terms, of any contrast.
NumericalUncertainty = float | Mapping[str, float | None] | NumericalBound | None


class AnovaOptions(TypedDict, total=False):
    """Keywords of :func:`study.analysis.anova.anova`, where they are described."""

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
    """What the rows are repeats of.

    Parameters
    ----------
    block : tuple of str
        Columns of the replicated unit; several cross (a Latin square).
    unit : str or None
        Column of the unit on which rows are repeated and whose rows are averaged.
    whole_plot : tuple of str
        Factors set once per whole plot of a block.
    replicates : {"auto", "runs", "mesh-seeds", "noise"}
        What the rows of one cell are.
    copies : {"refuse", "independent"}
        What rows are that repeat others in every digit.
    """

    block: tuple[str, ...] = ()
    unit: str | None = None
    whole_plot: tuple[str, ...] = ()
    replicates: str = "auto"
    copies: str = "refuse"

    def faults(self) -> list[Fault]:
        """List every breach of the rules."""
        found = _not_one_of("replicates", self.replicates, ("auto", "runs", "mesh-seeds", "noise"))
        found += _not_one_of("copies", self.copies, ("refuse", "independent"))
        if self.whole_plot and len(self.block) != 1:
            rule = "needs the block in which the plots lie, one column"
            found.append(Fault("whole plot", rule))
        return found


@dataclass(frozen=True)
class ResponseScale:
    """Scale on which the response is analyzed, and what counts as a difference on it.

    Parameters
    ----------
    transform : {"none", "log"}
        ``log`` reports effects as ratios.
    practical : Threshold or None
        Smallest difference that matters.
    u_num : float, mapping of str to float, NumericalBound or None
        Bound of the numerical error of a difference, in the unit of the response.
    tolerance : float or None
        Solver tolerance in the unit of the response; None for the default.
    """

    transform: str = "none"
    practical: Threshold | None = None
    u_num: NumericalUncertainty = None
    tolerance: float | None = None

    @property
    def is_log(self) -> bool:
        """Whether the logarithm of the response is analyzed."""
        return self.transform == "log"

    def faults(self) -> list[Fault]:
        """List every breach of the rules."""
        found = _not_one_of("transform", self.transform, ("none", "log"))
        if isinstance(self.u_num, Mapping):
            found += [f for name, u in self.u_num.items() for f in _unusable(f"u_num {name}", u)]
        elif isinstance(self.u_num, int | float):
            found += _unusable("u_num", self.u_num)
        return found

    def bound(self, terms: Iterable[str], unit: float) -> NumericalBound | None:
        """Numerical uncertainty of every difference, on the working scale.

        Parameters
        ----------
        terms : iterable of str
            Terms of the model, ``"A"`` or ``"A:B"``.
        unit : float
            Unit of the response on the working scale.

        Raises
        ------
        InputError
            If one is given for what is no term.
        """
        if not isinstance(self.u_num, Mapping):
            return bound_of(self.u_num, unit)
        known = list(terms)
        strange = [name for name in self.u_num if name not in known]
        if strange:
            raise InputError(
                [Fault("u_num", f"{n!r} is no term", nearest(n, known)) for n in strange]
            )
        return bound_of({n: float(u) for n, u in self.u_num.items() if u is not None}, unit)


#: smallest error probability: quantiles of studentized ranges are integrals, which do not end
#: far below
SMALLEST_ALPHA = 1e-9


def alpha_faults(alpha: float) -> list[Fault]:
    """List what is wrong with an error probability: nothing where it is one.

    Parameters
    ----------
    alpha : float
        A probability from 1e-9 to below 1, such as 0.05.
    """
    if SMALLEST_ALPHA <= alpha < 1:
        return []
    rule = f"must be between {SMALLEST_ALPHA:g} and 1, got {alpha!r}"
    return [Fault("alpha", rule, "usual are 0.05 and 0.01")]


@dataclass(frozen=True)
class AnalysisRequest:
    """One question to a table; :func:`study.analysis.anova.analyze` answers it.

    Parameters
    ----------
    response : str
        Column of the response.
    factors : tuple of str
        Columns of the factors.
    layout : Blocking
        Blocks, units and whole plots.
    model : "full", int or sequence
        Terms; see :func:`study.analysis.linear_model.design_matrix.terms_of`.
    sums : {"auto", "I", "II", "III"}
        Type of the sums of squares; ``auto`` is II when balanced and III when not.
    error : {"auto", "pooled", "own"}
        How the error is found; see :mod:`study.analysis.error.ledger`.
    scale : ResponseScale
        Transformation, practical difference, numerical uncertainty.
    records : bool
        Whether the rows are records of a deterministic study.
    specimens : int or None
        Specimens that were measured; None to count the blocks.
    alpha : float
        Size of the tests.
    seed : int
        Seed of every simulation.
    exact : bool
        Whether to simulate the exact p of Ryan-Joiner, Bartlett and Levene.
    simulated : bool
        Whether simultaneous intervals of simple effects are simulated; else they are
        Bonferroni's, which are made at once and never narrower.
    """

    response: str
    factors: tuple[str, ...]
    layout: Blocking = field(default_factory=Blocking)
    model: Model = "full"
    sums: str = "auto"
    error: str = "auto"
    scale: ResponseScale = field(default_factory=ResponseScale)
    records: bool = False
    specimens: int | None = None
    alpha: float = 0.05
    seed: int = 2011
    exact: bool = True
    simulated: bool = True

    @property
    def interval_seed(self) -> int | None:
        """Seed of simultaneous intervals; None where they are not simulated."""
        return self.seed if self.simulated else None

    def __post_init__(self) -> None:
        faults = [
            *_not_one_of("type", self.sums, ("auto", "I", "II", "III")),
            *_not_one_of("error", self.error, ("auto", "pooled", "own")),
            *self.layout.faults(),
            *self.scale.faults(),
        ]
        faults += alpha_faults(self.alpha)
        if self.error == "own" and not self.layout.block:
            mend = "name the replicated unit with --block"
            rule = "'own' tests against interactions with the blocks, but no block is named"
            faults.append(Fault("error", rule, mend))
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
