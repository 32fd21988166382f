"""Compiled Ogden law: nominal stress and tangent through principal stretches.

With ``F = sum l_a n_a x N_a`` and isochoric logarithmic stretches ``x_a`` (sum zero) the
principal Kirchhoff stresses are the deviator of ``s_a = sum_p 2 mu_p / alpha_p
(exp(alpha_p x_a) - 1)``. In the mixed basis ``n_a x N_b`` the tangent is diagonal but for
its 3 x 3 block of stretches (Ogden 1984, sec. 6.1.4):

    (P_a - P_b) / (l_a - l_b)  on the symmetric and  (P_a + P_b) / (l_a + l_b)  on the
    skew part of each pair a, b.

The first is written with ``sinh(z) / z`` of half the difference of logarithms, so that
equal stretches are no special case; ``(exp(z) - 1) / z`` does the same for alpha = 0.
"""

from __future__ import annotations

import math

from study.ground.arrays import Array
from study.ground.compilation import FAST, part

#: what a column of constants does: stress of W, or of dW/dalpha
STRESS = 0
BY_EXPONENT = 1
#: scratch rows of nine numbers that every law can do with
WORK_ROWS = 27


@part()
def sinh_ratio(z: float) -> float:
    """sinh(z) / z, 1 at zero."""
    if abs(z) > 0.5:
        return math.sinh(z) / z
    y = z * z
    # next term 0.25^8 / 17! < 1e-19
    tail = 1.0 + y / 156.0 * (1.0 + y / 210.0)
    tail = 1.0 + y / 72.0 * (1.0 + y / 110.0 * tail)
    return 1.0 + y / 6.0 * (1.0 + y / 20.0 * (1.0 + y / 42.0 * tail))


@part()
def exponential_ratio(z: float) -> float:
    """(exp(z) - 1) / z, 1 at zero."""
    return math.expm1(z) / z if abs(z) > 1e-8 else 1.0 + 0.5 * z


@part()
def exponential_ratio_slope(z: float) -> float:
    """Differentiate :func:`exponential_ratio`; 1/2 at zero."""
    if abs(z) > 0.5:
        return (math.exp(z) * (z - 1.0) + 1.0) / (z * z)
    total, power = 0.0, 1.0
    for k in range(16):  # sum z^k / (k! (k + 2)): the formula cancels here
        total += power / (k + 2)
        power *= z / (k + 1)
    return total


@part()
def principal_axes(c: Array, axes: Array) -> None:
    """Diagonalize a symmetric 3 x 3 matrix by Jacobi rotations (Golub, Van Loan, sec. 8.5).

    Shapes: c (9,); axes (9,).
    """
    axes[:] = 0.0
    axes[0] = axes[4] = axes[8] = 1.0
    for _ in range(12):  # cyclic rotations converge quadratically (ibid.): five sweeps do
        off = c[1] * c[1] + c[2] * c[2] + c[5] * c[5]
        # quadratic convergence: rotations of this size change no eigenvalue
        if not off > 1e-34 * (c[0] * c[0] + c[4] * c[4] + c[8] * c[8]):
            return
        for p in range(2):
            for q in range(p + 1, 3):
                _rotate(c, axes, p, q)


@part()
def _rotate(c: Array, axes: Array, p: int, q: int) -> None:
    a = c[3 * p + q]
    if a * a <= 1e-35 * abs(c[4 * p] * c[4 * q]):
        return
    theta = 0.5 * (c[4 * q] - c[4 * p]) / a
    t = 1.0 / (abs(theta) + math.sqrt(theta * theta + 1.0))
    if theta < 0.0:
        t = -t
    cos = 1.0 / math.sqrt(t * t + 1.0)
    sin = t * cos
    c[4 * p] -= t * a
    c[4 * q] += t * a
    c[3 * p + q] = c[3 * q + p] = 0.0
    r = 3 - p - q
    x, y = c[3 * r + p], c[3 * r + q]
    c[3 * r + p] = c[3 * p + r] = cos * x - sin * y
    c[3 * r + q] = c[3 * q + r] = sin * x + cos * y
    for k in range(3):
        x, y = axes[3 * p + k], axes[3 * q + k]
        axes[3 * p + k] = cos * x - sin * y
        axes[3 * q + k] = sin * x + cos * y


@part()
def _stretches(f: Array, work: Array, lam: Array, x: Array) -> None:
    """Principal stretches, logarithmic isochoric ones, and their axes N_a in row 5."""
    c, axes = work[4], work[5]
    for i in range(3):
        for j in range(i, 3):
            c[3 * i + j] = f[i] * f[j] + f[3 + i] * f[3 + j] + f[6 + i] * f[6 + j]
            c[3 * j + i] = c[3 * i + j]
    principal_axes(c, axes)
    mean = 0.0
    for a in range(3):
        lam[a] = math.sqrt(c[4 * a])
        x[a] = 0.5 * math.log(c[4 * a])
        mean += x[a] / 3.0
    for a in range(3):
        x[a] -= mean


