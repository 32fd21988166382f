"""Whether a material is stable: Drucker's criterion, surface instability, plausible constants.

Drucker: the incompressible tangent between principal Kirchhoff stresses and logarithmic
strains, ``D_ij = H_ij - H_i3 - H_3j + H_33`` with ``H = d2W / dln l_i dln l_j`` and
i, j = 1, 2, must be positive definite along uniaxial, equibiaxial and planar loading (the
check that Abaqus prints; Abaqus Theory Guide, hyperelastic stability). Of a foam it is H itself,
with the volume change that its free sides allow.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from study.ground.arrays import Array, Flags
from study.ground.errors import Fault, InputError
from study.mechanics.material.energy import CompressibleEnergy, Energy, IsochoricEnergy
from study.mechanics.material.homogeneous import EQUIBIAXIAL, PLANAR, UNIAXIAL, Mode, response
from study.mechanics.material.material import Material
from study.mechanics.material.relaxation import unphysical

#: stretches judged where the caller has no range of its own
USUAL_STRETCHES = np.linspace(0.5, 2.0, 151)
#: real root of x^3 + x^2 + 3x = 1, the surface wave condition of Biot (1963)
BIOT_ROOT = 0.29559774252208477
#: compression at which the free surface of a neo-Hookean half-space creases or wrinkles (V45)
BIOT_LIMITS: Mapping[str, float] = {
    "planar": BIOT_ROOT ** (1 / 2),
    "equibiaxial": BIOT_ROOT ** (1 / 3),
    "uniaxial": BIOT_ROOT ** (2 / 3),
}
#: initial shear moduli of soft tissue and silicone, MPa; outside, a unit is probably wrong
PLAUSIBLE_MU0 = (1e-4, 10.0)


@dataclass(frozen=True)
class StabilityResult:
    """Verdict on a range of stretches."""

    #: Whether Drucker's criterion holds in every mode on the whole range.
    stable: bool
    #: Names the mode and the stretch where it first fails.
    sentence: str
    #: Mode -> the unstable stretch nearest to 1, for the modes that fail.
    limits: Mapping[str, float]


def stable_in(mode: Mode, material: Material, stretches: ArrayLike) -> bool:
    """Whether Drucker's criterion holds in one mode."""
    given = np.append(np.asarray(stretches, float).ravel(), 1.0)
    return _limit(material, mode, float(given.min()), float(given.max())) is None


def stability(
    material: Material,
    stretches: ArrayLike = USUAL_STRETCHES,
    held: Mapping[str, tuple[float, float]] | None = None,
) -> StabilityResult:
    """Check Drucker's criterion in uniaxial, equibiaxial and planar loading.

    ``held`` are the least and the largest stretch of loadings that have a range of their own.
    """
    given = np.append(np.asarray(stretches, float).ravel(), 1.0)
    usual = (float(given.min()), float(given.max()))
    if material.small_strain:
        return StabilityResult(True, "stable: small strain, positive modulus", {})
    energy, limits, parts = material.energy, {}, []
    ranges = {m.name: (held or {}).get(m.name, usual) for m in (UNIAXIAL, EQUIBIAXIAL, PLANAR)}
    proven = isinstance(energy, IsochoricEnergy) and energy.always_stable(material.constants)
    for mode in () if proven else (UNIAXIAL, EQUIBIAXIAL, PLANAR):
        low, high = ranges[mode.name]
        limit = _limit(material, mode, min(low, 1.0), max(high, 1.0))
        if limit is not None:
            limits[mode.name] = limit
            parts.append(_failure(material, mode, limit))
    if limits:
        return StabilityResult(False, "unstable (Drucker) " + ", ".join(parts), limits)
    where = {name: f"from stretch {low:.4g} to {high:.4g}" for name, (low, high) in ranges.items()}
    if len(set(where.values())) == 1:
        alike = f"uniaxial, equibiaxial and planar loading {where[UNIAXIAL.name]}"
        return StabilityResult(True, f"stable in {alike}", {})
    listed = ", ".join(f"{name} loading {words}" for name, words in where.items())
    return StabilityResult(True, f"stable in {listed}", {})


