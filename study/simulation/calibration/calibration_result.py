"""What a calibration found, in values and as the document of ``study calibrate --json``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from study.ground.canonical import Json, Keyed, plain
from study.ground.errors import Fault, InputError
from study.mechanics.calibration.lack_of_fit import Adequacy
from study.mechanics.material.input_file import Converted, convert
from study.mechanics.material.material import Material, unit_shown
from study.mechanics.measurement.phases import RowCount
from study.mechanics.setup.setup import Tables
from study.record.record import WITH_CONSTANTS, ParameterDocument
from study.simulation.calibration.measured_tests import FitCurve
from study.simulation.calibration.resampling import Starts
from study.simulation.job import status_of
from study.simulation.response import in_shown_units, scale_of

if TYPE_CHECKING:
    from study.mechanics.calibration.fit import Fit
    from study.mechanics.calibration.fit_influence import Population
    from study.mechanics.calibration.identifiability import Identifiability, LikelihoodProfile
    from study.mechanics.calibration.lack_of_fit import LackOfFit, ResidualPattern
    from study.mechanics.calibration.residual_function import NuisanceEstimate
    from study.simulation.calibration.optimal_tests import NextTests
    from study.simulation.calibration.resampling import Bootstrap


@dataclass(frozen=True)
class PartialFit:
    """Fit to a part of the data, and what it predicts of the rest."""

    #: The specimen fitted for itself, or what was left out.
    label: str
    #: In MPa.
    fit: Fit
    #: Its curves, those left out as ``held-out``.
    curves: tuple[FitCurve, ...]

    def as_dict(self) -> dict[str, object]:
        """Constants in kPa, and the errors of the curves."""
        return {
            "label": self.label,
            "status": status_of(self.fit),
            "message": self.fit.message,
            "parameters": parameters(self.fit),
            "nuisance": nuisance(self.fit),
            "rss": self.fit.rss,
            "identifiable": self.fit.identifiable,
            "curves": [curve.as_dict() for curve in self.curves],
        }


@dataclass(frozen=True)
class CalibrationResult(Keyed):
    """Constants of one material from all tests of a calibration."""

    KEYS = (
        "status message fit=adequacy model parameters=fit.names nuisance=fit.nuisance "
        "mu0=material shear_moduli=material rss=fit.rss minima r_squared=fit.r_squared "
        "aicc=fit.aicc n=fit.n rows=curves serial_correlation=fit.serial "
        "correlation=fit.correlation condition=fit.condition identifiable=fit.identifiable "
        "reason=fit.reason identifiability=identified next_test=next_tests.as_dict stable "
        "stability evaluations seconds curves lack_of_fit residual_pattern=pattern specimens "
        "same_constants_p population cross_validation profiles numerical numerics "
        "bootstrap starts warnings notes name tests"
    )

    #: Of the calibration and of the energy.
    name: str
    model: str
    #: ``converged``, ``at-edge``, ``at-kink``, ``not-converged``, ``implausible`` or ``unstable``,
    #: and why.
    status: str
    message: str
    #: Of :mod:`study.mechanics.calibration`; constants in MPa.
    fit: Fit
    #: With the constants found; None where they make no material.
    material: Material | None
    #: Drucker's criterion over the range of the measured tests, those held out too.
    stable: bool
    stability: str
    curves: tuple[FitCurve, ...]
    #: Calls of the model, those of the cheaper stage included.
    evaluations: int
    seconds: float
    #: Whether the model describes the data, beside the word of the optimizer.
    adequacy: Adequacy = field(default_factory=lambda: Adequacy("doubtful"))
    lack_of_fit: LackOfFit | None = None
    pattern: ResidualPattern | None = None
    #: Each specimen for itself; each specimen or test left out in turn.
    specimens: tuple[PartialFit, ...] = ()
    cross_validation: tuple[PartialFit, ...] = ()
    #: p of the hypothesis that all specimens share their constants.
    same_constants_p: float | None = None
    #: Each constant's mean, scatter and intervals, specimens as the unit.
    population: tuple[Population, ...] = ()
    profiles: Mapping[str, LikelihoodProfile] = field(default_factory=dict)
    #: Cautions, and what was done to the measured rows.
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    #: Resolved tables of every test (mm, N, MPa), so that what was fitted can be simulated again.
    tests: tuple[Mapping[str, Tables], ...] = ()
    #: What fits from other starts found, where asked.
    starts: Starts | None = None
    #: The fit and the minima that its rows cannot be told from.
    minima: tuple[Fit, ...] = ()
    #: What the tests know of the constants, in the units of their curves.
    identified: Identifiability | None = None
    #: Tests that could be made next, by what they would tell of the constants.
    next_tests: NextTests | None = None
    #: Document of how far meshes and load steps may move the constants, where asked.
    numerics: Mapping[str, object] | None = None
    #: The same from one coarser mesh, which the intervals hold; None without elements.
    numerical: Mapping[str, object] | None = None
    #: Intervals from resampled data, where asked.
    bootstrap: Bootstrap | None = None

    @property
    def converged(self) -> bool:
        """Whether the constants may be used, with their intervals."""
        return self.status == "converged"

    @property
    def usable(self) -> bool:
        """Whether there are constants, if without intervals, of a model that describes its data."""
        return self.status in WITH_CONSTANTS and self.adequacy.describes

    def converted(self, convention: str) -> Converted:
        """Constants in another code's convention."""
        if self.material is None:
            raise InputError(Fault("convention", "the fit found no material to convert"))
        return convert(self.material, convention)

    def to_json(self) -> dict[str, Json]:
        """Document of ``study calibrate --json``; moduli are in kPa, exponents plain."""
        fit = self.fit
        shown = {
            "parameters": parameters(fit),
            "nuisance": nuisance(fit),
            "mu0": None if self.material is None else 1e3 * self.material.mu0,
            "shear_moduli": _moduli(self.material),
            "minima": [
                {"parameters": in_shown_units(minimum.names, minimum.values), "rss": minimum.rss}
                for minimum in self.minima
            ],
            "rows": RowCount.sum_of(curve.measured.rows for curve in self.curves).as_dict(),
            "serial_correlation": _serial(fit),
            "identifiability": _identified(self.identified),
            "curves": [curve.as_dict() for curve in self.curves],
            "specimens": [specimen.as_dict() for specimen in self.specimens],
            "population": {
                constant.name: _population(constant, [part.label for part in self.specimens])
                for constant in self.population
            },
            "cross_validation": [part.as_dict() for part in self.cross_validation],
            "profiles": {
                name: {
                    **_scaled(profile, _scale(fit, name), "interval", "values"),
                    "rss": profile.rss,
                }
                for name, profile in self.profiles.items()
            },
        }
        document = {**self.keyed(), **shown}
        seldom = ("shear_moduli", "numerical", "numerics", "bootstrap", "starts")
        return plain({k: v for k, v in document.items() if v is not None or k not in seldom})


