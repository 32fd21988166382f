"""What sensors must be for a wanted accuracy: to first order, and by simulated tests.

Every test is fitted twice: by the nonlinear fit, and to first order from the same errors. The
ratio of the two scatters is known far better than either of them, so that a few hundred tests
show whether first order holds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypeAlias, cast

import numpy as np

from study.execution.local import Executor, Inline, Loky, Results, Task
from study.ground.arrays import Array
from study.ground.canonical import Keyed
from study.ground.errors import Fault, InputError, RefusedError
from study.ground.units import times
from study.laboratory.sensors.force_model import (
    ForceAccuracy,
    ForceAt,
    PositionAccuracy,
    RequirementFile,
    force_model,
)
from study.mechanics.calibration.covariance import scaled_inverse
from study.mechanics.calibration.levenberg_marquardt import Status, levenberg_marquardt
from study.mechanics.calibration.residual_function import EvaluationFailed
from study.mechanics.material.material import is_dimensionless

# First-order propagation of sensor errors through a least-squares fit (JCGM 100:2008, 5): a row
# at displacement d differs by zero + scale_F F + noise_F - F' (offset + scale_d d + noise_d); all
# but the noise are the same in all rows of a test.


@dataclass(frozen=True)
class SensorErrorSource:
    """One error of one sensor."""

    #: ``position`` or ``force``; ``offset``, ``zero``, ``scale`` or ``noise``.
    sensor: str
    name: str
    #: Of ``given``: mm, N, or empty for a share.
    unit: str
    given: float
    #: shape (n,); change of the residual of every row by one unit of the error.
    response: Array
    #: Whether all rows have the same error.
    is_shared: bool


def sources_of(
    position: PositionAccuracy, force: ForceAccuracy, at: ForceAt, displacement_mm: Array
) -> tuple[SensorErrorSource, ...]:
    """List all errors of both sensors, with what they do to the rows of a test."""
    # Shapes: displacement_mm (n,).
    slope, ones = at.stiffness_N_per_mm, np.ones(displacement_mm.size)
    return (
        SensorErrorSource("position", "offset", "mm", position.offset_mm, -slope, True),
        SensorErrorSource("position", "scale", "", position.scale, -slope * displacement_mm, True),
        SensorErrorSource("position", "noise", "mm", position.noise_mm, -slope, False),
        SensorErrorSource("force", "zero", "N", force.zero_N, ones, True),
        SensorErrorSource("force", "scale", "", force.scale, at.force_N, True),
        SensorErrorSource("force", "noise", "N", force.noise_N, ones, False),
    )


@dataclass(frozen=True)
class PropagatedQuantity:
    """A constant, or the force that is predicted with the constants."""

    #: Unit of ``value``: MPa, N, or empty.
    name: str
    unit: str
    value: float
    #: shape (n_sources,); standard uncertainty by one unit of every source.
    per_source: Array
    sources: tuple[SensorErrorSource, ...]

    @property
    def parts(self) -> Array:
        """Standard uncertainty that every source makes, over the value."""
        given = np.array([source.given for source in self.sources])
        return np.asarray(self.per_source * given / abs(self.value))

    @property
    def relative(self) -> float:
        """Standard uncertainty over the value, all sources together."""
        return float(np.sqrt(np.sum(self.parts**2)))

    def at_multiples(self, position: Array, force: Array) -> Array:
        """Relative standard uncertainty with both sensors' errors so many times as large."""
        squares = self.parts**2
        is_position = np.array([source.sensor == "position" for source in self.sources])
        of_position_alone = float(squares[is_position].sum())
        other = float(squares.sum()) - of_position_alone
        return np.asarray(np.sqrt(position**2 * of_position_alone + force**2 * other))

    def allowed(self, relative: float) -> Array:
        """Largest error of every source, alone and beside the others as given.

        Infinite where it does nothing, NaN where the others leave none. Shapes: returns (2, n).
        """
        unit = self.per_source / abs(self.value)
        others = self.relative**2 - self.parts**2
        left = relative**2 - np.stack([np.zeros_like(others), others])
        root, free = np.sqrt(np.maximum(left, 0.0)), np.where(left >= 0, np.inf, np.nan)
        allowed = np.divide(root, unit, out=free.copy(), where=unit > 0)
        return np.asarray(np.where(left >= 0, allowed, np.nan))


