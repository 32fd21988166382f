"""What a fitted surface looks like: along each factor, over two of them, and at runs left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from study.ground.arrays import Array
from study.ground.canonical import Keyed
from study.ground.errors import Fault, RefusedError
from study.statistics.surfaces.emulator import (
    ERRORS,
    GIVEN,
    SETTINGS,
    SHARE,
    BlockedEmulator,
    Emulator,
    fit_emulator,
)
from study.statistics.surfaces.quadratic import QuadraticSurface
from study.statistics.surfaces.surface_factors import SAME_SETTING, Runs, box_points
from study.statistics.surfaces.surface_result import SurfaceAnalysis, SurfacePrediction

if TYPE_CHECKING:
    from study.statistics.surfaces.surface_result import Propagated


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


# An emulator of whole curves: a mean, and a few shapes whose sizes are emulated.

#: a shape is kept as long as it is this large beside the first one; at most so many
SMALLEST = 1e-4
MOST = 6


@dataclass(frozen=True)
class CurveEmulator:
    """Curves at settings that were not run."""

    #: Settings of the runs; the response is the mean of each curve.
    runs: Runs
    #: shape (m,); of the curves, in their unit.
    mean: Array
    #: shape (q, m); orthonormal.
    shapes: Array
    #: Of each shape, in the curves' unit.
    sizes: tuple[Emulator, ...]
    #: shape (n, m); errors of predicting the curve of each run from all the others, in that unit.
    loo_errors: Array
    #: Share of the curves' variance that is predicted so.
    q2: float

    @property
    def loo_rms(self) -> float:
        """Root mean square of the leave-one-out errors, in the curves' unit."""
        return float(np.sqrt(np.mean(self.loo_errors**2)))

    def value(self, coded: Array) -> Array:
        """Curves, shape (p, m), at coded points of shape (p, k)."""
        sizes = np.column_stack([size.value(coded) for size in self.sizes])
        return np.asarray(self.mean + sizes @ self.shapes)


def fit_curves(runs: Runs, curves: Array, seed: int = 0) -> CurveEmulator:
    """Emulate curves by their principal components (Higdon et al. 2008, JASA 103, 570)."""
    # Shapes: curves (n, m).
    settings, which = runs.distinct()
    averaged = np.zeros((len(settings), curves.shape[1]))
    np.add.at(averaged, which, curves)
    averaged /= np.bincount(which)[:, None]
    mean = averaged.mean(axis=0)
    _, size, shapes = np.linalg.svd(averaged - mean, full_matrices=False)
    if size[0] <= 1e-12 * float(np.abs(averaged).max()):
        rule = "every run has the same curve"
        raise RefusedError(str(Fault("invert", rule, "no input can be told from it")))
    retained = shapes[: max(1, min(MOST, int((size > SMALLEST * size[0]).sum())))]
    scores = (averaged - mean) @ retained.T
    sizes = tuple(
        fit_emulator(Runs(f"shape {j + 1}", runs.factors, settings, column), seed)
        for j, column in enumerate(scores.T)
    )
    # what the shapes leave out is an error, too
    rest = averaged - mean - scores @ retained
    errors = np.column_stack([emulator.loo_errors for emulator in sizes]) @ retained + rest
    q2 = 1.0 - float((errors**2).sum() / ((averaged - mean) ** 2).sum())
    if not q2 >= GIVEN:
        rule = f"the emulator of the curves has a Q2 of {q2:.2f}, below {GIVEN}"
        raise RefusedError(str(Fault("invert", rule, f"add runs: {2 * len(settings)} in all")))
    single = Runs("force", runs.factors, settings, averaged.mean(axis=1))
    return CurveEmulator(single, mean, retained, sizes, errors, q2)


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
