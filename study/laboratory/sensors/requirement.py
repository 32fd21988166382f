"""What a test and its sensors give, and what the sensors must be for a wanted accuracy."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from study.ground.arrays import Array
from study.ground.canonical import Keyed
from study.ground.errors import Fault, InputError
from study.laboratory.sensors.error_propagation import (
    PropagatedQuantity,
    Propagation,
    Sampling,
    SensorErrorSource,
    Simulation,
    propagate,
    rows_mm,
    simulate,
    sources_of,
)
from study.laboratory.sensors.force_model import RequirementFile, force_model, multiplied
from study.mechanics.material.material import is_dimensionless

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
    #: shape (n,); of the test that is fitted.
    rows_mm: Array
    force_N: Array
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
        constants, standard = self.propagation.constants, self.standard
        alone = min(constant.allowed_alone(standard)[source] for constant in constants)
        jointly = [constant.allowed_beside(standard)[source] for constant in constants]
        return float(alone), float(np.min(jointly))

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
        """Say what is known how well, what it needs, and where first order holds."""
        worst, k = self.propagation.worst, self.coverage
        times = f"{self.needed_multiple:.3g} times as large"
        needed = (
            f"is met; all errors could be {times}" if self.is_met else f"needs all errors {times}"
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
    sensors, test, prediction = file.asked, file.fitted.at(), file.predicted.at()
    sampling = Sampling(
        test, prediction, file.position, file.force, sensors.points, sensors.samples,
        file.seed,
    )  # fmt: skip
    _check_reach(file, sampling)
    fitted = force_model(test, sampling.farthest_mm)
    material, rows = fitted.problem.material, rows_mm(sampling.depth_mm, sensors.points)
    at = fitted(material.values, rows)
    end = prediction.test.depth_mm
    predicted = force_model(prediction, end)(material.values, np.array([end]))
    units = ["" if is_dimensionless(name) else "MPa" for name in material.names]
    sources = sources_of(file.position, file.force, at, rows)
    propagation = propagate(material.names, material.values, units, at, sources, predicted)
    simulations: tuple[Simulation, ...] = ()
    if sensors.samples:
        simulations = simulate(sampling, propagation, sensors.multiples, jobs, progress)
    return SensorRequirement(
        file.name, file.question, sensors.accuracy, sensors.coverage, rows, at.force_N, propagation,
        simulations, fitted.notes,
    )  # fmt: skip


def _check_reach(file: RequirementFile, sampling: Sampling) -> None:
    """Refuse errors with which a test would go through its specimen."""
    height = file.fitted.height_mm
    for multiple in file.asked.multiples if file.asked.samples else ():
        position, force = multiplied(file.position, file.force, multiple)
        farthest = replace(sampling, position=position, force=force).farthest_mm
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
    times = f"At {check.multiple:g} times the given errors"
    answered = check.samples - check.failed
    if not check.scatters:
        return f"{times} {check.failed} of {check.samples} fits have no answer ({check.message})."
    off = max(check.scatters, key=lambda s: abs(s.ratio - 1))
    shifted = max(check.scatters, key=lambda s: abs(s.bias))
    lost = f"; {check.failed} fits have no answer" if check.failed else ""
    bias = (
        f", and {shifted.name} is shifted by {shifted.bias:+.2f} standard deviations"
        if abs(shifted.bias) > 0.1
        else ""
    )
    verdict = "first order holds" if check.is_linear else "first order does not hold"
    return (
        f"{times} {verdict}: in {answered} simulated tests {off.name} scatters {off.ratio:.3f} "
        f"+- {2 * off.ratio_error:.3f} times as much as first order says{bias}{lost}."
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
