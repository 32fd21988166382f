"""What a refinement series says of every quantity: the document of ``study converge``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from study.curve import Curve
from study.errors import Fault, InputError, nearest

if TYPE_CHECKING:
    from study.analysis import ConvergenceResult
    from study.runner.refine_formal import FormalOrder
    from study.runner.refine_series import Level, Outlook, Series

Array = NDArray[np.float64]
Values = Mapping[str, tuple[Sequence[float], str]]

#: points of a curve that integrals over it take, between the solved steps by their tangents
_POINTS = 400


def _samples(curve: Curve) -> tuple[Array, Array]:
    """Displacements and forces, so close that the number of load steps does not matter."""
    d = np.linspace(0.0, float(curve.displacement_mm[-1]), _POINTS + 1)
    return d, curve.force_at(d)


def peak_force(curve: Curve) -> float:
    """Force at the last step, N."""
    return float(curve.force_N[-1])


def curve_rms(curve: Curve) -> float:
    """Root mean square of the force over the displacement, N: it stands for the whole curve."""
    return float(np.sqrt(np.mean(_samples(curve)[1][1:] ** 2)))


def work(curve: Curve) -> float:
    """Work done on the specimen, N mm."""
    d, force = _samples(curve)
    return float(np.trapezoid(force, d))


#: quantities of a curve that a series can watch, with their units
QUANTITIES: Mapping[str, tuple[Callable[[Curve], float], str]] = {
    "peak_force": (peak_force, "N"),
    "curve_rms": (curve_rms, "N"),
    "work": (work, "N mm"),
}
#: relative error of a force at the solver's tolerance
SOLVER_TOLERANCE = 1e-7
#: the algebraic error should be this much smaller than that of the mesh
ALGEBRAIC = 100.0
#: a value of this part of the largest of its kind is nothing to be settled
_NOTHING = 1e-9


def quantity(name: str) -> tuple[Callable[[Curve], float], str]:
    """Look up function and unit of a quantity of a single problem.

    Raises
    ------
    InputError
        If the quantity needs measured curves.
    """
    if name not in QUANTITIES:
        rule = f"{name!r} needs measured curves"
        raise InputError(Fault("converge.qoi", rule, nearest(name, QUANTITIES)))
    return QUANTITIES[name]


def curve_values(levels: Sequence[Level]) -> dict[str, tuple[list[float], str]]:
    """Every quantity of the curves of a series, in the order of the meshes."""
    return {
        name: ([function(level.curve) for level in levels], unit)
        for name, (function, unit) in QUANTITIES.items()
    }


def usable(levels: Sequence[Level]) -> tuple[list[Level], list[str]]:
    """Meshes with an answer and with elements of their own, and what is wrong with the others."""
    kept: list[Level] = []
    said = [
        f"the mesh of {level.mesh_size_mm:.4g} mm gave no answer: {level.message}"
        for level in levels
        if not level.converged
    ]
    for level in levels:
        if not level.converged:
            continue
        same = [k for k in kept if k.elements == level.elements and level.elements > 0]
        if same:
            said.append(
                f"the meshes of {same[0].mesh_size_mm:.4g} mm and {level.mesh_size_mm:.4g} mm "
                f"have the same {level.elements} elements: the coarser is left out; a larger "
                "ratio or a smaller mesh_size would refine"
            )
            kept.remove(same[0])
        kept.append(level)
    return kept, said


def representative_sizes(levels: Sequence[Level], config: Mapping[str, Any]) -> list[float]:
    """Sizes of solved meshes, scaled to the finest mesh's own size."""
    sizes = [level.mesh_size_mm for level in levels]
    return series_sizes(sizes, [level.elements for level in levels], config)


def series_sizes(
    sizes: Sequence[float],
    elements: Sequence[int],
    config: Mapping[str, Any],
    *,
    anchor: int = -1,
) -> list[float]:
    """Sizes by which a series is judged: by its elements, or those at a sharp edge."""
    from study.runner.refine_formal import edge_rules

    if edge_rules(config):
        return list(sizes)
    space = str(config["model"].get("space", "axisymmetric"))
    return by_elements(sizes, elements, space, anchor=anchor)


def by_elements(
    sizes: Sequence[float], elements: Sequence[int], space: str, *, anchor: int = -1
) -> list[float]:
    """Sizes h = (V / N)^(1/d) of meshes with N elements, scaled to the size of one of them.

    What counts is the ratio, and the elements a mesh really has decide it (Celik et al. 2008):
    whole numbers of cells never give exactly the ratio that was asked for.

    Examples
    --------
    >>> by_elements([2.0, 1.0], [100, 441], "axisymmetric")
    [2.1, 1.0]
    """
    if min(elements) <= 0 or len(set(elements)) < len(elements):
        return list(sizes)
    power = 1 / (3 if space == "3d" else 2)
    return [sizes[anchor] * (elements[anchor] / n) ** power for n in elements]


def judged(
    sizes: Sequence[float],
    values: Values,
    formal: float | None,
    tolerance: float = SOLVER_TOLERANCE,
) -> dict[str, ConvergenceResult]:
    """Judge every quantity of a series of at least three meshes.

    Parameters
    ----------
    tolerance : float
        Algebraic error as a fraction of the value.
    """
    from study.analysis import grid_convergence

    return {
        name: grid_convergence(
            sizes, numbers, formal_order=formal, qoi=name, unit=unit,
            tolerance=tolerance * max(abs(v) for v in numbers),
        )
        for name, (numbers, unit) in values.items()
    }  # fmt: skip


