"""Bound of the error of a refinement series: behaviour, order, limit and half-width by one rule.

:func:`series_bounds` answers for the finest two or three meshes of one series or of many, and
:func:`grid_convergence` for one series of any length with its sentence. Every series gets a bound;
its kind says what it rests on.

References: Roache (1994), J. Fluids Eng. 116, 405-413 (factors 3 and 1.25); Celik et al. (2008),
J. Fluids Eng. 130, 078001 (three meshes, unequal ratios); Eca and Hoekstra (2014), J. Comput.
Phys. 262, 104-130 (least squares for four or more, thrice the range without an order). How far an
order is believed was chosen by the simulation of ``validation/bounds.py``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from study.ground.arrays import Array, Flags
from study.ground.canonical import plain
from study.ground.errors import Fault, InputError, settled

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["ConvergenceResult", "grid_convergence", "observed_order", "series_bounds"]

#: Factor of the GCI where observed and formal order agree (Roache 1994).
SAFE = 1.25
#: The same where the observed order exceeds the formal one: the leading term still hides.
SAFE_ABOVE = 2.0
#: Factor of the GCI otherwise, and of the range of a series without an order.
CAUTIOUS = 3.0
#: Observed and formal order agree where they differ by no more.
AGREEMENT = 0.5
#: An observed order exceeds the formal one by more than rounding and curvature from here on.
ABOVE = 0.05
#: Smallest order that is believed: lower ones would let the bound grow without limit.
LEAST_ORDER = 0.5
#: Order of a series without a formal one, at most.
NO_ORDER = 1.0
#: Two meshes of a study show no order: this share of the expected one is assumed. With all of it,
#: claims of differences at the limit are wrong in more than 5 % where the true order is .7.
ASSUMED_SHARE = 0.7
#: Without a formal order, an observed order above this is limited.
_HIGHEST_ORDER = 4.0
#: No scheme promises more; with 1,000 a ratio to this power overflows and the bound is zero.
HIGHEST_FORMAL = 20.0
#: An order that the algebraic error moves by more than this is not carried by the data.
RESOLVED_ORDER = 0.05
#: Changes that grow are noise of the meshes below this share of the value.
NOISE_SHARE = 0.01
#: Distance of the finest from the extrapolated value, over the latter, that is told.
FAR = 0.05
#: An extrapolated value below this share of the largest value is zero, but for rounding.
_VANISHES = 1e-12
_MIN_RATIO = 1.3
#: Two triples of meshes that differ by less in order are in the asymptotic range.
_SAME_ORDER = 0.3
#: Meshes that show an order.
_FEWEST_FOR_ORDER = 3
#: Order of the values against the sizes turned round from which these seem to be in wrong order.
_TURNED_ORDER = 0.8
#: Lowest order of the grid that the least squares begin with.
_LOWEST = 0.05


def observed_order(h: ArrayLike, f: ArrayLike) -> Array:
    """Order p of f = f0 + C h^p through the three finest meshes, NaN where changes do not shrink.

    The root of (r21^p - 1) / (r21^p (r32^p - 1)) = e21 / e32, which is where the fixed point
    of Celik et al. (2008), equation 5, ends.

    Shapes: h (n,), f (..., n), fine to coarse.
    """
    f = np.asarray(f, float)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = (f[..., 1] - f[..., 0]) / (f[..., 2] - f[..., 1])
    return _order(np.asarray(h, float), ratio)


def _order(h: Array, ratio: Array) -> Array:
    """Order of series whose finer change is ``ratio`` times the coarser; 200 at most."""
    a, b = math.log(h[1] / h[0]), math.log(h[2] / h[1])
    monotone = (ratio > 0) & (ratio < a / b * (1 - 1e-12))
    target = np.log(np.where(monotone, ratio, 0.5 * min(a / b, 1.0)))
    if abs(a - b) <= 1e-9 * b:
        return np.where(monotone, -target / b, np.nan)
    low, high = np.full(target.shape, 1e-8), np.full(target.shape, 200.0)
    order = np.clip(-target / b, low, high)
    for _ in range(60):  # Newton's steps to the root of a falling function, halves beyond its ends
        fine, coarse = -np.expm1(-order * a), -np.expm1(-order * b)
        left = np.log(fine / coarse) - order * b - target
        low, high = np.where(left > 0, order, low), np.where(left > 0, high, order)
        slope = a * (1 - fine) / fine - b * (1 - coarse) / coarse - b
        last, order = order, order - left / slope
        order = np.where((low <= order) & (order <= high), order, (low + high) / 2)
        if np.all(np.abs(order - last) <= 1e-15 * order):
            break
    return np.where(monotone, order, np.nan)


def assumed_order(formal: float | None) -> float:
    """Order that a study assumes of two meshes, which show none: bonded corners limit it to one."""
    return ASSUMED_SHARE * (NO_ORDER if formal is None else min(formal, NO_ORDER))


@dataclass(frozen=True)
class MeshBounds:
    """What the finest two or three meshes of one series, or of many, tell; arrays of one shape."""

    #: ``"monotone"``, ``"oscillatory"``, ``"noise-floor"``, ``"inconclusive"``, ``"divergent"`` or
    #: ``"two meshes"``.
    kind: Array
    #: Half-width around the finest value.
    u: Array
    #: Observed order and the orders that values within the tolerance could have; NaN without one.
    order: Array
    low: Array
    high: Array
    #: Order and factor of the half-width, and whether the observed order was limited for it.
    order_used: Array
    factor: Array
    limited: Flags


def series_bounds(
    h: ArrayLike,
    f: ArrayLike,
    formal: float | None = None,
    tolerance: float = 0.0,
    noise: float | Array | None = None,
) -> MeshBounds:
    """Kind and bound of the error of the finest value, for every series.

    Shapes: h (n,), f (..., n), fine to coarse, of which the finest three count; noise (...): the
    growing changes below it are noise, 1 % of the finest value by default.

    Examples
    --------
    >>> two = series_bounds([1, 2], [10.0, 9.5], formal=2)
    >>> str(two.kind), round(float(two.u), 10)
    ('two meshes', 0.5)
    """
    h, f = np.asarray(h, float)[:3], np.asarray(f, float)[..., :3]
    change, spread = np.abs(np.diff(f)), np.ptp(f, axis=-1)
    top = NO_ORDER if formal is None else formal
    nan, shape = np.full(spread.shape, np.nan), spread.shape
    if h.size == 2:
        u = np.maximum(CAUTIOUS * spread / ((h[1] / h[0]) ** top - 1), tolerance)
        return MeshBounds(
            np.full(shape, "two meshes"), u, nan, nan, nan, np.full(shape, top),
            np.full(shape, CAUTIOUS), np.full(shape, True),
        )  # fmt: skip
    noise = NOISE_SHARE * np.abs(f[..., 0]) if noise is None else noise
    floor = _noise_floor(f, tolerance)
    order = observed_order(h, f)
    kind = np.select(
        [
            change.max(axis=-1) <= floor,
            change.min(axis=-1) <= floor,
            ~np.isnan(order),
            (np.diff(f).prod(axis=-1) < 0) & (change[..., 0] <= change[..., 1]),
            (change[..., 0] <= noise),
        ],
        ["noise-floor", "inconclusive", "monotone", "oscillatory", "noise-floor"],
        "divergent",
    )
    order = np.where(kind == "monotone", order, np.nan)
    low, high = _orders_within(h, change, order, tolerance)
    used, limited = _believed(order, low, high, formal, NO_ORDER)
    carried = (high - low) / 2 <= RESOLVED_ORDER
    safe = ~limited & (np.abs(order - top) <= AGREEMENT) & (formal is not None)
    factor = np.where(safe, np.where(order > top + ABOVE, SAFE_ABOVE, SAFE), CAUTIOUS)
    if formal is None:
        u = factor * change[..., 0] / ((h[1] / h[0]) ** used - 1)
    else:
        u = factor * _larger_error(h, change, used)
    u = np.where(carried & (safe | (formal is None)), u, np.maximum(u, spread))
    u = np.where(kind == "monotone", u, CAUTIOUS * spread)
    return MeshBounds(kind, np.maximum(u, tolerance), order, low, high, used, factor, limited)


def _noise_floor(f: Array, tolerance: float) -> Array:
    """Change of three values that tolerance or rounding alone may make; shape of f (..., 3)."""
    return np.asarray(np.maximum(10 * tolerance, 4 * np.spacing(np.abs(f).max(axis=-1))))


def _believed(
    order: Array | float, low: Array | float, high: Array | float, formal: float | None,
    unjudged: float,
) -> tuple[Array, Flags]:  # fmt: skip
    """Order for the bound, and whether the observed one had to be limited for it.

    An order above the formal one is believed for the limit, not for the bound (Roache 1998).
    """
    top = unjudged if formal is None else formal
    carried = (np.asarray(high) - low) / 2 <= RESOLVED_ORDER
    believed = np.where(carried, order, np.minimum(order, low))
    most = _HIGHEST_ORDER if formal is None else formal + AGREEMENT
    limited = ~carried | (believed < min(LEAST_ORDER, top)) | (order > most)
    return np.clip(believed, min(LEAST_ORDER, top), top), limited


def _larger_error(h: Array, change: Array, order: Array) -> Array:
    """Error of the finest value by the change between the finer and the coarser two meshes.

    Both count: one of the changes may be small by accident, where errors cancel or where a
    higher-order term hides the order.
    """
    fine, coarse = (h[i + 1] / h[i] for i in (0, 1))
    by_fine = change[..., 0] / (fine**order - 1)
    return np.asarray(np.maximum(by_fine, change[..., 1] / (coarse**order - 1) / fine**order))


def _orders_within(h: Array, change: Array, order: Array, tolerance: float) -> tuple[Array, Array]:
    """Orders when the middle value and an outer one err by the tolerance in opposite ways."""
    if tolerance == 0:
        return order, order
    fine, coarse = change[..., 0], change[..., 1]
    low = _order(h, (fine + 2 * tolerance) / np.maximum(coarse - 2 * tolerance, 1e-300))
    least = fine - 2 * tolerance
    high = np.where(least <= 0, np.inf, _order(h, least / (coarse + 2 * tolerance)))
    return np.where(np.isnan(low), 0.0, low), high


def _least_squares(h: Array, f: Array) -> tuple[float, float, float, float]:
    """Order, limit, slope and scatter of f0 + a h^p, plain or weighted by 1/h by the scatter."""
    candidates = [_weighted_fit(h, f, weight) for weight in (np.ones_like(h), 1 / h)]
    return min(candidates, key=lambda item: item[3])


def _weighted_fit(h: Array, f: Array, weight: Array) -> tuple[float, float, float, float]:
    """Order, limit, slope and scatter of one weighted fit."""
    from scipy.optimize import minimize_scalar

    root = np.sqrt(weight / weight.sum())
    x, y = h / h[-1], f - f[0]

    def solve(p: float) -> tuple[Array, float]:
        """Limit and slope by linear least squares at an order, with the sum of squares."""
        columns = np.column_stack([root, root * x**p])
        coefficients, *_ = np.linalg.lstsq(columns, root * y, rcond=None)
        rest = root * y - columns @ coefficients
        return coefficients, float(rest @ rest)

    orders = np.geomspace(_LOWEST, HIGHEST_FORMAL, 120)
    best = int(np.argmin([solve(p)[1] for p in orders]))
    low, high = orders[max(best - 1, 0)], orders[min(best + 1, orders.size - 1)]
    minimum = minimize_scalar(
        lambda p: solve(p)[1], bounds=(low, high), method="bounded", options={"xatol": 1e-13}
    )
    p = float(settled(minimum, "order of a refinement series").x)
    (limit, slope), rss = solve(p)
    scatter = math.sqrt(rss * h.size / (h.size - 3))
    return p, float(limit + f[0]), float(slope / h[-1] ** p), scatter


@dataclass(frozen=True)
class ConvergenceResult:
    """What a refinement series tells; keys are those of ``study converge --json``.

    ``gci_fine`` is a fraction of the finest value; ``u_num`` is the same half-width in the
    unit of the value (``gci_fine * abs(value[0])``). Without an order ``u_num`` is thrice the
    range of the finest three values, and at least the tolerance. ``observed_order`` is None
    where the stated tolerance leaves the order open by more than 0.05; ``order_interval`` holds the
    orders that are possible then, and the uncertainty is that of the lowest of them.
    """

    qoi: str
    unit: str
    mesh_size: tuple[float, ...]
    value: tuple[float, ...]
    behaviour: str
    observed_order: float | None = None
    formal_order: float | None = None
    extrapolated: float | None = None
    gci_fine: float | None = None
    factor_of_safety: float | None = None
    u_num: float | None = None
    asymptotic_ratio: float | None = None
    verdict: str = ""
    order_used: float | None = None
    gci_coarse: float | None = None
    order_interval: tuple[float, float] | None = None
    warnings: tuple[str, ...] = ()

    def to_json(self) -> dict[str, object]:
        """JSON document."""
        return dict(plain(self))

    def bound_of(self, value: float) -> float | None:
        """Half-width of another mesh's value; None where the series has no bound.

        With an order the distance to the limit, times the factor: an order a little above the
        formal one is believed for the limit, not for the interval. Without one thrice the distance
        to the finest value, and at least the bound of that.
        """
        if self.u_num is None:
            return None
        if self.extrapolated is None or self.factor_of_safety is None or self.order_used is None:
            return max(self.u_num, CAUTIOUS * abs(value - self.value[0]))
        limits = (
            self.extrapolated, _limit_by_pair(self.mesh_size, self.value, self.order_used)
        )  # fmt: skip
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
        Mesh sizes, in any order, n >= 3, or 2 with a formal order.
    values : array_like, shape (n,)
        Value of the quantity on each mesh.
    formal_order : float, optional
        Order that the element promises for this quantity. Without one the observed order
        cannot be judged: factor 3 at an order of 1 at most; four or more meshes whose triples
        agree take factor 1.25 at the fitted order, up to 4. Two meshes assume it.
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
        For fewer than three meshes (two with a formal order), equal sizes, or values that are
        not numbers.

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
    bounds = series_bounds(h, f, formal_order, tolerance)
    behaviour, limit, consistent = str(bounds.kind), None, True
    if behaviour == "monotone" and h.size > 3:
        bounds, limit, consistent = _fitted(h, f, formal_order, tolerance)
    u, used, factor = (float(v) for v in (bounds.u, bounds.order_used, bounds.factor))
    order, low, high = (float(v) for v in (bounds.order, bounds.low, bounds.high))
    limited = bool(bounds.limited)
    if behaviour in ("monotone", "two meshes"):
        if limit is None or limited:
            limit = _limit_by_pair(h, f, used if limited else order)
    elif behaviour == "oscillatory":
        u = max(u, float(np.ptp(f)) / 2)
    carried = (high - low) / 2 <= RESOLVED_ORDER
    ordered = limit is not None
    gci_fine, gci_coarse, ratio = _indices(h, f, used, factor, u) if ordered else (None,) * 3
    verdict = _verdict(behaviour, f, u, tolerance)
    if behaviour == "monotone":
        verdict = _monotone_verdict((low, order, high), formal_order, factor, limited, consistent)
        if np.diff(f).min() < 0 < np.diff(f).max():
            verdict = verdict.replace("monotone", "monotone at its fine end alone", 1)
        if f"{used:.3g}" not in (f"{order:.3g}", f"{formal_order or math.nan:.3g}"):
            verdict += f"; bound and GCI by order {used:.3g}"
    elif behaviour == "two meshes":
        verdict = f"two meshes: order assumed, {used:.3g}, factor {factor:g}"
    return ConvergenceResult(
        qoi, unit, tuple(h.tolist()), tuple(f.tolist()), behaviour,
        observed_order=order if behaviour == "monotone" and carried else None,
        formal_order=formal_order,
        extrapolated=limit,
        gci_fine=gci_fine,
        factor_of_safety=factor if ordered else None,
        u_num=u,
        asymptotic_ratio=ratio,
        verdict=verdict,
        order_used=used if ordered else None,
        gci_coarse=gci_coarse,
        order_interval=(low, high) if math.isfinite(high) and high > low else None,
        warnings=tuple(_warnings(h, f, limit)),
    )  # fmt: skip


def _indices(
    h: Array, f: Array, used: float, factor: float, u: float
) -> tuple[float | None, float | None, float | None]:
    """GCI of the finest and of the next mesh, and their ratio over that of the sizes."""
    fine = u / abs(float(f[0])) if f[0] else None
    if h.size == 2 or not f[1]:
        return fine, None, None
    by_fine, by_coarse = (
        abs(f[i + 1] - f[i]) / ((h[i + 1] / h[i]) ** used - 1) / abs(f[i]) if f[i] else math.inf
        for i in (0, 1)
    )
    ratio = float(by_coarse / ((h[1] / h[0]) ** used * by_fine)) if f[0] else None
    return fine, factor * float(by_coarse), ratio


def _fitted(
    h: Array, f: Array, formal: float | None, tolerance: float
) -> tuple[MeshBounds, float, bool]:
    """Bound of a monotone series of four or more meshes by least squares, and its limit.

    The last is whether the two finest triples of meshes agree in order.
    """
    order, limit, slope, scatter = _least_squares(h, f)
    # sum over the values of what an error of the tolerance does to the fitted order
    moved = tolerance * np.eye(h.size if tolerance else 0)
    half = sum(abs(_least_squares(h, f + error)[0] - order) for error in moved)
    low, high = max(order - half, 0.0), order + half
    carried = half <= RESOLVED_ORDER
    triples = [float(observed_order(h[i : i + 3], f[i : i + 3])) for i in (0, 1)]
    consistent = abs(triples[0] - triples[1]) <= _SAME_ORDER
    unjudged = _HIGHEST_ORDER if consistent and carried else NO_ORDER
    used, limited = _believed(order, low, high, formal, unjudged)
    factor = CAUTIOUS if limited or not consistent else SAFE
    if factor == SAFE and formal is not None and order > formal + ABOVE:
        factor = SAFE_ABOVE
    error = float(_larger_error(h, np.abs(np.diff(f)), used))
    if not limited:
        error = max(error, abs(float(f[0]) - limit))
    misfit = abs(float(f[0] - limit - slope * h[0] ** order))
    u = max(factor * error + scatter + misfit, tolerance)
    if not carried:  # the finest change may be small by accident: what else changed counts
        u = max(u, float(np.ptp(f[:3])))
    parts = ("monotone", u, order, low, high, used, factor, limited)
    return MeshBounds(*map(np.asarray, parts)), limit, consistent


def _limit_by_pair(h: Sequence[float] | Array, f: Sequence[float] | Array, order: float) -> float:
    """Limit of the two finest meshes by an order."""
    return float(f[0] + (f[0] - f[1]) / ((h[1] / h[0]) ** order - 1))


def _monotone_verdict(
    orders: tuple[float, float, float],
    formal: float | None,
    factor: float,
    limited: bool,
    consistent: bool,
) -> str:
    """Sentence of a monotone series; ``orders`` is the lowest, the observed, the highest."""
    low, observed, high = orders
    promised = "" if formal is None else f" (formal {formal:.3g})"
    if not (high - low) / 2 <= RESOLVED_ORDER:
        between = f"between {low:.2g} and {high:.2g}" if math.isfinite(high) else f"over {low:.2g}"
        return (
            f"monotone, but the values do not carry an order: {between} at this "
            f"tolerance{promised}; uncertainty indicative (factor {factor:g})"
        )
    order = f"monotone with observed order {observed:.3g}"
    near = formal is not None and abs(observed - formal) <= AGREEMENT
    if limited:
        return f"{order}{promised}: order limited, uncertainty indicative (factor {factor:g})"
    if factor == SAFE_ABOVE:
        return f"{order}{promised}: above the formal order, factor {factor:g}"
    if factor == SAFE:
        where = "in the asymptotic range" if near else "consistent over the meshes"
        return f"{order}{promised}: {where}, factor {factor:g}"
    why = "the triples disagree" if not consistent else "far from the formal order"
    if formal is None and consistent:
        why = "no formal order given: the order cannot be judged"
    return f"{order}{promised}: {why}, factor {factor:g}"


def _verdict(behaviour: str, f: Array, u: float, tolerance: float) -> str:
    """Sentence of a series without an order, with its bound."""
    bound = f"bound {u:.3g}, thrice the range of the finest three meshes"
    if u == tolerance > 0:
        bound = f"bound {u:.3g}, the tolerance"
    if behaviour == "noise-floor":
        changes = np.abs(np.diff(f[:3]))
        if changes.max() > _noise_floor(f[:3], tolerance):
            share = f"below {100 * NOISE_SHARE:g} % of the value"
            noise = f"the changes do not shrink, but the finest is {share}: taken for noise"
            return f"noise floor: {noise}, no order; {bound}"
        return f"noise floor: the changes are those of solver and meshes, no order; {bound}"
    if behaviour == "oscillatory":
        if u == float(np.ptp(f)) / 2:
            bound = f"bound {u:.3g}, half the range of {f.size} meshes"
        return f"oscillatory: no extrapolation; {bound}; run another mesh"
    if behaviour == "inconclusive":
        return f"inconclusive: two meshes agree and the third does not; {bound}; run another mesh"
    return (
        f"divergent: the changes do not shrink with refinement, GCI refused; {bound}; "
        "suspects: a singularity, locking, contact"
    )


def _checked(
    sizes: ArrayLike, values: ArrayLike, formal: float | None, tolerance: float
) -> tuple[Array, Array]:
    h, f = np.atleast_1d(np.asarray(sizes, float)), np.atleast_1d(np.asarray(values, float))
    faults = []
    if h.size != f.size:
        faults.append(Fault("sizes", f"{h.size} sizes for {f.size} values"))
    elif h.size < (3 if formal is None else 2):
        mend = "two are enough with a formal order"
        faults.append(Fault("sizes", f"an order needs at least three meshes, got {h.size}", mend))
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
    if formal is not None and not 0 < formal <= HIGHEST_FORMAL:
        rule = f"must be above 0 and at most {HIGHEST_FORMAL:g}, got {formal!r}"
        faults.append(Fault("formal order", rule, "2 of linear elements, 1 beside a sharp edge"))
    if not (math.isfinite(tolerance) and tolerance >= 0):
        faults.append(Fault("tolerance", f"must be zero or positive, got {tolerance!r}"))
    if faults:
        raise InputError(faults)
    order = np.argsort(h)
    return h[order], f[order]


def _warnings(h: Array, f: Array, limit: float | None) -> Iterator[str]:
    """Small ratios of the sizes, coarse meshes of no use, and a limit far off."""
    finest = float(f[0])
    if (ratio := (h[1:] / h[:-1]).min()) < _MIN_RATIO - 1e-12:
        yield (
            f"refinement ratio {ratio:.3g} is below {_MIN_RATIO}: "
            "noise of the mesh is amplified in the order"
        )
    if limit is None:
        return
    turned = np.flatnonzero((f[1:] - f[:-1]) * (f[1] - f[0]) < 0)
    if turned.size:
        yield (
            f"beyond the mesh size {h[turned[0]]:.4g} the value changes the other way: leave the "
            "coarser meshes out if they are too coarse; else noise of the meshes hides the order"
        )
    if abs(limit) <= _VANISHES * np.abs(f).max():
        if abs(finest) > abs(limit):
            yield f"the extrapolated value is zero: all of the finest value, {finest:.6g}, is error"
    elif abs(finest - limit) > FAR * abs(limit):
        yield (
            f"the finest value, {finest:.6g}, is {100 * abs(finest / limit - 1):.3g} % from its "
            f"extrapolated value, {limit:.6g}: refine further before either is used"
        )


def judged_numbers(
    sizes: ArrayLike, values: ArrayLike, formal_order: float | None, tolerance: float
) -> ConvergenceResult:
    """Judge numbers that were typed, shape (n,), and warn where these look mistaken."""
    result = grid_convergence(sizes, values, formal_order=formal_order, tolerance=tolerance)
    return replace(result, warnings=(*result.warnings, *_mistaken(result)))


def _mistaken(result: ConvergenceResult) -> Iterator[str]:
    """Equal values, and sizes the other way round."""
    if result.u_num == 0:
        yield (
            "equal values show no error, nor that there is none: state with --tolerance what a "
            "value may be off by, such as half of its last digit"
        )
    if result.extrapolated is None and len(result.value) >= _FEWEST_FOR_ORDER:
        turned = 1 / np.array(result.mesh_size[::-1])
        order = float(observed_order(turned, np.array(result.value[::-1])))
        if order >= _TURNED_ORDER:
            yield (
                f"the values converge towards the largest size, with order {order:.3g}: are the "
                "sizes numbers of elements, or in another order than the values? Give for every "
                "value the size of the elements that it was computed with"
            )


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


#: columns of a comparison, in the document of a result
KEYS = "displacement_mm simulated_N measured_N error_N u_num_N u_input_N u_data_N u_val_N"


def compare(
    displacement_mm: Array,
    simulated_N: Array,  # noqa: N803
    measured_N: Array,  # noqa: N803
    u: Mapping[str, Array | None],
) -> dict[str, object]:
    """Document of E = S - D with u_val along a curve, and what its end says of the model.

    ``u`` are the standard uncertainties of numerics, inputs and data, N; None where one is not
    known, and counts as zero.

    Shapes: displacement_mm, simulated_N, measured_N (n,).

    Examples
    --------
    >>> d, s = np.array([1.0, 2.0]), np.array([1.0, 2.1])
    >>> u = {"numerics": np.array([0.03, 0.03]), "inputs": None, "data": np.array([0.04, 0.04])}
    >>> found = compare(d, s, d, u)
    >>> found["u_val_N"], found["outside"], found["unknown"]
    ([0.05, 0.05], 0.5, ['inputs'])
    """
    zero, error = np.zeros(displacement_mm.shape), simulated_N - measured_N
    parts = {name: zero if part is None else part for name, part in u.items()}
    num, inputs, data = (parts[name] for name in ("numerics", "inputs", "data"))
    total = np.sqrt(num**2 + inputs**2 + data**2)
    unknown = [name for name, part in u.items() if part is None]
    e, end = float(error[-1]), float(total[-1])
    lacking = f" ({', '.join(unknown)} not known)" if unknown else ""
    if end == 0:
        verdict = "no uncertainty is known, so E cannot be judged"
    elif abs(e) > end:
        verdict = f"the model is off by E = {e:.3g} N +- {end:.2g} N at the end{lacking}"
    else:
        verdict = f"|E| = {abs(e):.2g} N is within u_val = {end:.2g} N at the end{lacking}"
    columns = (displacement_mm, simulated_N, measured_N, error, num, inputs, data, total)
    outside = float(np.mean(np.abs(error) > total))
    return {
        **{name: c.tolist() for name, c in zip(KEYS.split(), columns, strict=True)},
        "unknown": unknown, "outside": outside, "verdict": verdict,
    }  # fmt: skip
