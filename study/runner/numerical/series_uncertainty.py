"""Half-width of a series of values on its coarsest or on its finest mesh.

Rules of the grid convergence index (Roache 1994, ASME JFE 116, 405; Celik et al. 2008), and for
series without an order thrice the range of the values (Eca and Hoekstra 2014, J. Comput. Phys.
262, 104).
"""

from __future__ import annotations

from collections.abc import Sequence

from study.analysis.convergence.grid_convergence import grid_convergence

#: Observed order where only two meshes exist: bonded corners limit it to one.
ASSUMED_ORDER = 1.0

#: An observed order below this says that the meshes are not in the asymptotic range.
MIN_ORDER = 0.5

#: Safety factor with two meshes, and on the range of a series without an order.
TWO_MESH_FACTOR = 3.0


def two_mesh_uncertainty(coarse: float, fine: float, ratio: float) -> float:
    """Half-width for the coarser of two meshes: factor 3 on first-order extrapolation.

    Parameters
    ----------
    coarse, fine : float
        Values of one quantity on the two meshes; the half-width has their unit.
    ratio : float
        Element size of the coarser mesh over that of the finer one, above 1.

    Examples
    --------
    >>> round(two_mesh_uncertainty(1.1, 1.0, 2.0), 10)
    0.6
    """
    error = abs(coarse - fine) / (1 - ratio**-ASSUMED_ORDER)
    return float(TWO_MESH_FACTOR * error)


def ratio_of(sizes: Sequence[float], asked: float) -> float:
    """Ratio that the two first meshes really have, or the one asked for where that is unknown.

    Parameters
    ----------
    sizes : sequence of float
        Element sizes in mm, from coarse to fine; fewer than two, or two that do not fall, tell no
        ratio.
    asked : float
        Ratio of each mesh to the next finer one that was asked for, above 1.
    """
    known = len(sizes) > 1 and sizes[1] > 0 and sizes[0] > sizes[1]
    return sizes[0] / sizes[1] if known else asked


def series_uncertainty(
    values: Sequence[float],
    ratio: float,
    sizes: Sequence[float] = (),
    formal: float | None = None,
) -> tuple[str, float]:
    """Behaviour of a series from coarse to fine, and half-width for its coarsest mesh.

    Where the series converges with an order of its own, the distance to the extrapolated
    value counts, with the factor of the grid convergence index; elsewhere thrice the range of
    the values (Eca and Hoekstra 2014, J. Comput. Phys. 262, 104, for series without an order).

    Parameters
    ----------
    values : sequence of float
        One quantity on at least three meshes; the half-width has its unit.
    ratio : float
        Element size of each mesh over that of the next finer one, above 1; used where ``sizes`` are
        not.
    sizes : sequence of float, optional
        Element sizes of the meshes, in mm; used where there is one for each value and all are
        positive and different.
    formal : float, optional
        Order that the elements promise; without one the observed order cannot be judged.

    Examples
    --------
    >>> behaviour, u = series_uncertainty([1.4, 1.2, 1.1], 2.0, formal=1.0)
    >>> behaviour, round(u, 6)
    ('monotone', 0.5)
    >>> behaviour, u = series_uncertainty([1.4, 1.2, 1.1], 2.0)  # without a formal order: thrice
    >>> round(u, 6)
    1.2
    """
    usable = len(set(sizes)) == len(values) and all(size > 0 for size in sizes)
    nominal = [ratio**-k for k in range(len(values))]
    found = grid_convergence(sizes if usable else nominal, values, formal_order=formal)
    ordered = found.observed_order is not None and found.observed_order >= MIN_ORDER
    if ordered and (bound := found.bound_of(values[0])) is not None:
        return found.behaviour, bound
    if found.behaviour == "noise-floor":
        return found.behaviour, abs(values[0] - values[-1])
    return found.behaviour, TWO_MESH_FACTOR * (max(values) - min(values))


def fine_uncertainty(
    values: Sequence[float], sizes: Sequence[float], formal: float | None = None
) -> tuple[str, float]:
    """Behaviour of a series from coarse to fine, and half-width for its finest mesh.

    Without an order it is thrice the range of the values (Eca and Hoekstra 2014, J. Comput.
    Phys. 262, 104).

    Parameters
    ----------
    values : sequence of float
        One quantity on at least three meshes; the half-width has its unit.
    sizes : sequence of float
        Element sizes of the meshes, in mm, all different.
    formal : float, optional
        Order that the elements promise; without one the observed order cannot be judged.

    Examples
    --------
    >>> behaviour, u = fine_uncertainty([1.4, 1.2, 1.1], [4.0, 2.0, 1.0], formal=1.0)
    >>> behaviour, round(u, 6)
    ('monotone', 0.125)
    """
    found = grid_convergence(sizes, values, formal_order=formal)
    if found.u_num:
        return found.behaviour, float(found.u_num)
    spread = max(values) - min(values)
    return found.behaviour, spread if found.behaviour == "noise-floor" else TWO_MESH_FACTOR * spread
