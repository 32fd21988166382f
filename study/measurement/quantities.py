"""Columns of a measured test: displacement and force, or measures of strain and stress.

A curve is force over displacement. What was recorded as stretch, strain or stress becomes that of a
gauge section of known length and area: displacement is the elongation (or offset) in the sense
of the test, force is nominal stress times the reference area. True stress becomes nominal at
constant volume, sigma / l, as rubber and soft tissue are evaluated (Treloar 1975, ch. 5).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from study.arrays import Array
from study.errors import Fault, InputError

#: columns that say how far the specimen was deformed, and their dimension
KINEMATIC: Mapping[str, str] = {
    "displacement": "length",
    "stretch": "ratio",
    "strain": "ratio",
    "true_strain": "ratio",
    "volume_ratio": "ratio",
}

#: columns that say how it resisted
KINETIC: Mapping[str, str] = {
    "force": "force",
    "stress": "pressure",
    "true_stress": "pressure",
    "pressure": "pressure",
}

#: modes of loading in which a column has a meaning; all where it is not listed
_MODES: Mapping[str, tuple[str, ...]] = {
    "stretch": ("uniaxial", "equibiaxial", "planar", "confined", "volumetric"),
    "true_strain": ("uniaxial", "equibiaxial", "planar", "confined", "volumetric"),
    "volume_ratio": ("confined", "volumetric"),
    "true_stress": ("uniaxial", "equibiaxial", "planar", "confined", "simple-shear"),
    "pressure": ("volumetric",),
}

_TO_STRETCH: Mapping[str, Callable[[Array], Array]] = {
    "stretch": lambda value: value,
    "strain": lambda value: 1 + value,
    "true_strain": np.exp,
}


@dataclass(frozen=True)
class Gauge:
    """What turns stretch and stress into displacement and force.

    Parameters
    ----------
    area_mm2, length_mm : float
        Of the specimen before the test.
    mode : str
        Deformation, one of :data:`study.material.loading.LOADINGS`.
    sense : float
        Elongation per displacement: -1 where the test shortens.
    is_homogeneous : bool
        Whether the specimen deforms the same everywhere, so that it has one stretch.
    """

    area_mm2: float
    length_mm: float
    mode: str
    sense: float
    is_homogeneous: bool


def displacement_and_force(
    kinematic: str,
    deformed: Array,
    kinetic: str,
    resisted: Array,
    gauge: Gauge | None,
    where: str,
    *,
    in_order: bool = False,
) -> tuple[Array, Array]:
    """Curve of a test as it was recorded.

    Parameters
    ----------
    kinematic, kinetic : str
        Names of the columns, of :data:`KINEMATIC` and :data:`KINETIC`.
    deformed, resisted : ndarray, shape (rows,)
        Their values in mm or plain, and in N or MPa.
    gauge : Gauge, optional
        Needed where they are not displacement and force.
    where : str
        Name of the table, for messages.
    in_order : bool
        Whether the rows are those of a course in time, which stay as they are.

    Returns
    -------
    displacement_mm, force_N : ndarray, shape (rows,)
        Rows of a simple shear to the left are turned to the right, unless they are a course:
        its law is odd.

    Raises
    ------
    InputError
        If a column has no meaning in this test.
    """
    if kinematic == "displacement" and kinetic == "force":
        return deformed, resisted
    known = _checked(kinematic, kinetic, gauge, where)
    if known.mode == "simple-shear":
        shear = deformed / known.length_mm if kinematic == "displacement" else deformed
        force = resisted if kinetic == "force" else known.area_mm2 * resisted
        turned = np.where(shear < 0, -1.0, 1.0)
        if in_order or (turned > 0).all():
            return shear * known.length_mm, force
        order = np.argsort(np.abs(shear), kind="stable")
        return np.abs(shear)[order] * known.length_mm, (turned * force)[order]
    stretch = _stretch(kinematic, deformed, known)
    if not (stretch > 0).all():
        rule = f"{kinematic} of {deformed[np.argmin(stretch)]:g} leaves nothing of the specimen"
        raise InputError(Fault(where, rule, "check the column and measurements.units"))
    elongation = known.sense * (stretch - 1) * known.length_mm
    displacement = deformed if kinematic == "displacement" else elongation
    return displacement, _force(kinetic, resisted, stretch, known)


def _checked(kinematic: str, kinetic: str, gauge: Gauge | None, where: str) -> Gauge:
    if gauge is None or not gauge.is_homogeneous:
        rule = f"{kinematic} and {kinetic} are those of a specimen that deforms the same everywhere"
        mend = "give displacement and force, or a test without bonded faces"
        raise InputError(Fault(where, rule, mend))
    for column in (kinematic, kinetic):
        modes = _MODES.get(column, (gauge.mode,))
        if gauge.mode not in modes:
            rule = f"a column {column} has no meaning in {gauge.mode} loading"
            raise InputError(Fault(where, rule, f"it belongs to {', '.join(modes)}"))
    return gauge


def _stretch(kinematic: str, values: Array, gauge: Gauge) -> Array:
    if kinematic == "displacement":
        return np.asarray(1 + gauge.sense * values / gauge.length_mm)
    if kinematic == "volume_ratio":
        return np.asarray(values if gauge.mode == "confined" else np.cbrt(values))
    return np.asarray(_TO_STRETCH[kinematic](values))


def _force(kinetic: str, values: Array, stretch: Array, gauge: Gauge) -> Array:
    if kinetic == "force":
        return values
    if kinetic == "pressure":  # on faces whose area shrinks with l^2
        return np.asarray(gauge.area_mm2 * values * stretch**2)
    if kinetic == "true_stress" and gauge.mode != "confined":
        return np.asarray(gauge.area_mm2 * values / stretch)
    return np.asarray(gauge.area_mm2 * values)