def tangent(material: Material, mode: Mode, stretch: ArrayLike) -> Array:
    """Incompressible tangent D along a loading mode, MPa, shape (2, 2, n). Shapes: stretch (n,)."""
    x = np.log(np.atleast_1d(np.asarray(stretch, float)))
    a, v = np.array(mode.loaded, float), np.array(mode.free, float)
    bar = np.exp(a[:, None] * x - v[:, None] * x * a.sum() / v.sum())
    with np.errstate(all="ignore"):
        hessian = material.isochoric.principal_stress_slope(material.constants, bar, np.eye(3))
    d = hessian[:2, :2] - hessian[:2, 2:] - hessian[2:, :2] + hessian[2:, 2:]
    return np.asarray(d)


def check(
    material: Material, stretches: ArrayLike | None = None, where: str = "material"
) -> tuple[str, ...]:
    """Refuse constants that a user must not give; warn about implausible ones."""
    faults = []
    if not material.mu0 > 0:
        rule = f"the initial shear modulus must be positive, got {1e3 * material.mu0:g} kPa"
        mend = f"mu0 = {material.energy.shear_modulus_formula}"
        faults.append(Fault(where, rule, mend))
    for name, rule in material.energy.forbidden(material.constants).items():
        faults.append(Fault(f"{where}.{name}", rule))
    faults += unphysical(material.relaxation, f"{where}.relaxation")
    if not faults and stretches is not None:
        verdict = stability(material, stretches)
        if not verdict.stable:
            faults.append(Fault(where, verdict.sentence, "give constants stable on this range"))
    if faults:
        raise InputError(faults)
    low, high = PLAUSIBLE_MU0
    if not low <= material.mu0 <= high:
        return (
            f"{where}: an initial shear modulus of {1e3 * material.mu0:.4g} kPa is outside "
            f"{1e3 * low:g} to {1e3 * high:g} kPa of soft tissue and silicone: check the units",
        )
    return ()


def surface_warning(energy: Energy, mode: str, stretch: float) -> str:
    """Sentence if a compression goes beyond Biot's surface instability; empty otherwise."""
    limit = BIOT_LIMITS.get(mode, 0.0)
    if energy.small_strain or stretch >= limit:
        return ""
    return (
        f"beyond stretch {limit:.4f} in {mode} compression the free surface of a neo-Hookean "
        f"body is unstable (Biot 1963), got {stretch:.4f}: the computed state may not be the one "
        "that is seen"
    )


def _failure(material: Material, mode: Mode, limit: float) -> str:
    if limit == 1:
        return f"in {mode.name} loading from the start"
    side = "below" if limit < 1 else "above"
    splits = material.compressible is None
    ends = splits and np.isnan(tangent(material, mode, limit)).any()
    why = ", where its chains end" if ends else ""
    return f"in {mode.name} loading {side} stretch {limit:.4f}{why}"


def _limit(material: Material, mode: Mode, low: float, high: float) -> float | None:
    """Unstable stretch nearest to 1, by a scan outward and in between; None if there is none."""
    paths = [np.geomspace(1.0, end, 201) for end in (low, high) if end != 1] or [np.ones(1)]
    stable = np.split(_stable(material, mode, np.concatenate(paths)), len(paths))
    if not stable[0][0]:
        return 1.0
    limits = []
    for path, good in zip(paths, stable, strict=True):
        bad = np.flatnonzero(~good)
        if bad.size:
            limits.append(_first_unstable(material, mode, path[bad[0] - 1], path[bad[0]]))
    return min(limits, key=lambda s: abs(np.log(s))) if limits else None


def _first_unstable(material: Material, mode: Mode, good: float, bad: float) -> float:
    """Narrow the place where a mode becomes unstable down to neighboring numbers."""
    # Many places at once cost as much as one, and divide the interval by as many.
    for _ in range(9):  # 64^9 = 2^54: more than the digits of a number
        places = np.linspace(good, bad, 65)
        first = int(np.argmin(np.append(_stable(material, mode, places[1:-1]), False))) + 1
        good, bad = places[first - 1], places[first]
    return float(bad)


def _stable(material: Material, mode: Mode, stretch: Array) -> Flags:
    if material.compressible is not None:
        return _stable_in_volume(material, material.compressible, mode, stretch)
    d = tangent(material, mode, stretch)
    determinant = d[0, 0] * d[1, 1] - d[0, 1] * d[1, 0]
    return np.asarray((d[0, 0] + d[1, 1] > 0) & (determinant > 0))