@part()
def _sources(x: Array, terms: Array, what: int, s: Array) -> None:
    """Principal Kirchhoff stresses: deviator of s_a, or of ds_a/dalpha."""
    s[:] = 0.0
    for k in range(terms.shape[0]):
        mu, alpha = terms[k, 0], terms[k, 1]
        for a in range(3):
            if what == BY_EXPONENT:
                s[a] += 2.0 * mu * x[a] * x[a] * exponential_ratio_slope(alpha * x[a])
            else:
                s[a] += 2.0 * mu * x[a] * exponential_ratio(alpha * x[a])
    mean = (s[0] + s[1] + s[2]) / 3.0
    for a in range(3):
        s[a] -= mean


@part()
def ogden_stress(f: Array, terms: Array, what: int, work: Array, stress: Array) -> None:
    """Isochoric nominal stress for ``sum 2 mu / alpha^2 (sum l^alpha - 3)``.

    Shapes: f (9,); terms (n, 2), MPa; work (WORK_ROWS, 9); stress (9,).
    """
    lam, x, tau = work[6, 0:3], work[6, 3:6], work[6, 6:9]
    _stretches(f, work, lam, x)
    _sources(x, terms, what, tau)
    vectors, axes = work[7], work[5]
    for a in range(3):
        for i in range(3):
            n = f[3 * i] * axes[3 * a] + f[3 * i + 1] * axes[3 * a + 1]
            n += f[3 * i + 2] * axes[3 * a + 2]
            vectors[3 * a + i] = n / lam[a]
    for i in range(3):
        for j in range(3):
            total = 0.0
            for a in range(3):
                total += tau[a] / lam[a] * vectors[3 * a + i] * axes[3 * a + j]
            stress[3 * i + j] = total


@part()
def ogden_tangent(terms: Array, work: Array, tangent: Array) -> None:
    """Tangent of :func:`ogden_stress`, called before: sum of dyad times image.

    The nine dyads are n_a x N_b.

    Shapes: terms (n, 2); work (WORK_ROWS, 9); tangent (9, 9).
    """
    dyads, images = work[9:18], work[18:27]
    vectors, axes = work[7], work[5]
    for a in range(3):
        for b in range(3):
            for i in range(3):
                for j in range(3):
                    dyads[3 * a + b, 3 * i + j] = vectors[3 * a + i] * axes[3 * b + j]
    _images(terms, work, dyads, images)
    _product(dyads, images, tangent)


@part(fastmath=FAST)
def _product(D: Array, Q: Array, A: Array) -> None:
    """Write D' Q into A, 9 x 9 arrays, in scalars so that it vectorizes."""
    for n in range(9):
        t0 = t1 = t2 = t3 = t4 = t5 = t6 = t7 = t8 = 0.0
        for m in range(9):
            d = D[m, n]
            t0 += d * Q[m, 0]
            t1 += d * Q[m, 1]
            t2 += d * Q[m, 2]
            t3 += d * Q[m, 3]
            t4 += d * Q[m, 4]
            t5 += d * Q[m, 5]
            t6 += d * Q[m, 6]
            t7 += d * Q[m, 7]
            t8 += d * Q[m, 8]
        A[n, 0], A[n, 1], A[n, 2] = t0, t1, t2
        A[n, 3], A[n, 4], A[n, 5] = t3, t4, t5
        A[n, 6], A[n, 7], A[n, 8] = t6, t7, t8


@part()
def _images(terms: Array, work: Array, dyads: Array, images: Array) -> None:
    """Write what the tangent makes of each dyad: a block of stretches, and three pairs."""
    lam, x, tau = work[6, 0:3], work[6, 3:6], work[6, 6:9]
    slope, pair = work[8, 0:3], work[8, 3:6]
    _slopes(x, terms, slope, pair)
    mean = (slope[0] + slope[1] + slope[2]) / 9.0
    for a in range(3):
        for n in range(9):
            images[4 * a, n] = 0.0
        for b in range(3):
            h = mean - (slope[a] + slope[b]) / 3.0
            if a == b:
                h += slope[a] - tau[a]
            h /= lam[a] * lam[b]
            for n in range(9):
                images[4 * a, n] += h * dyads[4 * b, n]
    for a in range(2):
        for b in range(a + 1, 3):
            half = 0.5 * (x[a] - x[b])
            growth = pair[a + b - 1] * math.cosh(half) / sinh_ratio(half)
            shear = (growth - 0.5 * (tau[a] + tau[b])) / (lam[a] * lam[b])
            spin = (tau[a] / lam[a] + tau[b] / lam[b]) / (lam[a] + lam[b])
            same, other = 0.5 * (shear + spin), 0.5 * (shear - spin)
            for n in range(9):
                first, second = dyads[3 * a + b, n], dyads[3 * b + a, n]
                images[3 * a + b, n] = same * first + other * second
                images[3 * b + a, n] = other * first + same * second


@part()
def _slopes(x: Array, terms: Array, slope: Array, pair: Array) -> None:
    """ds_a/dx_a, and (s_a - s_b) / (x_a - x_b) of the pairs 01, 02, 12."""
    slope[:] = 0.0
    pair[:] = 0.0
    for k in range(terms.shape[0]):
        mu, alpha = terms[k, 0], terms[k, 1]
        for a in range(3):
            slope[a] += 2.0 * mu * math.exp(alpha * x[a])
            for b in range(a + 1, 3):
                middle = math.exp(0.5 * alpha * (x[a] + x[b]))
                ratio = sinh_ratio(0.5 * alpha * (x[a] - x[b]))
                pair[a + b - 1] += 2.0 * mu * middle * ratio
