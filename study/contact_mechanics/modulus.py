"""Young's modulus of one indentation curve by least squares, with an interval.

Force is E* times a known function of depth, so that E* is linear; a depth of contact, where it is
asked for, is searched by variable projection (Golub and Pereyra 1973). Neighboring residuals are
correlated: the variance is that of least squares under autoregressive errors of first order,
whose coefficient is estimated from the residuals and corrected for its bias.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.linalg import solve_banded
from scipy.optimize import minimize_scalar
from scipy.special import stdtrit

from study.arrays import Array, Flags
from study.contact_mechanics.force_law import ForceLaw

Status = Literal["fitted", "outside", "implausible", "unreadable"]

#: rows in contact and within the limits that a fit needs
MIN_ROWS = 5

#: depths of contact that are tried before the best of them is refined
_TRIED = 41

#: share of the travel up to which contact may begin, and before its start that it may have begun
_LATEST = 0.9
_EARLIEST = -0.2

#: rounds of fitting and of choosing the rows within the limits of the depth so found
_ROUNDS = 8

#: largest correlation of neighboring residuals that is told from a trend
_MOST_CORRELATED = 0.99


@dataclass(frozen=True)
class CurveModulus:
    """Modulus of one curve.

    Parameters
    ----------
    status : {"fitted", "outside", "implausible", "unreadable"}
        How the fit ended.
    message : str
        Why there is no modulus; empty where there is one.
    rows, rows_outside : int
        Rows in contact, and how many of them lie beyond a limit.
    modulus_MPa, error_MPa : float, optional
        Young's modulus and its standard error.
    interval_MPa : tuple of float, optional
        95 % interval.
    contact_mm, contact_error_mm : float, optional
        Displacement at contact and its standard error, where it was fitted.
    correlation : float, optional
        Of neighboring residuals.
    relative_rms : float, optional
        Root mean square of the residuals over that of the forces.
    """

    status: Status
    message: str = ""
    rows: int = 0
    rows_outside: int = 0
    modulus_MPa: float | None = None
    error_MPa: float | None = None
    interval_MPa: tuple[float, float] | None = None
    contact_mm: float | None = None
    contact_error_mm: float | None = None
    correlation: float | None = None
    relative_rms: float | None = None


def fit_modulus(
    displacement_mm: Array,
    force_N: Array,
    law: ForceLaw,
    *,
    poisson_ratio: float,
    deepest_mm: float,
    find_contact: bool = False,
) -> CurveModulus:
    """Fit Young's modulus to the rows of one curve that lie within the limits.

    Parameters
    ----------
    displacement_mm, force_N : ndarray, shape (n,)
        The curve, rising in displacement.
    law : ForceLaw
        Force over E* by depth.
    poisson_ratio : float
        Of the specimen.
    deepest_mm : float
        Depth up to which rows are used.
    find_contact : bool
        Whether the displacement at contact is fitted as well; 0 otherwise.
    """
    contact = 0.0
    used: Flags = np.zeros(displacement_mm.shape, dtype=bool)
    for _ in range(_ROUNDS if find_contact else 1):
        if find_contact:
            chosen = used if used.any() else np.ones_like(used)
            contact = _contact(displacement_mm[chosen], force_N[chosen], law)
        before, used = used, displacement_mm - contact <= deepest_mm
        if np.array_equal(before, used) or _touching(displacement_mm[used], contact) < MIN_ROWS:
            break
    rows = _touching(displacement_mm, contact)
    outside = int(np.count_nonzero(~used))
    if _touching(displacement_mm[used], contact) < MIN_ROWS:
        rule = f"{rows - outside} of {rows} rows in contact are within the limits, {MIN_ROWS} must"
        return CurveModulus("outside", rule, rows, outside)
    d, f = displacement_mm[used], force_N[used]
    return _judged(d - contact, f, law, poisson_ratio, (rows, outside), contact, find_contact)


def _touching(displacement: Array, contact: float) -> int:
    return int(np.count_nonzero(displacement > contact))


def _contact(d: Array, force: Array, law: ForceLaw) -> float:
    """Displacement at contact that leaves the least sum of squares."""
    span = float(np.ptp(d))
    tried = d[0] + span * np.linspace(_EARLIEST, _LATEST, _TRIED)
    explained = _explained(law.force(d - tried[:, None]), force)
    best = int(np.argmax(explained))
    step = tried[1] - tried[0]

    def loss(contact: float) -> float:
        return -float(_explained(law.force(d - contact)[None, :], force)[0])

    ends = (tried[best] - step, tried[best] + step)
    return float(minimize_scalar(loss, bounds=ends, options={"xatol": 1e-6 * span}).x)


def _explained(shapes: Array, force: Array) -> Array:
    """Sum of squares that each of several curves in proportion explains, shape (m,)."""
    size = np.maximum(np.einsum("ij,ij->i", shapes, shapes), 1e-300)
    return np.asarray((shapes @ force) * np.abs(shapes @ force) / size)


def _judged(
    depth: Array,
    force: Array,
    law: ForceLaw,
    poisson_ratio: float,
    rows: tuple[int, int],
    contact: float,
    find_contact: bool,
) -> CurveModulus:
    """Modulus and interval at a known contact; its slope enters the covariance."""
    shape = law.force(depth)
    plane_strain = float(shape @ force / (shape @ shape))
    if plane_strain <= 0:
        rule = f"the modulus would be {1e3 * plane_strain:.4g} kPa: check sign and contact"
        return CurveModulus("implausible", rule, *rows)
    columns = [shape, -plane_strain * law.stiffness(depth)] if find_contact else [shape]
    jacobian = np.column_stack(columns)
    residual = force - plane_strain * shape
    covariance, correlation, freedom = _covariance(jacobian, residual)
    scale = 1 - poisson_ratio**2
    value, error = scale * plane_strain, scale * float(np.sqrt(covariance[0, 0]))
    half = float(stdtrit(freedom, 0.975)) * error
    return CurveModulus(
        "fitted",
        "",
        *rows,
        modulus_MPa=value,
        error_MPa=error,
        interval_MPa=(value - half, value + half),
        contact_mm=contact if find_contact else None,
        contact_error_mm=float(np.sqrt(covariance[1, 1])) if find_contact else None,
        correlation=correlation,
        relative_rms=float(np.sqrt(residual @ residual / (force @ force))),
    )


def _covariance(jacobian: Array, residual: Array) -> tuple[Array, float, float]:
    """Covariance under AR(1) errors, their coefficient, and degrees of freedom.

    With R_ij = r^|i-j| and B = (J'J)^-1 J'RJ the expected residual sum of squares is
    sigma^2 (n - tr B), and the covariance sigma^2 B (J'J)^-1.
    """
    n, p = jacobian.shape
    size = float(residual @ residual)
    lag = float(residual[1:] @ residual[:-1]) / size if size > 0 else 0.0
    # low by about (p + (p + 2) r) / n after a fit of p constants (Kendall 1954 for a mean); half a
    # standard error more, because an interval suffers more from too low an r than from too high
    r = (n * lag + p) / max(n - p - 2, 1)
    r += 0.5 * float(np.sqrt(max(1 - r**2, 0.0) / n))
    r = float(np.clip(r, 0.0, _MOST_CORRELATED))
    # sums over all rows before, r J_(i-1) + r^2 J_(i-2) + ..., from s_i - r s_(i-1) = r J_(i-1)
    bands = np.vstack([np.ones(n), np.full(n, -r)])
    before = solve_banded((1, 0), bands, r * np.vstack([np.zeros((1, p)), jacobian[:-1]]))
    cross = jacobian.T @ before
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    spread = inverse @ (jacobian.T @ jacobian + cross + cross.T)
    left = max(n - float(np.trace(spread)), 1.0)
    freedom = max(n * (1 - r) / (1 + r) - p, 1.0)
    return np.asarray(size / left * spread @ inverse), r, freedom
