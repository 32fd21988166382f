"""Compiled constitutive law at one point: energies of invariants, small strain, the pressure.

With Penn's split ``I1bar = J^(-2/3) I1``, ``I2bar = J^(-4/3) I2`` the energy is W(I1bar, I2bar),
for example ``sum C_ij (I1bar - 3)^i (I2bar - 3)^j``. Nine numbers ``f[3 i + j] = F_ij`` hold a
tensor.
"""

from __future__ import annotations

import math

from study.ground.arrays import Array
from study.ground.compilation import FAST, part
from study.mechanics.element.invariant_law import (
    FINITE_EXTENSIBILITY,
    POLYNOMIAL,
    invariant_derivatives,
)
from study.mechanics.element.spectral import BY_EXPONENT, STRESS, ogden_stress, ogden_tangent
from study.mechanics.element.spectral import WORK_ROWS as SPECTRAL_ROWS
from study.mechanics.material.energy import PointLaw

#: Plain numbers, which kernels take for constants.
SMALL_STRAIN = int(PointLaw.SMALL_STRAIN)
OGDEN_BY_EXPONENT = int(PointLaw.OGDEN_BY_EXPONENT)
EXTENDED_TUBE = int(PointLaw.EXTENDED_TUBE)
#: scratch rows of nine numbers: those of principal stretches, of invariants, and a tangent
WORK_ROWS = SPECTRAL_ROWS + 7 + 9


@part()
def isochoric(law: int, f: Array, constants: Array, work: Array, stress: Array) -> float:
    """Isochoric stress of a law; J is returned, row 0 of ``work`` is dJ/dF / J.

    For small strain J is linear and row 0 is dJ/dF itself. A state that the energy does not
    reach is told as an inverted one is, by a J of -1.

    Shapes: f (9,); constants (n, k); work (WORK_ROWS, 9); stress (9,).
    """
    if law >= POLYNOMIAL:
        return float(invariant_stress(law, f, constants, work, stress))
    if law == SMALL_STRAIN:
        return float(linear_stress(f, constants[0, 0], work, stress))
    J = cofactor(f, work[0])
    if J > 0.0:
        for i in range(9):
            work[0, i] /= J
        if law == EXTENDED_TUBE:
            return float(extended_tube_stress(f, J, constants, work, stress))
        what = BY_EXPONENT if law == OGDEN_BY_EXPONENT else STRESS
        ogden_stress(f, constants, what, work, stress)
    return float(J)


@part()
def full_tangent(
    law: int,
    f: Array,
    constants: Array,
    plane: bool,
    bend: float,
    stiff: float,
    work: Array,
    tangent: Array,
) -> None:
    """Tangent of :func:`isochoric`, called before, and of a pressure. Shapes: tangent (9, 9)."""
    if law >= POLYNOMIAL:
        invariant_tangent(f, plane, bend, stiff, work, tangent)
        return
    if law == SMALL_STRAIN:
        linear_tangent(constants[0, 0], tangent)
    elif law == EXTENDED_TUBE:
        extended_tube_tangent(f, plane, constants, work, tangent)
    else:
        ogden_tangent(constants, work, tangent)
    add_pressure_tangent(work[0], bend, stiff, tangent)


@part()
def cofactor(f: Array, g: Array) -> float:
    """Write the cofactor matrix dJ/dF of ``f`` into ``g``; return J. Shapes: f, g (9,)."""
    g[0] = f[4] * f[8] - f[5] * f[7]
    g[1] = f[5] * f[6] - f[3] * f[8]
    g[2] = f[3] * f[7] - f[4] * f[6]
    g[3] = f[2] * f[7] - f[1] * f[8]
    g[4] = f[0] * f[8] - f[2] * f[6]
    g[5] = f[1] * f[6] - f[0] * f[7]
    g[6] = f[1] * f[5] - f[2] * f[4]
    g[7] = f[2] * f[3] - f[0] * f[5]
    g[8] = f[0] * f[4] - f[1] * f[3]
    return float(f[0] * g[0] + f[1] * g[1] + f[2] * g[2])


@part(fastmath=FAST)
def invariant_stress(law: int, f: Array, constants: Array, work: Array, stress: Array) -> float:
    """Isochoric nominal stress of an energy of the isochoric invariants.

    Shapes: f, stress (9,); work (7 or more, 9).
    """
    g, right, left, d1, d2, w = work[0], work[1], work[2], work[3], work[4], work[5]
    J = cofactor(f, g)
    if not J > 0.0:
        return J
    for i in range(9):
        g[i] /= J
    I1 = 0.0
    for i in range(9):
        I1 += f[i] * f[i]
    s1 = J ** (-2.0 / 3.0)
    second = constants.shape[1] > 1
    s2, I2 = s1 * s1, 0.0
    if second:
        trace = 0.0
        for i in range(3):
            for j in range(3):
                c = 0.0
                b = 0.0
                for k in range(3):
                    c += f[3 * k + i] * f[3 * k + j]
                    b += f[3 * i + k] * f[3 * j + k]
                right[3 * i + j] = c
                left[3 * i + j] = b
                trace += c * c
        I2 = 0.5 * (I1 * I1 - trace)
    a, b = s1 * I1 - 3.0, s2 * I2 - 3.0 if second else 0.0
    if not invariant_derivatives(law, constants, a, b, w):
        return -1.0
    for i in range(9):
        d1[i] = s1 * (2.0 * f[i] - 2.0 / 3.0 * I1 * g[i])
        stress[i] = w[0] * d1[i]
    if second:
        for i in range(3):
            for j in range(3):
                fc = 0.0
                for k in range(3):
                    fc += f[3 * i + k] * right[3 * k + j]
                n = 3 * i + j
                d2[n] = s2 * (2.0 * (I1 * f[n] - fc) - 4.0 / 3.0 * I2 * g[n])
                stress[n] += w[1] * d2[n]
    work[6, 0], work[6, 1], work[6, 2], work[6, 3] = I1, I2, s1, s2
    return J