@dataclass(frozen=True)
class Propagation:
    """Constants and predicted force, to first order of the errors."""

    sources: tuple[SensorErrorSource, ...]
    constants: tuple[PropagatedQuantity, ...]
    #: Predicted at the end of the predicted test.
    force: PropagatedQuantity
    #: shape (p, n); change of the constants by that of every row.
    pseudo_inverse: Array
    #: shape (p,); change of the predicted force by the constants.
    gradient: Array

    @property
    def worst(self) -> PropagatedQuantity:
        """Constant with the largest relative uncertainty."""
        return max(self.constants, key=lambda constant: constant.relative)


def propagate(
    names: Sequence[str],
    values: Array,
    units: Sequence[str],
    at: ForceAt,
    sources: tuple[SensorErrorSource, ...],
    predicted: ForceAt,
) -> Propagation:
    """Propagate sensor errors to the constants of an unweighted fit, and to a predicted force."""
    # Shapes: names, values, units (p,).
    inverse, rank = scaled_inverse(at.jacobian)
    if rank < len(names):
        raise RefusedError(
            f"the test determines {rank} of {len(names)} constants ({', '.join(names)}): "
            "no accuracy of a sensor tells them apart; press deeper, or take a simpler energy"
        )
    pseudo_inverse = inverse @ at.jacobian.T
    # roots of the constants' covariance by one unit of every source: a shared error has one column
    effects = np.stack([pseudo_inverse * source.response for source in sources])
    for root, source in zip(effects, sources, strict=True):
        if source.is_shared:
            root[:] = np.pad(root.sum(axis=1, keepdims=True), ((0, 0), (0, root.shape[1] - 1)))
    variance = np.einsum("skn,skn->sk", effects, effects)
    gradient = predicted.jacobian[0]
    constants = tuple(
        PropagatedQuantity(name, unit, float(value), np.sqrt(variance[:, k]), sources)
        for k, (name, value, unit) in enumerate(zip(names, values, units, strict=True))
    )
    per_source = np.linalg.norm(np.einsum("k,skn->sn", gradient, effects), axis=1)
    force = PropagatedQuantity("force", "N", float(predicted.force_N[0]), per_source, sources)
    return Propagation(sources, constants, force, pseudo_inverse, gradient)


#: Tests of one task, whatever the number of workers, so that this changes no digit.
CHUNK = 25
#: Step at which a fit has converged, over the smallest standard uncertainty of a constant. Contact
#: that sets in node by node makes kinks in the sum of squares, all of them far smaller than that.
STEP = 1e-3
#: The same over the constant itself, which is no smaller: forces are solved to about 1e-8.
SMALLEST_STEP = 1e-7
TOLD = 10
#: Largest share by which the scatter may differ from first order where that is said to hold.
LINEAR = 0.05
#: Largest shift of the mean in standard deviations: an interval of k = 2 then still holds 94.8 %.
SHIFTED = 0.25
#: Smallest share of the tests that must have an answer.
FEWEST = 0.9
#: Fewest tests whose scatter can be told.
FEWEST_TESTS = 10


@dataclass(frozen=True)
class Scatter(Keyed):
    """How one quantity scatters in the simulated tests."""

    KEYS = "name standard_deviation ratio ratio_standard_error=ratio_error bias"

    #: Of a constant, or ``force``.
    name: str
    #: Of a modulus in kPa, of the force in N.
    standard_deviation: float
    #: Its scatter over that of first order with the same errors.
    ratio: float
    #: Standard error of the ratio, by the jackknife.
    ratio_error: float
    #: Mean less the assumed value, in standard deviations.
    bias: float

    @property
    def is_linear(self) -> bool:
        """Whether first order holds, for scatter and mean."""
        return abs(self.ratio - 1) <= LINEAR and abs(self.bias) <= SHIFTED


