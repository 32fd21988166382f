"""Numerical uncertainty of a contrast of cells: the series of the difference, not of its parts.

The errors of two cells of one discretization share an order and partly cancel, so their
difference is formed on every mesh and bounded as one series. Nothing cancels between two
discretizations, so their bounds add. The bound never exceeds the weighted sum of the cells' own
bounds (triangle inequality), and never falls below a tenth of it.

References: Roache (1998), Verification and Validation in Computational Science and Engineering;
Celik et al. (2008), J. Fluids Eng. 130, 078001; Eca and Hoekstra (2014), J. Comput. Phys. 262,
104-130. The factors were chosen by simulation of six models of the order of convergence.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Protocol, TypeVar

import numpy as np

from study.ground.arrays import Array
from study.statistics.convergence.grid_convergence import (
    CAUTIOUS,
    NOISE_SHARE,
    SAFE,
    MeshBounds,
    assumed_order,
    series_bounds,
)

#: Safety factor of a difference over that of a response whose series shows the formal order: its
#: order is known less well.
DIFFERENCE_SHARE = 1.6
#: Smallest share of the sum of the cells' bounds that the bound of a difference may have.
FLOOR = 0.1
#: Share of the refined cells' mean bound that a difference of other cells inherits.
INHERITED_SHARE = 0.2

#: Name of a cell: a text, or its levels.
Cell = TypeVar("Cell", str, tuple[str, ...])
#: Half-width around a contrast in the unit of the response; None where nothing bounds its error.
Bound = float | None


@dataclass(frozen=True)
class CellSeries:
    """Values of one response of one cell on refined meshes."""

    #: Sizes from fine to coarse; only their ratios count.
    mesh_size: tuple[float, ...]
    #: Response on each mesh, on the scale of the analysis.
    value: tuple[float, ...]
    #: Order that the element promises for this response.
    formal_order: float | None = None
    #: Name of the element, order and formulation: errors cancel only within one.
    discretization: str = ""
    #: Value on the mesh of the study, where that is not the finest.
    studied: float | None = None
    #: Size that changes are compared with to tell noise from divergence: that of the finest value,
    #: or 1 for a logarithm.
    reference: float | None = None

    @property
    def noise(self) -> float:
        """Change below which a growing one is noise of the meshes."""
        return NOISE_SHARE * (abs(self.value[0]) if self.reference is None else self.reference)

    @property
    def on_the_studied_mesh(self) -> float:
        """Value on the mesh of the study."""
        return self.value[0] if self.studied is None else self.studied


def _finest(
    value: Array, mesh_size: Sequence[float], formal: float | None, noise: float | Array | None
) -> MeshBounds:
    """Bounds of the finest two or three meshes."""
    order = assumed_order(formal) if value.shape[-1] == 2 else formal
    return series_bounds(mesh_size, value, order, noise=noise)


def response_bounds(
    value: Array, mesh_size: Sequence[float], formal: float | None, noise: float | Array = 0.0
) -> Array:
    """Bound of single responses, in their unit; infinite where the meshes diverge: no claim.

    Shapes: value (..., n); noise (...); returns (...).
    """
    bounds = _finest(value, mesh_size, formal, noise)
    return np.where(bounds.kind == "divergent", np.inf, bounds.u)


def difference_bounds(value: Array, mesh_size: Sequence[float], formal: float | None) -> Array:
    """Bound of differences within one discretization.

    Shapes: value (..., n); returns (...).
    """
    bounds = _finest(value, mesh_size, formal, None)
    short = (bounds.factor == SAFE) | np.isnan(bounds.order_used)
    return np.asarray(np.where(short, DIFFERENCE_SHARE, 1.0) * bounds.u)


def contrast_uncertainty(weights: Mapping[Cell, float], series: Mapping[Cell, CellSeries]) -> Bound:
    """Bound the error, on the mesh of the study, of a contrast of cells of one discretization.

    None where a cell was not refined, or where nothing bounds its error.
    """
    used = {cell: w for cell, w in weights.items() if w}
    if not used or any(len(series[c].value) < 2 if c in series else True for c in used):
        return None
    cells = [series[cell] for cell in used]
    w = np.array(list(used.values()))
    meshes = min(len(cell.value) for cell in cells)
    sizes = np.array([cell.mesh_size[:meshes] for cell in cells])
    ratios = sizes[:, 1:] / sizes[:, :-1]
    alike = np.allclose(ratios, ratios[0], rtol=0.05)
    moved = abs(
        sum(k * (c.on_the_studied_mesh - c.value[0]) for k, c in zip(w, cells, strict=True))
    )
    orders = [cell.formal_order for cell in cells]
    formal = None if None in orders else min(o for o in orders if o is not None)
    if not alike:  # refined by different ratios, each cell knows its own error alone
        alone = [response_bounds(np.array(c.value), c.mesh_size, c.formal_order, c.noise)
               for c in cells]  # fmt: skip
        u = float(np.abs(w) @ alone)
        return u + moved if math.isfinite(u) else None
    value = np.array([cell.value[:meshes] for cell in cells])
    size, noise = cells[0].mesh_size[:meshes], np.array([cell.noise for cell in cells])
    ceiling = float(np.abs(w) @ response_bounds(value, size, formal, noise))
    if not math.isfinite(ceiling):
        return None
    u = float(difference_bounds(w @ value, size, formal))
    return float(min(max(u, FLOOR * ceiling), ceiling) + moved)


def limit_of(series: CellSeries) -> tuple[float, float] | None:
    """Signed error of the value on the mesh of the study, and its bound."""
    value, size = np.array(series.value), series.mesh_size
    if len(value) < 2:
        return None
    bound = float(response_bounds(value, size, series.formal_order, series.noise))
    if not math.isfinite(bound):
        return None
    order, limit = float(series_bounds(size, value, series.formal_order).order_used), value[0]
    if len(value) > 2 and math.isfinite(order):
        limit += (value[0] - value[1]) / ((size[1] / size[0]) ** order - 1)
    return series.on_the_studied_mesh - limit, bound + abs(series.on_the_studied_mesh - value[0])


def inherited_uncertainty(weights: Array, error: Array, bound: Array) -> float:
    """Bound the error of a contrast by that of other cells of the same discretization.

    Shapes: weights (k,); error (m,); bound (m,).

    Notes
    -----
    An error that all cells share drops out of a difference; their scatter over the refined
    cells is what does not. One refined cell shows no scatter: then no cell's error is assumed
    to be more than three times its bound.
    """
    size = float(np.abs(weights).sum())
    if error.size == 1:
        return CAUTIOUS * size * float(bound[0])
    from scipy.special import stdtrit

    scatter = float(stdtrit(error.size - 1, 0.975)) * float(error.std(ddof=1))
    u = scatter * float(np.sqrt(weights @ weights)) + INHERITED_SHARE * float(bound.mean())
    rest = abs(float(weights.sum()))
    if rest > 1e-12 * size:
        u += rest * (abs(float(error.mean())) + float(bound.mean()))
    return u


# -------------------------------------------------------------------------------------------------
# Where the numerical uncertainty of a difference comes from: one number, one a term, or series.
#
# A difference is named by the levels on its two sides; the factors that are not named are averaged.

Levels = Mapping[str, str]


class NumericalBound(Protocol):
    """Bound of the numerical error of any difference, on the scale of the analysis."""

    def of(self, plus: Levels, minus: Levels) -> float | None:
        """Half-width around a difference as analyzed; None where nothing is known of it."""
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

    of_component = of


@dataclass(frozen=True)
class TermBounds:
    """Bounds by term: a difference at fixed levels is bounded by the sum of those it is made of."""

    #: Bound of each term, ``"A"`` or ``"A:B"``; a term that is absent has none.
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
    """Bounds from refined cells: of the difference itself, or inherited from other cells."""

    #: Factors that name a cell, in order; a factor whose levels are meshes is none of them.
    factors: tuple[str, ...]
    #: Levels of every cell of the study.
    cells: tuple[tuple[str, ...], ...]
    #: Refinement of those cells that were refined.
    series: Mapping[tuple[str, ...], CellSeries]
    #: Name of the discretization of every cell; a cell without a mesh error has none.
    discretization: Mapping[tuple[str, ...], str]
    #: Bound of what no mesh shows (load steps, solver tolerance), for one response.
    more: float = 0.0
    #: Factor whose levels are meshes: a difference between them has no bound, because it is itself
    #: an error of the discretization.
    mesh: str | None = None
    #: The finest mesh, on which the simple effects of the other factors are judged.
    only: Mapping[str, str] = field(default_factory=dict)
    _known: dict[tuple[object, ...], float | None] = field(default_factory=dict)

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
        key = (*sides, on_one_mesh, pure)
        if key not in self._known:
            weights = self._component if pure else self._weights
            first, second = weights(plus), weights(minus)
            cells = {**first, **second} if first and second else {}
            difference = {cell: first.get(cell, 0.0) - second.get(cell, 0.0) for cell in cells}
            self._known[key] = self._bound(difference, on_one_mesh=on_one_mesh)
        return self._known[key]

    def _component(self, side: Levels) -> dict[tuple[str, ...], float]:
        total: dict[tuple[str, ...], float] = {}
        for k in range(len(side) + 1):
            for names in combinations(side, k):
                sign = (-1) ** (len(side) - k)
                for cell, w in self._weights({name: side[name] for name in names}).items():
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
            series = {cell: replace(values, studied=None) for cell, values in series.items()}
        parts = [self._part(name, part, series) for name, part in by_element.items()]
        bounds = [part for part in parts if part is not None]
        return sum(bounds) + 2 * self.more if len(bounds) == len(parts) else None

    def _part(
        self,
        element: str,
        weights: Mapping[tuple[str, ...], float],
        series: Mapping[tuple[str, ...], CellSeries],
    ) -> Bound:
        """Bound of the part that lies in one discretization."""
        if all(cell in series for cell in weights):
            return contrast_uncertainty(weights, series)
        refined = [s for c, s in series.items() if self.discretization.get(c) == element]
        bounded = [limit for limit in map(limit_of, refined) if limit is not None]
        if not bounded or len(bounded) < len(refined):
            return None
        error, bound = np.array(bounded).T
        return inherited_uncertainty(np.array(list(weights.values())), error, bound)
