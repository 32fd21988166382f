"""Mesh convergence: behaviour first, then order, extrapolation and GCI, or a refusal.

References: Celik et al. (2008), J. Fluids Eng. 130, 078001 (three meshes, unequal ratios);
Eca and Hoekstra (2014), J. Comput. Phys. 262, 104-130 (least squares for four or more).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from study.ground.arrays import Array
from study.ground.canonical import plain
from study.ground.errors import Fault, InputError

if TYPE_CHECKING:
    import pandas as pd


# -------------------------------------------------------------------------------------------------
# Order of a refinement series: through three meshes, by least squares, and how sure it is.
#
# References: Celik et al. (2008), J. Fluids Eng. 130, 078001 (three meshes, unequal ratios);
# Eca and Hoekstra (2014), J. Comput. Phys. 262, 104-130 (least squares for four or more).

#: an order that the algebraic error moves by more than this is not carried by the data
RESOLVED_ORDER = 0.05

#: two triples of meshes that differ by less in order are in the asymptotic range
SAME_ORDER = 0.3
_LOWEST = 0.05
_HIGHEST = 20.0


def classify(h: Array, f: Array, tolerance: float = 0.0) -> str:
    """Behaviour of the finest three meshes (all of them for the noise floor).

    Shapes: h, f (n,).

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


@dataclass(frozen=True)
class OrderFit:
    """Order and limit of a monotone series."""

    #: p and f0 of f = f0 + C h^p.
    order: float
    extrapolated: float
    #: Standard deviation of the fit, and its miss at the finest mesh; zero for three meshes.
    scatter: float = 0.0
    misfit: float = 0.0
    #: Whether the two finest triples of meshes agree in order.
    consistent: bool = True
    #: Orders that values within the algebraic error could have.
    interval: tuple[float, float] = (0.0, 0.0)

    @property
    def carried(self) -> bool:
        """Whether the values determine the order to within 0.05."""
        return (self.interval[1] - self.interval[0]) / 2 <= RESOLVED_ORDER


def fitted_order(h: Array, f: Array, tolerance: float = 0.0) -> OrderFit:
    """Order of a series that was found monotone, fine to coarse.

    Shapes: h, f (n,).
    """
    if h.size == 3:
        p = observed_order(h, f)
        limit = f[0] + (f[0] - f[1]) / ((h[1] / h[0]) ** p - 1)
        fit = OrderFit(p, float(limit))
        return replace(fit, interval=_three_mesh_interval(h, f, tolerance, p))
    fit = _least_squares(h, f)
    half = _fitted_half_width(h, f, tolerance, fit.order)
    return replace(fit, interval=(max(fit.order - half, 0.0), fit.order + half))


def observed_order(h: Sequence[float] | Array, f: Sequence[float] | Array) -> float:
    """Order p of f = f0 + C h^p through three meshes, fine to coarse.

    The root of (r21^p - 1) / (r21^p (r32^p - 1)) = e21 / e32, which is where the fixed point
    of Celik et al. (2008) ends; a bracketed root also converges for ratios near 1.

    Shapes: h, f (3,).
    """
    return _order(h, (f[1] - f[0]) / (f[2] - f[1]))


def _order(h: Sequence[float] | Array, ratio: float) -> float:
    from scipy.optimize import brentq

    a, b = math.log(h[1] / h[0]), math.log(h[2] / h[1])
    target = math.log(ratio)

    def mismatch(p: float) -> float:
        # logarithm of the ratio, without overflow for a large p
        return math.log(-math.expm1(-p * a)) - math.log(-math.expm1(-p * b)) - p * b - target

    low, high = 1e-8, 1.0
    while mismatch(high) > 0 and high < 1e3:
        high *= 2
    if mismatch(low) <= 0:
        return low
    return float(brentq(mismatch, low, high, xtol=1e-14, rtol=1e-14))


