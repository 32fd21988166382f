"""Numerical uncertainty of a contrast of cells: the series of the difference, not of its parts.

The errors of two cells of one discretization share an order and partly cancel, so their
difference is formed on every mesh and bounded as one series. Nothing cancels between two
discretizations, so their bounds add. The bound never exceeds the weighted sum of the cells' own
bounds (triangle inequality), and never falls below a tenth of it.

References: Roache (1998), Verification and Validation in Computational Science and Engineering;
Celik et al. (2008), J. Fluids Eng. 130, 078001; Eca and Hoekstra (2014), J. Comput. Phys. 262,
104-130. The factors were chosen by simulation of six models of the order of convergence.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from study.arrays import Array

#: Order of a series that shows none of its own and whose element promises none.
NO_ORDER = 1.0
#: Smallest observed order that is believed.
LOWEST_ORDER = 0.5
#: Observed and formal order agree where they differ by no more.
SAME_ORDER = 0.5
#: Safety factor of a difference whose series shows the formal order: its order is known less
#: well than that of a response, for which 1.25 is usual.
SAFE = 2.0
#: Safety factor of a response whose series shows the formal order (Roache 1998).
SAFE_RESPONSE = 1.25
#: Safety factor of a series without a trustworthy order (Eca and Hoekstra 2014).
CAUTIOUS = 3.0
#: Smallest share of the sum of the cells' bounds that the bound of a difference may have.
FLOOR = 0.1
#: Two meshes show no order: this share of the expected one is assumed.
ASSUMED_SHARE = 0.7
#: Growing changes below this share of the value are noise of the meshes, bounded by thrice the
#: range; above it the quantity diverges and nothing bounds its error.
NOISE_SHARE = 0.01
#: Share of the refined cells' mean bound that a difference of other cells inherits.
INHERITED_SHARE = 0.2


@dataclass(frozen=True)
class CellSeries:
    """Values of one response of one cell on refined meshes.

    Parameters
    ----------
    mesh_size : tuple of float
        Sizes from fine to coarse; only their ratios count.
    value : tuple of float
        Response on each mesh, on the scale of the analysis.
    formal_order : float or None
        Order that the element promises for this response.
    discretization : str
        Name of the element, order and formulation: errors cancel only within one.
    studied : float, optional
        Value on the mesh of the study, where that is not the finest.
    reference : float, optional
        Size that changes are compared with to tell noise from divergence: that of the finest
        value, or 1 for a logarithm.
    """

    mesh_size: tuple[float, ...]
    value: tuple[float, ...]
    formal_order: float | None = None
    discretization: str = ""
    studied: float | None = None
    reference: float | None = None

    @property
    def noise(self) -> float:
        """Change below which a growing one is noise of the meshes."""
        return NOISE_SHARE * (abs(self.value[0]) if self.reference is None else self.reference)

    @property
    def on_the_studied_mesh(self) -> float:
        """Value on the mesh of the study."""
        return self.value[0] if self.studied is None else self.studied


@dataclass(frozen=True)
class ContrastUncertainty:
    """Bound of the numerical error of a contrast on its finest mesh.

    Parameters
    ----------
    u : float
        Half-width around the contrast on the finest mesh, in the unit of the response.
    moved : float
        Distance of the contrast on the mesh of the study from that on the finest mesh.
    order : float
        Order by which ``u`` falls with the mesh size.
    method : {"three meshes", "two meshes", "other cells", "one other cell"}
        Where it comes from.
    """

    u: float
    moved: float
    order: float
    method: str

    @property
    def effective(self) -> float:
        """Half-width around the contrast on the mesh of the study."""
        return self.u + self.moved


def observed_orders(value: Array, mesh_size: Sequence[float]) -> Array:
    """Order p of f = f0 + C h^p through three meshes, NaN where the changes do not shrink.

    Parameters
    ----------
    value : ndarray, shape (..., 3)
        From fine to coarse.
    mesh_size : sequence of float
        Three sizes from fine to coarse.

    Returns
    -------
    ndarray, shape (...)
        The fixed point of Celik et al. (2008), equation 5.
    """
    e21, e32 = value[..., 1] - value[..., 0], value[..., 2] - value[..., 1]
    a, b = math.log(mesh_size[1] / mesh_size[0]), math.log(mesh_size[2] / mesh_size[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = e21 / e32
        monotone = (ratio > 0) & (ratio < a / b * (1 - 1e-12))
        target = np.log(np.where(monotone, ratio, 0.5))
    if abs(a - b) <= 1e-9 * b:
        return np.where(monotone, -target / b, np.nan)
    low, high = np.full(target.shape, 1e-8), np.full(target.shape, 200.0)
    for _ in range(60):  # bisection of a falling function: 200 / 2^60 is below rounding
        middle = (low + high) / 2
        found = np.log(-np.expm1(-middle * a)) - np.log(-np.expm1(-middle * b)) - middle * b
        low, high = np.where(found > target, middle, low), np.where(found > target, high, middle)
    return np.where(monotone, (low + high) / 2, np.nan)


def response_bounds(
    value: Array, mesh_size: Sequence[float], formal: float | None, noise: float | Array = 0.0
) -> Array:
    """Grid convergence index of single responses, in their unit.

    Parameters
    ----------
    value : ndarray, shape (..., n)
        On two or more meshes from fine to coarse; the finest three count.
    mesh_size : sequence of float
        Size of each mesh, from fine to coarse; only the ratios count.
    formal : float or None
        Order that the element promises; without one, no order above 1 is taken, and a safety
        factor of 3.
    noise : float or ndarray, shape (...)
        Growing changes up to this size are no divergence.

    Returns
    -------
    ndarray, shape (...)
        Infinite where the changes grow with refinement: no bound is known.
    """
    if value.shape[-1] == 2:
        return _two_meshes(value, mesh_size, formal)
    value, size = value[..., :3], mesh_size[:3]
    p = observed_orders(value, size)
    limit = NO_ORDER if formal is None else formal
    used = np.clip(np.where(np.isnan(p), limit, p), min(LOWEST_ORDER, limit), limit)
    error = _larger_error(value, size, used)
    safe = (np.abs(p - limit) <= SAME_ORDER) & (formal is not None)
    spread = np.ptp(value, axis=-1)
    bound = np.where(safe, SAFE_RESPONSE * error, np.maximum(CAUTIOUS * error, spread))
    bound = np.where(np.isnan(p), CAUTIOUS * spread, bound)
    return np.where(_diverges(value, noise), np.inf, bound)


def _diverges(value: Array, noise: float | Array) -> Array:
    """Whether the changes grow with refinement, by more than noise and rounding."""
    e21, e32 = np.abs(value[..., 1] - value[..., 0]), np.abs(value[..., 2] - value[..., 1])
    floor = np.maximum(noise, 4 * np.spacing(np.abs(value).max(axis=-1)))
    return np.asarray((e21 > e32 * (1 + 1e-9)) & (e21 > floor))


def difference_bounds(
    value: Array, mesh_size: Sequence[float], formal: float | None
) -> tuple[Array, Array]:
    """Bound of differences within one discretization, and the order by which it falls.

    Parameters
    ----------
    value : ndarray, shape (..., n)
        The difference on two or more meshes from fine to coarse; the finest three count.
    mesh_size : sequence of float
        Size of each mesh, from fine to coarse; only the ratios count.
    formal : float or None
        Order that the element promises; without one, no order above 1 is taken, and a safety
        factor of 3.

    Returns
    -------
    bound, order : ndarray, shape (...)
        Without floor and ceiling.
    """
    if value.shape[-1] == 2:
        order = ASSUMED_SHARE * min(NO_ORDER if formal is None else formal, 1.0)
        return _two_meshes(value, mesh_size, formal), np.full(value.shape[:-1], order)
    value, size = value[..., :3], mesh_size[:3]
    p = observed_orders(value, size)
    limit = NO_ORDER if formal is None else formal
    used = np.where(np.isnan(p), min(limit, 1.0), np.clip(p, min(LOWEST_ORDER, limit), limit))
    error = _larger_error(value, size, used)
    safe = (np.abs(p - limit) <= SAME_ORDER) & (formal is not None)
    spread = np.ptp(value, axis=-1)
    return np.where(safe, SAFE * error, np.maximum(CAUTIOUS * error, spread)), used


def _larger_error(value: Array, size: Sequence[float], order: Array) -> Array:
    """Error of the finest value by the change between the finer and the coarser two meshes.

    Both count: one of the changes may be small by accident, where errors cancel or where a
    higher-order term hides the order.
    """
    fine, coarse = (np.power(size[i + 1] / size[i], order) for i in (0, 1))
    e21, e32 = np.abs(value[..., 1] - value[..., 0]), np.abs(value[..., 2] - value[..., 1])
    return np.asarray(np.maximum(e21 / (fine - 1), e32 / (coarse - 1) / fine))


def _two_meshes(value: Array, mesh_size: Sequence[float], formal: float | None) -> Array:
    order = ASSUMED_SHARE * min(NO_ORDER if formal is None else formal, 1.0)
    ratio = (mesh_size[1] / mesh_size[0]) ** order
    return np.asarray(CAUTIOUS * np.abs(value[..., 1] - value[..., 0]) / (ratio - 1))


def contrast_uncertainty(
    weights: Mapping[str, float], series: Mapping[str, CellSeries]
) -> ContrastUncertainty | None:
    """Bound the numerical error of a contrast of cells that were all refined.

    Parameters
    ----------
    weights : mapping of str to float
        Weight of each cell in the contrast.
    series : mapping of str to CellSeries
        Refinement of each cell that has a weight.

    Returns
    -------
    ContrastUncertainty or None
        None where a cell was not refined, the meshes of one discretization differ in ratio, or
        a cell diverges: then nothing is known.
    """
    used = {cell: w for cell, w in weights.items() if w}
    if not used or any(cell not in series for cell in used):
        return None
    by_element: dict[str, list[str]] = {}
    for cell in used:
        by_element.setdefault(series[cell].discretization, []).append(cell)
    parts = [_within(cells, used, series) for cells in by_element.values()]
    known = [part for part in parts if part is not None]
    if len(known) < len(parts):
        return None
    moved = sum(w * (series[c].on_the_studied_mesh - series[c].value[0]) for c, w in used.items())
    return ContrastUncertainty(
        math.fsum(part.u for part in known),
        abs(moved),
        min(part.order for part in known),
        "two meshes" if any(part.method == "two meshes" for part in known) else "three meshes",
    )


def _within(
    cells: Sequence[str], weights: Mapping[str, float], series: Mapping[str, CellSeries]
) -> ContrastUncertainty | None:
    """Bound of the part of a contrast that lies in one discretization."""
    first = series[cells[0]]
    meshes = min(len(series[cell].value) for cell in cells)
    ratios = [_ratios(series[cell].mesh_size[:meshes]) for cell in cells]
    if meshes < 2 or any(not np.allclose(r, ratios[0], rtol=0.05) for r in ratios):
        return None
    w = np.array([weights[cell] for cell in cells])
    value = np.array([series[cell].value[:meshes] for cell in cells])
    size = first.mesh_size[:meshes]
    orders = [series[cell].formal_order for cell in cells]
    formal = None if None in orders else min(o for o in orders if o is not None)
    noise = np.array([series[cell].noise for cell in cells])
    ceiling = float(np.abs(w) @ response_bounds(value, size, formal, noise))
    if not math.isfinite(ceiling):
        return None
    difference = w @ value
    bound, order = difference_bounds(difference, size, formal)
    u = min(max(float(bound), FLOOR * ceiling), ceiling)
    method = "two meshes" if meshes == 2 else "three meshes"
    return ContrastUncertainty(u, 0.0, float(order), method)


def _ratios(mesh_size: Sequence[float]) -> Array:
    size = np.asarray(mesh_size)
    return np.asarray(size[1:] / size[:-1])


def limit_of(series: CellSeries) -> tuple[float, float] | None:
    """Signed error of the value on the mesh of the study, and its bound.

    Parameters
    ----------
    series : CellSeries
        Values of one cell; one mesh alone gives None, too.

    Returns
    -------
    tuple of float or None
        Distance to the extrapolated value (the finest where there is no order) and the
        half-width around it; None where the changes grow with refinement.
    """
    value, size = np.array(series.value), series.mesh_size
    if len(value) < 2:
        return None
    bound = float(response_bounds(value, size, series.formal_order, series.noise))
    if not math.isfinite(bound):
        return None
    limit, order = series.value[0], math.nan
    if len(value) > 2:
        order = float(observed_orders(value[:3], size[:3]))
    if math.isfinite(order):
        highest = NO_ORDER if series.formal_order is None else series.formal_order
        used = min(max(order, LOWEST_ORDER), highest)
        limit += (value[0] - value[1]) / ((size[1] / size[0]) ** used - 1)
    return series.on_the_studied_mesh - limit, bound + abs(series.on_the_studied_mesh - value[0])


def inherited_uncertainty(
    weights: Array, error: Array, bound: Array, order: float = NO_ORDER
) -> ContrastUncertainty:
    """Bound the error of a contrast by that of other cells of the same discretization.

    Parameters
    ----------
    weights : ndarray, shape (k,)
        Of the cells in the contrast.
    error : ndarray, shape (m,)
        Signed error of each refined cell on the mesh studied, carried to the contrast.
    bound : ndarray, shape (m,)
        Bound of each of them.
    order : float
        Order by which the bound is taken to fall with the mesh size.

    Notes
    -----
    An error that all cells share drops out of a difference; their scatter over the refined
    cells is what does not. One refined cell shows no scatter: then no cell's error is assumed
    to be more than three times its bound.
    """
    size = float(np.abs(weights).sum())
    if error.size == 1:
        return ContrastUncertainty(CAUTIOUS * size * float(bound[0]), 0.0, order, "one other cell")
    from scipy.special import stdtrit

    scatter = float(stdtrit(error.size - 1, 0.975)) * float(error.std(ddof=1))
    u = scatter * float(np.sqrt(weights @ weights)) + INHERITED_SHARE * float(bound.mean())
    rest = abs(float(weights.sum()))
    if rest > 1e-12 * size:
        u += rest * (abs(float(error.mean())) + float(bound.mean()))
    return ContrastUncertainty(u, 0.0, order, "other cells")
