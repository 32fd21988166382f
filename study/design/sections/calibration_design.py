"""A calibration file as a value: its measured tests, and how the constants are to be found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

from study.design.diagnostics import with_values
from study.design.sections.calibration import Bounds, Fitting
from study.design.sections.nuisance import NuisanceInput
from study.measurement.section import MeasurementSpec
from study.setup.material_section import MaterialSection
from study.setup.section import values_of
from study.setup.setup import Setup, Tables

Role = Literal["fit", "held-out"]


@dataclass(frozen=True)
class CalibratedTest:
    """One of the ``[[tests]]`` of a calibration.

    Parameters
    ----------
    tables : mapping
        Document of its problem, in mm, N, MPa and deg: what is hashed and sent to a worker.
    measurements : MeasurementSpec
        Where its measured curves are.
    role : {"fit", "held-out"}
        Whether its curves enter the fit, or are only predicted.
    weight : float or str
        Factor on its residuals; ``"equal"``, or ``"scatter"`` for one over the standard error.
    nuisance : mapping of str to NuisanceInput
        What is not known exactly of it, by key.
    """

    tables: Tables
    measurements: MeasurementSpec
    role: Role = "fit"
    weight: float | str = "equal"
    nuisance: Mapping[str, NuisanceInput] = field(default_factory=dict)

    @cached_property
    def setup(self) -> Setup:
        """Specimen, test and discretization."""
        return Setup.of(self.tables)

    @property
    def file(self) -> str:
        """Its measured file, or the pattern of its files."""
        return str(self.measurements.file or self.measurements.files)


@dataclass(frozen=True)
class CalibrationDesign:
    """One material that is fitted to measured tests.

    Parameters
    ----------
    name : str
        Of the calibration: that of its folder of results.
    tests : tuple of CalibratedTest
        In the order of the file; all have the same material.
    asked : Fitting
        How the constants are to be found.
    bounds : mapping of str to (float, float)
        Least and largest value of a constant, MPa, exponents plain.
    """

    name: str
    tests: tuple[CalibratedTest, ...]
    asked: Fitting = field(default_factory=Fitting)
    bounds: Bounds = field(default_factory=dict)

    @cached_property
    def material(self) -> MaterialSection:
        """Energy of all tests, and the constants to start from where the file gives them."""
        return MaterialSection.of(self.tests[0].tables)

    @property
    def document(self) -> dict[str, object]:
        """How the constants are to be found, as plain values for a hash."""
        return {**values_of(self.asked), "bounds": dict(self.bounds)}

    def pooled(self) -> CalibrationDesign:
        """Copy of which nothing but the constants of all specimens together is asked."""
        return replace(self, asked=with_values(self.asked, specimens="pooled", leave_out=None))