@dataclass(frozen=True)
class Simulation(Keyed):
    """All tests with errors so many times as large as given."""

    KEYS = "multiple samples failed linear=is_linear message quantities=scatters"

    multiple: float
    #: Tests, and those whose fit has no answer.
    samples: int
    failed: int
    #: Constants in their order, and the predicted force.
    scatters: tuple[Scatter, ...]
    #: Why the first of those that failed did.
    message: str = ""

    @property
    def is_linear(self) -> bool:
        """Whether first order holds for all quantities, and hardly any test failed."""
        enough = self.samples - self.failed >= FEWEST * self.samples
        return enough and all(scatter.is_linear for scatter in self.scatters)


def simulate(
    file: RequirementFile,
    propagation: Propagation,
    jobs: int,
    progress: Callable[[str], None] | None = None,
) -> tuple[Simulation, ...]:
    """Simulate tests at several multiples of the given errors."""
    if not file.requirement.samples:
        return ()
    tasks, owners, multiples = [], {}, file.requirement.multiples
    for multiple in multiples:
        for chunk in _chunks(file, propagation, multiple):
            key = f"{multiple:g}-{chunk.first}"
            tasks.append(Task(key, partial(_payload, chunk)))
            owners[key] = multiple
    answers: dict[float, list[Answer]] = {multiple: [] for multiple in multiples}
    say = progress or (lambda text: None)
    # a closed form is done before processes have started
    simulated = not file.fitted.setup.is_homogeneous
    executor: Executor = Loky(perform, jobs) if simulated else Inline(perform)
    for done, outcome in enumerate(executor.run(tasks), start=1):
        answers[owners[outcome.key]] += _answers(outcome.result)
        if done * TOLD // len(tasks) > (done - 1) * TOLD // len(tasks):
            say(f"{done} of {len(tasks)} parts of the simulated tests")
    return tuple(
        _simulation(m, file.requirement.samples, propagation, answers[m]) for m in multiples
    )


def _chunks(file: RequirementFile, propagation: Propagation, multiple: float) -> Iterator[Chunk]:
    """Divide a simulation into tasks, whose random numbers are those of multiple and test."""
    stream, samples = (file.seed, round(1e6 * multiple)), file.requirement.samples
    least = min(constant.relative for constant in propagation.constants)
    xtol = max(STEP * multiple * least, SMALLEST_STEP)
    for first in range(0, samples, CHUNK):
        last = min(first + CHUNK, samples)
        inverse = propagation.pseudo_inverse
        yield Chunk(file.multiplied(multiple), stream, first, last, inverse, xtol)


def _payload(chunk: Chunk, _: Results) -> Chunk:
    return chunk


def _answers(result: Mapping[str, object]) -> list[Answer]:
    """Read what a worker found; one that died answers none of its tests."""
    if result["status"] == "failed":
        raise RuntimeError(str(result.get("traceback", result.get("message"))))
    if result["status"] != "done":
        return [str(result.get("message", result["status"]))]
    return cast("list[Answer]", result["tests"])


def _simulation(
    multiple: float, samples: int, propagation: Propagation, answers: Sequence[Answer]
) -> Simulation:
    """Judge the tests of one multiple."""
    changes = np.array([answer for answer in answers if not isinstance(answer, str)])
    message = next((answer for answer in answers if isinstance(answer, str)), "")
    answered, p, force = len(changes), len(propagation.constants), propagation.force
    if answered < FEWEST_TESTS:
        return Simulation(multiple, samples, samples - answered, (), message)
    fitted, linear = changes[:, :p], changes[:, p : 2 * p]
    pairs = [
        *zip(propagation.constants, fitted.T, linear.T, strict=True),
        (force, changes[:, -1] - force.value, linear @ propagation.gradient),
    ]
    scatters = tuple(_scatter(of, changed, moved, multiple) for of, changed, moved in pairs)
    return Simulation(multiple, samples, samples - answered, scatters, message)


