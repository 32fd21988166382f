"""What a fitted surface says: of its factors and uncertain inputs, along them, between levels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import zip_longest

import numpy as np
from numpy.typing import ArrayLike

from study.ground.arrays import Array
from study.ground.canonical import Keyed
from study.ground.errors import Fault, RefusedError
from study.statistics.surfaces.emulator import (
    ERRORS,
    GIVEN,
    INDEX,
    RANKED,
    SAMPLE_ERROR,
    SETTINGS,
    SHARE,
    BlockedEmulator,
    EffectRange,
    Emulator,
    SobolIndex,
    effect_ranges,
    jansen,
    sobol_indices,
)
from study.statistics.surfaces.quadratic import QuadraticSurface
from study.statistics.surfaces.surface_factors import (
    SAME_SETTING,
    Extreme,
    InputDistribution,
    Runs,
    box_points,
    never_run,
)
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
        notes.append('"matters" needs the runs that confirm it')
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


# What a surface looks like: along each factor, over two of them, and at runs left out.

#: points of a profile, and along each side of a contour
POINTS = 41
GRID = 31


def profiles(
    surface: SurfaceAnalysis, at: Array | None = None
) -> dict[str, tuple[Array, SurfacePrediction]]:
    """Predict along each factor, the others in the middle of their ranges or at a coded setting.

    Settings are those that were run, from the lowest to the highest, in the factor's unit, with
    that of ``at``, shape (k,), among them.
    """
    by_factor = {}
    for j, (factor, column) in enumerate(
        zip(surface.runs.factors, surface.runs.coded.T, strict=True)
    ):
        along = _coded(column, POINTS)
        if at is not None:
            along = np.union1d(along, at[j])
        coded = np.tile(np.zeros(len(surface.runs.factors)) if at is None else at, (len(along), 1))
        coded[:, j] = along
        value, half = surface.model.predict(coded)
        setting = np.array([factor.setting(float(x)) for x in coded[:, j]])
        by_factor[factor.name] = setting, SurfacePrediction(value, value - half, value + half)
    return by_factor


def strongest(surface: SurfaceAnalysis) -> tuple[str, ...]:
    """Names of the factors, the one that moves the response most first."""
    if surface.sensitivity:
        return tuple(i.factor for i in sorted(surface.sensitivity, key=lambda i: i.rank))
    sizes = {name: np.ptp(along.value) for name, (_, along) in profiles(surface).items()}
    return tuple(sorted(sizes, key=lambda name: -sizes[name]))


def contour(surface: SurfaceAnalysis, factors: Sequence[str]) -> tuple[dict[str, Array], Array]:
    """Predict over two factors, the others in the middle: columns (m,), and the runs (n, 2)."""
    runs = surface.runs
    pair = [runs.names.index(name) for name in factors]
    points = np.zeros((GRID * GRID, len(runs.factors)))
    grid = np.meshgrid(*(_coded(runs.coded[:, j], GRID) for j in pair))
    points[:, pair] = np.column_stack([part.ravel() for part in grid])
    at, ran = (
        [np.array([runs.factors[j].setting(float(x)) for x in coded[:, j]]) for j in pair]
        for coded in (points, runs.coded)
    )
    value, _ = surface.model.predict(points)
    return dict(zip(factors, at, strict=True)) | {"value": value}, np.column_stack(ran)


def left_out(surface: SurfaceAnalysis) -> tuple[Array, Array] | None:
    """Every run and what all the others predict of it; None where no run can be left out."""
    model = surface.model
    if isinstance(model, QuadraticSurface):
        if model.loo is None:
            return None
        is_predicted = np.isfinite(model.loo.errors)
        return model.loo.observed[is_predicted], (model.loo.observed - model.loo.errors)[
            is_predicted
        ]
    observed = np.concatenate([emulator.runs.response for emulator in model.each])
    return observed, observed - model.loo_errors


def _coded(column: Array, points: int) -> Array:
    return np.linspace(float(column.min()), float(column.max()), points)


# What another level of a factor without numbers changes, over the ranges of the numbers.


@dataclass(frozen=True)
class LevelDifference:
    """Difference of a response at one level from that at another, with the same numbers."""

    #: The factor; the response at ``level`` less that at ``other``.
    factor: str
    level: str
    other: str
    #: Over the ranges: mean, and ends of what 95 % of the settings have, in the response's unit.
    mean: float
    low: float
    high: float
    #: Half width around them: twice the largest leave-one-out errors, and numerical uncertainty.
    bound: float
    #: {"matters", "no practical difference", "cannot tell"}: whether it matters at some settings;
    #: no difference means at none.
    verdict: str


def level_difference(
    names: tuple[str, str, str],
    models: tuple[Emulator | BlockedEmulator, Emulator | BlockedEmulator],
    practical: float | None,
    u: float = 0.0,
) -> LevelDifference:
    """Compare the emulators of two levels."""
    points = box_points(len(models[0].runs.factors), SETTINGS)
    predictions = [model.predict(points) for model in models]
    change = predictions[0][0] - predictions[1][0]
    half = np.hypot(predictions[0][1], predictions[1][1])
    largest = [float(np.abs(model.loo_errors).max()) for model in models]
    bound = ERRORS * float(np.hypot(largest[0], largest[1])) + u
    verdict = "cannot tell"
    if practical is not None and all(model.gate == "given" for model in models):
        if float(np.quantile(np.abs(change), SHARE)) - bound > practical:
            verdict = "matters"
        elif float((np.abs(change) + half).max()) + u < practical:
            verdict = "no practical difference"
    tail = 0.5 * (1.0 - SHARE)
    low, high = (float(q) for q in np.quantile(change, [tail, 1.0 - tail]))
    return LevelDifference(*names, float(change.mean()), low, high, bound, verdict)


# Elementary effects, which screen factors by trajectories of runs (Morris 1991, Technometrics 33,
# 161-174; mu* by Campolongo, Cariboni and Saltelli 2007, Environ. Model. Softw. 22, 1509-1518).

SCREENS = "its runs are trajectories, which screen the factors: no surface and no verdict"


@dataclass(frozen=True)
class ElementaryEffect:
    """Changes of the response over the whole range of a factor, by runs one after the other."""

    factor: str
    effects: int
    #: Mean, mean size and standard deviation, in the response's unit; None of too few.
    mu: float | None
    mu_star: float | None
    sigma: float | None


def elementary_effects(runs: Runs) -> tuple[ElementaryEffect, ...]:
    """Summarize the elementary effects of every factor, the largest mean size first."""
    steps, screened = np.diff(runs.coded, axis=0) / 2, []
    moves = np.abs(steps) > SAME_SETTING
    for name, step, moved in zip(runs.names, steps.T, moves.T, strict=True):
        pair = moved & (moves.sum(axis=1) == 1)
        effect = np.diff(runs.response)[pair] / step[pair]
        mu = float(effect.mean()) if effect.size else None
        size = float(np.abs(effect).mean()) if effect.size else None
        sigma = float(effect.std(ddof=1)) if effect.size > 1 else None
        screened.append(ElementaryEffect(name, int(effect.size), mu, size, sigma))
    return tuple(sorted(screened, key=lambda e: -(e.mu_star or 0.0)))


# A surface over the numeric factors of a study, for one response.


@dataclass(frozen=True)
class FittedSurface(Keyed):
    """What the runs of a study say of one response over its numeric factors."""

    KEYS = "response unit at=labels practical U=bound"

    response: str
    unit: str
    #: The surface; None where the runs cannot carry one.
    surface: SurfaceAnalysis | None
    refused: str = ""
    #: Levels of the other factors: every combination of them has a surface of its own.
    labels: Mapping[str, str] = field(default_factory=dict)
    #: Smallest difference that matters, in the response's unit.
    practical: float | None = None
    #: Bound of the numerical error of a difference of two settings, in the same unit.
    bound: float | None = None
    #: Units of the factors that are numbers.
    units: Mapping[str, str] = field(default_factory=dict)
    #: The response's distribution where inputs are uncertain.
    uncertain: Propagated | None = None
    #: Distribution of each of them, in words.
    inputs: Mapping[str, str] = field(default_factory=dict)
    #: From the surfaces at the first levels of the other factors, one factor at a time.
    differences: tuple[LevelDifference, ...] = ()
    #: In place of a surface where the runs are trajectories of Morris.
    screened: tuple[ElementaryEffect, ...] = ()

    @property
    def verdicts(self) -> list[dict[str, object]]:
        """One row a numeric factor, with the keys of a study's verdicts."""
        rows: list[dict[str, object]] = []
        for item in () if self.surface is None else self.surface.sensitivity:
            effect = item.range
            low = 0.0 if effect is None else max(0.0, effect.value - effect.bound)
            rows.append({
                "response": self.response,
                "factor": item.factor,
                "at": dict(self.labels),
                "verdict": item.verdict,
                "effect": effect and effect.value,
                "ci95": effect and [low, effect.value + effect.bound],
                "practical": self.practical,
                "u_num": self.bound,
                "U": self.bound,
                "p": None,
            })  # fmt: skip
        return rows

    @property
    def unconfirmed(self) -> list[Mapping[str, float]]:
        """Settings whose runs would confirm what is said of the factors, each once."""
        judged = () if self.surface is None else self.surface.sensitivity
        every = [at for item in judged for at in item.confirm]
        return list({tuple(setting.items()): setting for setting in every}.values())

    def keyed(self) -> dict[str, object]:
        """Give what stands under every key: the response, where the others are, the surface."""
        if self.surface is None:
            screened = {"screened": [vars(e) for e in self.screened]} if self.screened else {}
            none: dict[str, object] = {"surface": None, "sensitivity": [], "refused": self.refused}
            return super().keyed() | none | screened
        keys = super().keyed() | self.surface.keyed()
        if self.labels:
            keys["differences"] = self.differences
        if self.uncertain is not None:
            keys["uncertainty"] = self.uncertain.keyed() | {"distributions": self.inputs}
        return keys
