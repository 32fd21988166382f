"""Homogeneous tests in closed form: uniaxial, equibiaxial, planar, confined, simple shear.

Incompressible materials follow the textbook formulas (Ogden 1984, ch. 7; Treloar 1975);
where K is finite the free stretch is solved from zero lateral stress, so that the answer is
the one a mixed finite element gives. Gradients are total derivatives: where Poisson's ratio
is given, K follows the constants.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from study.ground.arrays import Array
from study.ground.errors import Fault, InputError, nearest
from study.mechanics.material.energy import poisson_from_bulk
from study.mechanics.material.material import Material

# Stress and tangent of a material at a deformation gradient.


def first_piola(
    material: Material, F: Array, principal: tuple[Array, Array] | None = None
) -> Array:
    """First Piola-Kirchhoff (nominal) stress dW/dF in MPa, shape (3, 3, ...).

    ``principal`` are the singular values of F (..., 3) and their right vectors (..., 3, 3), where
    they are at hand.
    """
    bulk = _finite(material.bulk)
    if material.small_strain:
        eye = np.eye(3).reshape((3, 3) + (1,) * (F.ndim - 2))
        strain = 0.5 * (F + np.swapaxes(F, 0, 1)) - eye
        trace = np.trace(strain)
        return np.asarray(2 * material.mu0 * (strain - trace / 3 * eye) + bulk * trace * eye)
    moved = np.moveaxis(F, (0, 1), (-2, -1))
    # singular values of F lose no digits, eigenvalues of F'F would lose half near singularity
    stretches, directions = principal or np.linalg.svd(moved)[1:]
    stretch, axes = np.moveaxis(stretches, -1, 0), np.moveaxis(directions, (-1, -2), (0, 1))
    if (foam := material.compressible) is not None:
        kirchhoff = foam.kirchhoff(material.constants, material.compressibility, stretch)
    else:
        J = np.asarray(np.linalg.det(moved))
        stress = material.isochoric.principal_stress(material.constants, stretch / np.cbrt(J))
        kirchhoff = deviator(stress) + bulk * J * (J - 1)
    if np.isnan(kirchhoff).any():
        rule = f"{material.model} has no stress at this state: it lies beyond the end of the chains"
        mend = "deform less, or give constants whose limit lies further away"
        raise InputError(Fault("material", rule, mend))
    # F S with S = sum tau_i / l_i^2 N_i x N_i
    S = np.einsum("Ai...,Bi...,i...->AB...", axes, axes, kirchhoff / stretch**2)
    return np.asarray(np.einsum("iA...,AB...->iB...", F, S))


def deviator(values: Array) -> Array:
    """Subtract the mean over the first axis. Shapes: values (3, ...)."""
    # what ``mean`` computes, at half its cost for a few points
    return np.asarray(values - np.add.reduce(values) / len(values))


def _finite(bulk: float) -> float:
    return 0.0 if math.isinf(bulk) else bulk


@dataclass(frozen=True)
class Mode:
    """Which principal directions carry the given stretch and which are free of stress."""

    name: str
    loaded: tuple[int, int, int]
    free: tuple[int, int, int]

    @property
    def free_axis(self) -> int:
        """Index of one stress-free direction."""
        return self.free.index(1)


UNIAXIAL = Mode("uniaxial", (1, 0, 0), (0, 1, 1))
EQUIBIAXIAL = Mode("equibiaxial", (1, 1, 0), (0, 0, 1))
PLANAR = Mode("planar", (1, 0, 0), (0, 0, 1))
CONFINED = Mode("confined", (1, 0, 0), (0, 0, 0))
MODES: dict[str, Mode] = {m.name: m for m in (UNIAXIAL, EQUIBIAXIAL, PLANAR, CONFINED)}


@dataclass(frozen=True)
class Loaded:
    """Nominal stress of one loading."""

    #: shape (n,); over the reference area in the loaded direction, MPa; tension is positive. NaN
    #: where the material has no equilibrium state (an unstable one can have none).
    stress: Array
    #: shape (n,); total derivative with respect to every constant.
    gradient: Mapping[str, Array]


@dataclass(frozen=True)
class StressResponse(Loaded):
    """State of a homogeneous test at every stretch."""

    #: shape (n,); its derivative with respect to the stretch.
    slope: Array
    #: shape (n,); stretch of the free direction (1 if there is none).
    free_stretch: Array
    #: shape (n,); J.
    volume_ratio: Array


def response(material: Material, mode: Mode | str, stretch: ArrayLike) -> StressResponse:
    """Stress, its slope, the free stretch and the gradient of one homogeneous test."""
    # Shapes: stretch (n,).
    if isinstance(mode, str):
        if mode not in MODES:
            raise InputError(f"no homogeneous test {mode!r}: {nearest(mode, MODES)}")
        mode = MODES[mode]
    stretches = np.atleast_1d(np.asarray(stretch, dtype=float)).ravel()
    if not np.all(stretches > 0):
        raise InputError(f"stretches must be positive, got {stretches.min():g}")
    if mode is CONFINED and material.incompressible:
        raise InputError("an incompressible material cannot be compressed in a rigid box")
    if material.small_strain:
        return _linear(material, mode, stretches)
    x, a, v = np.log(stretches), np.array(mode.loaded, float), np.array(mode.free, float)
    if material.compressible is None:
        start = -x * a.sum() / max(v.sum(), 1.0)  # the volume is nearly kept
    else:  # the strain of small ones begins the search
        nu = poisson_from_bulk(material.mu0, material.bulk)
        start = -nu * a.sum() / (1 - nu * (2 - v.sum())) * x
    return _balanced(material, a, v, a[:, None] * x, start if v.any() else np.zeros_like(x))


def _balanced(
    material: Material, loaded: Array, free: Array, fixed: Array, start: Array
) -> StressResponse:
    """State at stretches with ln l = ``fixed`` + ``free`` z, where z leaves no stress on its sides.

    The slope is that by the stretch of the first direction, which turns ln l along ``loaded``.

    Shapes: loaded, free (3,); fixed (3, n); start (n,).
    """
    # unstable constants may overflow or have no equilibrium: NaN says so
    with np.errstate(all="ignore"):
        z = _free_log_stretch(material, free, fixed, start)
        log, stretch = fixed + free[:, None] * z, np.exp(fixed[0])
        J, (bulk, dbulk) = np.exp(log.sum(0)), _bulk_beside(material)
        kirchhoff, along_x, along_z = _without_bulk(material, log, np.array([loaded, free]))
        partial = _without_bulk_gradient(material, log)
        volumetric = bulk * (2 * J - 1) * J
        if not free.any():
            tau, dtau = kirchhoff[0] + bulk * J * (J - 1), along_x[0] + volumetric
            gradient = {n: (g[0] + dbulk[n] * J * (J - 1)) / stretch for n, g in partial.items()}
            return StressResponse(tau / stretch, gradient, (dtau - tau) / stretch**2, np.exp(z), J)
        # the free direction's total stress is zero, so K (J-1) J = -kirchhoff[t] without cancelling
        t = int(free.argmax())
        tau, tau_x, tau_z = (q[0] - q[t] for q in (kirchhoff, along_x, along_z))
        dz_dx, dz = np.full_like(J, -loaded.sum() / free.sum()), dict.fromkeys(partial, 0.0 * J)
        if not material.incompressible:
            by_z = along_z[t] + volumetric * free.sum()
            dz_dx = -(along_x[t] + volumetric * loaded.sum()) / by_z
            dz = {n: -(g[t] + dbulk[n] * J * (J - 1)) / by_z for n, g in partial.items()}
        gradient = {n: (g[0] - g[t] + tau_z * dz[n]) / stretch for n, g in partial.items()}
        slope = (tau_x + tau_z * dz_dx - tau) / stretch**2
        return StressResponse(tau / stretch, gradient, slope, np.exp(z), J)


def _bulk_beside(material: Material) -> tuple[float, dict[str, float]]:
    """K and its derivatives, where a change of volume has an energy of its own; else zero."""
    if material.compressible is not None:
        return 0.0, dict.fromkeys(material.names, 0.0)
    return _finite(material.bulk), material.bulk_gradient()


def _without_bulk(material: Material, log: Array, directions: Array) -> tuple[Array, ...]:
    """Principal Kirchhoff stress but for that of K, and its slopes along rates of ln l."""
    # Shapes: log (3, n), directions (k, 3); returns 1 + k of (3, n).
    if (foam := material.compressible) is not None:
        given = material.constants, material.compressibility, np.exp(log)
        return foam.kirchhoff(*given), *(foam.kirchhoff_slope(*given, d) for d in directions)
    turns = directions - np.add.reduce(directions, 1)[:, None] / 3
    bar = np.exp(deviator(log))
    stress, slopes = material.isochoric.stress_and_slope(material.constants, bar, turns)
    return deviator(stress), *(deviator(slope) for slope in slopes)


def _without_bulk_gradient(material: Material, log: Array) -> dict[str, Array]:
    """Differentiate the stress of :func:`_without_bulk` by every constant, each (3, n)."""
    if (foam := material.compressible) is not None:
        return foam.kirchhoff_gradient(material.constants, material.compressibility, np.exp(log))
    bar = np.exp(deviator(log))
    slopes = material.isochoric.principal_stress_gradient(material.constants, bar)
    return {name: deviator(slope) for name, slope in slopes.items()}


def _free_log_stretch(material: Material, free: Array, fixed: Array, start: Array) -> Array:
    """Logarithm of the free stretch: constant volume, or zero stress by safeguarded Newton."""
    if material.incompressible or not free.any():
        return np.array(start)
    t, (bulk, _) = int(free.argmax()), _bulk_beside(material)

    def lateral(z: Array) -> tuple[Array, Array]:
        log = fixed if z.size == start.size else np.tile(fixed, z.size // start.size)
        log = log + free[:, None] * z
        J = np.exp(np.add.reduce(log))
        stress, slope = _without_bulk(material, log, free[None])
        return stress[t] + bulk * J * (J - 1), slope[t] + bulk * (2 * J - 1) * J * free.sum()

    return _safeguarded_newton(lateral, start)


#: largest step of Newton's method after which the next one, about its square, is rounding
_LAST_STEP = 1e-9


def _safeguarded_newton(
    function: Callable[[Array], tuple[Array, Array]], start: Array, width: float = 0.02
) -> Array:
    """Root of an elementwise function that rises through zero near ``start``; NaN if none."""
    # Shapes: function (n,).
    low, high = start - width, start + width
    for _ in range(8):  # widen until the root is bracketed, to 0.02 * 2^8 = 5 in log stretch
        ends = function(np.concatenate([low, high]))[0]
        below, above = ends[: low.size] < 0, ends[low.size :] > 0
        if np.all(below & above):
            break
        low = np.where(below, low, start - 2 * (start - low))
        high = np.where(above, high, start + 2 * (high - start))
    z, moved = np.array(start), np.inf
    for _ in range(80):
        value, slope = function(z)
        low, high = np.where(value < 0, z, low), np.where(value > 0, z, high)
        new = z - value / slope
        inside = (new >= low) & (new <= high)
        new = np.where(inside, new, 0.5 * (low + high))
        new = np.where(value == 0, z, new)
        step = np.abs(new - z)
        last, moved = moved, float(np.max(step, initial=0.0))
        z = new
        if moved <= _LAST_STEP and (moved <= 4e-16 or inside.all()):
            break
        # rounding of the stress leaves the last digit of z moving to and fro
        if last <= moved < 1e-13:
            break
    return np.where(below & above & (step <= _LAST_STEP), z, np.nan)


def _linear(material: Material, mode: Mode, stretch: Array) -> StressResponse:
    """Small strain: nominal stress is a modulus times (l - 1)."""
    mu, bulk = material.mu0, material.bulk
    modulus = _modulus(mode, mu, bulk).real
    h = 1e-30  # complex step: exact to rounding
    by_mu = _modulus(mode, mu + 1j * h, bulk).imag / h
    by_bulk = 0.0 if np.isinf(bulk) else _modulus(mode, mu, bulk + 1j * h).imag / h
    dmu, dbulk = material.mu0_gradient(), material.bulk_gradient()
    strain, nu = stretch - 1, poisson_from_bulk(mu, bulk)
    lateral = {"uniaxial": -nu, "equibiaxial": -2 * nu / (1 - nu), "planar": -nu / (1 - nu)}
    free = 1 + lateral.get(mode.name, 0.0) * strain
    J = stretch ** sum(mode.loaded) * free ** sum(mode.free)
    gradient = {n: (by_mu * dmu[n] + by_bulk * dbulk[n]) * strain for n in material.names}
    return StressResponse(modulus * strain, gradient, np.full_like(strain, modulus), free, J)


def _modulus(mode: Mode, mu: complex, bulk: complex) -> complex:
    """Stiffness of a homogeneous test from mu and K, finite for infinite K."""
    r = mu / bulk
    if mode is UNIAXIAL:
        return complex(9 * mu / (3 + r))
    if mode is EQUIBIAXIAL:
        return complex(18 * mu / (3 + 4 * r))
    if mode is PLANAR:
        return complex(4 * mu * (3 + r) / (3 + 4 * r))
    return complex(bulk + 4 * mu / 3)


# Nominal stress of a homogeneous specimen in every loading that a measured test may have, by the
# stretch of the loaded direction or the amount of shear.


@dataclass(frozen=True)
class Loading:
    """One way to deform a homogeneous specimen."""

    #: Material and measure, shape (n,), to :class:`Loaded`.
    nominal: Callable[[Material, Array], Loaded]
    #: Whether the measure is the amount of shear, zero at rest, and not a stretch.
    is_shear: bool = False
    #: Principal mode, for stability; None where a principal mode does not describe it.
    mode: Mode | None = None
    #: Whether the specimen resists with its volume, so that an incompressible one is rigid.
    is_volumetric: bool = False

    def measure(self, share: Array) -> Array:
        """Stretch or shear of an elongation (or offset) over the length of the specimen."""
        return share if self.is_shear else 1.0 + share


def _principal(mode: Mode) -> Loading:
    return Loading(
        lambda material, stretch: response(material, mode, stretch),
        mode=mode,
        is_volumetric=mode is CONFINED,
    )


def _simple_shear(material: Material, shear: Array, prestretch: float = 1.0) -> Loaded:
    """Shear stress; the volume is kept, so that K does not enter.

    A specimen may have been stretched along the normal of its sheared faces before: F is then
    shear e1 e2 + prestretch e2 e2 + (e1 e1 + e3 e3) / sqrt(prestretch) (Budday and others 2017).
    """
    if material.compressible is not None and prestretch != 1:
        rule = "has a free stretch of its own, and a sheared specimen keeps its volume here"
        raise InputError(Fault("test.prestretch", rule, "leave it out, or take another energy"))
    if material.small_strain:
        slopes = material.mu0_gradient()
        return Loaded(material.mu0 * shear, {name: slope * shear for name, slope in slopes.items()})
    longest, _, shortest = bar = np.stack(sheared_stretches(shear, prestretch))

    def sheared(principal: Array) -> Array:
        """P_12 = shear (tau_1 - tau_3) / (l_1^2 - l_3^2), through the principal stretches."""
        # Without a pre-stretch these are l and 1/l with l - 1/l = shear, so that
        # shear / (l^2 - 1/l^2) = 1 / (l + 1/l), at rest too.
        difference = principal[0] - principal[2]
        if prestretch == 1:
            return np.asarray(np.sign(shear) * difference / (longest + shortest))
        return np.asarray(shear * difference / (longest**2 - shortest**2))

    constants = material.constants
    with np.errstate(all="ignore"):  # constants of a fit may overflow: NaN says so
        if (foam := material.compressible) is not None:
            stress = foam.kirchhoff(constants, material.compressibility, bar)
            gradient = foam.kirchhoff_gradient(constants, material.compressibility, bar)
        else:
            stress = material.isochoric.principal_stress(constants, bar)
            gradient = material.isochoric.principal_stress_gradient(constants, bar)
    return Loaded(sheared(stress), {name: sheared(slope) for name, slope in gradient.items()})


def sheared_stretches(shear: Array, prestretch: float = 1.0) -> tuple[Array, Array, Array]:
    """Principal stretches of a simple shear, the longest and shortest in its plane.

    Shapes: shear (n,); returns (n,).
    """
    free = 1 / math.sqrt(prestretch)
    # (l_1 +- l_3)^2 = tr b +- 2 l_1 l_3
    both, apart = np.hypot(shear, prestretch + free), np.hypot(shear, prestretch - free)
    longest = 0.5 * (both + apart)
    return longest, np.full(shear.shape, free), prestretch * free / longest


def _biaxial(material: Material, stretch: Array) -> Loaded:
    """Two directions stretched as they like, the third free of stress.

    Shapes: stretch (2 n,), the n of the first direction and the n of the second; stresses too.
    """
    if stretch.size % 2:
        rule = "has stretches of two directions, as many of each"
        raise InputError(Fault("test.kind", f"biaxial {rule}", "calibrate it to measured rows"))
    if material.compressible is not None or material.small_strain:
        rule = f"{material.model} has no closed form of unequal stretches here"
        raise InputError(Fault("material.model", rule, "take an isochoric energy"))
    x = np.log(stretch)
    fixed = np.stack([x, np.roll(x, stretch.size // 2), np.zeros_like(x)])
    along, free = np.eye(3)[[0, 2]]
    return _balanced(material, along, free, fixed, -fixed.sum(0))


def _volumetric(material: Material, stretch: Array) -> Loaded:
    """Equal stretches on all sides: P = K (J - 1) l^2, compression negative."""
    if material.incompressible:
        rule = "an incompressible material cannot change its volume"
        raise InputError(Fault("material", rule, "give poisson_ratio or bulk_modulus"))
    if material.compressible is not None:
        log = np.tile(np.log(stretch), (3, 1))
        tau, by = _without_bulk(material, log, np.eye(3)[:1])[0], _without_bulk_gradient
        return Loaded(tau[0] / stretch, {n: g[0] / stretch for n, g in by(material, log).items()})
    shape = (stretch**3 - 1) * stretch**2
    slopes = material.bulk_gradient()
    return Loaded(material.bulk * shape, {n: slopes[n] * shape for n in material.names})


def loading_in(mode: str, prestretch: float | None = None) -> Loading:
    """Give the loading of a specimen that may be stretched before it is sheared."""
    if prestretch is None:
        return LOADINGS[mode]
    return Loading(partial(_simple_shear, prestretch=prestretch), is_shear=True)


LOADINGS: Mapping[str, Loading] = {
    "uniaxial": _principal(UNIAXIAL),
    "equibiaxial": _principal(EQUIBIAXIAL),
    "planar": _principal(PLANAR),
    "biaxial": Loading(_biaxial),
    "confined": _principal(CONFINED),
    "simple-shear": Loading(_simple_shear, is_shear=True),
    "volumetric": Loading(_volumetric, is_volumetric=True),
}
