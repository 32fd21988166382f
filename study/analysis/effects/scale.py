"""The working scale of a response: what matters on it, and what bounds its numerical error."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from study.analysis.effects.estimates import TermEstimate
from study.analysis.effects.numerical_bound import NumericalBound


def _exp(value: float) -> float:
    """Exponential; infinite where a double is too small for it."""
    try:
        return math.exp(value)
    except OverflowError:
        return math.inf


@dataclass(frozen=True)
class Scale:
    """What turns an estimate into a verdict, on the working scale.

    Parameters
    ----------
    transform : {"none", "log"}
        Of the response.
    practical : float or None
        Smallest difference that matters.
    bound : NumericalBound or None
        Of the numerical error; None where none is known.
    deterministic : bool
        Whether the differences are known without scatter.
    unit : float
        Unit of the response on the working scale.
    specimens : int or None
        Blocks that were measured; None where the rows are no scores of specimens.
    only : mapping of str to str
        Level of a factor that alone counts for the simple effects of the others.
    """

    transform: str
    practical: float | None
    bound: NumericalBound | None
    deterministic: bool
    unit: float = 1.0
    specimens: int | None = None
    only: Mapping[str, str] = field(default_factory=dict)

    @property
    def back(self) -> Callable[[float], float]:
        """From the working scale to that of the report."""
        return _exp if self.transform == "log" else float

    def between(self, estimate: TermEstimate, first: int, second: int) -> float | None:
        """Bound of the difference of two levels (or combinations) of a term, by their index."""
        if self.bound is None:
            return None
        sides = [
            dict(zip(estimate.term, estimate.settings[i], strict=True)) for i in (first, second)
        ]
        known = self.bound.of if len(estimate.term) == 1 else self.bound.of_component
        return known(*sides)
