"""Responses: one number each, from a predicted and a measured curve or from the constants."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from study.ground.arrays import Array
from study.ground.curve import Curve
from study.mechanics.material.material import is_constant, unit_shown
from study.record.record import ResponseDocument

# Responses of a predicted curve alone, by their names in a study file.

#: responses of a predicted curve alone, with their units; those at a displacement name it, too
SIMULATED = {
    "peak_force": "N",
    "work": "N mm",
    "force_at": "N",
    "stiffness_at": "N/mm",
    "peak_contact_pressure": "kPa",
    "contact_area": "mm^2",
    "side_force": "N",
    "moment": "N mm",
    "base_force": "N",
    "base_side_force": "N",
    "base_moment": "N mm",
    "dofs": "",
}

AT_DISPLACEMENT = ("force_at", "stiffness_at")


def simulated_at(name: str) -> tuple[str, float | None]:
    """Split the name of a response at a displacement into the response and the place in mm."""
    for start in AT_DISPLACEMENT:
        displacement = name.removeprefix(f"{start}_").removesuffix("_mm")
        if name == f"{start}_{displacement}_mm":
            return start, float(displacement)
    return name, None


def is_simulated(name: str) -> bool:
    """Whether a response is one of the predicted curve alone."""
    return simulated_at(name)[0] in SIMULATED


#: responses that compare with measured curves
SCORED = ("relative_rms_force_error", "rms_force_error", "peak_force_error", "work_error")
#: responses that compare with the displacements of markers inside a specimen
MARKED = ("marker_error", "predicted_marker_error")
#: unit of every other response; constants are reported in kPa, exponents plain
RESPONSES = {
    "relative_rms_force_error": "%",
    "rms_force_error": "N",
    "peak_force_error": "N",
    "work_error": "%",
    **dict.fromkeys(MARKED, "mm"),
    "mu0": "kPa",
    "seconds": "s",
}


def response_unit(name: str) -> str | None:
    """Find the unit of a response: "" for a plain number, None if there is no such response."""
    if name in RESPONSES:
        return RESPONSES[name]
    if is_simulated(name):
        return SIMULATED[simulated_at(name)[0]]
    if not is_constant(name):
        return None
    return unit_shown(name)


def is_of_material(name: str) -> bool:
    """Whether a response is a constant of a material, or its initial shear modulus."""
    return name == "mu0" or is_constant(name)


#: kPa in one MPa: a fit is in MPa, a response in kPa
KPA = 1000.0


def residual_N(predicted: Curve, measured: Curve) -> Array:  # noqa: N802
    """Predicted less measured force at the n measured points, N, shape (n,)."""
    return predicted.force_at(measured.displacement_mm) - measured.force_N


def rms_force_error(predicted: Curve, measured: Curve) -> float:
    """Root mean square of the difference in force over the measured points, N."""
    return float(np.sqrt(np.mean(residual_N(predicted, measured) ** 2)))


def relative_rms_force_error(predicted: Curve, measured: Curve) -> float:
    """RMS of the difference over the RMS of the measured force, %."""
    scale = float(np.sqrt(np.mean(measured.force_N**2)))
    return 100 * rms_force_error(predicted, measured) / scale


def peak_force_error(predicted: Curve, measured: Curve) -> float:
    """Absolute difference of the largest forces, N."""
    forces = predicted.force_at(measured.displacement_mm)
    return float(abs(forces.max() - measured.force_N.max()))


def work_error(predicted: Curve, measured: Curve) -> float:
    """Absolute difference of the work over the measured range, over the measured work, %."""
    d = measured.displacement_mm
    measured_work = float(np.trapezoid(measured.force_N, d))
    return 100 * abs(float(np.trapezoid(residual_N(predicted, measured), d)) / measured_work)


#: responses of a predicted and a measured curve, by name; every record holds them all
CURVE_RESPONSES: Mapping[str, Callable[[Curve, Curve], float]] = {
    "relative_rms_force_error": relative_rms_force_error,
    "rms_force_error": rms_force_error,
    "peak_force_error": peak_force_error,
    "work_error": work_error,
}
#: points of a curve that integrals over it take, between the solved steps by their tangents: the
#: trapezoidal rule is then off by a millionth of the work, for a force that grows with the square
#: of the displacement
_POINTS = 400


def even_places(curve: Curve) -> Array:
    """Displacements that divide a curve evenly, mm, so close that its load steps do not matter."""
    return np.linspace(0.0, float(curve.displacement_mm[-1]), _POINTS + 1)


def work(curve: Curve) -> float:
    """Work done on the specimen, N mm."""
    places = even_places(curve)
    return float(np.trapezoid(curve.force_at(places), places))


def simulated(response: str, curve: Curve) -> float:
    """Value of a response of a predicted curve alone; one at a displacement has it in its name."""
    name, displacement_mm = simulated_at(response)
    if displacement_mm is not None:
        ordinate = curve.stiffness_at if name == "stiffness_at" else curve.force_at
        return float(ordinate(displacement_mm))
    if name == "peak_force":
        return float(curve.force_N.max())
    if name == "work":
        return work(curve) if curve.work_Nmm is None else float(curve.work_Nmm[-1])
    # the largest value over the test of what finite elements say of plate or indenter, and of the
    # base; another program or a closed form gives none
    return float(np.max(curve.quantities.get(name, np.full(1, np.nan))))


def units_of(named: Iterable[str], measured: bool = True) -> dict[str, str]:
    """Units of all responses that the records of a study hold, those not asked for too."""
    every = (*(CURVE_RESPONSES if measured else ()), "mu0", *named)
    return {name: response_unit(name) or "" for name in every}


def scale_of(constant: str) -> float:
    """Factor from MPa to the unit in which a constant is reported; 1 for one that is no modulus."""
    return KPA if response_unit(constant) == "kPa" else 1.0


def in_shown_units(constants: Sequence[str], values: Array) -> dict[str, object]:
    """Numbers of every constant in the unit in which it is reported; values (p,) or (p, k), MPa."""
    pairs = zip(constants, values, strict=True)
    return {name: (scale_of(name) * value).tolist() for name, value in pairs}


def score(
    predicted: Curve, measured: Curve | None = None, names: Iterable[str] = ()
) -> dict[str, ResponseDocument]:
    """Every response that a predicted curve has, with its unit."""
    values = {name: simulated(name, predicted) for name in of_prediction(names)}
    if measured is not None:
        values |= {name: of(predicted, measured) for name, of in CURVE_RESPONSES.items()}
    units = units_of(values)
    return {name: {"value": value, "unit": units[name]} for name, value in values.items()}


def of_prediction(names: Iterable[str]) -> list[str]:
    """Those responses asked for that a predicted curve alone gives."""
    return [name for name in names if is_simulated(name) and name != "dofs"]


def constants_of(constants: Mapping[str, float], mu0: float | None) -> dict[str, ResponseDocument]:
    """List the initial shear modulus and every constant: moduli in kPa, others as they are."""
    shown: dict[str, ResponseDocument] = {
        name: {"value": scale_of(name) * float(value), "unit": response_unit(name) or ""}
        for name, value in constants.items()
    }
    if mu0 is None:
        return shown
    return {"mu0": {"value": KPA * mu0, "unit": RESPONSES["mu0"]}, **shown}


def averaged(scores: Sequence[Mapping[str, ResponseDocument]]) -> dict[str, ResponseDocument]:
    """Mean over the directions, with units; a mean that is not finite is None."""
    out: dict[str, ResponseDocument] = {}
    for name, first in scores[0].items():
        numbers = [score[name]["value"] for score in scores if name in score]
        mean = float(np.mean(np.array(numbers, dtype=float)))
        out[name] = {"value": mean if np.isfinite(mean) else None, "unit": first["unit"]}
    return out


def step_uncertainty(
    predicted: Curve, measured: Curve | None, names: Iterable[str] = (), *, is_splined: bool = False
) -> dict[str, float]:
    """Change of every response where the curve keeps every other load step only.

    The steps that are left out are twice as many as were solved; what is left of their effect in
    the response itself is a part of this change, since the interpolation between two steps gets
    better by more than twice when they are halved. Zero where the force is known everywhere
    (closed form), and nothing where one step is all there is. Another program solves with load
    steps of its own, which are not ours to halve: of its curve, whose tangents are a spline's, what
    lies between the displacements that it was asked for is.
    """
    alone = of_prediction(names)
    compared = CURVE_RESPONSES if measured is not None else {}
    if is_splined:
        compared, rough = {}, predicted.every_other_point()
        rough = replace(rough, stiffness_N_per_mm=None, work_Nmm=None).with_tangents()
        if rough.stiffness_N_per_mm is None:
            return {}
    elif predicted.stiffness_N_per_mm is None:
        return dict.fromkeys([*compared, *alone], 0.0)
    elif len(predicted) < 2:
        return {}
    else:
        rough = predicted.every_other_point()
    scatter = {name: abs(simulated(name, predicted) - simulated(name, rough)) for name in alone}
    if measured is None:
        return scatter
    return scatter | {
        name: abs(of(predicted, measured) - of(rough, measured)) for name, of in compared.items()
    }
