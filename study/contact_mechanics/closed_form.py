"""Closed-form modulus of the indentations of one test: curves, limits, median, warnings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from study.contact_mechanics.curves import RecordedCurve, read_curves
from study.contact_mechanics.force_law import ForceLaw, force_law
from study.contact_mechanics.layer import Layer
from study.contact_mechanics.median import MedianEstimate, median_estimate
from study.contact_mechanics.modulus import CurveModulus, fit_modulus
from study.contact_mechanics.result import FittedCurve, IndentationModulus
from study.contact_mechanics.validity import Limit, caution, limits
from study.design.sections.calibration import Theory
from study.measurement.section import MeasurementSpec
from study.setup.geometry import Indenter

#: share by which the chosen support changes the force before it is said
_SAID = 0.01

#: deepest data over which the law is tabulated: contact may have begun before the recording
_DEEPER = 1.25


@dataclass(frozen=True)
class IndentationTest:
    """What the closed form needs to know of a test.

    Parameters
    ----------
    indenter : Flat, Cone or Sphere
        What is pressed in, without friction.
    layer : Layer
        Specimen on its base.
    area_mm2 : float
        Cross-section of the specimen.
    spec : MeasurementSpec
        Where its curves are.
    displacement_mm : float, optional
        Last displacement that is used.
    theory : {"integral-equation", "dimitriadis", "half-space"}
        How the support enters.
    paraboloid : bool
        Whether a sphere is taken for a paraboloid, as Hertz did.
    find_contact : bool
        Whether the displacement at contact is fitted.
    """

    indenter: Indenter
    layer: Layer
    area_mm2: float
    spec: MeasurementSpec
    displacement_mm: float | None = None
    theory: Theory = "integral-equation"
    paraboloid: bool = False
    find_contact: bool = False


def indentation_modulus(
    test: IndentationTest, root: Path, number: int = 0
) -> tuple[IndentationModulus, tuple[str, ...]]:
    """Young's modulus of every curve of a test and their median, and notes on the files.

    Parameters
    ----------
    test : IndentationTest
        The test.
    root : Path
        Data root.
    number : int
        Of its ``[[tests]]`` table.

    Raises
    ------
    InputError
        If a file is malformed or no curve is of any use.
    """
    height = test.layer.height_mm
    curves, notes = read_curves(test.spec, root, height, test.displacement_mm)
    deepest = max(float(c.displacement_mm[-1]) for c in curves if not c.fault)
    law = force_law(
        test.indenter, test.layer, _DEEPER * deepest, theory=test.theory, paraboloid=test.paraboloid
    )
    series = test.theory == "dimitriadis"
    found = limits(test.indenter, test.layer, law, area_mm2=test.area_mm2, is_series=series)
    fitted = tuple(FittedCurve(c.label, c.groups, _fitted(test, c, law, found)) for c in curves)
    units = _units(fitted, test.spec.block)
    result = IndentationModulus(
        test=number,
        file=str(test.spec.file or test.spec.files),
        indenter=test.indenter.shape,
        theory=test.theory,
        poisson_ratio=test.layer.poisson_ratio,
        height_mm=height,
        limits=found,
        curves=fitted,
        block=test.spec.block,
        unit_moduli_MPa=units,
        estimate=_estimate(fitted, units),
        warnings=tuple(_warnings(test, fitted, found, law, deepest)),
    )
    return result, notes


def _fitted(
    test: IndentationTest, curve: RecordedCurve, law: ForceLaw, found: Sequence[Limit]
) -> CurveModulus:
    if curve.fault:
        return CurveModulus("unreadable", curve.fault)
    return fit_modulus(
        curve.displacement_mm,
        curve.force_N,
        law,
        poisson_ratio=test.layer.poisson_ratio,
        deepest_mm=found[0].depth_mm,
        find_contact=test.find_contact,
    )


def _units(fitted: Sequence[FittedCurve], block: str | None) -> Mapping[str, float]:
    """Median modulus of every unit: curves of one specimen are repeats, not independent."""
    moduli: dict[str, list[float]] = {}
    for one in fitted:
        if one.found.modulus_MPa is not None:
            unit = one.label if block is None else one.groups[block]
            moduli.setdefault(unit, []).append(one.found.modulus_MPa)
    return {unit: float(np.median(values)) for unit, values in moduli.items()}


def _estimate(fitted: Sequence[FittedCurve], units: Mapping[str, float]) -> MedianEstimate | None:
    if not units:
        return None
    own = [one.found.interval_MPa for one in fitted if one.found.interval_MPa is not None]
    return median_estimate(list(units.values()), own[0] if len(own) == 1 else None)


def _warnings(
    test: IndentationTest,
    fitted: Sequence[FittedCurve],
    found: Sequence[Limit],
    law: ForceLaw,
    deepest_mm: float,
) -> list[str]:
    said = []
    rows = sum(one.found.rows for one in fitted)
    outside = sum(one.found.rows_outside for one in fitted)
    if outside:
        said.append(
            f"{100 * outside / rows:.3g} % of the rows in contact ({outside} of {rows}) lie deeper "
            f"than {found[0].depth_mm:.4g} mm ({found[0].what}) and are not fitted"
        )
    for status, count in Counter(one.found.status for one in fitted).items():
        if status != "fitted":
            first = next(one for one in fitted if one.found.status == status)
            said.append(f"{count} of {len(fitted)} curves are {status}: {first.label}: "
                        f"{first.found.message}")  # fmt: skip
    if words := caution(test.indenter):
        said.append(words)
    return [*said, *_support(test, law, min(found[0].depth_mm, deepest_mm))]


def _support(test: IndentationTest, law: ForceLaw, depth_mm: float) -> list[str]:
    """Say by how much another treatment of the support is off at the deepest row that counts."""
    if test.theory == "integral-equation" or depth_mm <= 0:
        return []
    depth = np.array([depth_mm])
    exact = force_law(test.indenter, test.layer, depth_mm, paraboloid=test.paraboloid)
    off = float(exact.force(depth)[0] / law.force(depth)[0]) - 1
    if abs(off) < _SAID:
        return []
    name = "the half-space" if test.theory == "half-space" else "Dimitriadis' series"
    return [
        f"at {depth_mm:.4g} mm the layer resists {100 * off:+.1f} % against {name}, and the "
        "modulus is off by up to as much: write theory = 'integral-equation'"
    ]
