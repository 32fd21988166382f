"""What the profile z = f(r) of a rigid indenter does to the integral equation of its contact.

Sneddon's (1965, Int. J. Engng Sci. 3, 47) answer to a profile needs of it the transform

    q(t) = t int_0^t f'(r) / sqrt(t^2 - r^2) dr = t int_0^(pi/2) f'(t sin u) du   (mm),

which is the depth at which a half-space is touched up to the radius t.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from study.ground.arrays import Array
from study.ground.canonical import Keyed
from study.mechanics.setup.calibration_table import Theory
from study.mechanics.setup.geometry import Cone, Flat, Indenter, Sphere

if TYPE_CHECKING:
    from scipy.interpolate import CubicHermiteSpline

#: Gauss points on (-1, 1) and their weights by their number; those of 48 take longer to find than
#: a contact takes to solve with them
gauss_points = lru_cache(maxsize=8)(np.polynomial.legendre.leggauss)

#: Gauss points over a rounded edge
_EDGE = 64
#: share of an indenter's radius up to which contact is followed: its wall is upright at all of it
NEARLY = 0.98


def transform(indenter: Indenter, radius_mm: Array, *, paraboloid: bool = False) -> Array:
    """Transform q of a profile, mm, shape (n,).

    Examples
    --------
    A cone of 45 degrees is touched up to t at the depth pi/2 t:

    >>> float(transform(Cone(45.0), np.array([2.0]))[0] / np.pi)
    1.0
    """
    t = np.asarray(radius_mm, dtype=float)
    if isinstance(indenter, Sphere):
        size = indenter.radius_mm
        return np.asarray(t**2 / size if paraboloid else t * np.arctanh(t / size))
    if isinstance(indenter, Cone):
        return _rounded_cone(indenter, t)
    return _rounded_edge(indenter, t)


def _rounded_cone(cone: Cone, t: Array) -> Array:
    """Spherical up to where the flank is tangent to it, straight beyond."""
    slope = 1 / np.tan(np.radians(cone.half_angle_deg))
    size = cone.tip_radius_mm
    tangent = np.minimum(size * np.cos(np.radians(cone.half_angle_deg)), t)
    share = np.divide(tangent, t, out=np.zeros_like(t), where=t > 0)
    straight = slope * (np.pi / 2 - np.arcsin(np.minimum(share, 1.0)))
    if size == 0:
        return np.asarray(t * straight)
    below = np.sqrt(size**2 - tangent**2) + np.sqrt(t**2 - tangent**2)
    return np.asarray(t * (np.log((size + t) / below) + straight))


def _rounded_edge(flat: Flat, t: Array) -> Array:
    """Zero on the plane face; a quarter of a circle from there to the shaft."""
    size, face = flat.edge_radius_mm, flat.face_radius_mm
    if size == 0:
        return np.zeros_like(t)
    points, weights = gauss_points(_EDGE)
    wide = np.maximum(t, face)
    first = np.arcsin(np.divide(face, wide, out=np.ones_like(wide), where=wide > 0))
    half = 0.5 * (np.pi / 2 - first)
    angles = first[:, None] + half[:, None] * (points + 1)
    out = np.clip((wide[:, None] * np.sin(angles) - face) / size, 0.0, 1 - 1e-12)
    return np.asarray(t * half * ((out / np.sqrt(1 - out**2)) @ weights))


def contact_range(indenter: Indenter) -> tuple[float, float]:
    """Contact radius at first touch and the largest one that the profile has, mm."""
    if isinstance(indenter, Sphere):
        return 0.0, NEARLY * indenter.radius_mm
    if isinstance(indenter, Cone):
        return 0.0, np.inf if indenter.shaft_radius_mm is None else indenter.shaft_radius_mm
    face = indenter.face_radius_mm
    return face, face + NEARLY * indenter.edge_radius_mm


# Kernel of an elastic layer: what its support adds to the answer of a half-space.
# The surface of a layer of height h answers a pressure of wave number x/h as that of a half-space
# does, times K(x). On a bonded base, with the shear stress on the surface zero,
#     K = ((3 - 4 nu) sinh 2x - 2x) / ((3 - 4 nu) cosh 2x + 2x^2 + 5 - 12 nu + 8 nu^2),
# and on a frictionless base K = 2 sinh^2 x / (sinh 2x + 2x), whatever nu (Lebedev and Ufliand 1958,
# J. Appl. Math. Mech. 22, 442; Hayes, Keer, Herrmann and Mockros 1972, J. Biomech. 5, 541).

#: wave number times height at which the integral is cut: 1 - K is below 1e-15 there
_LONGEST = 25.0
#: Gauss points over the wave numbers; cosines of contacts five heights wide are resolved
_WAVES = 240


@dataclass(frozen=True)
class Layer:
    """An elastic layer on a rigid base."""

    #: Its height, above zero; infinite for a half-space.
    height_mm: float
    #: Above -1 and at most 0.5.
    poisson_ratio: float
    #: Whether it sticks to the base; it slides without friction otherwise.
    bonded: bool = True

    def coupling(self, places_mm: Array, others_mm: Array) -> Array:
        """Kernel of the integral equation, 1/mm, shape (n, m)."""
        # 2/(pi h) int (1 - K(x)) cos(x s/h) cos(x t/h) dx for places s and t, in mm from the axis.
        if not np.isfinite(self.height_mm):  # nothing of the base is felt
            return np.zeros((places_mm.size, others_mm.size))
        waves, weights = _missing(self.poisson_ratio, self.bonded)
        first = np.cos(np.outer(places_mm / self.height_mm, waves))
        second = np.cos(np.outer(others_mm / self.height_mm, waves))
        return np.asarray(2 / (np.pi * self.height_mm) * (first * weights) @ second.T)


@lru_cache(maxsize=16)
def _missing(nu: float, bonded: bool) -> tuple[Array, Array]:
    """Gauss points x and weights of the integral of (1 - K(x)) times a function."""
    points, weights = gauss_points(_WAVES)
    x = 0.5 * _LONGEST * (points + 1)
    if bonded:
        k = 3 - 4 * nu
        below = k * np.cosh(2 * x) + 2 * x**2 + 5 - 12 * nu + 8 * nu**2
        answer = (k * np.sinh(2 * x) - 2 * x) / below
    else:
        answer = 2 * np.sinh(x) ** 2 / (np.sinh(2 * x) + 2 * x)
    return x, 0.5 * _LONGEST * weights * (1 - answer)


# Dimitriadis' series for a sphere on a layer (2002, Biophys. J. 82, 2798, eq. 7 and 12), for
# comparison with published moduli: its force is 1 % low at chi = sqrt(R d) / h = 0.2, 3 % at 0.3
# and 8 % at 0.5 (nu = 0.5, bonded). The coefficient of chi^4 there is -0.0976 by the paper's own
# formula, used here; it prints +0.0975.


def coefficients(layer: Layer) -> Array:
    """Coefficients of chi^0 to chi^4, shape (5,).

    Examples
    --------
    >>> coefficients(Layer(1.0, 0.5, bonded=False)).round(3).tolist()
    [1.0, 0.884, 0.781, 0.386, 0.005]
    """
    nu = layer.poisson_ratio
    if layer.bonded:
        alpha = -(1.2876 - 1.4678 * nu + 1.3442 * nu**2) / (1 - nu)
        beta = (0.6387 - 1.0277 * nu + 1.5164 * nu**2) / (1 - nu)
    else:
        alpha = -0.347 * (3 - 2 * nu) / (1 - nu)
        beta = 0.056 * (5 - 2 * nu) / (1 - nu)
    third = alpha**3 + 4 * np.pi**2 / 15 * beta
    fourth = alpha**3 + 3 * np.pi**2 / 5 * beta
    x = 1 / np.pi
    series = [1.0, -2 * alpha * x, 4 * alpha**2 * x**2, -8 * third * x**3]
    return np.array([*series, 16 * alpha * fourth * x**4])


def correction(layer: Layer, radius_mm: float, depth_mm: Array) -> Array:
    """Force of a sphere of a radius over Hertz's at depths, shape (n,)."""
    chi = np.sqrt(radius_mm * depth_mm) / layer.height_mm
    return np.asarray(np.polynomial.Polynomial(coefficients(layer))(chi))


