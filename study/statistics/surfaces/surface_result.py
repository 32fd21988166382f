"""What an analysis over numeric factors found, for people and for programs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest

import numpy as np
from numpy.typing import ArrayLike

from study.ground.arrays import Array
from study.ground.canonical import Keyed
from study.statistics.surfaces.emulator import (
    INDEX,
    BlockedEmulator,
    EffectRange,
    Emulator,
    SobolIndex,
    effect_ranges,
)
from study.statistics.surfaces.quadratic import QuadraticSurface
from study.statistics.surfaces.surface_factors import Extreme, Runs, extremes, never_run


@dataclass(frozen=True)
class SurfacePrediction(Keyed):
    """Predictions with their 95 % intervals, shape (m,) each, in the response's unit."""

    value: Array
    low: Array
    high: Array
    response: str = ""
    unit: str = ""
    #: Such as that no run lies in the part of the ranges that was asked about.
    notes: tuple[str, ...] = ()

    def keyed(self) -> dict[str, object]:
        """Give what stands under every key: of a single point numbers, of several lists."""
        ends = {"value": self.value, "low": self.low, "high": self.high}
        values = {k: v[0] if v.size == 1 else v for k, v in ends.items()}
        return {"response": self.response, "unit": self.unit, **values}


@dataclass(frozen=True)
class Sensitivity(Keyed):
    """What the emulator says of one factor; at a Q2 below .9 its rank alone."""

    KEYS = f"factor rank {INDEX} range=range.value range_bound=range.bound verdict confirm"

    factor: str
    rank: int
    index: SobolIndex | None = None
    range: EffectRange | None = None
    #: Settings whose runs would confirm that it matters.
    confirm: tuple[Mapping[str, float], ...] = ()

    @property
    def verdict(self) -> str:
        """Whether it matters, and what that still waits for."""
        return "cannot tell" if self.range is None else self.range.told


@dataclass(frozen=True)
class SurfaceAnalysis(Keyed):
    """A surface over numeric factors."""

    KEYS = "response=runs.name runs=runs.size factors=runs.ranges surface sensitivity notes"

    model: QuadraticSurface | Emulator | BlockedEmulator
    #: One entry a factor; empty where Q2 refuses it, or a quadratic is not asked.
    sensitivity: tuple[Sensitivity, ...]
    smallest: Extreme
    largest: Extreme
    notes: tuple[str, ...]

    @property
    def runs(self) -> Runs:
        """The runs that were used."""
        return self.model.runs

    @property
    def kind(self) -> str:
        """Either ``quadratic`` or ``emulator``."""
        return "quadratic" if isinstance(self.model, QuadraticSurface) else "emulator"

    def noted(self, *notes: str) -> SurfaceAnalysis:
        """Copy with notes before its own."""
        return replace(self, notes=(*notes, *self.notes))

    def predict(self, at: Mapping[str, ArrayLike]) -> SurfacePrediction:
        """Predict at settings that were not run, inside those that were. Shapes: at (m,)."""
        points = self.runs.points(at)
        value, half = self.model.predict(points)
        notes = tuple(never_run(self.runs, points))
        return SurfacePrediction(value, value - half, value + half, self.runs.name, "", notes)

    @property
    def surface(self) -> dict[str, object]:
        """What is known of the surface, by its kind, and its extremes."""
        best = {"smallest": self.smallest, "largest": self.largest}
        return {"kind": self.kind, **self.model.keyed(), "best": best}


def analysis_of(
    model: QuadraticSurface | Emulator | BlockedEmulator,
    practical: float | None = None,
    u: float = 0.0,
) -> SurfaceAnalysis:
    """Say what a surface means; of an emulator all that its Q2 allows."""
    if isinstance(model, QuadraticSurface):
        judged, said = _of_quadratic(model, practical, u)
    else:
        judged, said = _of_emulator(model, practical, u)
    runs = model.runs
    low, high = (
        Extreme(at, runs.settings(at), *(float(part[0]) for part in model.predict(at[None, :])))
        for at in extremes(model.value, len(runs.factors))
    )
    return SurfaceAnalysis(model, judged, low, high, tuple(said))


def _judged(
    runs: Runs,
    ranks: Sequence[int],
    indices: Sequence[SobolIndex] = (),
    ranges: Sequence[EffectRange] | None = (),
) -> tuple[Sensitivity, ...]:
    """Gather what is known of every factor: its rank, its index, its range."""
    each = zip_longest(runs.names, ranks, indices, ranges or ())
    return tuple(
        Sensitivity(
            name, rank, index, reach,
            tuple(map(runs.settings, reach.confirm)) if reach is not None and reach.claims else (),
        )
        for name, rank, index, reach in each
    )  # fmt: skip


def _of_quadratic(
    found: QuadraticSurface, practical: float | None, u: float
) -> tuple[tuple[Sensitivity, ...], list[str]]:
    """Judge the factors of a quadratic where a practical difference is given, with notes."""
    said = [*found.notes, *never_run(found.runs)]
    point = found.stationary
    if point is None or not point.established:
        said.append(
            "no stationary point established inside the region; confirm the best predicted "
            "setting by a run there"
        )
    if practical is None:
        return (), said
    names = found.runs.names
    ranges = found.ranges(practical, u)
    sizes = [i.value for i in effect_ranges(found.value, found.runs, [0.0] * len(names), None, 0.0)]
    ranks = 1 + np.argsort(np.argsort([-size for size in sizes]))
    if ranges is None:
        said.append("no factor is judged: a quadratic does not carry these runs, or fits them all")
    return _judged(found.runs, ranks.tolist(), (), ranges), said


def _of_emulator(
    found: Emulator | BlockedEmulator, practical: float | None, u: float
) -> tuple[tuple[Sensitivity, ...], list[str]]:
    """Ask an emulator for all that its Q2 allows, with notes."""
    unrun = never_run(found.runs)
    twice = 2 * found.runs.response.size
    if found.gate == "refused":
        return (), [f"Q2 {found.q2:.2f} is below .7: no indices; add runs, {twice} in all", *unrun]
    indices = found.indices()
    order = np.argsort([-index.total for index in indices]).tolist()
    ranks = [order.index(j) + 1 for j in range(len(order))]
    if found.gate == "ranking only":
        note = f"Q2 {found.q2:.2f} is below .9: ranking only; add runs, {twice} in all"
        return _judged(found.runs, ranks), [note, *unrun]
    judged = _judged(found.runs, ranks, indices, found.ranges(practical, u))
    notes = [
        *unrun,
        "indices are of factors uniform over their ranges; ranges hold at 95 % of the settings",
    ]
    if any(item.confirm for item in judged):
        notes.append("matters holds once the two predicted extremes were run: see confirm")
    return judged, notes
