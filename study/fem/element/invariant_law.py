"""Compiled energies of the isochoric invariants: W and its derivatives by I1bar and I2bar.

One function for every law of :class:`study.material.energy.PointLaw` from ``POLYNOMIAL`` on; what
the constants mean stands beside the energies in :mod:`study.material.energies`. A state that an
energy does not reach, such as one beyond the end of its chains, is told and has no derivatives.
"""

from __future__ import annotations

import math

from study.arrays import Array
from study.compilation import FAST, part
from study.material.energies.exponential import LARGEST_EXPONENT
from study.material.energy import PointLaw

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

    Parameters
    ----------
    law : int
        Number of a :class:`study.material.energy.PointLaw`, ``POLYNOMIAL`` or larger.
    constants : ndarray, shape (n, m)
        As the law takes them; m = 1 if the second invariant does not enter.
    a, b : float
        Isochoric invariants less 3; ``b`` is not looked at where m = 1.
    out : ndarray, shape (5 or more,)
        Receives W_a, W_b, W_aa, W_ab, W_bb.

    Returns
    -------
    bool
        Whether the energy reaches this state.
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

    Parameters
    ----------
    law, constants, a, b
        As for :func:`invariant_derivatives`.

    Returns
    -------
    float
        In MPa; NaN for ``VAN_DER_WAALS_BY_MIXTURE``, which is the rate of an energy.
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
    """Of (p + q a) exp(k a) - p + d b.

    Parameters
    ----------
    constants : ndarray, shape (3, 1) or (3, 2)
        p and q in MPa and k in the first column; d in MPa on top of the second one.
    a : float
        I1bar - 3.
    out : ndarray, shape (5 or more,)
        As for :func:`invariant_derivatives`; zero before.

    Returns
    -------
    bool
        False where k a is ``LARGEST_EXPONENT`` or more.
    """
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

    Parameters
    ----------
    constants : ndarray, shape (4 or more, 1)
        e, plain, and A1, A2, A3 in MPa; what follows is not looked at.
    a : float
        I1bar - 3.
    out : ndarray, shape (5 or more,)
        As for :func:`invariant_derivatives`; zero before.

    Returns
    -------
    bool
        False where e a is 1 or more: the chains have ended.
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

    Parameters
    ----------
    constants : ndarray, shape (3, 2)
        Rows (lambda_m^2 - 3, beta), (P, Q) and (S, unused); P, Q and S in MPa.
    a, b : float
        Isochoric invariants less 3.
    by_mixture : bool
        Whether W is differentiated by beta first; second derivatives are then NaN.
    out : ndarray, shape (5 or more,)
        As for :func:`invariant_derivatives`.

    Returns
    -------
    bool
        False where eta = sqrt(x / (lambda_m^2 - 3)) is 1 or more: the chains have ended.
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
    """Add the derivatives of sum C_ij a^i b^j.

    Parameters
    ----------
    table : ndarray, shape (ni, nj)
        C_ij in MPa.
    a, b : float
        Isochoric invariants less 3.
    out : ndarray, shape (5 or more,)
        As for :func:`invariant_derivatives`, added to.
    """
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
    """Sum C_ij a^i b^j.

    Parameters
    ----------
    table : ndarray, shape (ni, nj)
        C_ij in MPa.
    a, b : float
        Isochoric invariants less 3.
    """
    energy, row = 0.0, 1.0
    for i in range(table.shape[0]):
        term = row
        for j in range(table.shape[1]):
            energy += table[i, j] * term
            term *= b
        row *= a
    return energy
