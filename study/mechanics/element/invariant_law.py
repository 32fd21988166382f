"""Compiled energies of the isochoric invariants: W and its derivatives by I1bar and I2bar.

One function for every law of ``PointLaw`` from ``POLYNOMIAL`` on; what
the constants mean stands beside the energies in :mod:`study.mechanics.material`. A state that an
energy does not reach, such as one beyond the end of its chains, is told and has no derivatives.
"""

from __future__ import annotations

import math

from study.ground.arrays import Array
from study.ground.compilation import FAST, part
from study.mechanics.material.energy import PointLaw
from study.mechanics.material.exponential import LARGEST_EXPONENT

#: Plain numbers, which kernels take for constants; from POLYNOMIAL on, laws of the invariants.
POLYNOMIAL = int(PointLaw.POLYNOMIAL)
EXPONENTIAL = int(PointLaw.EXPONENTIAL)
FINITE_EXTENSIBILITY = int(PointLaw.FINITE_EXTENSIBILITY)
VAN_DER_WAALS = int(PointLaw.VAN_DER_WAALS)
VAN_DER_WAALS_BY_MIXTURE = int(PointLaw.VAN_DER_WAALS_BY_MIXTURE)
#: mixed invariant less 3 below which its root is that of rounding
_REST = 1e-30


@part()
def invariant_derivatives(law: int, constants: Array, a: float, b: float, out: Array) -> bool:
    """Differentiate an energy by a = I1bar - 3 and b = I2bar - 3: a new law has its branch here.

    Shapes: constants (n, m); out (5 or more,).
    """
    out[:] = 0.0
    if law == POLYNOMIAL:
        polynomial_derivatives(constants, a, b, out)
        return True
    if law == EXPONENTIAL:
        return bool(exponential_derivatives(constants, a, out))
    if law == FINITE_EXTENSIBILITY:
        return bool(finite_extensibility_derivatives(constants, a, out))
    if law in (VAN_DER_WAALS, VAN_DER_WAALS_BY_MIXTURE):
        by_mixture = law == VAN_DER_WAALS_BY_MIXTURE
        return bool(van_der_waals_derivatives(constants, a, b, by_mixture, out))
    out[:] = math.nan  # no such law: never a stress of zero
    return True


@part(fastmath=FAST)
def invariant_energy(law: int, constants: Array, a: float, b: float) -> float:
    """Energy W per reference volume that :func:`invariant_derivatives` differentiates.

    Units: returns MPa.
    """
    if law == POLYNOMIAL:
        return polynomial_energy(constants, a, b)
    if law == EXPONENTIAL:
        p, q, k = constants[0, 0], constants[1, 0], constants[2, 0]
        linear = constants[0, 1] * b if constants.shape[1] > 1 else 0.0
        return float(p * math.expm1(k * a) + q * a * math.exp(k * a) + linear)
    if law == FINITE_EXTENSIBILITY:
        e = constants[0, 0]
        s = 1.0 / (1.0 - e * a)
        logarithm = -constants[1, 0] * math.log1p(-e * a) / e
        powers = constants[2, 0] + 0.5 * constants[3, 0] * (2.0 - e * a) * s
        return float(logarithm + a * s * powers)
    if law == VAN_DER_WAALS:
        room, beta = constants[0, 0], constants[0, 1]
        x = max((1.0 - beta) * a + beta * b, 0.0)
        eta = math.sqrt(x / room)
        chains = -2.0 * room * constants[1, 0] * (math.log1p(-eta) + eta)
        return float(chains + 2.0 / 3.0 * constants[2, 0] * x * math.sqrt(x))
    return math.nan


@part()
def exponential_derivatives(constants: Array, a: float, out: Array) -> bool:
    """Of (p + q a) exp(k a) - p + d b. Shapes: constants (3, 1), MPa; out (5 or more,)."""
    p, q, k = constants[0, 0], constants[1, 0], constants[2, 0]
    if not k * a < LARGEST_EXPONENT:
        return False
    growth, height = math.exp(k * a), p + q * a
    out[0] = (q + k * height) * growth
    out[2] = k * (2.0 * q + k * height) * growth
    if constants.shape[1] > 1:
        out[1] = constants[0, 1]
    return True


