"""Choice between energies: each is fitted to the same tests and weighed by AICc."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

from study.calibration.lack_of_fit import akaike_weights
from study.design.sections.calibration_design import CalibrationDesign
from study.errors import InputError
from study.record.record import plain
from study.runner.calibration.calibrate import calibrate
from study.runner.calibration.measured_tests import problem_of
from study.runner.calibration.result import CalibrationResult
from study.runner.fitting.staged_fit import Progress
from study.setup.section import with_table

#: energies compared: name, order, label
CANDIDATES = (
    ("neo-hookean", None, "neo-hookean"),
    ("mooney-rivlin", None, "mooney-rivlin"),
    ("reduced-polynomial", 2, "reduced-polynomial-2"),
    ("reduced-polynomial", 3, "reduced-polynomial-3"),
    ("ogden", 1, "ogden-1"),
    ("arruda-boyce", None, "arruda-boyce"),
    ("gent", None, "gent"),
    ("fung", None, "fung"),
    ("veronda-westmann", None, "veronda-westmann"),
    ("van-der-waals", None, "van-der-waals"),
    ("extended-tube", None, "extended-tube"),
)

#: compared besides where the sides are free to follow Poisson's ratio, in closed-form tests
FOAMS = (("ogden-hill", 1, "ogden-hill-1"), ("ogden-hill", 2, "ogden-hill-2"))


@dataclass(frozen=True)
class EnergyChoice:
    """Fits of several energies to the same tests.

    Parameters
    ----------
    fits : mapping of str to CalibrationResult
        By label, in the order of the candidates.
    weights : mapping of str to float
        Akaike weights of those that converged.
    failures : mapping of str to str
        Energies without an answer, and why.
    """

    fits: Mapping[str, CalibrationResult]
    weights: Mapping[str, float]
    failures: Mapping[str, str]

    @property
    def best(self) -> str | None:
        """Label of the energy with the smallest AICc; None where none converged."""
        return max(self.weights, key=self.weights.__getitem__) if self.weights else None

    @property
    def sentence(self) -> str:
        """The choice in words, with what it does not say."""
        if self.best is None:
            return "no energy could be fitted"
        found = self.fits[self.best]
        said = f"AICc prefers {self.best} (weight {self.weights[self.best]:.3g})"
        if not found.fit.identifiable:
            return f"{said}, but its constants are not identifiable: {found.fit.reason}"
        return f"{said}; it compares energies on these data only, not the constants' truth"

    def to_json(self) -> dict[str, object]:
        """Table of the energies."""
        best = min((f.fit.aicc for f in self.fits.values()), default=0.0)

        content = {
            "best": self.best,
            "sentence": self.sentence,
            "energies": [
                {
                    "energy": label,
                    "status": found.status,
                    "constants": len(found.fit.names),
                    "aicc": found.fit.aicc,
                    "delta_aicc": found.fit.aicc - best,
                    "weight": self.weights.get(label),
                    "rss": found.fit.rss,
                    "mu0": None if found.material is None else 1e3 * found.material.mu0,
                    "identifiable": found.fit.identifiable,
                    "reason": found.fit.reason,
                    "stable": found.stable,
                    "held_out": [
                        c.as_dict()["relative_rms_force_error"]
                        for c in found.curves
                        if c.role == "held-out"
                    ],
                }
                for label, found in self.fits.items()
            ],
            "failures": dict(self.failures),
        }
        return cast("dict[str, object]", plain(content, "energies", {}))


def choose(
    config: CalibrationDesign, root: Path, *, progress: Progress | None = None
) -> EnergyChoice:
    """Fit every candidate to the tests of a calibration.

    Parameters
    ----------
    config : CalibrationDesign
        The calibration; its material gives the compressibility.
    root : Path
        Data root.
    progress : callable, optional
        Gets every accepted iteration of every fit.

    Returns
    -------
    EnergyChoice
        An energy whose fit did not converge, or was refused, is among its ``failures``.
    """
    found: dict[str, CalibrationResult] = {}
    failures: dict[str, str] = {}
    for model, order, label in (*CANDIDATES, *(FOAMS if _may_be_foam(config) else ())):
        try:
            result = calibrate(_with_energy(config, model, order), root, progress=progress)
        except InputError as error:
            failures[label] = str(error)
            continue
        if result.converged:
            found[label] = result
        else:
            failures[label] = f"{result.status}: {result.message}"
    weights = akaike_weights({label: one.fit.aicc for label, one in found.items()})
    return EnergyChoice(found, weights, failures)


def _may_be_foam(config: CalibrationDesign) -> bool:
    """Whether Poisson's ratio is given and no test asks for elements, which foams lack."""
    problems = (problem_of(test.tables) for test in config.tests)
    compressible = config.material.compressibility.poisson_ratio is not None
    return compressible and all(one.method == "closed-form" for one in problems)


def _with_energy(config: CalibrationDesign, model: str, order: int | None) -> CalibrationDesign:
    """Make the same calibration of another energy; start, bounds and extra fits do not carry."""
    changes: dict[str, object] = {"model": model, "order": order, "constants": {}}
    tests = tuple(
        replace(test, tables=with_table(test.tables, "material", **changes))
        for test in config.tests
    )
    return CalibrationDesign(config.name, tests)