# Frictionless contact of a rigid body of revolution with an elastic layer, by its radius.
# The pressure follows from a function phi on the contact, 0 <= t <= a, that solves the Fredholm
# equation of the second kind
#     phi(t) - int_0^a k(s, t) phi(s) ds = d - q(t),    F = 2 E* int_0^a phi(t) dt,
# with the layer's kernel k (``contact_law``), the profile's transform q
# (``contact_law``), the depth d and E* = E / (1 - nu^2). Where the profile
# is smooth at the rim the pressure ends there with zero: phi(a) = 0, which makes the depth follow
# from the radius. Nystrom's method with Gauss points is exact to rounding up to a = 5 h.

#: Gauss points over the contact radius
_POINTS = 48


class ContactCondition(NamedTuple):
    """One contact of a given radius."""

    #: Depth at which the radius is reached; 0 on the face of a flat punch.
    depth_mm: float
    force_mm2: float
    #: Force over E* and depth of a flat punch of the radius, 2 a on a half-space: the slope of
    #: force over depth of every indenter (Pharr, Oliver and Brotzen 1992).
    stiffness_mm: float


def contact_state(
    layer: Layer, indenter: Indenter, radius_mm: float, *, paraboloid: bool = False
) -> ContactCondition:
    """Depth, force and stiffness of the contact of a given radius."""
    points, weights = gauss_points(_POINTS)
    t, w = 0.5 * radius_mm * (points + 1), 0.5 * radius_mm * weights
    matrix = np.eye(_POINTS) - layer.coupling(t, t) * w
    given = np.column_stack([np.ones(_POINTS), transform(indenter, t, paraboloid=paraboloid)])
    plain, shaped = np.linalg.solve(matrix, given).T
    rim = np.array([radius_mm])
    onto = (layer.coupling(rim, t) * w)[0]
    at_rim = float(transform(indenter, rim, paraboloid=paraboloid)[0] + onto @ shaped)
    depth = at_rim / float(1 + onto @ plain)
    return ContactCondition(depth, float(2 * w @ (depth * plain - shaped)), float(2 * w @ plain))


