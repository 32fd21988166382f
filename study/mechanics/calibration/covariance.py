"""What a fit knows and what it cannot know: covariance, intervals, identifiability.

Everything starts from a QR of the column-scaled Jacobian; ``inv(J'J)`` loses every digit of
the standard errors on six of NIST's 27 sets.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from study.ground.arrays import Array, Flags
from study.ground.units import times

#: V39: a warning is due above these
CAUTION_CORRELATION = 0.95
CAUTION_CONDITION = 100.0
#: V39: not identifiable above this
LIMIT_CORRELATION = 0.99
#: share of the largest force below which what an interval leaves open does not matter
AS_GOOD_AS_ZERO = 0.01


@dataclass(frozen=True)
class Uncertainty:
    """Covariance of least-squares estimates; the error variance is estimated from the fit."""

    #: shape (p, p); ``s^2 (J'J)^-1`` with ``s^2 = rss / (n - p)``: weights are relative, so that a
    #: common factor on all of them changes nothing.
    covariance: Array
    #: shape (p,)
    standard_error: Array
    #: shape (p, 2); student-t intervals with n - p degrees of freedom.
    ci95: Array
    #: shape (p, p)
    correlation: Array
    condition: float
    #: Numerical rank of the scaled Jacobian.
    rank: int
    degrees_of_freedom: int
    #: shape (p,); largest change of a force by a constant, over the largest force.
    influence: Array | None = None


def uncertainty(
    jacobian: Array, residual: Array, values: Array, free: Flags | None = None
) -> Uncertainty:
    """Covariance, standard errors, 95 % intervals and correlation at a minimum."""
    # Shapes: jacobian (n, p); residual (n,); values (p,); free (p,).
    n, p = jacobian.shape
    free = np.ones(p, bool) if free is None else free
    dof = n - int(free.sum())
    inverse, rank = scaled_inverse(jacobian[:, free])
    covariance = np.full((p, p), np.nan)
    variance = float(residual @ residual) / dof if dof > 0 else np.nan
    covariance[np.ix_(free, free)] = variance * inverse
    error = np.sqrt(np.diag(covariance))
    half = student_t(dof) * error
    correlation = np.full((free.size, free.size), np.nan)
    scale = np.sqrt(np.diag(inverse))
    inner = inverse / np.outer(scale, scale)
    np.fill_diagonal(inner, np.where(np.isfinite(scale), 1.0, np.nan))
    correlation[np.ix_(free, free)] = inner
    return Uncertainty(
        covariance,
        error,
        np.stack([values - half, values + half], axis=1),
        correlation,
        scaled_condition(jacobian[:, free], values[free]),
        rank,
        dof,
    )


def influence(jacobian: Array, force: Array) -> Array:
    """Largest change of a force by every parameter, over the largest force; both weighted."""
    # Shapes: jacobian (n, p); force (n,); returns (p,).
    largest = np.abs(jacobian).max(axis=0, initial=0.0)
    return np.asarray(largest / np.abs(force).max())


def scaled_inverse(jacobian: Array) -> tuple[Array, int]:
    """``(J'J)^-1`` by QR of the column-scaled Jacobian, and its rank; NaN if deficient."""
    # Shapes: jacobian (n, p); returns (p, p).
    p = jacobian.shape[1]
    norms = np.linalg.norm(jacobian, axis=0)
    if p == 0 or jacobian.shape[0] < p or not np.all(norms > 0):
        return np.full((p, p), np.nan), int(np.count_nonzero(norms))
    triangle = np.linalg.qr(jacobian / norms, mode="r")
    singular = np.linalg.svd(triangle, compute_uv=False)
    rank = int(np.sum(singular > max(jacobian.shape) * np.finfo(float).eps * singular[0]))
    if rank < p:
        return np.full((p, p), np.nan), rank
    inverse = np.linalg.solve(triangle, np.eye(p)) / norms[:, None]
    return inverse @ inverse.T, rank


def scaled_condition(jacobian: Array, values: Array) -> float:
    """cond(J diag(theta)): sensitivity to relative changes; a zero constant counts as one."""
    # Shapes: jacobian (n, p); values (p,).
    if jacobian.size == 0:
        return 1.0
    scaled = jacobian * np.where(values == 0, 1.0, values)
    singular = np.linalg.svd(scaled, compute_uv=False)
    return float(singular[0] / singular[-1]) if singular[-1] > 0 else float("inf")


def student_t(degrees_of_freedom: int) -> float:
    """Two-sided quantile of Student's t at 95 %; NaN without degrees of freedom."""
    if degrees_of_freedom <= 0:
        return float("nan")
    from scipy.special import stdtrit

    return float(stdtrit(degrees_of_freedom, 0.975))


def identifiability(names: Sequence[str], values: Array, estimate: Uncertainty) -> tuple[bool, str]:
    """Verdict of V39 on whether the data determine every constant, and why.

    Not identifiable: rank-deficient, two constants correlated beyond 0.99, or an interval
    wider than twice the value of a constant, unless half of it changes no force by more than 1 %
    of the largest: such a constant is known to be as good as zero. A correlation beyond 0.95
    or a scaled condition number above 100 is only a caution.

    Shapes: values (p,).
    """
    free = np.isfinite(np.diag(estimate.correlation)) | (estimate.rank < len(names))
    if estimate.rank < int(free.sum()) and not np.isfinite(estimate.correlation).all():
        listed = " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
        rank = f"{estimate.rank} of {len(names)} combinations"
        return False, f"the data determine only {rank} of {listed}"
    off = np.nan_to_num(estimate.correlation - np.diag(np.diag(estimate.correlation)))
    i, j = np.unravel_index(int(np.argmax(np.abs(off))), off.shape)
    first, second, worst = min(int(i), int(j)), max(int(i), int(j)), float(off[i, j])
    if abs(worst) > LIMIT_CORRELATION:
        # errors that go together leave only first / s1 -+ second / s2 determined
        ratio = float(estimate.standard_error[first] / estimate.standard_error[second])
        sign, shown = ("+" if worst < 0 else "-"), f"{ratio:.3g}"
        leading, second_name = names[first], names[second]
        also = second_name if shown == "1" else f"{shown} {second_name}"
        return False, (
            f"{leading} and {second_name} move together: correlation {worst:.4f}; "
            f"only {leading} {sign} {also} is determined"
        )
    if estimate.degrees_of_freedom <= 0:
        return False, "as many constants as points: nothing is left to judge them by"
    if wide := _widest(names, values, estimate):
        return False, wide
    caution = ""
    if abs(worst) > CAUTION_CORRELATION:
        caution = f"caution: {names[first]} and {names[second]} are correlated by {worst:.4f}"
    elif estimate.condition > CAUTION_CONDITION:
        number = float(f"{estimate.condition:.3g}")
        caution = f"caution: the scaled condition number is {number:,.0f}"
    return True, caution


def _widest(names: Sequence[str], values: Array, estimate: Uncertainty) -> str:
    width = estimate.ci95[:, 1] - estimate.ci95[:, 0]
    # an interval that changes no force by more than this says that the constant is zero
    seen = np.inf if estimate.influence is None else 0.5 * width * estimate.influence
    ratio = np.zeros(values.size)
    np.divide(width, np.abs(values), out=ratio, where=(values != 0) & (seen > AS_GOOD_AS_ZERO))
    worst = int(np.argmax(np.nan_to_num(ratio)))
    if not ratio[worst] > 2:
        return ""
    return f"the 95 % interval of {names[worst]} is {times(ratio[worst])} as wide as its value"