def _three_mesh_interval(h: Array, f: Array, tolerance: float, p: float) -> tuple[float, float]:
    """Orders when the middle value and an outer one err by the tolerance in opposite ways."""
    if tolerance == 0:
        return p, p
    e21, e32 = abs(f[1] - f[0]), abs(f[2] - f[1])
    least = max(e32 - 2 * tolerance, 1e-300)
    low = _order(h, (e21 + 2 * tolerance) / least)
    smallest = e21 - 2 * tolerance
    high = math.inf if smallest <= 0 else _order(h, smallest / (e32 + 2 * tolerance))
    return low, high


def _least_squares(h: Array, f: Array) -> OrderFit:
    """Fit f0 + a h^p, plain and weighted by 1/h; the one with less scatter is kept."""
    candidates = [_weighted_fit(h, f, weight) for weight in (np.ones_like(h), 1 / h)]
    p, limit, slope, scatter = min(candidates, key=lambda item: item[3])
    misfit = float(abs(f[0] - limit - slope * h[0] ** p))
    agree = False
    if classify(h[1:], f[1:]) == "monotone":
        gap = abs(observed_order(h[:3], f[:3]) - observed_order(h[1:4], f[1:4]))
        agree = gap <= SAME_ORDER
    return OrderFit(p, limit, scatter, misfit, agree)


def _weighted_fit(h: Array, f: Array, weight: Array) -> tuple[float, float, float, float]:
    """Order, limit, slope and scatter of one weighted fit."""
    from scipy.optimize import minimize_scalar

    solve = _linear_part(h, f, weight)
    orders = np.geomspace(_LOWEST, _HIGHEST, 120)
    best = int(np.argmin([solve(p)[1] for p in orders]))
    low, high = orders[max(best - 1, 0)], orders[min(best + 1, orders.size - 1)]
    found = minimize_scalar(
        lambda p: solve(p)[1], bounds=(low, high), method="bounded", options={"xatol": 1e-13}
    )
    p = float(found.x)
    (limit, slope), rss = solve(p)
    scatter = math.sqrt(rss * h.size / (h.size - 3))
    return p, float(limit + f[0]), float(slope / h[-1] ** p), scatter


def _linear_part(h: Array, f: Array, weight: Array) -> Callable[[float], tuple[Array, float]]:
    """Limit and slope by linear least squares at a given order, with the sum of squares."""
    root = np.sqrt(weight / weight.sum())
    x, y = h / h[-1], f - f[0]

    def solve(p: float) -> tuple[Array, float]:
        columns = np.column_stack([root, root * x**p])
        coefficients, *_ = np.linalg.lstsq(columns, root * y, rcond=None)
        rest = root * y - columns @ coefficients
        return coefficients, float(rest @ rest)

    return solve


def _fitted_half_width(h: Array, f: Array, tolerance: float, p: float) -> float:
    """Sum over the values of what an error of the tolerance does to the fitted order."""
    if tolerance == 0:
        return 0.0
    moved = 0.0
    for k in range(h.size):
        changed = f.copy()
        changed[k] += tolerance
        moved += abs(_least_squares(h, changed).order - p)
    return moved


__all__ = ["ConvergenceResult", "classify", "grid_convergence", "observed_order"]

#: distance of the finest from the extrapolated value, over the latter, that is told
FAR = 0.05
_MIN_RATIO = 1.3
#: factor of the GCI where observed and formal order agree (Roache 1994)
SAFE = 1.25
#: factor of the GCI otherwise
CAUTIOUS = 3.0
#: lower orders would let the bound grow without limit
LEAST_ORDER = 0.5
#: observed and formal order agree where they differ by no more
AGREEMENT = 0.5
#: without a formal order, the order that three meshes are trusted with at most
_UNJUDGED_ORDER = 1.0
#: and the order that four or more agreeing meshes are trusted with
_HIGHEST_ORDER = 4.0
#: half-width over standard uncertainty where factor 1.25 applies: the error is a bias there, the
#: shifted Gaussian of ASME V&V 20-2009. Simulated rms(error / U) is 0.70 to 0.79, so U/2 would
#: be too small
_BIAS_COVERAGE = 1.15