@part(fastmath=FAST)
def invariant_tangent(
    f: Array, plane: bool, bend: float, stiff: float, work: Array, tangent: Array
) -> None:
    """Tangent of :func:`invariant_stress` in both invariants, called before, and of a pressure.

    What an invariant owes to each dyad, and what its slope does. The pressure's part is that
    of :func:`add_pressure_tangent` and costs nothing here. An energy of the first invariant
    has a shorter way, see :func:`first_invariant_coefficients`.
    """
    g, d1, w = work[0], work[3], work[5]
    I1, s1 = work[6, 0], work[6, 2]
    first, curved = w[0] * s1, w[2]
    turned = 2.0 / 3.0 * first * I1 - bend
    for i in range(3):
        for j in range(3):
            if not plane or (i == 2) == (j == 2):
                n = 3 * i + j
                along_f = -4.0 / 3.0 * first * g[n]
                along_g = (4.0 / 9.0 * first * I1 + bend + stiff) * g[n] - 4.0 / 3.0 * first * f[n]
                along_d = curved * d1[n]
                for k in range(i, 3):
                    crossed = turned * g[3 * k + j]
                    for m in range(3):
                        o = 3 * k + m
                        if o >= n and (not plane or (k == 2) == (m == 2)):
                            value = along_f * f[o] + along_g * g[o] + along_d * d1[o]
                            tangent[n, o] = value + crossed * g[3 * i + m]
                tangent[n, n] += 2.0 * first
    _add_second_invariant(f, plane, work, tangent)
    for n in range(1, 9):
        for o in range(n):
            tangent[n, o] = tangent[o, n]


@part(fastmath=FAST)
def first_invariant_coefficients(
    work: Array, bend: float, stiff: float, w: float
) -> tuple[float, float, float, float, float]:
    """Coefficients of w dP/dF where W depends on the first invariant alone.

    With G = F^-T, and :func:`invariant_stress` called before,

        w dP_ij/dF_kl = c_1 d_ik d_jl + c_x G_il G_kj
                        + c_FF F_ij F_kl + c_FG (F_ij G_kl + G_ij F_kl) + c_GG G_ij G_kl

    Units: work, bend, stiff, w mm^3; returns N mm.
    """
    I1, s1 = work[6, 0], work[6, 2]
    first, curved = work[5, 0] * s1, work[5, 2]
    c_x = w * (2.0 / 3.0 * first * I1 - bend)
    # dI1bar/dF = along F + back G
    along, back = 2.0 * s1, -2.0 / 3.0 * s1 * I1
    c_FF = w * curved * along * along
    c_FG = w * (curved * along * back - 4.0 / 3.0 * first)
    c_GG = w * (4.0 / 9.0 * first * I1 + bend + stiff + curved * back * back)
    return 2.0 * w * first, c_x, c_FF, c_FG, c_GG


@part(fastmath=FAST)
def _add_second_invariant(f: Array, plane: bool, work: Array, tangent: Array) -> None:
    """Add what W owes to the second invariant, alone and together with the first."""
    g, right, left, d1, d2, w = work[0], work[1], work[2], work[3], work[4], work[5]
    I1, I2, s2 = work[6, 0], work[6, 1], work[6, 3]
    slope = w[1] * s2
    for i in range(3):
        for j in range(3):
            if plane and (i == 2) != (j == 2):
                continue
            n = 3 * i + j
            # dI2/dF is d2 / s2 + 4/3 I2 G
            along_g = -4.0 / 3.0 * (w[1] * d2[n] + 4.0 / 3.0 * slope * I2 * g[n])
            along_d1 = w[3] * d2[n]
            along_d2 = w[4] * d2[n] + w[3] * d1[n] - 4.0 / 3.0 * w[1] * g[n]
            along_f = 4.0 * slope * f[n]
            for k in range(i, 3):
                crossed, turned = 4.0 / 3.0 * slope * I2 * g[3 * k + j], 2.0 * slope * f[3 * k + j]
                for m in range(3):
                    o = 3 * k + m
                    if o >= n and (not plane or (k == 2) == (m == 2)):
                        value = along_f * f[o] + along_g * g[o] + along_d1 * d1[o]
                        value += along_d2 * d2[o] + crossed * g[3 * i + m]
                        tangent[n, o] += value - turned * f[3 * i + m]
            for k in range(3):
                if k >= j:
                    tangent[n, 3 * i + k] -= 2.0 * slope * right[3 * k + j]
                if k >= i:
                    tangent[n, 3 * k + j] -= 2.0 * slope * left[3 * i + k]
            tangent[n, n] += 2.0 * slope * I1


