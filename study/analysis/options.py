"""What may be asked of an analysis, checked once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from study.errors import Fault, InputError, nearest

_CHOICES = {
    "type": ("auto", "I", "II", "III"),
    "transform": ("none", "log"),
    "error": ("auto", "pooled", "own"),
    "replicates": ("auto", "runs", "mesh-seeds", "noise"),
}


@dataclass(frozen=True)
class Options:
    """Options of one analysis; see :func:`study.analysis.analyze`."""

    block: tuple[str, ...] = ()
    unit: str | None = None
    whole_plot: tuple[str, ...] = ()
    replicates: str = "auto"
    type: str = "auto"
    model: Any = "full"
    error: str = "auto"
    records: bool = False
    tolerance: float | None = None
    practical: Any = None
    transform: str = "none"
    u_num: float | Mapping[str, float] | None = None
    alpha: float = 0.05
    seed: int = 2011
    exact: bool = True

    def check(self) -> None:
        """Raise for every option outside its range.

        Raises
        ------
        InputError
            Naming all of them at once.
        """
        faults = []
        for name, choices in _CHOICES.items():
            value = getattr(self, name)
            if value not in choices:
                listed = f"{', '.join(choices[:-1])} or {choices[-1]}"
                faults.append(Fault(name, f"must be {listed}, got {value!r}"))
        if not 0 < self.alpha < 1:
            faults.append(Fault("alpha", f"must be between 0 and 1, got {self.alpha!r}"))
        if self.error == "own" and not self.block:
            mend = "name the replicated unit with --block"
            rule = "'own' tests against interactions with the blocks, but no block is named"
            faults.append(Fault("error", rule, mend))
        if self.error == "own" and len(self.block) > 1:
            faults.append(Fault("error", "'own' needs one block; several that cross are pooled"))
        if self.whole_plot and len(self.block) != 1:
            faults.append(Fault("whole plot", "needs the block in which the plots lie, one column"))
        if faults:
            raise InputError(faults)

    @property
    def largest_u_num(self) -> float | None:
        """Numerical uncertainty in the unit of the response: the largest of a mapping."""
        return max(self._u_nums(), default=None)

    @property
    def smallest_u_num(self) -> float | None:
        """Numerical uncertainty in the unit of the response: the smallest of a mapping."""
        return min(self._u_nums(), default=None)

    def _u_nums(self) -> list[float]:
        if isinstance(self.u_num, Mapping):
            return [float(v) for v in self.u_num.values() if v is not None and np.isfinite(v)]
        return [] if self.u_num is None else [float(self.u_num)]

    def u_num_of_terms(self, terms: Iterable[str]) -> dict[str, float] | None:
        """Numerical uncertainty of each term; None where one holds for all.

        Raises
        ------
        InputError
            If one is given for what is no term.
        """
        if not isinstance(self.u_num, Mapping):
            return None
        known = list(terms)
        strange = [name for name in self.u_num if name not in known]
        if strange:
            raise InputError(
                [Fault("u_num", f"{n!r} is no term", nearest(n, known)) for n in strange]
            )
        found = {name: float(u) for name, u in self.u_num.items() if u is not None}
        return {name: u for name, u in found.items() if np.isfinite(u)}
