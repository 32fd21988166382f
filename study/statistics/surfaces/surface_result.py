"""What an analysis over numeric factors found, for people and for programs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest

import numpy as np
from numpy.typing import ArrayLike

from study.ground.arrays import Array
from study.ground.canonical import Keyed
from study.ground.errors import Fault, RefusedError
from study.statistics.surfaces.emulator import (
    GIVEN,
    INDEX,
    RANKED,
    SAMPLE_ERROR,
    BlockedEmulator,
    EffectRange,
    Emulator,
    SobolIndex,
    effect_ranges,
    jansen,
    sobol_indices,
)
from study.statistics.surfaces.input_distribution import InputDistribution
from study.statistics.surfaces.quadratic import QuadraticSurface
from study.statistics.surfaces.surface_factors import Extreme, Runs, never_run
from study.statistics.surfaces.surface_optimum import Model, extremes


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
        return "cannot tell" if self.range is None else self.range.words


@dataclass(frozen=True)
class SurfaceAnalysis(Keyed):
    """A surface over numeric factors."""

    KEYS = "response=runs.name runs=runs.size factors=runs.ranges surface sensitivity notes"

    model: Model
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


def analysis_of(model: Model, practical: float | None = None, u: float = 0.0) -> SurfaceAnalysis:
    """Say what a surface means; of an emulator all that its Q2 allows."""
    if isinstance(model, QuadraticSurface):
        judged, notes = _of_quadratic(model, practical, u)
    else:
        judged, notes = _of_emulator(model, practical, u)
    return SurfaceAnalysis(model, judged, *extremes(model), tuple(notes))


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
    model: QuadraticSurface, practical: float | None, u: float
) -> tuple[tuple[Sensitivity, ...], list[str]]:
    """Judge the factors of a quadratic where a practical difference is given, with notes."""
    notes = [*model.notes, *never_run(model.runs)]
    point = model.stationary
    if point is None or not point.established:
        notes.append(
            "no stationary point established inside the region; confirm the best predicted "
            "setting by a run there"
        )
    if practical is None:
        return (), notes
    names = model.runs.names
    ranges = model.ranges(practical, u)
    sizes = [i.value for i in effect_ranges(model.value, model.runs, [0.0] * len(names), None, 0.0)]
    ranks = 1 + np.argsort(np.argsort([-size for size in sizes]))
    if ranges is None:
        notes.append("no factor is judged: a quadratic does not carry these runs, or fits them all")
    return _judged(model.runs, ranks.tolist(), (), ranges), notes


def _of_emulator(
    model: Emulator | BlockedEmulator, practical: float | None, u: float
) -> tuple[tuple[Sensitivity, ...], list[str]]:
    """Ask an emulator for all that its Q2 allows, with notes."""
    unrun = never_run(model.runs)
    twice = 2 * model.runs.response.size
    if model.gate == "refused":
        return (), [f"Q2 {model.q2:.2f} is below .7: no indices; add runs, {twice} in all", *unrun]
    indices = model.indices()
    order = np.argsort([-index.total for index in indices]).tolist()
    ranks = [order.index(j) + 1 for j in range(len(order))]
    if model.gate == "ranking only":
        note = f"Q2 {model.q2:.2f} is below .9: ranking only; add runs, {twice} in all"
        return _judged(model.runs, ranks), [note, *unrun]
    judged = _judged(model.runs, ranks, indices, model.ranges(practical, u))
    notes = [
        *unrun,
        "indices are of factors uniform over their ranges; ranges hold at 95 % of the settings",
    ]
    if any(item.confirm for item in judged):
        notes.append("matters holds once the two predicted extremes were run: see confirm")
    return judged, notes


# What uncertain inputs do to a response, through its surface (Saltelli et al. 2008; GUM S1).

#: points of the sample, as a power of two: 8,192
SAMPLE = 13
#: reported percentiles of a distribution, in percent
PERCENTILES = np.array([2.5, 5.0, 25.0, 50.0, 75.0, 95.0, 97.5])
#: points at which the surface's own uncertainty is asked: 2,048
OWN_SAMPLE = 11


@dataclass(frozen=True)
class PropagatedNumber:
    """A number of the response's distribution, and what the surface may err in it."""

    value: float
    #: Half width of an interval of about 95 % for the surface's own error, in that unit.
    own: float


@dataclass(frozen=True)
class InputShare(Keyed):
    """What one uncertain input does."""

    KEYS = f"input=name {INDEX} sd_if_halved=halved gain"

    name: str
    #: Its share of the response's variance; None below a Q2 of .9.
    index: SobolIndex | None
    #: Standard deviation of the response if this input were known twice as well.
    halved: float
    #: Share of the standard deviation that goes then.
    gain: float


@dataclass(frozen=True)
class Propagated(Keyed):
    """Distribution of a response whose inputs are uncertain."""

    KEYS = "mean sd percentiles=by_percent inputs fixed cut"

    mean: PropagatedNumber
    sd: PropagatedNumber
    percentiles: Mapping[float, PropagatedNumber]
    #: The one that is worth measuring most first.
    inputs: tuple[InputShare, ...]
    #: Settings of the factors that are not uncertain.
    fixed: Mapping[str, float]
    #: Probability of each input that lies outside its range, and was cut off.
    cut: Mapping[str, float]

    @property
    def by_percent(self) -> dict[str, PropagatedNumber]:
        """Percentiles by how they are written."""
        return {f"{percent:g}": value for percent, value in self.percentiles.items()}


