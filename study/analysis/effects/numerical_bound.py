"""Where the numerical uncertainty of a difference comes from: one number, one a term, or series.

A difference is named by the levels on its two sides; the factors that are not named are averaged.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Protocol

import numpy as np

from study.analysis.effects.contrast_uncertainty import (
    CellSeries,
    ContrastUncertainty,
    contrast_uncertainty,
    inherited_uncertainty,
    limit_of,
)

Levels = Mapping[str, str]


class NumericalBound(Protocol):
    """Bound of the numerical error of any difference, on the scale of the analysis."""

    def of(self, plus: Levels, minus: Levels) -> float | None:
        """Half-width around a difference as analyzed; None where nothing is known of it.

        Parameters
        ----------
        plus, minus : mapping of str to str
            Levels of the named factors on both sides.
        """
        ...

    def of_component(self, first: Levels, second: Levels) -> float | None:
        """Half-width around a difference of two pure components of an interaction."""
        ...


@dataclass(frozen=True)
class OneBound:
    """The same bound for every difference."""

    u: float

    def of(self, plus: Levels, minus: Levels) -> float | None:
        """Return the bound."""
        return self.u

    def of_component(self, first: Levels, second: Levels) -> float | None:
        """Return the bound."""
        return self.u


@dataclass(frozen=True)
class TermBounds:
    """Bounds by term: a difference at fixed levels is bounded by the sum of those it is made of.

    Parameters
    ----------
    u : mapping of str to float
        Bound of each term, ``"A"`` or ``"A:B"``; a term that is absent has none.
    """

    u: Mapping[str, float]

    def of(self, plus: Levels, minus: Levels) -> float | None:
        """Sum over the terms that the difference is made of."""
        changed = {name for name in plus if plus[name] != minus[name]}
        parts = {name: set(name.split(":")) for name in self.u}
        return sum(
            self.u[name] for name, inside in parts.items() if inside & changed and inside <= {*plus}
        )

    def of_component(self, first: Levels, second: Levels) -> float | None:
        """Return the bound of the interaction."""
        return self.u.get(":".join(first), 0.0)


@dataclass(frozen=True)
class SeriesBounds:
    """Bounds from refined cells: of the difference itself, or inherited from other cells.

    Parameters
    ----------
    factors : tuple of str
        Factors that name a cell, in order; a factor whose levels are meshes is none of them.
    cells : tuple of tuple of str
        Levels of every cell of the study.
    series : mapping
        Refinement of those cells that were refined.
    discretization : mapping
        Name of the discretization of every cell; a cell without a mesh error has none.
    more : float
        Bound of what no mesh shows (load steps, solver tolerance), for one response.
    mesh : str or None
        Factor whose levels are meshes: a difference between them has no bound, because it is
        itself an error of the discretization.
    only : mapping of str to str
        The finest mesh, on which the simple effects of the other factors are judged.
    """

    factors: tuple[str, ...]
    cells: tuple[tuple[str, ...], ...]
    series: Mapping[tuple[str, ...], CellSeries]
    discretization: Mapping[tuple[str, ...], str]
    more: float = 0.0
    mesh: str | None = None
    only: Mapping[str, str] = field(default_factory=dict)
    _known: dict[tuple[tuple[str, ...], ...], float | None] = field(default_factory=dict)

    def of(self, plus: Levels, minus: Levels) -> float | None:
        """Bound of one difference."""
        changed = [name for name in plus if plus[name] != minus[name]]
        if self.mesh in changed:
            return 0.0
        on_one_mesh = self.mesh is not None and self.mesh in plus
        return self._remembered(plus, minus, on_one_mesh=on_one_mesh)

    def of_component(self, first: Levels, second: Levels) -> float | None:
        """Bound of a difference of pure components: their alternating sums of means."""
        if self.mesh in first:
            return 0.0
        return self._remembered(first, second, pure=True)

    def _remembered(
        self, plus: Levels, minus: Levels, *, on_one_mesh: bool = False, pure: bool = False
    ) -> float | None:
        """Bound of a difference of two sides, made once: it is asked for every block left out."""
        sides = (tuple(side.get(f, "") for f in self.factors) for side in (plus, minus))
        key = (*sides, (str(on_one_mesh), str(pure)))
        if key not in self._known:
            weights = self._component if pure else self._weights
            found = _difference(weights(plus), weights(minus))
            self._known[key] = self._bound(found, on_one_mesh=on_one_mesh)
        return self._known[key]

    def _component(self, side: Levels) -> dict[tuple[str, ...], float]:
        total: dict[tuple[str, ...], float] = {}
        for k in range(len(side) + 1):
            for kept in combinations(side, k):
                sign = (-1) ** (len(side) - k)
                for cell, w in self._weights({name: side[name] for name in kept}).items():
                    total[cell] = total.get(cell, 0.0) + sign * w
        return total

    def _weights(self, side: Levels) -> dict[tuple[str, ...], float]:
        at = [(i, side[f]) for i, f in enumerate(self.factors) if f in side]
        chosen = [cell for cell in self.cells if all(cell[i] == level for i, level in at)]
        return {cell: 1 / len(chosen) for cell in chosen} if chosen else {}

    def _bound(
        self, weights: Mapping[tuple[str, ...], float], *, on_one_mesh: bool = False
    ) -> float | None:
        """Bound of a contrast; its distance to the finest mesh counts unless it is there."""
        if not weights:
            return None
        used = {c: w for c, w in weights.items() if abs(w) > 1e-12 and self.discretization[c]}
        if not used:
            return 2 * self.more
        by_element: dict[str, dict[tuple[str, ...], float]] = {}
        for cell, w in used.items():
            by_element.setdefault(self.discretization[cell], {})[cell] = w
        series = self.series
        if on_one_mesh:
            series = {cell: replace(own, studied=None) for cell, own in series.items()}
        parts = [self._part(name, part, series) for name, part in by_element.items()]
        if any(part is None for part in parts):
            return None
        return sum(part.effective for part in parts if part is not None) + 2 * self.more

    def _part(
        self,
        element: str,
        weights: Mapping[tuple[str, ...], float],
        series: Mapping[tuple[str, ...], CellSeries],
    ) -> ContrastUncertainty | None:
        """Bound of the part that lies in one discretization."""
        if all(cell in series for cell in weights):
            return contrast_uncertainty(
                {"/".join(c): w for c, w in weights.items()},
                {"/".join(c): series[c] for c in weights},
            )
        refined = [s for c, s in series.items() if self.discretization.get(c) == element]
        limits = [limit_of(s) for s in refined]
        known = [found for found in limits if found is not None]
        if not known or len(known) < len(limits):
            return None
        return inherited_uncertainty(
            np.array(list(weights.values())),
            np.array([error for error, _ in known]),
            np.array([bound for _, bound in known]),
        )


def _difference(
    plus: Mapping[tuple[str, ...], float], minus: Mapping[tuple[str, ...], float]
) -> dict[tuple[str, ...], float]:
    if not plus or not minus:
        return {}
    return {cell: plus.get(cell, 0.0) - minus.get(cell, 0.0) for cell in {**plus, **minus}}


def bound_of(
    u: float | Mapping[str, float] | NumericalBound | None, unit: float = 1.0
) -> NumericalBound | None:
    """Bound of whatever was given, with numbers carried to the scale of the analysis.

    Parameters
    ----------
    u : float, mapping of str to float, NumericalBound or None
        Bound of every difference or, by term (``"A"``, ``"A:B"``), of its effect, in the unit of
        the response; or what bounds any difference on the scale of the analysis.
    unit : float
        Unit of the response on that scale: 1, or 1 / geometric mean for a log response.

    Returns
    -------
    NumericalBound or None
        None where nothing was given.
    """
    if u is None:
        return None
    if isinstance(u, Mapping):
        return TermBounds({name: value * unit for name, value in u.items()})
    if isinstance(u, int | float):
        return OneBound(float(u) * unit)
    return u