# Force of an indenter on a layer over its depth: solved at radii that grow by even ratios,
# between them a cubic in logarithms with the exact slope dF/dd = E* stiffness.

#: contact radii that are tabulated, over three decades: force is interpolated to 1e-6
_RADII = 60
_DECADES = 3.0
#: contact radius over height beyond which nothing is tabulated
WIDEST = 5.0


@dataclass(frozen=True)
class ContactForceLaw:
    """Force over E* and contact radius, by depth."""

    #: shape (n,); tabulated contacts, rising; all above zero.
    depth_mm: Array
    force_mm2: Array
    stiffness_mm: Array
    radius_mm: Array

    def force(self, depth_mm: Array) -> Array:
        """Force over E* at depths, mm^2, of their shape; zero where they are negative."""
        d = np.maximum(depth_mm, 0.0)
        x = np.log(np.clip(d, self.depth_mm[0], self.depth_mm[-1]))
        within = np.exp(self._spline(x))
        power = self.stiffness_mm[0] * self.depth_mm[0] / self.force_mm2[0]
        early = np.minimum(d / self.depth_mm[0], 1.0) ** power
        return np.asarray(within * early + self._beyond(d) * self.stiffness_mm[-1])

    def stiffness(self, depth_mm: Array) -> Array:
        """Slope of force over E* by depth, mm, of the shape of the depths."""
        d = np.maximum(depth_mm, 1e-12 * self.depth_mm[0])
        ends = np.clip(d, self.depth_mm[0], self.depth_mm[-1])
        slope = self._spline(np.log(ends), 1)
        inside = slope * (self.force(d) - self._beyond(d) * self.stiffness_mm[-1]) / ends
        early = np.where(d < self.depth_mm[0], ends / d, 1.0)
        slopes = np.where(d > self.depth_mm[-1], self.stiffness_mm[-1], inside * early)
        return np.where(np.asarray(depth_mm) > 0, slopes, 0.0)

    def radius(self, depth_mm: Array) -> Array:
        """Contact radius at depths, mm, of their shape."""
        d = np.maximum(depth_mm, 1e-12 * self.depth_mm[0])
        log = np.interp(np.log(d), np.log(self.depth_mm), np.log(self.radius_mm))
        return np.asarray(np.exp(log))

    def _beyond(self, depth: Array) -> Array:
        return np.asarray(np.maximum(depth - self.depth_mm[-1], 0.0))

    @cached_property
    def _spline(self) -> CubicHermiteSpline:
        from scipy.interpolate import CubicHermiteSpline

        slope = self.stiffness_mm * self.depth_mm / self.force_mm2
        return CubicHermiteSpline(np.log(self.depth_mm), np.log(self.force_mm2), slope)


