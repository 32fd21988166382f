"""What an analysis over numeric factors found, for people and for programs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from study.ground.arrays import Array
from study.statistics.analysis.sums_of_squares import FRatioTest
from study.statistics.surfaces.emulator import (
    NO_INDEX,
    BlockedEmulator,
    EffectRange,
    Emulator,
    SobolIndex,
    effect_ranges,
)
from study.statistics.surfaces.quadratic import QuadraticSurface, StationaryPoint
from study.statistics.surfaces.surface_factors import Extreme, Runs, extremes, never_run

Document = dict[str, object]


@dataclass(frozen=True)
class SurfacePrediction:
    """Predictions with their 95 % intervals, shape (m,) each, in the response's unit."""

    value: Array
    low: Array
    high: Array
    response: str = ""
    unit: str = ""
    #: Such as that no run lies in the part of the ranges that was asked about.
    notes: tuple[str, ...] = ()

    def to_json(self) -> Document:
        """Plain values; a single point gives numbers, several give lists."""
        ends = {"value": self.value, "low": self.low, "high": self.high}
        values = {k: float(v[0]) if v.size == 1 else v.tolist() for k, v in ends.items()}
        return {"response": self.response, "unit": self.unit, **values}


@dataclass(frozen=True)
class Sensitivity:
    """What the emulator says of one factor; at a Q2 below .9 its rank alone."""

    factor: str
    rank: int
    index: SobolIndex | None
    range: EffectRange | None


@dataclass(frozen=True)
class SurfaceAnalysis:
    """A surface over numeric factors."""

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

    def to_json(self) -> Document:
        """Plain values, with the keys ``surface`` and ``sensitivity``."""
        model = self.model
        shape = (
            self._quadratic(model) if isinstance(model, QuadraticSurface) else self._emulator(model)
        )
        best = {"smallest": self._extreme(self.smallest), "largest": self._extreme(self.largest)}
        surface: Document = {"kind": self.kind, **shape, "best": best}
        factors = {
            f.name: {"low": f.low, "high": f.high, "scale": "log" if f.log else "linear"}
            for f in self.runs.factors
        }
        return {
            "response": self.runs.name,
            "runs": int(self.runs.response.size),
            "factors": factors,
            "surface": surface,
            "sensitivity": [self._sensitivity(item) for item in self.sensitivity],
            "notes": list(self.notes),
        }

    def _quadratic(self, found: QuadraticSurface) -> Document:
        loo = found.loo
        return {
            "error": found.error,
            "terms": [
                {
                    "term": t.term,
                    "coefficient": t.coefficient,
                    "ci95": t.interval and list(t.interval),
                    "p": t.p,
                }
                for t in found.terms
            ],
            "factor_tests": {name: _test(test) for name, test in found.factor_tests.items()},
            "aliases": list(found.aliases),
            "loo_rms": None if loo is None else loo.rms,
            "loo_max": None if loo is None else loo.largest,
            "q2": None if loo is None else _finite(loo.q2),
            "lack_of_fit": _test(found.lack_of_fit),
            "stationary": self._stationary(found.stationary),
        }

    def _emulator(self, found: Emulator | BlockedEmulator) -> Document:
        own: Document
        if isinstance(found, Emulator):
            own = self._process(found)
        else:
            own = {"blocks": {name: self._process(e) for name, e in found.emulators.items()}}
        return {
            **own,
            "loo_rms": found.loo_rms,
            "loo_max": float(np.abs(found.loo_errors).max()),
            "q2": found.q2,
            "indices": found.gate,
        }

    def _process(self, found: Emulator) -> Document:
        kernel = found.process.found.kernel
        lengths = dict(zip(self.runs.names, kernel.lengths.tolist(), strict=True))
        own: Document = {"kernel": kernel.family, "lengths": lengths, "q2": found.q2}
        if kernel.categories is None:
            return own
        # with the functions of the other combinations of levels, in their order
        shared = kernel.categories.matrix[found.combination]
        return own | {"category_correlation": shared.tolist()}

    def _stationary(self, point: StationaryPoint | None) -> Document | None:
        if point is None:
            return None
        region = point.region
        ends: Document | None = None
        if region is not None and np.isfinite(region.low).all():
            ends = {
                "low": self.runs.settings(region.low),
                "high": self.runs.settings(region.high),
                "leaves_the_box": region.leaves,
            }
        return {
            "kind": point.kind,
            "at": self.runs.settings(point.at) if np.abs(point.at).max() < FAR else None,
            "coded": point.at.tolist(),
            "value": point.value,
            "eigenvalues": point.eigenvalues.tolist(),
            "eigenvectors": point.eigenvectors.T.tolist(),
            "inside": point.inside,
            "established": point.established,
            "region": ends,
        }

    def _extreme(self, extreme: Extreme) -> Document:
        return {
            "at": self.runs.settings(extreme.at),
            "value": extreme.value,
            "half_width": _finite(extreme.half_width),
            "on_boundary": extreme.on_boundary,
        }

    def _sensitivity(self, item: Sensitivity) -> Document:
        index, effect = item.index, item.range
        return {
            "factor": item.factor,
            "rank": item.rank,
            **(NO_INDEX if index is None else index.to_json()),
            "range": None if effect is None else effect.value,
            "range_bound": None if effect is None else effect.bound,
            "verdict": "cannot tell" if effect is None else effect.told,
            "confirm": [self.runs.settings(point) for point in effect.confirm]
            if effect is not None and effect.claims
            else [],
        }


#: coded distance beyond which a stationary point is not given in units: a logarithm overflows
FAR = 100.0


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
    low, high = (
        Extreme(at, *(float(part[0]) for part in model.predict(at[None, :])))
        for at in extremes(model.value, len(model.runs.factors))
    )
    return SurfaceAnalysis(model, judged, low, high, tuple(said))


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
    ranks = np.argsort(np.argsort([-size for size in sizes])).tolist()
    if ranges is None:
        said.append("no factor is judged: a quadratic does not carry these runs, or fits them all")
    every = zip(names, ranks, ranges or [None] * len(names), strict=True)
    return tuple(Sensitivity(name, rank + 1, None, item) for name, rank, item in every), said


def _of_emulator(
    found: Emulator | BlockedEmulator, practical: float | None, u: float
) -> tuple[tuple[Sensitivity, ...], list[str]]:
    """Ask an emulator for all that its Q2 allows, with notes."""
    names, unrun = found.runs.names, never_run(found.runs)
    twice = 2 * found.runs.response.size
    if found.gate == "refused":
        return (), [f"Q2 {found.q2:.2f} is below .7: no indices; add runs, {twice} in all", *unrun]
    indices = found.indices()
    order = np.argsort([-index.total for index in indices]).tolist()
    ranks = [order.index(j) + 1 for j in range(len(names))]
    if found.gate == "ranking only":
        note = f"Q2 {found.q2:.2f} is below .9: ranking only; add runs, {twice} in all"
        ranked = zip(names, ranks, strict=True)
        return tuple(Sensitivity(name, rank, None, None) for name, rank in ranked), [note, *unrun]
    ranges = found.ranges(practical, u)
    judged = tuple(map(Sensitivity, names, ranks, indices, ranges))
    notes = [
        *unrun,
        "indices are of factors uniform over their ranges; ranges hold at 95 % of the settings",
    ]
    if any(item.claims for item in ranges):
        notes.append("matters holds once the two predicted extremes were run: see confirm")
    return judged, notes


def _test(test: FRatioTest | None) -> Document | None:
    if test is None:
        return None
    return {"F": test.f, "df": test.df, "df_error": test.df_error, "p": test.p}


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