def _scatter(
    quantity: PropagatedQuantity, fitted: Array, linear: Array, multiple: float
) -> Scatter:
    """Compare the scatter of changes with that of first order from the same errors."""
    ratios = _without_each(fitted) / _without_each(linear)
    ratio = float(np.std(fitted, ddof=1) / np.std(linear, ddof=1))
    n, first_order = fitted.size, multiple * quantity.relative * abs(quantity.value)
    error = float(np.sqrt((n - 1) / n * np.sum((ratios - ratios.mean()) ** 2)))
    # what the mean of the linear changes is off zero is chance, and the same in both
    shift, deviation = float(np.mean(fitted - linear)), first_order * ratio
    shown = deviation * (1e3 if quantity.unit == "MPa" else 1.0)
    return Scatter(quantity.name, shown, ratio, error, shift / deviation)


def _without_each(values: Array) -> Array:
    """Give the standard deviation without each value in turn, shape (n,)."""
    n, centered = values.size, values - values.mean()
    squares = np.sum(centered**2) - centered**2 - centered**2 / (n - 1)
    return np.asarray(np.sqrt(np.maximum(squares, 0.0) / (n - 2)))


# Virtual tests: measured with drawn sensor errors, and fitted anew (JCGM 101:2008).


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
class Chunk:
    """Part of a simulation that one worker does."""

    #: With the errors of this simulation.
    file: RequirementFile
    #: Begins the seed of every test.
    stream: tuple[int, ...]
    #: Numbers of its tests, the last one excluded.
    first: int
    last: int
    #: shape (p, n); change of the constants by that of every row, to first order.
    pseudo_inverse: Array
    #: Full step over the constants at which a fit has converged.
    xtol: float


#: changes of the constants in one test, by the nonlinear fit and to first order, and the predicted
#: force in N; or why there is no answer
Answer: TypeAlias = list[float] | str


def perform(chunk: Chunk) -> dict[str, object]:
    """Measure and fit the tests of one chunk (in a worker)."""
    problem, tests = chunk.file.predicted.at(), list[Answer]()
    test = _Test(chunk)
    depth = np.array([problem.test.depth_mm])
    predicted = force_model(problem, float(depth[0]))
    for k in range(chunk.first, chunk.last):
        try:
            values, linear = test.measured(np.random.default_rng([*chunk.stream, k]))
            force = predicted(values, depth).force_N
        except (EvaluationFailed, InputError) as error:
            tests.append(str(error))
            continue
        tests.append(np.concatenate([values - test.values, linear, force]).tolist())
    return {"status": "done", "tests": tests}


class _Test:
    """One test at its rows, to be measured with errors and fitted as often as asked."""

    def __init__(self, chunk: Chunk) -> None:
        self.chunk, file = chunk, chunk.file
        self.model = force_model(file.fitted.at(), file.farthest_mm)
        self.rows = file.rows_mm
        self.values = self.model.problem.material.values
        self.true = self.model(self.values, self.rows)

    def measured(self, random: np.random.Generator) -> tuple[Array, Array]:
        """Constants of the fit to one measured test, and their change to first order."""
        n, p, f = self.rows.size, self.chunk.file.position, self.chunk.file.force
        shift, scale = p.offset_mm * random.standard_normal(), p.scale * random.standard_normal()
        moved = shift + self.rows * scale + p.noise_mm * random.standard_normal(n)
        shift, scale = f.zero_N * random.standard_normal(), f.scale * random.standard_normal()
        off = shift + self.true.force_N * scale + f.noise_N * random.standard_normal(n)
        linear = self.chunk.pseudo_inverse @ (off - self.true.stiffness_N_per_mm * moved)
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
            xtol=self.chunk.xtol,
            gtol=GTOL,
            edge=EDGE,
            max_evaluations=MOST_EVALUATIONS,
        )
        # a lowest point at which contact sets in is as good a constant as another
        if not (fit.converged or fit.status is Status.at_kink):
            raise EvaluationFailed(fit.status.sentence)
        return fit.x


