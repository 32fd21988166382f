"""Moduli of the curves of a test, gathered by unit, and what is wrong with them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass

from study.contact_mechanics.median import MedianEstimate
from study.contact_mechanics.modulus import CurveModulus
from study.contact_mechanics.validity import Limit


@dataclass(frozen=True)
class FittedCurve:
    """Modulus of one curve.

    Parameters
    ----------
    label : str
        File and labels.
    groups : mapping of str to str
        Label of every grouping column.
    found : CurveModulus
        What was fitted.
    """

    label: str
    groups: Mapping[str, str]
    found: CurveModulus

    def to_json(self) -> dict[str, object]:
        """Plain values, moduli in kPa."""
        found = asdict(self.found)
        low_high = found.pop("interval_MPa")
        return {
            "label": self.label,
            "groups": dict(self.groups),
            "modulus_kPa": _kilo(found.pop("modulus_MPa")),
            "standard_error_kPa": _kilo(found.pop("error_MPa")),
            "ci95_kPa": None if low_high is None else [_kilo(v) for v in low_high],
            **found,
        }


@dataclass(frozen=True)
class IndentationModulus:
    """Modulus of one test of a calibration file in closed form.

    Parameters
    ----------
    test : int
        Number of its ``[[tests]]`` table.
    file : str
        Its measurements.
    indenter, theory : str
        What was pressed in, and how the support enters.
    poisson_ratio, height_mm : float
        Of the specimen.
    limits : tuple of Limit
        Depths at which assumptions end, the least first.
    curves : tuple of FittedCurve
        All of them.
    block : str, optional
        Column of the units; every curve is one where it is None.
    unit_moduli_MPa : mapping of str to float
        Median of the curves of every unit.
    estimate : MedianEstimate or None
        Median over units; None where no curve could be fitted.
    warnings : tuple of str
        What a reader must know.
    """

    test: int
    file: str
    indenter: str
    theory: str
    poisson_ratio: float
    height_mm: float
    limits: tuple[Limit, ...]
    curves: tuple[FittedCurve, ...]
    block: str | None
    unit_moduli_MPa: Mapping[str, float]
    estimate: MedianEstimate | None
    warnings: tuple[str, ...]

    @property
    def rows(self) -> int:
        """Rows in contact."""
        return sum(one.found.rows for one in self.curves)

    @property
    def rows_outside(self) -> int:
        """Rows beyond a limit, which no fit uses."""
        return sum(one.found.rows_outside for one in self.curves)

    @property
    def fitted(self) -> int:
        """Curves that have a modulus."""
        return sum(one.found.status == "fitted" for one in self.curves)

    def to_json(self) -> dict[str, object]:
        """Plain values, moduli in kPa."""
        return {
            "test": self.test,
            "file": self.file,
            "indenter": self.indenter,
            "theory": self.theory,
            "poisson_ratio": self.poisson_ratio,
            "height_mm": self.height_mm,
            "limits": [one.to_json() for one in self.limits],
            "youngs_modulus": self._estimate(1.0),
            "shear_modulus": self._estimate(1 / (2 * (1 + self.poisson_ratio))),
            "block": self.block,
            "units": {k: _kilo(v) for k, v in self.unit_moduli_MPa.items()},
            "curves_read": len(self.curves),
            "curves_fitted": self.fitted,
            "rows": self.rows,
            "rows_outside": self.rows_outside,
            "curves": [one.to_json() for one in self.curves],
            "warnings": list(self.warnings),
        }

    def _estimate(self, factor: float) -> dict[str, object] | None:
        found = self.estimate
        if found is None:
            return None
        interval = found.interval_MPa
        return {
            "median_kPa": _kilo(factor * found.value_MPa),
            "ci95_kPa": None if interval is None else [_kilo(factor * v) for v in interval],
            "interval": found.kind,
            "units": found.units,
            "quartiles_kPa": [_kilo(factor * v) for v in found.quartiles_MPa],
        }


@dataclass(frozen=True)
class AnalyticCalibration:
    """What ``study calibrate --method analytic`` found.

    Parameters
    ----------
    name : str
        Of the calibration.
    tests : tuple of IndentationModulus
        One for every ``[[tests]]`` table.
    notes : tuple of str
        What was done to the files.
    seconds : float
        Time that reading and fitting took.
    """

    name: str
    tests: tuple[IndentationModulus, ...]
    notes: tuple[str, ...]
    seconds: float

    @property
    def is_complete(self) -> bool:
        """Whether every test has a modulus."""
        return all(one.estimate is not None for one in self.tests)

    def to_json(self) -> dict[str, object]:
        """Document of ``study calibrate --method analytic --json``."""
        return {
            "name": self.name,
            "method": "analytic",
            "tests": [one.to_json() for one in self.tests],
            "notes": list(self.notes),
            "seconds": self.seconds,
        }


def _kilo(value_MPa: float | None) -> float | None:
    return None if value_MPa is None else 1e3 * value_MPa