@dataclass(frozen=True)
class ConvergenceResult:
    """What a refinement series tells; keys are those of ``study converge --json``.

    ``gci_fine`` is a fraction of the finest value; ``u_num`` is the same half-width in the
    unit of the value (``gci_fine * abs(value[0])``), the solver tolerance at the noise floor,
    or half the range of four or more oscillating values. ``observed_order`` is None where the
    stated tolerance leaves the order open by more than 0.05; ``order_interval`` holds the
    orders that are possible then, and the uncertainty is that of the lowest of them.
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
    order_interval: tuple[float, float] | None = None
    warnings: tuple[str, ...] = ()

    @property
    def standard_uncertainty(self) -> float | None:
        """Standard uncertainty for a comparison with measurements, in the unit of the value.

        U/1.15 with factor 1.25, U/2 with factor 3; half a range and a tolerance are limits of
        a uniform distribution, over sqrt(3).
        """
        if self.u_num is None:
            return None
        if self.factor_of_safety is None:
            return self.u_num / math.sqrt(3)
        return self.u_num / (_BIAS_COVERAGE if self.factor_of_safety == SAFE else 2)

    def to_json(self) -> dict[str, object]:
        """JSON document."""
        return dict(plain(self))

    def bound_of(self, value: float) -> float | None:
        """Half-width of another mesh's value: its distance to the limit, times the factor.

        An order a little above the formal one is believed for the limit, not for the interval.
        None where the meshes have no order.
        """
        if self.extrapolated is None or self.factor_of_safety is None:
            return None
        limits = [self.extrapolated]
        if self.order_used is not None:
            limits.append(_limit_by_pair(self.mesh_size, self.value, self.order_used))
        return self.factor_of_safety * max(abs(value - limit) for limit in limits)

    def to_frame(self) -> pd.DataFrame:
        """Return the meshes, the finest first."""
        import pandas as pd

        return pd.DataFrame({"mesh_size": self.mesh_size, "value": self.value})

    def _repr_html_(self) -> str:
        """Meshes and verdict as the last line of a cell shows them."""
        return self.to_frame().to_html(index=False) + f"<p>{escape(self.verdict)}</p>"


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
        Order that the element promises for this quantity. Without one the observed order
        cannot be judged: factor 3 at an order of 1 at most; four or more meshes whose triples
        agree take factor 1.25 at the fitted order, up to 4.
    tolerance : float
        Algebraic error of a value (solver tolerance), in its unit.
    qoi, unit : str
        Name and unit of the quantity, for the sentences.

    Returns
    -------
    ConvergenceResult
        Behaviour, observed order, extrapolated value, GCI.

    Raises
    ------
    InputError
        For fewer than three meshes, equal sizes, or values that are not numbers.

    Examples
    --------
    >>> result = grid_convergence([1, 2, 4], [0.97050, 0.96854, 0.96178])
    >>> result.behaviour, round(result.observed_order, 7), result.factor_of_safety
    ('monotone', 1.7861696, 3.0)
    >>> values = [0.97050, 0.96854, 0.96178]
    >>> round(grid_convergence([1, 2, 4], values, formal_order=2).gci_fine, 8)
    0.00103083
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
        found = _monotone(h, f, formal_order, tolerance)
        base["warnings"] = (*warnings, *_far_warnings(float(f[0]), found["extrapolated"]))
        return ConvergenceResult(**base, **found)
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


def _far_warnings(finest: float, extrapolated: float) -> list[str]:
    """Say where the limit is an extrapolation by more than a study should rest on."""
    if not extrapolated or abs(finest - extrapolated) <= FAR * abs(extrapolated):
        return []
    off = abs(finest / extrapolated - 1)
    return [
        f"the finest value, {finest:.6g}, is {100 * off:.3g} % from its extrapolated value, "
        f"{extrapolated:.6g}: refine further before either is used"
    ]


def _monotone(h: Array, f: Array, formal: float | None, tolerance: float) -> dict[str, Any]:
    fit = fitted_order(h, f, tolerance)
    used, limited = _limited(fit, formal, h.size)
    factor = _factor(fit, formal, limited, h.size)
    a21, a32 = (h[1] / h[0]) ** used - 1, (h[2] / h[1]) ** used - 1
    by_pair = _limit_by_pair(h, f, used)
    extrapolated = by_pair if limited else fit.extrapolated
    error = max(abs(f[0] - extrapolated), abs(f[0] - by_pair))
    u = max(float(factor * error + fit.scatter + fit.misfit), tolerance)
    if not fit.carried:  # the finest change may be small by accident: what else changed counts
        u = max(u, float(np.ptp(f[:3])))
    u32 = SAFE * abs(f[2] - f[1]) / a32
    u21 = SAFE * abs(f[1] - f[0]) / a21
    ratio = None
    if f[0] != 0 and f[1] != 0:
        ratio = float((u32 / abs(f[1])) / ((h[1] / h[0]) ** used * u21 / abs(f[0])))
    low, high = fit.interval
    return {
        "observed_order": fit.order if fit.carried else None,
        "order_interval": (low, high) if math.isfinite(high) and high > low else None,
        "order_used": used,
        "extrapolated": extrapolated,
        "gci_fine": u / abs(float(f[0])) if f[0] != 0 else None,
        "gci_coarse": factor / SAFE * float(u32) / abs(float(f[1])) if f[1] != 0 else None,
        "factor_of_safety": factor,
        "u_num": u,
        "asymptotic_ratio": ratio,
        "verdict": _monotone_verdict(fit, formal, factor, limited),
    }


def _limit_by_pair(h: Sequence[float] | Array, f: Sequence[float] | Array, order: float) -> float:
    """Limit of the two finest meshes by an order."""
    return float(f[0] + (f[0] - f[1]) / ((h[1] / h[0]) ** order - 1))


def _limited(fit: OrderFit, formal: float | None, meshes: int) -> tuple[float, bool]:
    """Order for the GCI, and whether it had to be limited."""
    order = fit.order if fit.carried else min(fit.order, fit.interval[0])
    if order < LEAST_ORDER:
        return LEAST_ORDER, True
    if formal is None:
        most = _HIGHEST_ORDER if _agreed(fit, meshes) else _UNJUDGED_ORDER
        return min(order, most), order > _HIGHEST_ORDER or not fit.carried
    if order > formal + AGREEMENT:
        return formal, True
    # an order a little above the formal one is believed for the limit, not for the interval
    # (Roache 1998, Verification and Validation in Computational Science and Engineering)
    return min(order, formal), not fit.carried


def _agreed(fit: OrderFit, meshes: int) -> bool:
    """Whether four or more meshes vouch for the order."""
    return meshes >= 4 and fit.consistent and fit.carried


def _near(fit: OrderFit, formal: float | None) -> bool:
    return formal is not None and abs(fit.order - formal) <= AGREEMENT


def _factor(fit: OrderFit, formal: float | None, limited: bool, meshes: int) -> float:
    if limited:
        return CAUTIOUS
    if meshes >= 4:
        return SAFE if fit.consistent else CAUTIOUS
    return SAFE if _near(fit, formal) else CAUTIOUS


def _monotone_verdict(fit: OrderFit, formal: float | None, factor: float, limited: bool) -> str:
    beside = "" if formal is None else f" (formal {formal:.3g})"
    if not fit.carried:
        low, high = fit.interval
        between = f"between {low:.2g} and {high:.2g}" if math.isfinite(high) else f"over {low:.2g}"
        return (
            f"monotone, but the values do not carry an order: {between} at this "
            f"tolerance{beside}; uncertainty indicative (factor {factor:g})"
        )
    order = f"monotone with observed order {fit.order:.3g}"
    if limited:
        return f"{order}{beside}: order limited, uncertainty indicative (factor {factor:g})"
    if factor == SAFE:
        where = "in the asymptotic range" if _near(fit, formal) else "consistent over the meshes"
        return f"{order}{beside}: {where}, factor {factor:g}"
    why = "the triples disagree" if not fit.consistent else "far from the formal order"
    if formal is None and fit.consistent:
        why = "no formal order given: the order cannot be judged"
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


@dataclass(frozen=True)
class NumericalUncertainty:
    """Numerical uncertainty of one response on the mesh of the study (ASME V&V 20-2009)."""

    #: Levels of the factors of the discretization.
    levels: Mapping[str, str]
    response: str
    #: Response on the study's mesh and its uncertainty, in ``unit``.
    value: float | None
    u_num: float | None
    unit: str
    #: Of the refinement series, or ``"two meshes"``.
    behaviour: str
    #: Which cell was refined and how far.
    note: str
    #: Sizes in mm and values of the series, from coarse to fine.
    mesh_size: tuple[float, ...] = ()
    series: tuple[float, ...] = ()
    formal_order: float | None = None
    formal_reason: str = ""


# -------------------------------------------------------------------------------------------------
# Comparison of a simulated with a measured curve: E and its uncertainty (ASME V&V 20-2009).


@dataclass(frozen=True)
class Comparison:
    """E with its parts along a curve; arrays have one entry a displacement, forces in N."""

    #: shape (n,); curve and E = S - D.
    displacement_mm: Array
    simulated_N: Array
    measured_N: Array
    error_N: Array
    #: shape (n,); standard uncertainties; zero where one is not known.
    u_num_N: Array
    u_input_N: Array
    u_data_N: Array
    u_val_N: Array
    #: Which of numerics, inputs and data are not known at all.
    unknown: tuple[str, ...] = ()

    @property
    def outside(self) -> float:
        """Part of the curve where |E| exceeds u_val."""
        return float(np.mean(np.abs(self.error_N) > self.u_val_N))

    @property
    def verdict(self) -> str:
        """What the end of the curve says of the model."""
        e, u = float(self.error_N[-1]), float(self.u_val_N[-1])
        if u == 0:
            return "no uncertainty is known, so E cannot be judged"
        lacking = f" ({', '.join(self.unknown)} not known)" if self.unknown else ""
        if abs(e) > u:
            return f"the model is off by E = {e:.3g} N +- {u:.2g} N at the end{lacking}"
        return f"|E| = {abs(e):.2g} N is within u_val = {u:.2g} N at the end{lacking}"

    def to_json(self) -> dict[str, object]:
        """JSON document with the verdict."""
        return {**plain(self), "outside": self.outside, "verdict": self.verdict}


def compare(
    displacement_mm: ArrayLike,
    simulated_N: ArrayLike,  # noqa: N803
    measured_N: ArrayLike,  # noqa: N803
    u_num_N: ArrayLike | None = None,  # noqa: N803
    u_input_N: ArrayLike | None = None,  # noqa: N803
    u_data_N: ArrayLike | None = None,  # noqa: N803
) -> Comparison:
    """E +- u_val along a curve.

    Shapes: displacement_mm (n,); simulated_N, measured_N (n,); u_num_N, u_input_N, u_data_N (n,).

    Examples
    --------
    >>> found = compare([1.0, 2.0], [1.0, 2.1], [1.0, 2.0], 0.03, 0.0, 0.04)
    >>> found.error_N.round(3).tolist(), found.u_val_N.round(3).tolist(), found.outside
    ([0.0, 0.1], [0.05, 0.05], 0.5)
    """
    d, s, m = (np.atleast_1d(np.asarray(v, float)) for v in (displacement_mm, simulated_N,
                                                            measured_N))  # fmt: skip
    parts = {"numerics": u_num_N, "inputs": u_input_N, "data": u_data_N}
    known = [np.broadcast_to(np.asarray(0.0 if v is None else v, float), d.shape)
             for v in parts.values()]  # fmt: skip
    total = np.sqrt(sum(u**2 for u in known))
    unknown = tuple(name for name, v in parts.items() if v is None)
    return Comparison(d, s, m, s - m, known[0], known[1], known[2], np.asarray(total), unknown)