def within(results: Mapping[str, ConvergenceResult], accuracy: float) -> dict[str, bool]:
    """Whether the uncertainty of each quantity is at most a fraction of its value.

    A series without an order has no GCI; it settles where thrice the range of its finest three
    meshes is small enough (Eca and Hoekstra 2014 for series that are noise).
    """
    return {name: _bound(r) <= accuracy * abs(r.value[0]) + _NOTHING for name, r in results.items()}


def _bound(result: ConvergenceResult) -> float:
    if result.u_num is not None:
        return result.u_num
    finest = result.value[:3]
    return 3 * (max(finest) - min(finest))


def outlook(series: Series, formal: float | None) -> Outlook:
    """Whether every quantity has the accuracy that its problem asks for, else the size it takes."""
    from study.runner.refine_series import Outlook

    kept, _ = usable(series.levels)
    if len(kept) < 3 or series.spec.tolerance is None:
        return Outlook(False)
    sizes = representative_sizes(kept, series.config)
    results = judged(sizes, curve_values(kept), formal)
    wanted = series.spec.tolerance
    sizes_needed = [size_needed(r, wanted) for r in results.values()]
    known = [size for size in sizes_needed if size is not None]
    return Outlook(all(within(results, wanted).values()), min(known, default=None))


def document(series: Series, formal: FormalOrder, tolerance: float | None = None) -> dict[str, Any]:
    """Everything that a series says, with the keys of the main quantity on top.

    Parameters
    ----------
    tolerance : float, optional
        Algebraic error of the main quantity, in its unit.
    """
    quantity(series.spec.qoi)
    kept, said = usable(series.levels)
    fraction = SOLVER_TOLERANCE
    if tolerance and kept:
        main = curve_values(kept[-1:])[series.spec.qoi][0][0]
        fraction = tolerance / abs(main) if main else fraction
    facts = {
        "formal_reason": formal.why,
        "levels": dict(series.levels_of),
        "meshes": [level.to_json() for level in reversed(series.levels)],
        "stopped": series.stopped,
    }
    if len(kept) < 3:
        return too_few(series.spec.qoi, kept, formal.order, said) | facts
    sizes = representative_sizes(kept, series.config)
    results = judged(sizes, curve_values(kept), formal.order, fraction)
    made = combined(series.spec.qoi, results, series.spec.tolerance, said) | facts
    made["given_mesh"]["mesh_size"] = kept[0].mesh_size_mm
    return made


def combined(
    qoi: str,
    results: Mapping[str, ConvergenceResult],
    accuracy: float | None,
    said: Sequence[str] = (),
) -> dict[str, Any]:
    """Document of several judged quantities; all of them must settle."""
    main = results[qoi]
    open_ = [name for name, ok in within(results, accuracy or 1.0).items() if not ok]
    if accuracy is None:  # nothing small is asked for, but an uncertainty there must be
        open_ = [name for name, r in results.items() if r.u_num is None]
    warnings = [*said, *main.warnings]
    if accuracy is not None and open_:
        warnings.append(f"not within {100 * accuracy:g} %: {', '.join(open_)}")
    return replace(main, warnings=tuple(dict.fromkeys(warnings))).to_json() | {
        "quantities": {name: result.to_json() for name, result in results.items()},
        "accuracy": accuracy,
        "settled": not open_,
        "given_mesh": _given(main),
        "mesh_size_needed": None if accuracy is None else size_needed(main, accuracy),
    }


def _given(result: ConvergenceResult) -> dict[str, Any]:
    """Value and uncertainty on the problem's own mesh, the coarsest of its series."""
    value, u = result.value[-1], None
    if result.extrapolated is not None and result.factor_of_safety is not None:
        u = result.factor_of_safety * abs(value - result.extrapolated)
    elif result.u_num is not None:
        u = max(result.u_num, abs(value - result.value[0]))
    return {"mesh_size": result.mesh_size[-1], "value": value, "u_num": u}


def size_needed(result: ConvergenceResult, accuracy: float) -> float | None:
    """Mesh size whose uncertainty would be the wanted fraction of the value, by the order used."""
    if result.order_used is None or not result.u_num or result.extrapolated in (None, 0.0):
        return None
    allowed = accuracy * abs(result.extrapolated)
    return float(result.mesh_size[0] * (allowed / result.u_num) ** (1 / result.order_used))


def too_few(
    qoi: str, kept: Sequence[Level], formal: float | None, said: Sequence[str]
) -> dict[str, Any]:
    """Document of a series that has no three meshes."""
    function, unit = QUANTITIES[qoi]
    nothing = dict.fromkeys(
        ("observed_order", "extrapolated", "gci_fine", "factor_of_safety", "u_num",
         "asymptotic_ratio", "order_used", "gci_coarse", "order_interval", "accuracy",
         "mesh_size_needed", "given_mesh")
    )  # fmt: skip
    return {
        **nothing,
        "qoi": qoi,
        "unit": unit,
        "mesh_size": [level.mesh_size_mm for level in reversed(kept)],
        "value": [function(level.curve) for level in reversed(kept)],
        "behaviour": "inconclusive",
        "formal_order": formal,
        "verdict": f"an order needs three meshes with an answer, there are {len(kept)}",
        "warnings": list(said),
        "quantities": {},
        "settled": False,
    }
