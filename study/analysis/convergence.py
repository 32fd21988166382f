"""Mesh convergence: behaviour first, then order, extrapolation and GCI, or a refusal.

References: Celik et al. (2008), J. Fluids Eng. 130, 078001 (three meshes, unequal ratios);
Eca and Hoekstra (2014), J. Comput. Phys. 262, 104-130 (least squares for four or more).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from study.analysis.matrix import Array
from study.analysis.results import plain
from study.errors import Fault, InputError

_SAFE, _CAUTIOUS = 1.25, 3.0
_MIN_ORDER, _MAX_ORDER = 0.5, 20.0
_MIN_RATIO = 1.3


@dataclass(frozen=True)
class ConvergenceResult:
    """What a refinement series tells; keys are those of ``study converge --json``.

    ``gci_fine`` is a fraction of the finest value; ``u_num`` is the same half-width in the
    unit of the value (``gci_fine * abs(value[0])``), the solver tolerance at the noise floor,
    or half the range of four or more oscillating values.
    """

    qoi: str
    unit: str
    mesh_size: tuple[float, ...]
    value: tuple[float, ...]
    behaviour: str
    observed_order: float | None
    formal_order: float | None
    extrapolated: float | None
    gci_fine: float | None
    factor_of_safety: float | None
    u_num: float | None
    asymptotic_ratio: float | None
    verdict: str
    order_used: float | None = None
    gci_coarse: float | None = None
    warnings: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """JSON document."""
        return dict(plain(self))


@dataclass(frozen=True)
class _Fit:
    order: float
    extrapolated: float
    scatter: float
    misfit: float
    consistent: bool


def grid_convergence(
    sizes: ArrayLike,
    values: ArrayLike,
    *,
    formal_order: float | None = None,
    tolerance: float = 0.0,
    qoi: str = "value",
    unit: str = "",
) -> ConvergenceResult:
    """Classify a refinement series, then estimate order, limit and uncertainty.

    Parameters
    ----------
    sizes : array_like, shape (n,)
        Mesh sizes, in any order, n >= 3.
    values : array_like, shape (n,)
        Value of the quantity on each mesh.
    formal_order : float, optional
        Order that the element promises for this quantity.
    tolerance : float
        Algebraic error of a value (solver tolerance), in its unit.

    Raises
    ------
    InputError
        For fewer than three meshes, equal sizes, or values that are not numbers.

    Examples
    --------
    >>> result = grid_convergence([1, 2, 4], [0.97050, 0.96854, 0.96178])
    >>> result.behaviour, round(result.observed_order, 7), round(result.gci_fine, 8)
    ('monotone', 1.7861696, 0.00103083)
    """
    h, f = _checked(sizes, values, formal_order, tolerance)
    warnings = _ratio_warnings(h)
    behaviour = classify(h, f, tolerance)
    base: dict[str, Any] = {
        "qoi": qoi,
        "unit": unit,
        "mesh_size": tuple(h.tolist()),
        "value": tuple(f.tolist()),
        "behaviour": behaviour,
        "formal_order": formal_order,
        "warnings": tuple(warnings),
    }
    if behaviour == "monotone":
        return ConvergenceResult(**base, **_monotone(h, f, formal_order, tolerance))
    return ConvergenceResult(**base, **_without_order(behaviour, f, tolerance))


def _checked(
    sizes: ArrayLike, values: ArrayLike, formal: float | None, tolerance: float
) -> tuple[Array, Array]:
    h, f = np.atleast_1d(np.asarray(sizes, float)), np.atleast_1d(np.asarray(values, float))
    faults = []
    if h.size != f.size:
        faults.append(Fault("sizes", f"{h.size} sizes for {f.size} values"))
    elif h.size < 3:
        faults.append(Fault("sizes", f"an order needs at least three meshes, got {h.size}"))
    if not (np.all(np.isfinite(h)) and np.all(h > 0)):
        faults.append(Fault("sizes", f"must be positive numbers, got {h.tolist()}"))
    elif np.unique(h).size < h.size:
        faults.append(
            Fault("sizes", f"must be distinct, got {h.tolist()}", "refine by at least 1.3")
        )
    if not np.all(np.isfinite(f)):
        faults.append(
            Fault("values", f"must be finite numbers, got {f.tolist()}", "drop the failed level")
        )
    if formal is not None and not (math.isfinite(formal) and formal > 0):
        faults.append(Fault("formal order", f"must be positive, got {formal!r}"))
    if not (math.isfinite(tolerance) and tolerance >= 0):
        faults.append(Fault("tolerance", f"must be zero or positive, got {tolerance!r}"))
    if faults:
        raise InputError(faults)
    order = np.argsort(h)
    return h[order], f[order]


def _ratio_warnings(h: Array) -> list[str]:
    ratios = h[1:] / h[:-1]
    if ratios.min() >= _MIN_RATIO - 1e-12:
        return []
    return [
        f"refinement ratio {ratios.min():.3g} is below {_MIN_RATIO}: "
        "noise of the mesh is amplified in the order"
    ]


def classify(h: Array, f: Array, tolerance: float = 0.0) -> str:
    """Behaviour of the finest three meshes (all of them for the noise floor).

    Examples
    --------
    >>> classify(np.array([1, 2, 2.6]), np.array([1.0, 2.0, 2.6]))
    'monotone'
    >>> classify(np.array([1, 2, 4.0]), np.array([4.0, 2.0, 1.0]))
    'divergent'
    """
    floor = max(10 * tolerance, 4 * float(np.spacing(np.abs(f).max())))
    if float(np.abs(np.diff(f)).max()) <= floor:
        return "noise-floor"
    e21, e32 = f[1] - f[0], f[2] - f[1]
    if min(abs(e21), abs(e32)) <= floor:
        return "inconclusive"
    ratio, limit = e21 / e32, math.log(h[1] / h[0]) / math.log(h[2] / h[1])
    if 0 < ratio < limit * (1 - 1e-12):
        return "monotone"
    return "oscillatory" if -1 <= ratio < 0 else "divergent"


def observed_order(h: Sequence[float] | Array, f: Sequence[float] | Array) -> float:
    """Order p of f = f0 + C h^p through three meshes, fine to coarse.

    The root of (r21^p - 1) / (r21^p (r32^p - 1)) = e21 / e32, which is where the fixed point
    of Celik et al. (2008) ends; a bracketed root also converges for ratios near 1.
    """
    from scipy.optimize import brentq

    a, b = math.log(h[1] / h[0]), math.log(h[2] / h[1])
    target = math.log((f[1] - f[0]) / (f[2] - f[1]))

    def mismatch(p: float) -> float:
        # logarithm of the ratio, without overflow for a large p
        return math.log(-math.expm1(-p * a)) - math.log(-math.expm1(-p * b)) - p * b - target

    low, high = 1e-8, 1.0
    while mismatch(high) > 0 and high < 1e3:
        high *= 2
    if mismatch(low) <= 0:
        return low
    return float(brentq(mismatch, low, high, xtol=1e-14, rtol=1e-14))


def _monotone(h: Array, f: Array, formal: float | None, tolerance: float) -> dict[str, Any]:
    fit = _three(h, f) if h.size == 3 else _least_squares(h, f)
    used, limited = _limited(fit.order, formal)
    factor = _factor(fit, formal, limited, h.size)
    a21, a32 = (h[1] / h[0]) ** used - 1, (h[2] / h[1]) ** used - 1
    by_pair = float(f[0] + (f[0] - f[1]) / a21)
    extrapolated = by_pair if h.size == 3 or limited else fit.extrapolated
    u = factor * abs(f[0] - extrapolated) + fit.scatter + fit.misfit
    u = max(float(u), tolerance)
    u32 = _SAFE * abs(f[2] - f[1]) / a32
    u21 = _SAFE * abs(f[1] - f[0]) / a21
    ratio = None
    if f[0] != 0 and f[1] != 0:
        ratio = float((u32 / abs(f[1])) / ((h[1] / h[0]) ** used * u21 / abs(f[0])))
    return {
        "observed_order": fit.order,
        "order_used": used,
        "extrapolated": extrapolated,
        "gci_fine": u / abs(float(f[0])) if f[0] != 0 else None,
        "gci_coarse": factor / _SAFE * float(u32) / abs(float(f[1])) if f[1] != 0 else None,
        "factor_of_safety": factor,
        "u_num": u,
        "asymptotic_ratio": ratio,
        "verdict": _monotone_verdict(fit, formal, factor, limited),
    }


def _three(h: Array, f: Array) -> _Fit:
    p = observed_order(h, f)
    limit = f[0] + (f[0] - f[1]) / ((h[1] / h[0]) ** p - 1)
    return _Fit(p, float(limit), 0.0, 0.0, consistent=True)


def _least_squares(h: Array, f: Array) -> _Fit:
    """Fit f0 + a h^p, plain and weighted by 1/h; the one with less scatter is kept."""
    candidates = [_weighted_fit(h, f, np.ones_like(h)), _weighted_fit(h, f, 1 / h)]
    p, limit, slope, scatter = min(candidates, key=lambda item: item[3])
    misfit = float(abs(f[0] - limit - slope * h[0] ** p))
    agree = False
    if classify(h[1:], f[1:]) == "monotone":
        agree = abs(observed_order(h[:3], f[:3]) - observed_order(h[1:4], f[1:4])) <= 0.3
    return _Fit(p, limit, scatter, misfit, agree)


def _weighted_fit(h: Array, f: Array, weight: Array) -> tuple[float, float, float, float]:
    from scipy.optimize import minimize_scalar

    root = np.sqrt(weight / weight.sum())
    x, y = h / h[-1], f - f[0]

    def solve(p: float) -> tuple[Array, float]:
        columns = np.column_stack([root, root * x**p])
        coefficients, *_ = np.linalg.lstsq(columns, root * y, rcond=None)
        rest = root * y - columns @ coefficients
        return coefficients, float(rest @ rest)

    orders = np.geomspace(0.05, _MAX_ORDER, 120)
    best = int(np.argmin([solve(p)[1] for p in orders]))
    low, high = orders[max(best - 1, 0)], orders[min(best + 1, orders.size - 1)]
    found = minimize_scalar(
        lambda p: solve(p)[1], bounds=(low, high), method="bounded", options={"xatol": 1e-13}
    )
    p = float(found.x)
    (limit, slope), rss = solve(p)
    scatter = math.sqrt(rss * h.size / (h.size - 3))
    return p, float(limit + f[0]), float(slope / h[-1] ** p), scatter


def _limited(order: float, formal: float | None) -> tuple[float, bool]:
    """Order for the GCI, and whether it had to be limited."""
    if order < _MIN_ORDER:
        return _MIN_ORDER, True
    if formal is not None and order > formal + 0.5:
        return formal, True
    return order, False


def _factor(fit: _Fit, formal: float | None, limited: bool, meshes: int) -> float:
    if limited:
        return _CAUTIOUS
    if meshes >= 4:
        return _SAFE if fit.consistent else _CAUTIOUS
    return _SAFE if formal is None or abs(fit.order - formal) <= 0.5 else _CAUTIOUS


def _monotone_verdict(fit: _Fit, formal: float | None, factor: float, limited: bool) -> str:
    order = f"monotone with observed order {fit.order:.3g}"
    beside = "" if formal is None else f" (formal {formal:g})"
    if limited:
        return f"{order}{beside}: order limited, uncertainty indicative (factor {factor:g})"
    if factor == _SAFE:
        return f"{order}{beside}: in the asymptotic range, factor {factor:g}"
    why = "the triples disagree" if not fit.consistent else "far from the formal order"
    return f"{order}{beside}: {why}, factor {factor:g}"


def _without_order(behaviour: str, f: Array, tolerance: float) -> dict[str, Any]:
    nothing = dict.fromkeys(
        ("observed_order", "extrapolated", "gci_fine", "factor_of_safety", "asymptotic_ratio")
    )
    u: float | None = None
    if behaviour == "noise-floor":
        u = tolerance
        text = "noise floor: the meshes agree to 10 times the solver tolerance, no order"
    elif behaviour == "oscillatory":
        if f.size >= 4:
            u = float(np.ptp(f)) / 2
            text = f"oscillatory: no extrapolation, u from the range of {f.size} meshes"
        else:
            text = "oscillatory: no extrapolation"
        text += "; run another mesh"
    elif behaviour == "inconclusive":
        text = "inconclusive: two meshes agree and the third does not; run another mesh"
    else:
        text = (
            "divergent: the changes grow with refinement, GCI refused; "
            "suspects: a singularity, locking, contact"
        )
    return {**nothing, "u_num": u, "verdict": text}
