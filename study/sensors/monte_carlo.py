"""Monte Carlo simulation of whole tests: errors are drawn, constants fitted anew (JCGM 101:2008).

Every test is fitted twice: by the nonlinear fit, and to first order from the same errors. The
ratio of the two scatters is known far better than either of them, so that a few hundred tests
show whether first order holds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from study.arrays import Array
from study.execution.inline import Inline
from study.execution.loky import Loky
from study.execution.task import Executor, Results, Task
from study.sensors.propagation import Propagation, Quantity
from study.sensors.section import multiplied
from study.sensors.virtual_test import Changes, Chunk, Sampling, perform
from study.setup.setup import Setup, Tables

#: Tests of one task, whatever the number of workers, so that this changes no digit.
CHUNK = 25
#: Step at which a fit has converged, over the smallest standard uncertainty of a constant. Contact
#: that sets in node by node makes kinks in the sum of squares, all of them far smaller than that.
STEP = 1e-3
#: The same over the constant itself, which is no smaller: forces are solved to about 1e-8.
SMALLEST_STEP = 1e-7
#: How often progress is told.
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
class Scatter:
    """How one quantity scatters in the simulated tests.

    Parameters
    ----------
    name, unit : str
        Of a constant, or ``force``; MPa, N or empty.
    standard_deviation : float
        In the unit of the quantity.
    ratio : float
        Its scatter over that of first order with the same errors.
    ratio_error : float
        Standard error of the ratio, by the jackknife.
    bias : float
        Mean less the assumed value, in standard deviations.
    """

    name: str
    unit: str
    standard_deviation: float
    ratio: float
    ratio_error: float
    bias: float

    @property
    def is_linear(self) -> bool:
        """Whether first order holds, for scatter and mean."""
        return abs(self.ratio - 1) <= LINEAR and abs(self.bias) <= SHIFTED


@dataclass(frozen=True)
class Simulation:
    """All tests with errors so many times as large as given.

    Parameters
    ----------
    multiple : float
        Of the given errors.
    samples, failed : int
        Tests, and those whose fit has no answer.
    scatters : tuple of Scatter
        Constants in their order, and the predicted force.
    message : str
        Why the first of those that failed did.
    """

    multiple: float
    samples: int
    failed: int
    scatters: tuple[Scatter, ...]
    message: str = ""

    @property
    def is_linear(self) -> bool:
        """Whether first order holds for all quantities, and hardly any test failed."""
        enough = self.samples - self.failed >= FEWEST * self.samples
        return enough and all(one.is_linear for one in self.scatters)


def simulate(
    sampling: Sampling,
    propagation: Propagation,
    multiples: Sequence[float],
    jobs: int,
    progress: Callable[[str], None] | None = None,
) -> tuple[Simulation, ...]:
    """Simulate tests at several multiples of the given errors.

    Parameters
    ----------
    sampling : Sampling
        With the errors as given.
    propagation : Propagation
        To first order.
    multiples : sequence of float
        Of the errors.
    jobs : int
        Workers where tests are solved by finite elements; a closed form needs none.
    progress : callable, optional
        Gets a sentence after every part.
    """
    tasks, owners = [], {}
    for multiple in multiples:
        for chunk in _chunks(sampling, propagation, multiple):
            key = f"{multiple:g}-{chunk.first}"
            tasks.append(Task(key, _payload(chunk)))
            owners[key] = multiple
    found: dict[float, Changes] = {multiple: Changes() for multiple in multiples}
    say = progress or (lambda text: None)
    for done, outcome in enumerate(_executor(sampling.fitted, jobs).run(tasks), start=1):
        found[owners[outcome.key]].add(_changes(outcome.result))
        if done * TOLD // len(tasks) > (done - 1) * TOLD // len(tasks):
            say(f"{done} of {len(tasks)} parts of the simulated tests")
    return tuple(_simulation(m, sampling.samples, propagation, found[m]) for m in multiples)


def _chunks(sampling: Sampling, propagation: Propagation, multiple: float) -> Iterator[Chunk]:
    """Divide a simulation into tasks, whose random numbers are those of multiple and test."""
    position, force = multiplied(sampling.position, sampling.force, multiple)
    drawn = replace(sampling, position=position, force=force)
    stream = (sampling.seed, round(1e6 * multiple))
    rows = tuple(map(tuple, propagation.pseudo_inverse.tolist()))
    least = min(one.relative for one in propagation.constants)
    xtol = max(STEP * multiple * least, SMALLEST_STEP)
    for first in range(0, sampling.samples, CHUNK):
        yield Chunk(drawn, stream, first, min(first + CHUNK, sampling.samples), rows, xtol)


def _payload(chunk: Chunk) -> Callable[[Results], dict[str, object]]:
    return lambda _: chunk.to_json()


def _changes(result: Mapping[str, object]) -> Changes:
    """Read what a worker found; one that died answers none of its tests.

    Raises
    ------
    RuntimeError
        If it met a bug.
    """
    if result["status"] == "failed":
        raise RuntimeError(str(result.get("traceback", result.get("message"))))
    if result["status"] != "done":
        return Changes(messages=[str(result.get("message", result["status"]))])
    return Changes(
        cast("list[list[float]]", result["fitted"]),
        cast("list[list[float]]", result["linear"]),
        cast("list[float]", result["force_N"]),
        cast("list[str]", result["messages"]),
    )


def _executor(tables: Tables, jobs: int) -> Executor:
    """Take processes for finite elements; a closed form is done before they have started."""
    return Inline(perform) if Setup.of(tables).is_homogeneous else Loky(perform, jobs)


def _simulation(
    multiple: float, samples: int, propagation: Propagation, found: Changes
) -> Simulation:
    """Judge the tests of one multiple."""
    answered, message = len(found.fitted), next(iter(found.messages), "")
    if answered < FEWEST_TESTS:
        return Simulation(multiple, samples, samples - answered, (), message)
    linear = np.array(found.linear)
    force = propagation.force
    pairs = [
        *zip(propagation.constants, np.array(found.fitted).T, linear.T, strict=True),
        (force, np.array(found.force_N) - force.value, linear @ propagation.gradient),
    ]
    scatters = tuple(_scatter(one, changed, moved, multiple) for one, changed, moved in pairs)
    return Simulation(multiple, samples, samples - answered, scatters, message)


def _scatter(one: Quantity, fitted: Array, linear: Array, multiple: float) -> Scatter:
    """Compare the scatter of changes with that of first order from the same errors."""
    ratios = _without_each(fitted) / _without_each(linear)
    ratio = float(np.std(fitted, ddof=1) / np.std(linear, ddof=1))
    n, first_order = fitted.size, multiple * one.relative * abs(one.value)
    error = float(np.sqrt((n - 1) / n * np.sum((ratios - ratios.mean()) ** 2)))
    # what the mean of the linear changes is off zero is chance, and the same in both
    shift = float(np.mean(fitted - linear))
    return Scatter(
        one.name, one.unit, first_order * ratio, ratio, error, shift / (first_order * ratio)
    )


def _without_each(values: Array) -> Array:
    """Give the standard deviation without each value in turn, shape (n,)."""
    n, centered = values.size, values - values.mean()
    squares = np.sum(centered**2) - centered**2 - centered**2 / (n - 1)
    return np.asarray(np.sqrt(np.maximum(squares, 0.0) / (n - 2)))
