"""Virtual tests: measured with drawn sensor errors, and fitted anew (JCGM 101:2008)."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field

import numpy as np

from study.ground.arrays import Array
from study.ground.errors import InputError
from study.laboratory.sensors.force_model import (
    ForceAccuracy,
    ForceModel,
    PositionAccuracy,
    force_model,
)
from study.mechanics.calibration.levenberg_marquardt import Status, levenberg_marquardt
from study.mechanics.calibration.residual_function import EvaluationFailed
from study.mechanics.setup.setup import Problem

#: Standard deviations of the noise that the simulated curve reaches beyond the test.
REACH = 5.0
#: Promised relative change of the sum of squares at which a fit has converged.
FTOL = 1e-9
#: Relative offset at which it has converged: what is left is a thousandth of a standard error by
#: noise (Bates and Watts 1981).
GTOL = 1e-3
#: Decrease of the sum of squares that is not worth the way along a kink.
EDGE = 1e-3
#: Evaluations of a fit, which usually takes three to six from the assumed constants.
MOST_EVALUATIONS = 30


@dataclass(frozen=True)
class Sampling:
    """What a Monte Carlo simulation draws."""

    #: Both tests, with the assumed constants.
    fitted: Problem
    predicted: Problem
    position: PositionAccuracy
    force: ForceAccuracy
    points: int
    #: Number of tests; the stream of random numbers.
    samples: int
    seed: int

    @property
    def depth_mm(self) -> float:
        """Displacement of the fitted test."""
        return self.fitted.test.depth_mm

    @property
    def farthest_mm(self) -> float:
        """Largest displacement that a tracker may tell."""
        error = self.position
        beyond = np.hypot(np.hypot(error.offset_mm, error.noise_mm), error.scale * self.depth_mm)
        return self.depth_mm + REACH * float(beyond)


def rows_mm(depth_mm: float, points: int) -> Array:
    """Displacements of the rows of a test, even, the last one at its depth."""
    # Shapes: returns (points,), mm.
    return np.asarray(depth_mm * np.arange(1, points + 1) / points)


@dataclass(frozen=True)
class Chunk:
    """Part of a simulation that one worker does."""

    #: With the errors of this simulation.
    sampling: Sampling
    #: Begins the seed of every test.
    stream: tuple[int, ...]
    #: Numbers of its tests, the last one excluded.
    first: int
    last: int
    #: shape (p, n); change of the constants by that of every row, to first order.
    pseudo_inverse: Array
    #: Full step over the constants at which a fit has converged.
    xtol: float


@dataclass
class Changes:
    """Changes of the constants in the tests of a chunk that have an answer."""

    #: A row for every test: of the nonlinear fit, and to first order.
    fitted: list[list[float]] = field(default_factory=list)
    linear: list[list[float]] = field(default_factory=list)
    force_N: list[float] = field(default_factory=list)
    #: Why the other tests have no answer.
    messages: list[str] = field(default_factory=list)

    def add(self, more: Changes) -> None:
        """Take in the tests of another chunk."""
        self.fitted += more.fitted
        self.linear += more.linear
        self.force_N += more.force_N
        self.messages += more.messages


def perform(chunk: Chunk) -> dict[str, object]:
    """Measure and fit the tests of one chunk (in a worker)."""
    sampling, changes = chunk.sampling, Changes()
    test = _Test(sampling, chunk.pseudo_inverse, chunk.xtol)
    depth = np.array([sampling.predicted.test.depth_mm])
    predicted = force_model(sampling.predicted, float(depth[0]))
    for k in range(chunk.first, chunk.last):
        try:
            values, linear = test.measured(np.random.default_rng([*chunk.stream, k]))
            force = predicted(values, depth).force_N[0]
        except (EvaluationFailed, InputError) as error:
            changes.messages.append(str(error))
            continue
        changes.fitted.append((values - test.values).tolist())
        changes.linear.append(linear.tolist())
        changes.force_N.append(float(force))
    return {"status": "done", **asdict(changes)}


class _Test:
    """One test at its rows, to be measured with errors and fitted as often as asked."""

    def __init__(self, sampling: Sampling, pseudo_inverse: Array, xtol: float) -> None:
        self.model: ForceModel = force_model(sampling.fitted, sampling.farthest_mm)
        self.rows = rows_mm(sampling.depth_mm, sampling.points)
        self.position, self.force = sampling.position, sampling.force
        self.pseudo_inverse, self.xtol = pseudo_inverse, xtol
        self.values = self.model.problem.material.values
        self.true = self.model(self.values, self.rows)

    def measured(self, random: np.random.Generator) -> tuple[Array, Array]:
        """Constants of the fit to one measured test, and their change to first order."""
        n, p, f = self.rows.size, self.position, self.force
        moved = p.offset_mm * random.standard_normal() + self.rows * (
            p.scale * random.standard_normal()
        )
        moved = moved + p.noise_mm * random.standard_normal(n)
        off = f.zero_N * random.standard_normal() + self.true.force_N * (
            f.scale * random.standard_normal()
        )
        off = off + f.noise_N * random.standard_normal(n)
        linear = self.pseudo_inverse @ (off - self.true.stiffness_N_per_mm * moved)
        return self._fit(self.rows + moved, self.true.force_N + off), linear

    def _fit(self, displacement_mm: Array, force_N: Array) -> Array:  # noqa: N803
        """Constants that fit measured rows best, each with the same weight."""

        def residual(values: Array) -> tuple[Array, Array]:
            at = self.model(values, displacement_mm)
            return at.force_N - force_N, at.jacobian

        fit = levenberg_marquardt(
            residual,
            self.values,
            ftol=FTOL,
            xtol=self.xtol,
            gtol=GTOL,
            edge=EDGE,
            max_evaluations=MOST_EVALUATIONS,
        )
        # a lowest point at which contact sets in is as good a constant as another
        if not (fit.converged or fit.status is Status.at_kink):
            raise EvaluationFailed(fit.status.sentence)
        return fit.x