@part()
def finite_extensibility_derivatives(constants: Array, a: float, out: Array) -> bool:
    """W_a = A1 s + A2 s^2 + A3 s^3 with s = 1 / (1 - e a).

    Shapes: constants (4 or more, 1), MPa; out (5 or more,).
    """
    e, first, second, third = constants[0, 0], constants[1, 0], constants[2, 0], constants[3, 0]
    gap = 1.0 - e * a
    if not gap > 0.0:
        return False
    s = 1.0 / gap
    out[0] = s * (first + s * (second + s * third))
    out[2] = e * s * s * (first + s * (2.0 * second + s * 3.0 * third))
    return True


@part()
def van_der_waals_derivatives(
    constants: Array, a: float, b: float, by_mixture: bool, out: Array
) -> bool:
    """P / (1 - eta) + Q eta / (1 - eta)^2 + S sqrt(x) is dW/dx, x = (1 - beta) a + beta b.

    The derivative by beta has no second derivatives here: a rate of the stress needs none.

    Shapes: constants (3, 2), MPa; out (5 or more,).
    """
    room, beta = constants[0, 0], constants[0, 1]
    p, q, s = constants[1, 0], constants[1, 1], constants[2, 0]
    x = max((1.0 - beta) * a + beta * b, 0.0)
    root = math.sqrt(x)
    eta = root / math.sqrt(room)
    if not eta < 1.0:
        return False
    gap = 1.0 / (1.0 - eta)
    slope, curvature = gap * (p + q * eta * gap) + s * root, 0.0
    if x > _REST:
        by_eta = gap * gap * (p + q * (1.0 + 2.0 * eta * gap))
        curvature = 0.5 * (by_eta / math.sqrt(room) + s) / root
    if by_mixture:
        turned = curvature * (b - a)
        out[0], out[1] = (1.0 - beta) * turned - slope, beta * turned + slope
        out[2] = out[3] = out[4] = math.nan
        return True
    out[0], out[1] = (1.0 - beta) * slope, beta * slope
    out[2], out[3] = (1.0 - beta) ** 2 * curvature, (1.0 - beta) * beta * curvature
    out[4] = beta**2 * curvature
    return True


@part()
def _power_derivatives(x: float, n: int) -> tuple[float, float, float]:
    """x^n and its first two derivatives, exact at x = 0."""
    value = x**n if n > 0 else 1.0
    first = n * x ** (n - 1) if n > 1 else (1.0 if n == 1 else 0.0)
    second = n * (n - 1) * x ** (n - 2) if n > 2 else (2.0 if n == 2 else 0.0)
    return value, first, second


@part()
def polynomial_derivatives(table: Array, a: float, b: float, out: Array) -> None:
    """Add the derivatives of sum C_ij a^i b^j. Shapes: table (ni, nj), MPa; out (5 or more,)."""
    for i in range(table.shape[0]):
        ai, ai1, ai2 = _power_derivatives(a, i)
        for j in range(table.shape[1]):
            c = table[i, j]
            if c != 0.0:
                bj, bj1, bj2 = _power_derivatives(b, j)
                out[0] += c * ai1 * bj
                out[1] += c * ai * bj1
                out[2] += c * ai2 * bj
                out[3] += c * ai1 * bj1
                out[4] += c * ai * bj2


@part(fastmath=FAST)
def polynomial_energy(table: Array, a: float, b: float) -> float:
    """Sum C_ij a^i b^j. Shapes: table (ni, nj), MPa."""
    energy, row = 0.0, 1.0
    for i in range(table.shape[0]):
        term = row
        for j in range(table.shape[1]):
            energy += table[i, j] * term
            term *= b
        row *= a
    return energy