def _moduli(material: Material | None) -> dict[str, object] | None:
    """Shear moduli of a material that relaxes, kPa: of a load that comes at once, and of old."""
    if material is None or not material.relaxation:
        return None
    return {"instantaneous": 1e3 * material.mu0, "long_term": 1e3 * material.long_term_mu}


def parameters(fit: Fit) -> dict[str, ParameterDocument]:
    """Constants with errors and intervals by name: kPa, exponents plain. Units: fit MPa."""
    return {
        name: {
            "value": scale_of(name) * float(fit.values[i]),
            "unit": unit_shown(name),
            "standard_error": scale_of(name) * float(fit.standard_error[i]),
            "ci95": [scale_of(name) * float(v) for v in fit.ci95[i]],
        }
        for i, name in enumerate(fit.names)
    }


def _identified(identified: Identifiability | None) -> dict[str, object] | None:
    """Give combinations from the best known to the least, in kPa (exponents plain) and N."""
    if identified is None:
        return None
    return {
        "sentence": identified.sentence,
        "noise_N": identified.noise_N,
        "directions": [
            {
                "combination": direction.words,
                "coefficients": {
                    n: scale_of(first) / scale_of(n) * c for n, c in direction.combination.items()
                },
                "value": scale_of(first) * direction.value,
                "unit": unit_shown(first),
                "standard_error": scale_of(first) * direction.standard_error,
                "relative": direction.relative,
                "known": direction.is_known,
            }
            for direction in identified.directions
            for first in [next(iter(direction.combination))]
        ],
        "constants": {
            constant.name: {
                "known": constant.is_known,
                "alone_N": constant.alone_N,
                "refitted_N": constant.refitted_N,
            }
            for constant in identified.constants
        },
    }