def force_law(
    indenter: Indenter,
    layer: Layer,
    deepest_mm: float,
    *,
    theory: Theory = "integral-equation",
    paraboloid: bool = False,
) -> ContactForceLaw:
    """Tabulate the force of an indenter up to a depth.

    Examples
    --------
    Hertz, 4/3 E* sqrt(R) d^1.5:

    >>> law = force_law(Sphere(4.0), Layer(np.inf, 0.5), 0.5, paraboloid=True)
    >>> float(law.force(np.array([0.25]))[0] / (4 / 3 * 2 * 0.125))
    1.000
    """
    if theory == "dimitriadis":
        if not isinstance(indenter, Sphere):
            raise ValueError(f"the published series is for spheres, got {indenter}")
        return _by_series(indenter, layer, deepest_mm)
    half_space = replace(layer, height_mm=np.inf)
    support = layer if theory == "integral-equation" else half_space
    radii = _radii(indenter, support, deepest_mm, paraboloid)
    states = [contact_state(support, indenter, a, paraboloid=paraboloid) for a in radii]
    if isinstance(indenter, Flat) and indenter.is_sharp_edged:
        depth, stiffness = deepest_mm * np.array([1e-3, 1.0]), np.full(2, states[0].stiffness_mm)
        return ContactForceLaw(depth, stiffness * depth, stiffness, np.full(2, indenter.radius_mm))
    depth, force, stiffness = np.array(states).T
    return ContactForceLaw(depth, force, stiffness, radii)


def _radii(indenter: Indenter, layer: Layer, deepest: float, paraboloid: bool) -> Array:
    """Contact radii up to that of the deepest indentation, mm."""
    first, most = contact_range(indenter)
    if first == most:
        return np.array([first])
    most = min(most, max(WIDEST * layer.height_mm, 1.001 * first))
    wide = max(1e-3 * min(most, deepest), 1.0001 * first)
    while wide < most:
        if contact_state(layer, indenter, wide, paraboloid=paraboloid).depth_mm >= deepest:
            break
        wide = first + 1.5 * (wide - first)
    spread = min(wide, most) - first
    return np.asarray(first + spread * np.logspace(-_DECADES, 0, _RADII))


def _by_series(sphere: Sphere, layer: Layer, deepest: float) -> ContactForceLaw:
    """Force of the published series; its contact radius is Hertz's."""
    depth = deepest * np.logspace(-2 * _DECADES, 0, _RADII)
    size, step = sphere.radius_mm, 1e-6

    def force(d: Array) -> Array:
        hertz = 4 / 3 * np.sqrt(size) * d**1.5
        return np.asarray(hertz * correction(layer, size, d))

    slope = (force(depth * (1 + step)) - force(depth * (1 - step))) / (2 * step * depth)
    return ContactForceLaw(depth, force(depth), slope, np.sqrt(size * depth))


# Depths at which the assumptions of the closed form end: the built-in finite elements
# (neo-Hookean, nu = 0.4999, no friction) resist about 3 % less there
# (docs/analytic_indentation.py).

