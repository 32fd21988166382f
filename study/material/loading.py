"""Nominal stress of a homogeneous specimen in every loading that a measured test may have.

A loading is a function of one measure: the stretch of the loaded direction, or the amount of
shear. Where K is finite the free stretch is solved (:mod:`study.material.homogeneous`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from study.arrays import Array
from study.errors import Fault, InputError
from study.material.energy import CompressibleEnergy
from study.material.homogeneous import CONFINED, EQUIBIAXIAL, PLANAR, UNIAXIAL, Mode, response
from study.material.material import Material
from study.material.stress import first_piola_gradient


@dataclass(frozen=True)
class Loaded:
    """Nominal stress of one loading.

    Parameters
    ----------
    stress : ndarray, shape (n,)
        Over the reference area, MPa; tension is positive. NaN where there is none.
    gradient : mapping of str to ndarray, shape (n,)
        Total derivative with respect to every constant.
    """

    stress: Array
    gradient: Mapping[str, Array]


@dataclass(frozen=True)
class Loading:
    """One way to deform a homogeneous specimen.

    Parameters
    ----------
    nominal : callable
        Material and measure, shape (n,), to :class:`Loaded`.
    is_shear : bool
        Whether the measure is the amount of shear, zero at rest, and not a stretch.
    mode : Mode or None
        Principal mode, for stability; None where a principal mode does not describe it.
    is_volumetric : bool
        Whether the specimen resists with its volume, so that an incompressible one is rigid.
    """

    nominal: Callable[[Material, Array], Loaded]
    is_shear: bool = False
    mode: Mode | None = None
    is_volumetric: bool = False

    def measure(self, share: Array) -> Array:
        """Stretch or shear of an elongation (or offset) over the length of the specimen."""
        return share if self.is_shear else 1.0 + share


def _principal(mode: Mode, *, is_volumetric: bool = False) -> Loading:
    def nominal(material: Material, stretch: Array) -> Loaded:
        state = response(material, mode, stretch)
        return Loaded(state.stress, state.gradient)

    return Loading(nominal, mode=mode, is_volumetric=is_volumetric)


def _simple_shear(material: Material, shear: Array, prestretch: float = 1.0) -> Loaded:
    """Shear stress; the volume is kept, so that K does not enter.

    A specimen may have been stretched along the normal of its sheared faces before: F is then
    shear e1 e2 + prestretch e2 e2 + (e1 e1 + e3 e3) / sqrt(prestretch) (Budday and others 2017).
    """
    if material.compressible is not None and prestretch != 1:
        rule = "has a free stretch of its own, and a sheared specimen keeps its volume here"
        raise InputError(Fault("test.prestretch", rule, "leave it out, or take another energy"))
    F = np.zeros((3, 3, shear.size))
    F[[0, 2], [0, 2]], F[1, 1], F[0, 1] = 1 / math.sqrt(prestretch), prestretch, shear
    with np.errstate(all="ignore"):  # constants of a fit may overflow: NaN says so
        gradient = first_piola_gradient(material, F)
    return Loaded(
        _sheared(material, shear, prestretch),
        {name: slope[0, 1] for name, slope in gradient.items()},
    )


def _sheared(material: Material, shear: Array, prestretch: float) -> Array:
    """P_12 = shear (tau_1 - tau_3) / (l_1^2 - l_3^2), through the principal stretches.

    Without a pre-stretch these are l and 1/l with l - 1/l = shear.
    """
    if material.small_strain:
        return np.asarray(material.mu0 * shear)
    longest, across, shortest = sheared_stretches(shear, prestretch)
    bar = np.stack([longest, across, shortest])
    constants, foam = material.constants, material.compressible
    with np.errstate(all="ignore"):
        if foam is None:
            principal = material.isochoric.principal_stress(constants, bar)
        else:
            principal = foam.kirchhoff(constants, material.compressibility, bar)
    if prestretch == 1:  # shear / (l^2 - 1/l^2) = 1 / (l + 1/l), at rest too
        return np.asarray(np.sign(shear) * (principal[0] - principal[2]) / (longest + shortest))
    return np.asarray(shear * (principal[0] - principal[2]) / (longest**2 - shortest**2))


def sheared_stretches(shear: Array, prestretch: float = 1.0) -> tuple[Array, Array, Array]:
    """Principal stretches of a simple shear, the longest and shortest in its plane.

    Parameters
    ----------
    shear : ndarray, shape (n,)
        Offset over the length before the test.
    prestretch : float
        Stretch along the normal of the sheared faces before the test.

    Returns
    -------
    longest, across, shortest : ndarray, shape (n,)

    Examples
    --------
    >>> [round(float(one[0]), 6) for one in sheared_stretches(np.array([1.5]))]
    [2.0, 1.0, 0.5]
    """
    free = 1 / math.sqrt(prestretch)
    # (l_1 +- l_3)^2 = tr b +- 2 l_1 l_3
    both, apart = np.hypot(shear, prestretch + free), np.hypot(shear, prestretch - free)
    longest = 0.5 * (both + apart)
    return longest, np.full(shear.shape, free), prestretch * free / longest


def _volumetric(material: Material, stretch: Array) -> Loaded:
    """Equal stretches on all sides: P = K (J - 1) l^2, compression negative."""
    if material.incompressible:
        rule = "an incompressible material cannot change its volume"
        raise InputError(Fault("material", rule, "give poisson_ratio or bulk_modulus"))
    if (foam := material.compressible) is not None:
        return _swollen(material, foam, stretch)
    shape = (stretch**3 - 1) * stretch**2
    slopes = material.bulk_gradient()
    return Loaded(material.bulk * shape, {n: slopes[n] * shape for n in material.names})


def _swollen(material: Material, foam: CompressibleEnergy, stretch: Array) -> Loaded:
    """Equal stretches of an energy whose volume change belongs to all of it."""
    all_sides, volume = np.stack([stretch] * 3), material.compressibility
    tau = foam.kirchhoff(material.constants, volume, all_sides)[0]
    slopes = foam.kirchhoff_gradient(material.constants, volume, all_sides)
    return Loaded(tau / stretch, {name: slope[0] / stretch for name, slope in slopes.items()})


def loading_in(mode: str, prestretch: float | None = None) -> Loading:
    """Give the loading of a specimen that may be stretched before it is sheared.

    Parameters
    ----------
    mode : str
        One of :data:`LOADINGS`.
    prestretch : float, optional
        Of a simple shear.
    """
    if prestretch is None:
        return LOADINGS[mode]
    return Loading(partial(_simple_shear, prestretch=prestretch), is_shear=True)


#: every loading by its name
LOADINGS: Mapping[str, Loading] = {
    "uniaxial": _principal(UNIAXIAL),
    "equibiaxial": _principal(EQUIBIAXIAL),
    "planar": _principal(PLANAR),
    "confined": _principal(CONFINED, is_volumetric=True),
    "simple-shear": Loading(_simple_shear, is_shear=True),
    "volumetric": Loading(_volumetric, is_volumetric=True),
}