def _stable_in_volume(
    material: Material, energy: CompressibleEnergy, mode: Mode, stretch: Array
) -> Flags:
    """Whether dtau . dln l is positive for every change, volume included (Abaqus' hyperfoam)."""
    free = response(material, mode, stretch).free_stretch
    a, v = np.array(mode.loaded, float), np.array(mode.free, float)
    sides = stretch ** a[:, None] * free ** v[:, None]
    with np.errstate(all="ignore"):
        slopes = [
            energy.kirchhoff_slope(material.constants, material.compressibility, sides, unit)
            for unit in np.eye(3)
        ]
    hessian = np.moveaxis(np.array(slopes), -1, 0)
    is_finite = np.asarray(np.isfinite(hessian).all(axis=(1, 2)))
    values = np.linalg.eigvalsh(np.where(is_finite[:, None, None], hessian, 0.0))
    return np.asarray(is_finite & (values[:, 0] > 0))


# Where an energy loses its ellipticity: deformation may then gather in bands of no width.
# An incompressible isotropic material is strongly elliptic in the plane of two principal
# stretches l1, l2 where ``alpha > 0`` and ``beta > -sqrt(alpha gamma)`` (Dowaikh and Ogden 1990,
# IMA J. Appl. Math. 44, 261, eqs. 2.14 to 2.18), with
#     alpha = l1^2 (t1 - t2) / (l1^2 - l2^2),    gamma = alpha l2^2 / l1^2,
#     2 beta = h11 - t1 + h22 - t2 - 2 h12 + 2 (l1^2 t2 - l2^2 t1) / (l1^2 - l2^2),
# ``t = dW / dln l`` and ``h = d2W / dln l dln l``. A common pressure drops out. Past that point
# an answer depends on the mesh, and no finer one mends it. Ogden's terms with exponents of one
# and more never get there; Hencky's quadratic logarithm, which an exponent of zero is, does at a
# ratio of stretches of 11.

#: equal stretches are taken this far apart (relative), where the formulas have their limit
_APART = 1e-4


def always_elliptic(material: Material) -> bool:
    """Whether an energy is known to keep its ellipticity at every stretch; False says nothing."""
    return material.small_strain or material.isochoric.always_elliptic(material.constants)


def ellipticity(material: Material, stretches: Array) -> Array:
    """How far from losing its ellipticity an energy is, in the worst of the principal planes.

    Shapes: stretches (3, n); returns (n,), MPa.
    """
    bar = _apart(stretches / np.cbrt(stretches.prod(axis=0)))
    energy, constants = material.isochoric, material.constants
    t = energy.principal_stress(constants, bar)
    h = energy.principal_stress_slope(constants, bar, np.eye(3))
    worst = np.full(bar.shape[1], np.inf)
    for i, j in combinations(range(3), 2):
        a, b = bar[i], bar[j]
        shear = (t[i] - t[j]) / (a**2 - b**2)
        beta = 0.5 * (h[i, i] - t[i] + h[j, j] - t[j]) - h[i, j]
        beta += (a**2 * t[j] - b**2 * t[i]) / (a**2 - b**2)
        alpha = shear * np.minimum(a, b) ** 2
        worst = np.minimum(worst, np.minimum(alpha, beta + a * b * shear))
    return worst


def ellipticity_end(material: Material, mode: Mode, low: float, high: float) -> float | None:
    """Stretch nearest to 1, to a 200th of the range, at which ellipticity is lost; None if kept."""
    a, v = np.array(mode.loaded, float), np.array(mode.free, float)
    if material.compressible is not None or always_elliptic(material) or not v.any():
        return None
    ends: list[float] = []
    for end in (low, high):
        x = np.log(np.geomspace(1.0, end, 201))
        sides = np.exp(a[:, None] * x - v[:, None] * x * a.sum() / v.sum())
        with np.errstate(all="ignore"):
            lost = np.flatnonzero(~(ellipticity(material, sides) > 0))
        ends += [float(np.exp(x[lost[0]]))] if lost.size else []
    return min(ends, key=lambda stretch: abs(np.log(stretch))) if ends else None


def _apart(bar: Array) -> Array:
    """Sorted stretches, the largest first, no two of them equal."""
    ordered = np.sort(bar, axis=0)[::-1].copy()
    ordered[0] *= np.where(ordered[0] < (1 + _APART) * ordered[1], 1 + _APART, 1.0)
    ordered[2] *= np.where(ordered[1] < (1 + _APART) * ordered[2], 1 - _APART, 1.0)
    return ordered