#: depth over the radius of a sphere: strains under it are about 0.2 a/R (Tabor 1951)
SPHERE_DEPTH = 0.1
#: depth over the radius of a flat punch
PUNCH_DEPTH = 0.15
#: depth over the height of the layer: the mean strain under a wide contact
LAYER_DEPTH = 0.1
#: chi = sqrt(R d) / h up to which the published series was compared with experiments
SERIES_CHI = 1.0
#: shortening of the whole specimen, as a free column, over the depth: its sides are no layer's
COLUMN_SHARE = 0.03
#: depths at which a limit that rises with depth is looked for
_DEPTHS = 400


@dataclass(frozen=True)
class ValidityLimit(Keyed):
    """Depth at which one assumption ends."""

    KEYS = "limit=what depth_mm"

    what: str
    #: Largest depth at which it holds; infinite where it always does.
    depth_mm: float


def limits(
    indenter: Indenter,
    layer: Layer,
    law: ContactForceLaw,
    *,
    area_mm2: float | None = None,
    is_series: bool = False,
) -> tuple[ValidityLimit, ...]:
    """Depths at which the assumptions of the closed form end, the least first."""
    depths = {f"d/h <= {LAYER_DEPTH:g}": LAYER_DEPTH * layer.height_mm}
    if isinstance(indenter, Sphere):
        depths[f"d/R <= {SPHERE_DEPTH:g}"] = SPHERE_DEPTH * indenter.radius_mm
    if isinstance(indenter, Flat):
        depths[f"d/a <= {PUNCH_DEPTH:g}"] = PUNCH_DEPTH * indenter.radius_mm
    if isinstance(indenter, Cone) and indenter.shaft_radius_mm is not None:
        depths["a below the shaft"] = _depth_at(law, indenter.shaft_radius_mm)
    if is_series and isinstance(indenter, Sphere):
        depth = (SERIES_CHI * layer.height_mm) ** 2 / indenter.radius_mm
        depths[f"sqrt(R d)/h <= {SERIES_CHI:g}"] = depth
    else:
        depths[f"a/h <= {WIDEST:g}"] = _depth_at(law, WIDEST * layer.height_mm)
    if area_mm2 is not None:
        what = f"shortening of the whole specimen <= {100 * COLUMN_SHARE:g} % of d"
        depths[what] = _column_depth(layer, law, area_mm2)
    return tuple(ValidityLimit(*pair) for pair in sorted(depths.items(), key=lambda pair: pair[1]))


def _depth_at(law: ContactForceLaw, radius_mm: float) -> float:
    """Depth at which contact reaches a radius; infinite beyond the table, 0 before it."""
    if radius_mm <= law.radius_mm[0]:
        return 0.0
    if radius_mm > law.radius_mm[-1]:
        return float("inf")
    log = np.interp(np.log(radius_mm), np.log(law.radius_mm), np.log(law.depth_mm))
    return float(np.exp(log))


def _column_depth(layer: Layer, law: ContactForceLaw, area_mm2: float) -> float:
    """Depth up to which a narrow specimen yields as a whole by little."""
    depths = law.depth_mm[-1] * np.logspace(-4, 0, _DEPTHS)
    per_modulus = law.force(depths) / (1 - layer.poisson_ratio**2)
    share = per_modulus * layer.height_mm / (area_mm2 * depths)
    above = np.flatnonzero(share > COLUMN_SHARE)
    return float("inf") if not above.size else float(depths[above[0] - 1]) if above[0] else 0.0


def caution(indenter: Indenter) -> str:
    """Say what no depth mends; empty where nothing is wrong."""
    if isinstance(indenter, Cone) and indenter.half_angle_deg < 75:
        return (
            f"a cone of {indenter.half_angle_deg:g} deg strains by the same amount at any depth: a "
            "neo-Hookean solid resists 10 % less than the closed form at 30 deg, 7 % at 45 deg, "
            "5 % at 60 deg, and the modulus is as much too low"
        )
    return ""