def propagate(
    surface: SurfaceAnalysis,
    inputs: Mapping[str, InputDistribution],
    fixed: Mapping[str, float],
    seed: int = 0,
) -> Propagated:
    """Carry the distributions of inputs through a surface."""
    from scipy.stats import qmc

    model = surface.model
    q2 = model.q2
    if not q2 >= RANKED:
        rule = f"Q2 is {q2:.2f}, below {RANKED}: nothing is said of uncertain inputs"
        raise RefusedError(str(Fault("uncertainty", rule, "add runs")))
    distributed = _Inputs(surface.runs, dict(inputs), dict(fixed))
    u = qmc.Sobol(len(inputs), seed=seed).random_base2(SAMPLE)
    values = model.value(distributed.coded(u))
    responses, errors = _numbers(values[:, None])[:, 0], _own(model, distributed, seed)
    each = [PropagatedNumber(float(v), float(e)) for v, e in zip(responses, errors, strict=True)]
    shares: Sequence[SobolIndex | None] = [None] * len(inputs)
    if q2 >= GIVEN:
        shares = _shares(model, distributed, q2, seed)
    rows, sd = [], each[1].value
    for name, share in zip(inputs, shares, strict=True):
        halved = float(model.value(distributed.halved(name).coded(u)).std())
        rows.append(InputShare(name, share, halved, 1.0 - halved / sd if sd > 0 else 0.0))
    return Propagated(
        each[0],
        each[1],
        dict(zip(PERCENTILES.tolist(), each[2:], strict=True)),
        tuple(sorted(rows, key=lambda row: row.halved)),
        dict(fixed),
        {name: spread.outside for name, spread in inputs.items()},
    )


@dataclass(frozen=True)
class _Inputs:
    """Uncertain and fixed inputs of a surface."""

    runs: Runs
    spreads: Mapping[str, InputDistribution]
    fixed: Mapping[str, float]

    def coded(self, shares: Array) -> Array:
        """Coded points (m, k) of shares (m, inputs) of the distributions."""
        columns = dict(zip(self.spreads, shares.T, strict=True))
        coded_columns = [
            f.coded(self.spreads[f.name].quantile(columns[f.name]))
            if f.name in columns
            else np.full(len(shares), float(f.coded(np.array([self.fixed[f.name]]))[0]))
            for f in self.runs.factors
        ]
        return np.column_stack(coded_columns)

    def unit(self, shares: Array) -> Array:
        """Give the same in the unit box."""
        return 0.5 * (self.coded(shares) + 1.0)

    def halved(self, name: str) -> _Inputs:
        """Give the same with one of them known twice as well."""
        spreads = {n: s.halved() if n == name else s for n, s in self.spreads.items()}
        return _Inputs(self.runs, spreads, self.fixed)


def _numbers(values: Array) -> Array:
    """Mean, standard deviation and percentiles, shape (2 + percentiles, p), of values (n, p)."""
    middle = np.percentile(values, PERCENTILES, axis=0)
    return np.vstack([values.mean(axis=0), values.std(axis=0), middle])


def _own(model: Model, inputs: _Inputs, seed: int) -> Array:
    """Half widths for the surface's own error, shape (2 + percentiles,), in the response's unit."""
    from scipy.stats import qmc

    # Left-out runs are missed by that much on average: a number that belongs to one place of the
    # distribution may be, too. The mean and the spread average over places.
    if isinstance(model, QuadraticSurface):
        rms = 0.0 if model.loo is None else model.loo.rms
        return np.full(2 + PERCENTILES.size, 2.0 * rms)
    u = qmc.Sobol(len(inputs.spreads), seed=seed + 1).random_base2(OWN_SAMPLE)
    if isinstance(model, BlockedEmulator):
        responses = np.array([_numbers(e.value(inputs.coded(u))[:, None])[:, 0]
                              for e in model.each])  # fmt: skip
        errors = np.mean([_own(e, inputs, seed) for e in model.each], axis=0)
        return np.asarray(model.scatter(responses) + errors)
    paths = model.scale * model.paths(seed)(inputs.unit(u))
    responses = _numbers(paths)
    scatter = np.sqrt(np.mean((responses[:, 1:] - responses[:, :1]) ** 2, axis=1))
    least = np.full(scatter.shape, model.loo_rms)
    least[:2] /= np.sqrt(model.runs.response.size)
    return np.asarray(1.96 * np.maximum(model.widening * scatter, least))


def _shares(model: Model, inputs: _Inputs, q2: float, seed: int) -> Sequence[SobolIndex]:
    """Sobol indices of the uncertain inputs."""
    k = len(inputs.spreads)
    if isinstance(model, Emulator):
        paths = model.paths(seed)
        return sobol_indices(lambda u: paths(inputs.unit(u)), k, q2, seed)
    # without paths the ends of an interval are the estimate's own, but for what Q2 leaves open
    indices = jansen(lambda u: model.value(inputs.coded(u))[:, None], k, seed)
    margin = 1.0 - q2 + SAMPLE_ERROR
    return [
        SobolIndex.of(s[0], np.repeat(np.clip(s, 0, 1), 2), t[0], np.repeat(np.clip(t, 0, 1), 2),
                      margin)
        for s, t in zip(*indices, strict=True)
    ]  # fmt: skip