# What the sensors must be for a wanted accuracy.

#: Multiples of the given errors that the map of accuracies shows, from a tenth to ten times.
MULTIPLES = np.logspace(-1, 1, 61)


@dataclass(frozen=True)
class SensorRequirement(Keyed):
    """Uncertainty of constants and force by sensors, and what a wanted accuracy needs."""

    KEYS = (
        "name accuracy coverage met=is_met needed_multiple quantities=each_quantity required "
        "monte_carlo=simulations sentences report warnings"
    )

    name: str
    question: str
    #: Wanted expanded uncertainty over the value; expanded over standard uncertainty.
    accuracy: float
    coverage: float
    propagation: Propagation
    #: Monte Carlo, at multiples of the given errors.
    simulations: tuple[Simulation, ...]
    #: What is wrong with the simulated force, if anything.
    notes: tuple[str, ...] = ()
    #: Page of it, where one was written.
    report: str | None = None
    #: Where first order does not hold.
    warnings: tuple[str, ...] = ()

    @property
    def standard(self) -> float:
        """Wanted standard uncertainty over the value."""
        return self.accuracy / self.coverage

    @property
    def quantities(self) -> tuple[PropagatedQuantity, ...]:
        """Constants and the predicted force."""
        return (*self.propagation.constants, self.propagation.force)

    @property
    def is_met(self) -> bool:
        """Whether every constant is known as well as wanted."""
        return self.propagation.worst.relative <= self.standard

    @property
    def needed_multiple(self) -> float:
        """Multiple of all given errors that just meets the wanted accuracy."""
        return self.standard / self.propagation.worst.relative

    def allowed(self, source: int) -> tuple[float, float]:
        """Largest error of a source for all constants: alone, and beside the others as given."""
        each = [constant.allowed(self.standard) for constant in self.propagation.constants]
        alone, jointly = np.min(each, axis=0)[:, source]
        return float(alone), float(jointly)

    @property
    def each_quantity(self) -> list[dict[str, object]]:
        """Constants in kPa (exponents plain) and force: value, uncertainty, part of each error."""
        names = [f"{source.sensor}.{source.name}" for source in self.propagation.sources]
        return [
            {
                "name": q.name,
                "unit": "kPa" if q.unit == "MPa" else q.unit,
                "value": q.value * (1e3 if q.unit == "MPa" else 1.0),
                "relative_standard_uncertainty": q.relative,
                "relative_expanded_uncertainty": self.coverage * q.relative,
                "parts": dict(zip(names, q.parts.tolist(), strict=True)),
            }
            for q in self.quantities
        ]

    @property
    def required(self) -> list[dict[str, object]]:
        """Largest errors of every source; infinite for any, NaN for none."""
        keys = ("allowed_alone", "allowed_beside_the_others")
        return [
            {"sensor": source.sensor, "error": source.name, "unit": source.unit or "1",
             "given": source.given, **dict(zip(keys, self.allowed(k), strict=True))}
            for k, source in enumerate(self.propagation.sources)
        ]  # fmt: skip

    def sentences(self) -> list[str]:
        """Say how well every modulus is known, what that needs, and where first order holds."""
        worst, k = self.propagation.worst, self.coverage
        larger = f"{times(self.needed_multiple)} as large"
        needed = (
            f"is met; all errors could be {larger}" if self.is_met else f"needs all errors {larger}"
        )
        force = self.propagation.force.relative
        return [
            f"{worst.name} is known to {percent(k * worst.relative)} (k = {k:g}), the force that "
            f"is predicted to {percent(k * force)}.",
            f"{percent(self.accuracy)} for every constant {needed}.",
            _largest_part(self),
            *map(_linear, self.simulations),
        ]

    def worst_at(self, position: Array, force: Array) -> Array:
        """Largest expanded relative uncertainty of a constant at multiples of both errors."""
        each = [constant.at_multiples(position, force) for constant in self.propagation.constants]
        return np.asarray(self.coverage * np.max(each, axis=0))


