"""Homogeneous tests in closed form: uniaxial, equibiaxial, planar, confined, simple shear.

Incompressible materials follow the textbook formulas (Ogden 1984, ch. 7; Treloar 1975);
where K is finite the free stretch is solved from zero lateral stress, so that the answer is
the one a mixed finite element gives. Gradients are total derivatives: where Poisson's ratio
is given, K follows the constants.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from study.arrays import Array
from study.errors import InputError, nearest
from study.material.compressibility import poisson_from_bulk
from study.material.energy import CompressibleEnergy
from study.material.material import Material
from study.material.stress import deviator, first_piola


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
class Response:
    """State of a homogeneous test at every stretch.

    Parameters
    ----------
    stress : ndarray, shape (n,)
        Nominal stress in the loaded direction, MPa; NaN where the material has no
        equilibrium state (an unstable one can have none).
    slope : ndarray, shape (n,)
        Its derivative with respect to the stretch.
    free_stretch : ndarray, shape (n,)
        Stretch of the free direction (1 if there is none).
    volume_ratio : ndarray, shape (n,)
        J.
    gradient : dict of str to ndarray, shape (n,)
        Total derivative of the stress with respect to every constant.
    """

    stress: Array
    slope: Array
    free_stretch: Array
    volume_ratio: Array
    gradient: dict[str, Array]


def uniaxial(material: Material, stretch: ArrayLike) -> Array:
    """Nominal stress in MPa under uniaxial load, sides free (V01, V04).

    Parameters
    ----------
    material : Material
        With numbers.
    stretch : array_like
        In the loaded direction, positive; stresses have its shape.
    """
    return _shaped(response(material, UNIAXIAL, stretch).stress, stretch)


def equibiaxial(material: Material, stretch: ArrayLike) -> Array:
    """Nominal stress in MPa under two equal stretches (V02).

    Parameters
    ----------
    material : Material
        With numbers.
    stretch : array_like
        In both loaded directions, positive; stresses have its shape.
    """
    return _shaped(response(material, EQUIBIAXIAL, stretch).stress, stretch)


def planar(material: Material, stretch: ArrayLike) -> Array:
    """Nominal stress in MPa in planar tension (pure shear): l, 1, free (V03).

    Parameters
    ----------
    material : Material
        With numbers.
    stretch : array_like
        In the loaded direction, positive; stresses have its shape.
    """
    return _shaped(response(material, PLANAR, stretch).stress, stretch)


def confined(material: Material, stretch: ArrayLike) -> Array:
    """Nominal stress in MPa in confined compression: l, 1, 1 (V06).

    Parameters
    ----------
    material : Material
        With numbers, not incompressible.
    stretch : array_like
        In the loaded direction, positive; stresses have its shape.
    """
    return _shaped(response(material, CONFINED, stretch).stress, stretch)


def uniaxial_gradient(material: Material, stretch: ArrayLike) -> dict[str, Array]:
    """Total derivative of :func:`uniaxial` with respect to every constant, K(nu) included.

    Parameters
    ----------
    material, stretch
        As for :func:`uniaxial`.

    Returns
    -------
    dict of str to ndarray
        By the name of the constant, each of the shape of ``stretch``: MPa over the constant's unit.
    """
    gradient = response(material, UNIAXIAL, stretch).gradient
    return {name: _shaped(value, stretch) for name, value in gradient.items()}


def simple_shear(material: Material, shear: ArrayLike) -> tuple[Array, Array, Array]:
    """Cauchy stresses (s12, s11, s22) in MPa in simple shear with s33 = 0 (V05).

    Parameters
    ----------
    material : Material
        Any hyperelastic one (simple shear keeps the volume, so K does not enter).
    shear : array_like, shape (n,)
        Amount of shear.
    """
    g = np.atleast_1d(np.asarray(shear, dtype=float))
    F = np.zeros((3, 3, g.size))
    F[[0, 1, 2], [0, 1, 2]], F[0, 1] = 1.0, g
    sigma = np.einsum("iA...,jA...->ij...", first_piola(material, F), F)
    parts = sigma[0, 1], sigma[0, 0] - sigma[2, 2], sigma[1, 1] - sigma[2, 2]
    s12, s11, s22 = (_shaped(part, shear) for part in parts)
    return s12, s11, s22


def response(material: Material, mode: Mode | str, stretch: ArrayLike) -> Response:
    """Stress, its slope, the free stretch and the gradient of one homogeneous test.

    Parameters
    ----------
    material : Material
        With numbers.
    mode : Mode or str
        One of :data:`MODES`.
    stretch : array_like, shape (n,)
        Stretch in the loaded direction, positive.

    Raises
    ------
    InputError
        If a stretch is not positive, the mode is unknown, or an incompressible material is
        to be compressed in a rigid box.
    """
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
    # unstable constants may overflow or have no equilibrium: NaN says so
    with np.errstate(all="ignore"):
        if (foam := material.compressible) is not None:
            return _compressible(material, foam, mode, stretches)
        return _hyperelastic(material, mode, stretches)


def _compressible(
    material: Material, energy: CompressibleEnergy, mode: Mode, stretch: Array
) -> Response:
    """Test of an energy whose volume change belongs to all of it."""
    x, t = np.log(stretch), 0 if mode is CONFINED else mode.free_axis
    a, v = np.array(mode.loaded, float), np.array(mode.free, float)
    known = material.constants, material.compressibility

    def at(z: Array) -> Array:
        log = np.tile(x, z.size // x.size)
        return np.asarray(np.exp(a[:, None] * log + v[:, None] * z))

    def lateral(z: Array) -> tuple[Array, Array]:
        sides = at(z)
        return energy.kirchhoff(*known, sides)[t], energy.kirchhoff_slope(*known, sides, v)[t]

    nu = poisson_from_bulk(material.mu0, material.bulk)
    loaded = a.sum()  # one or two directions: the strain of small ones begins the search
    narrower = -nu * loaded / (1 - nu * (2 - v.sum()))
    z = np.zeros_like(x) if mode is CONFINED else _safeguarded_newton(lateral, narrower * x)
    sides = at(z)
    tau, partial = energy.kirchhoff(*known, sides), energy.kirchhoff_gradient(*known, sides)
    along_x = energy.kirchhoff_slope(*known, sides, a)
    along_z = energy.kirchhoff_slope(*known, sides, v)
    gives = np.zeros_like(x) if mode is CONFINED else along_z[0] / along_z[t]
    gradient = {n: (g[0] - gives * g[t]) / stretch for n, g in partial.items()}
    slope = (along_x[0] - gives * along_x[t] - tau[0]) / stretch**2
    return Response(tau[0] / stretch, slope, np.exp(z), sides.prod(0), gradient)


def _hyperelastic(material: Material, mode: Mode, stretch: Array) -> Response:
    x = np.log(stretch)
    a, v = np.array(mode.loaded, float), np.array(mode.free, float)
    z = _free_log_stretch(material, mode, x)
    log = a[:, None] * x + v[:, None] * z
    bar, J = np.exp(deviator(log)), np.exp(log.sum(0))
    energy, constants = material.isochoric, material.constants
    directions = np.array([deviator(a), deviator(v)])
    stress, slopes = energy.stress_and_slope(constants, bar, directions)
    kirchhoff, along_x, along_z = deviator(stress), deviator(slopes[0]), deviator(slopes[1])
    by_constant = energy.principal_stress_gradient(constants, bar)
    partial = {n: deviator(g) for n, g in by_constant.items()}
    if mode is CONFINED:
        bulk, dbulk = material.bulk, material.bulk_gradient()
        tau = kirchhoff[0] + bulk * J * (J - 1)
        dtau = along_x[0] + bulk * (2 * J - 1) * J
        gradient = {n: (g[0] + dbulk[n] * J * (J - 1)) / stretch for n, g in partial.items()}
        return Response(tau / stretch, (dtau - tau) / stretch**2, np.exp(z), J, gradient)
    # the free direction's total stress is zero, so K (J-1) J = -kirchhoff[t] without cancelling
    t = mode.free_axis
    tau, tau_x, tau_z = (q[0] - q[t] for q in (kirchhoff, along_x, along_z))
    dz_dx, dz_dc = _free_rates(material, mode, J, along_x[t], along_z[t], partial)
    gradient = {n: (g[0] - g[t] + tau_z * dz_dc[n]) / stretch for n, g in partial.items()}
    slope = (tau_x + tau_z * dz_dx - tau) / stretch**2
    return Response(tau / stretch, slope, np.exp(z), J, gradient)


def _free_rates(
    material: Material, mode: Mode, J: Array, by_x: Array, by_z: Array, partial: dict[str, Array]
) -> tuple[Array, dict[str, Array]]:
    """Differentiate the free logarithmic stretch by ln l and by every constant."""
    loaded, free = sum(mode.loaded), sum(mode.free)
    if material.incompressible:
        zero = np.zeros_like(J)
        return zero - loaded / free, dict.fromkeys(partial, zero)
    t, volumetric = mode.free_axis, material.bulk * (2 * J - 1) * J
    f_z = by_z + volumetric * free
    dbulk = material.bulk_gradient()
    dz = {n: -(g[t] + dbulk[n] * J * (J - 1)) / f_z for n, g in partial.items()}
    return -(by_x + volumetric * loaded) / f_z, dz


def _free_log_stretch(material: Material, mode: Mode, x: Array) -> Array:
    """Logarithm of the free stretch: constant volume, or zero stress by safeguarded Newton."""
    if mode is CONFINED:
        return np.zeros_like(x)
    a, v = np.array(mode.loaded, float), np.array(mode.free, float)
    z0 = -x * a.sum() / v.sum()
    if material.incompressible:
        return np.asarray(z0)
    t, bulk = mode.free_axis, material.bulk
    energy, constants = material.isochoric, material.constants

    loaded, turn, sides = a[:, None] * x, deviator(v), v.sum()

    def lateral(z: Array) -> tuple[Array, Array]:
        log = loaded if z.size == x.size else np.tile(loaded, z.size // x.size)
        log = log + v[:, None] * z
        volume = np.add.reduce(log)
        bar, J = np.exp(log - volume / 3), np.exp(volume)
        stress, along = energy.stress_and_slope(constants, bar, turn)
        tau, slope = (q[t] - np.add.reduce(q) / 3 for q in (stress, along))
        return tau + bulk * J * (J - 1), slope + bulk * (2 * J - 1) * J * sides

    return _safeguarded_newton(lateral, z0)


#: largest step of Newton's method after which the next one, about its square, is rounding
_LAST_STEP = 1e-9


def _safeguarded_newton(
    function: Callable[[Array], tuple[Array, Array]], start: Array, width: float = 0.02
) -> Array:
    """Root of an elementwise function that rises through zero near ``start``; NaN if none.

    Parameters
    ----------
    function : callable
        Values and slopes at places of shape (n,), or at several such sets one after the other.
    """
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


def _linear(material: Material, mode: Mode, stretch: Array) -> Response:
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
    return Response(modulus * strain, np.full_like(strain, modulus), free, J, gradient)


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


def _shaped(values: Array, like: ArrayLike) -> Array:
    return np.asarray(values).reshape(np.shape(like))