def nuisance(fit: Fit) -> dict[str, dict[str, object]]:
    """Nuisance parameters by name, with errors, intervals, shares: mm, mm^2, N, kPa, deg, 1."""
    return {estimate.name: _nuisance(estimate) for estimate in fit.nuisance}


def _nuisance(estimate: NuisanceEstimate) -> dict[str, object]:
    unit, scale = _unit_of(estimate.key)
    meaning = "carried to the constants: the tests do not move it"
    if estimate.is_fitted:
        meaning = "a pseudo-observation: one more row of the fit, and no measurement"
    return {
        "treated": "fitted" if estimate.is_fitted else "propagated",
        "unit": unit,
        "expected": scale * estimate.expected,
        "uncertainty": None if estimate.uncertainty is None else scale * estimate.uncertainty,
        "prior": "none: found from the tests alone" if estimate.uncertainty is None else meaning,
        **_scaled(estimate, scale, "value", "standard_error", "ci95"),
        "shares": estimate.shares,
    }


def _unit_of(key: str) -> tuple[str, float]:
    """Give the unit of a nuisance parameter as it is shown, and the factor to it."""
    plain = {"displacement_offset": "mm", "force_zero": "N", "friction": ""}
    last = key.rpartition(".")[2]
    if last == "bulk_modulus":
        return "kPa", 1e3
    others = {"poisson_ratio": "", "area": "mm^2", "half_angle": "deg"}
    return plain.get(key, others.get(last, "mm")), 1.0


def _population(population: Population, labels: Sequence[str]) -> dict[str, object]:
    """Give one constant among specimens in kPa, exponents plain."""
    scale = scale_of(population.name)
    shrunk = zip(labels, population.shrunk, strict=False)
    return {
        "specimens": population.specimens,
        "unit": unit_shown(population.name),
        **_scaled(population, scale, "mean", "standard_deviation", "between", "mean_ci95"),
        "next_ci95": [scale * v for v in population.next_ci95],
        "shrunk": {label: scale * value for label, value in shrunk},
    }


def _scaled(value: object, scale: float, *names: str) -> dict[str, object]:
    """Sizes of a value, each a number or several, in the unit in which they are shown."""
    return {name: scale * np.asarray(getattr(value, name)) for name in names}


def _scale(fit: Fit, name: str) -> float:
    """Factor to the unit in which a constant or a nuisance parameter is shown."""
    if name in fit.names:
        return scale_of(name)
    return _unit_of(next(estimate.key for estimate in fit.nuisance if estimate.name == name))[1]


def _serial(fit: Fit) -> dict[str, object] | None:
    """Say what the correlation of recorded rows leaves of them; None without intervals."""
    if fit.serial is None:
        return None
    return {
        "rows": fit.serial.rows,
        "effective_rows": fit.serial.effective_rows,
        "correlation": fit.serial.correlation,
        "inflation": dict(zip(fit.names, fit.serial.inflation.tolist(), strict=True)),
    }