def sensor_requirement(
    file: RequirementFile, jobs: int, progress: Callable[[str], None] | None = None
) -> SensorRequirement:
    """Propagate the errors of both sensors, and check that by simulated tests."""
    prediction = file.predicted.at()
    _check_reach(file)
    fitted = force_model(file.fitted.at(), file.farthest_mm)
    material, rows = fitted.problem.material, file.rows_mm
    at, end = fitted(material.values, rows), prediction.test.depth_mm
    predicted = force_model(prediction, end)(material.values, np.array([end]))
    units = ["" if is_dimensionless(name) else "MPa" for name in material.names]
    sources = sources_of(file.position, file.force, at, rows)
    propagation = propagate(material.names, material.values, units, at, sources, predicted)
    return SensorRequirement(
        file.name, file.question, file.requirement.accuracy, file.requirement.coverage, propagation,
        simulate(file, propagation, jobs, progress), fitted.notes,
    )  # fmt: skip


def _check_reach(file: RequirementFile) -> None:
    """Refuse errors with which a test would go through its specimen."""
    height = file.fitted.height_mm
    for multiple in file.requirement.multiples if file.requirement.samples else ():
        farthest = file.multiplied(multiple).farthest_mm
        if height is not None and farthest >= height:
            rule = (
                f"at {multiple:g} times its errors the tracker may tell {farthest:.4g} mm, "
                f"which reaches the specimen's height of {height:g} mm"
            )
            mend = "press less deep, or ask for smaller requirement.multiples"
            raise InputError(Fault("position", rule, mend))


def _largest_part(sensors: SensorRequirement) -> str:
    worst = sensors.propagation.worst
    shares = worst.parts**2 / worst.relative**2
    largest = int(np.argmax(shares))
    source = sensors.propagation.sources[largest]
    return (
        f"{percent(shares[largest])} of the variance of {worst.name} comes from the "
        f"{source.sensor}'s {source.name} of {size(source, source.given)}."
    )


def _linear(check: Simulation) -> str:
    times = f"At {f'{check.multiple:g} times ' * (check.multiple != 1)}the given errors"
    answered = check.samples - check.failed
    if not check.scatters:
        return f"{times} {check.failed} of {check.samples} fits have no answer ({check.message})."
    off = max(check.scatters, key=lambda s: abs(s.ratio - 1))
    shifted = max(check.scatters, key=lambda s: abs(s.bias))
    lost = f"; {check.failed} of {check.samples} fits have no answer" if check.failed else ""
    bias = ""
    if abs(shifted.bias) > 0.1:
        mean = "its mean" if shifted is off else f"the mean of {shifted.name}"
        size_of = f"{shifted.bias:+.2f}".replace("-", "\N{MINUS SIGN}")
        bias = f", and {mean} is shifted by {size_of} standard deviations"
    verdict = "first order holds" if check.is_linear else "first order does not hold"
    return (
        f"{times} {verdict}: in {answered} simulated tests the scatter of {off.name} is "
        f"{off.ratio:.3f} \N{PLUS-MINUS SIGN} {2 * off.ratio_error:.3f} times that of first order"
        f"{bias}{lost}."
    )


def percent(share: float) -> str:
    """Write a share in percent, three digits."""
    return f"{100 * share:.3g} %"


def size(source: SensorErrorSource, value: float) -> str:
    """Write an error with its unit. Units: source mm."""
    if math.isinf(value):
        return "any"
    if math.isnan(value):
        return "none"
    return f"{value:.3g} {source.unit}" if source.unit else percent(value)
