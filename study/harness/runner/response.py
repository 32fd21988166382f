"""Responses: one number each, from a predicted and a measured curve or from the constants."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Protocol

import numpy as np

from study.ground.arrays import Array
from study.ground.curve import Curve
from study.harness.design.study_file import MARKED, RESPONSES, SIMULATED, is_simulated, simulated_at
from study.harness.record.document import Quantity
from study.mechanics.material.material import is_dimensionless, unit_shown

#: kPa in one MPa: a fit is in MPa, a response in kPa
KPA = 1000.0


@dataclass(frozen=True)
class Scored:
    """One scored curve of a case: all that a response may look at.

    Parameters
    ----------
    measured : Curve or None
        What was measured; None in a study of simulations alone.
    predicted : Curve or None
        What the model says; None for a fit to resampled residuals, which predicts nothing.
    constants : mapping of str to float
        Constants of the material in MPa, exponents plain.
    mu0 : float or None
        Initial shear modulus in MPa, where it is known.
    """

    measured: Curve | None
    predicted: Curve | None = None
    constants: Mapping[str, float] = field(default_factory=dict)
    mu0: float | None = None


class Response(Protocol):
    """One number of a scored curve."""

    @property
    def name(self) -> str:
        """Key of the study file and of records."""
        ...

    @property
    def unit(self) -> str:
        """Unit of its value; empty for a plain number."""
        ...

    def compute(self, scored: Scored) -> float:
        """Value of the response, in its unit."""
        ...


class CurveResponse(ABC):
    """A response that compares a predicted with a measured curve."""

    name: ClassVar[str]
    unit: ClassVar[str]

    def compute(self, scored: Scored) -> float:
        """Value of the response, in its unit.

        Raises
        ------
        ValueError
            If one of the curves is missing.
        """
        if scored.predicted is None or scored.measured is None:
            raise ValueError(f"{self.name} needs a predicted and a measured curve")
        return self.between(scored.predicted, scored.measured)

    @abstractmethod
    def between(self, predicted: Curve, measured: Curve) -> float:
        """Compare two curves over the measured points."""


class RmsForceError(CurveResponse):
    """Root mean square of the difference in force over the measured points."""

    name = "rms_force_error"
    unit = RESPONSES[name]

    def between(self, predicted: Curve, measured: Curve) -> float:
        """Compare two curves, N."""
        return float(np.sqrt(np.mean(residual_N(predicted, measured) ** 2)))


class RelativeRmsForceError(CurveResponse):
    """RMS of the difference over the RMS of the measured force.

    Examples
    --------
    >>> measured = Curve(np.array([1.0, 2.0]), np.array([3.0, 4.0]))
    >>> predicted = Curve(np.array([1.0, 2.0]), np.array([3.3, 4.4]))
    >>> round(RelativeRmsForceError().between(predicted, measured), 10)
    10.0
    """

    name = "relative_rms_force_error"
    unit = RESPONSES[name]

    def between(self, predicted: Curve, measured: Curve) -> float:
        """Compare two curves, %."""
        scale = float(np.sqrt(np.mean(measured.force_N**2)))
        return 100 * RmsForceError().between(predicted, measured) / scale


class PeakForceError(CurveResponse):
    """Absolute difference of the largest forces."""

    name = "peak_force_error"
    unit = RESPONSES[name]

    def between(self, predicted: Curve, measured: Curve) -> float:
        """Compare two curves, N."""
        forces = predicted.force_at(measured.displacement_mm)
        return float(abs(forces.max() - measured.force_N.max()))


class WorkError(CurveResponse):
    """Absolute difference of the work over the measured range, over the measured work."""

    name = "work_error"
    unit = RESPONSES[name]

    def between(self, predicted: Curve, measured: Curve) -> float:
        """Compare two curves, %."""
        d = measured.displacement_mm
        work = float(np.trapezoid(measured.force_N, d))
        return 100 * abs(float(np.trapezoid(residual_N(predicted, measured), d)) / work)


#: largest values over the test of what finite elements say of plate or indenter
CONTACT = ("peak_contact_pressure", "contact_area", "side_force")


@dataclass(frozen=True)
class SimulatedResponse:
    """A number of a predicted curve alone; one at a displacement has it in its name.

    Examples
    --------
    >>> curve = Curve(np.array([1.0, 2.0]), np.array([3.0, 8.0]))
    >>> [SimulatedResponse(name).of(curve) for name in ("peak_force", "force_at_1.5_mm", "work")]
    [8.0, 5.5, 7.0]
    """

    name: str

    @property
    def unit(self) -> str:
        """Unit of its value."""
        return SIMULATED[simulated_at(self.name)[0]]

    def compute(self, scored: Scored) -> float:
        """Value of the response, in its unit.

        Raises
        ------
        ValueError
            If there is no predicted curve.
        """
        if scored.predicted is None:
            raise ValueError(f"{self.name} needs a predicted curve")
        return self.of(scored.predicted)

    def of(self, curve: Curve) -> float:
        """Value for a curve."""
        name, place = simulated_at(self.name)
        if place is not None:
            ordinate = curve.stiffness_at if name == "stiffness_at" else curve.force_at
            return float(ordinate(place))
        if name in CONTACT:  # another program or a closed form gives none
            values = curve.quantities.get(name, np.full(1, np.nan))
            return float(np.max(values))
        if name == "peak_force":
            return float(curve.force_N.max())
        # Work done on the specimen from the unloaded state, N mm.
        if curve.work_Nmm is not None:
            return float(curve.work_Nmm[-1])
        ends = np.linspace(0.0, float(curve.displacement_mm[-1]), _POINTS + 1)
        return float(np.trapezoid(curve.force_at(ends), ends))


#: points between which the work of a curve is summed: the trapezoidal rule is then off by a
#: millionth of the work, for a force that grows with the square of the displacement
_POINTS = 400


@dataclass(frozen=True)
class ConstantResponse:
    """A constant of the material in kPa; an exponent is a plain number, a time is in s."""

    name: str

    @property
    def unit(self) -> str:
        """Unit of its value."""
        return unit_shown(self.name)

    def compute(self, scored: Scored) -> float:
        """Value of the constant."""
        return scale_of(self.name) * float(scored.constants[self.name])


class InitialShearModulus:
    """Initial shear modulus of the material."""

    name: ClassVar[str] = "mu0"
    unit: ClassVar[str] = RESPONSES[name]

    def compute(self, scored: Scored) -> float:
        """Value of the modulus, kPa; NaN where it is not known."""
        return float("nan") if scored.mu0 is None else KPA * scored.mu0


#: responses of a predicted and a measured curve, by name; every record holds them all
CURVE_RESPONSES: Mapping[str, CurveResponse] = {
    r.name: r for r in (RelativeRmsForceError(), RmsForceError(), PeakForceError(), WorkError())
}


def units_of(named: Iterable[str], measured: bool = True) -> dict[str, str]:
    """Units of all responses that the records of a study hold, those not asked for too."""
    every: list[Response] = [*(CURVE_RESPONSES.values() if measured else ()), InitialShearModulus()]
    names = list(named)
    every += [SimulatedResponse(name) for name in names if is_simulated(name)]
    units = {r.name: r.unit for r in every}
    units |= {name: RESPONSES[name] for name in names if name in MARKED}
    constants = [ConstantResponse(name) for name in names if name not in {*units, "seconds"}]
    units |= {r.name: r.unit for r in constants}
    return units | ({"seconds": RESPONSES["seconds"]} if "seconds" in names else {})


def scale_of(constant: str) -> float:
    """Factor from MPa to the unit in which a constant is reported; 1 for one that is no modulus."""
    return 1.0 if is_dimensionless(constant) else KPA


def in_shown_units(constants: Sequence[str], values: Array) -> dict[str, object]:
    """Numbers of every constant in the unit in which it is reported; values (p,) or (p, k), MPa."""
    pairs = zip(constants, values, strict=True)
    return {name: (scale_of(name) * value).tolist() for name, value in pairs}


def score(scored: Scored, names: Iterable[str] = ()) -> dict[str, Quantity]:
    """Every response that a curve has, with its unit."""
    every: list[Response] = []
    if scored.predicted is not None:
        every += of_prediction(names)
        every += [] if scored.measured is None else list(CURVE_RESPONSES.values())
    return _computed(every, scored) | constants_of(scored)


def of_prediction(names: Iterable[str]) -> list[SimulatedResponse]:
    """Those responses asked for that a predicted curve alone gives."""
    return [SimulatedResponse(name) for name in names if is_simulated(name) and name != "dofs"]


def constants_of(scored: Scored) -> dict[str, Quantity]:
    """List the initial shear modulus and every constant: moduli in kPa, others as they are."""
    responses: list[Response] = [] if scored.mu0 is None else [InitialShearModulus()]
    responses += [ConstantResponse(name) for name in scored.constants]
    return _computed(responses, scored)


def _computed(responses: Iterable[Response], scored: Scored) -> dict[str, Quantity]:
    """Values of some responses, by name."""
    return {r.name: {"value": r.compute(scored), "unit": r.unit} for r in responses}


def averaged(scores: Sequence[Mapping[str, Quantity]]) -> dict[str, Quantity]:
    """Mean over the directions, with units; a mean that is not finite is None."""
    out: dict[str, Quantity] = {}
    for name, first in scores[0].items():
        numbers = [score[name]["value"] for score in scores if name in score]
        mean = float(np.mean(np.array(numbers, dtype=float)))
        out[name] = {"value": mean if np.isfinite(mean) else None, "unit": first["unit"]}
    return out


def splined_uncertainty(predicted: Curve, names: Iterable[str]) -> dict[str, float]:
    """Change of every response of a curve whose tangents are a spline's, with half of its points.

    Another program solves with load steps of its own, which are not ours to halve; what lies
    between the displacements that it was asked for is. Nothing where too few points are left.
    """
    rough = replace(predicted.every_other_point(), stiffness_N_per_mm=None, work_Nmm=None)
    rough = rough.with_tangents()
    if rough.stiffness_N_per_mm is None:
        return {}
    return {r.name: abs(r.of(predicted) - r.of(rough)) for r in of_prediction(names)}


def step_uncertainty(
    predicted: Curve, measured: Curve | None, names: Iterable[str] = ()
) -> dict[str, float]:
    """Change of every response where the curve keeps every other load step only.

    The steps that are left out are twice as many as were solved; what is left of their effect in
    the response itself is a part of this change, since the interpolation between two steps gets
    better by more than twice when they are halved. Zero where the force is known everywhere
    (closed form), and nothing where one step is all there is.
    """
    predicted_alone = of_prediction(names)
    compared = CURVE_RESPONSES if measured is not None else {}
    if predicted.stiffness_N_per_mm is None:
        return dict.fromkeys([*compared, *(r.name for r in predicted_alone)], 0.0)
    if len(predicted) < 2:
        return {}
    rough = predicted.every_other_point()
    scatter = {r.name: abs(r.of(predicted) - r.of(rough)) for r in predicted_alone}
    if measured is None:
        return scatter
    return scatter | {
        name: abs(r.between(predicted, measured) - r.between(rough, measured))
        for name, r in compared.items()
    }


def residual_N(predicted: Curve, measured: Curve) -> Array:  # noqa: N802
    """Predicted less measured force at the measured points, N, shape (n,).

    Parameters
    ----------
    predicted, measured : Curve
        The predicted one has to reach as far as the measured one, which has the n points.
    """
    return predicted.force_at(measured.displacement_mm) - measured.force_N