@part()
def invariants_beyond_rest(f: Array, d: Array) -> tuple[float, float]:
    """I1bar - 3 and I2bar - 3, by F - 1: they are squares of strains, and 3 would leave rounding.

    With D = F'F - 1 these are I1 - 3 = tr D, I2 - 3 = 2 tr D + II(D), J^2 - 1 = tr D + II(D) +
    det D.

    Shapes: f (9,); d (9,), which receives D.
    """
    square = 0.0
    for i in range(3):
        for j in range(3):
            value = f[3 * i + j] + f[3 * j + i] - (2.0 if i == j else 0.0)
            for k in range(3):
                along = f[3 * k + i] - (1.0 if k == i else 0.0)
                value += along * (f[3 * k + j] - (1.0 if k == j else 0.0))
            d[3 * i + j] = value
            square += value * value
    trace = d[0] + d[4] + d[8]
    second = 0.5 * (trace * trace - square)
    third = d[0] * (d[4] * d[8] - d[5] * d[7]) - d[1] * (d[3] * d[8] - d[5] * d[6])
    third += d[2] * (d[3] * d[7] - d[4] * d[6])
    swollen = math.log1p(trace + second + third) / 3.0  # ln J^(2/3)
    a = trace * math.exp(-swollen) + 3.0 * math.expm1(-swollen)
    b = (2.0 * trace + second) * math.exp(-2.0 * swollen) + 3.0 * math.expm1(-2.0 * swollen)
    return a, b


@part()
def extended_tube_stress(f: Array, J: float, constants: Array, work: Array, stress: Array) -> float:
    """Isochoric stress of crosslinks, of the first invariant, and of entanglements, Ogden's.

    Shapes: f, J, stress (9,); constants (6, 1); work (WORK_ROWS, 9).
    """
    of_invariants, tubes = work[SPECTRAL_ROWS : SPECTRAL_ROWS + 7], work[SPECTRAL_ROWS + 7]
    reached = invariant_stress(FINITE_EXTENSIBILITY, f, constants, of_invariants, stress)
    if not reached > 0.0:
        return -1.0
    ogden_stress(f, constants[4:6].reshape(1, 2), STRESS, work, tubes)
    for i in range(9):
        stress[i] += tubes[i]
    return J


@part()
def extended_tube_tangent(
    f: Array, plane: bool, constants: Array, work: Array, tangent: Array
) -> None:
    """Tangent of :func:`extended_tube_stress`, called before."""
    of_invariants, chains = work[SPECTRAL_ROWS : SPECTRAL_ROWS + 7], work[SPECTRAL_ROWS + 7 :]
    ogden_tangent(constants[4:6].reshape(1, 2), work, tangent)
    chains[:] = 0.0
    invariant_tangent(f, plane, 0.0, 0.0, of_invariants, chains)
    for n in range(9):
        for o in range(9):
            tangent[n, o] += chains[n, o]


@part(fastmath=FAST)
def linear_stress(f: Array, mu: float, work: Array, stress: Array) -> float:
    """Deviatoric small-strain stress ``2 mu dev(eps)``; row 0 of ``work`` receives dJ/dF = 1.

    Shapes: f, stress (9,); mu, work (1 or more, 9), MPa.
    """
    J = f[0] + f[4] + f[8] - 2.0
    work[0, :] = 0.0
    for i in range(3):
        work[0, 4 * i] = 1.0
        for j in range(3):
            stress[3 * i + j] = mu * (f[3 * i + j] + f[3 * j + i])
        stress[4 * i] -= 2.0 / 3.0 * mu * (J + 2.0)
    return float(J)


@part(fastmath=FAST)
def linear_tangent(mu: float, tangent: Array) -> None:
    """Tangent of :func:`linear_stress`. Shapes: mu, tangent (9, 9), MPa."""
    tangent[:, :] = 0.0
    for i in range(3):
        for j in range(3):
            tangent[3 * i + j, 3 * i + j] += mu
            tangent[3 * i + j, 3 * j + i] += mu
            tangent[4 * i, 4 * j] -= 2.0 / 3.0 * mu


@part(fastmath=FAST)
def add_pressure_tangent(g: Array, bend: float, stiff: float, tangent: Array) -> None:
    """Add the tangent of ``p dJ/dF``, with ``dJ/dF = J g``. Shapes: g (9,)."""
    for i in range(3):
        for j in range(3):
            n = 3 * i + j
            along = (bend + stiff) * g[n]
            for k in range(3):
                crossed = bend * g[3 * k + j]
                for m in range(3):
                    tangent[n, 3 * k + m] += along * g[3 * k + m] - crossed * g[3 * i + m]
