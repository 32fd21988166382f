"""Single numbers of a curve whose convergence is judged: peak force, root mean square, work."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from study.arrays import Array
from study.curve import Curve
from study.errors import Fault, InputError, nearest

if TYPE_CHECKING:
    from study.runner.numerical.refinement import Level


#: points of a curve that integrals over it take, between the solved steps by their tangents
_POINTS = 400


def _samples(curve: Curve) -> tuple[Array, Array]:
    """Displacements and forces, so close that the number of load steps does not matter."""
    d = np.linspace(0.0, float(curve.displacement_mm[-1]), _POINTS + 1)
    return d, curve.force_at(d)


def peak_force(curve: Curve) -> float:
    """Force at the last step, N.

    Parameters
    ----------
    curve : Curve
        At least one step.
    """
    return float(curve.force_N[-1])


def curve_rms(curve: Curve) -> float:
    """Root mean square of the force over the displacement, N: it stands for the whole curve.

    Parameters
    ----------
    curve : Curve
        Counted from zero displacement to its last step, interpolated between its steps.
    """
    return float(np.sqrt(np.mean(_samples(curve)[1][1:] ** 2)))


def work(curve: Curve) -> float:
    """Work done on the specimen, N mm.

    Parameters
    ----------
    curve : Curve
        Counted from zero displacement to its last step, interpolated between its steps.
    """
    d, force = _samples(curve)
    return float(np.trapezoid(force, d))


#: quantities of a curve that a series can watch, with their units
QUANTITIES: Mapping[str, tuple[Callable[[Curve], float], str]] = {
    "peak_force": (peak_force, "N"),
    "curve_rms": (curve_rms, "N"),
    "work": (work, "N mm"),
}


def quantity(name: str) -> tuple[Callable[[Curve], float], str]:
    """Look up function and unit of a quantity of a single problem.

    Parameters
    ----------
    name : {"peak_force", "curve_rms", "work"}
        Key ``converge.qoi`` of the study file, which allows quantities of studies too.

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
    """Every quantity of the curves of a series, in the order of the meshes.

    Parameters
    ----------
    levels : sequence of Level
        Meshes with an answer.

    Returns
    -------
    dict of str to tuple
        By the name of the quantity its values, one for each mesh, and their unit.
    """
    return {
        name: ([function(level.curve) for level in levels], unit)
        for name, (function, unit) in QUANTITIES.items()
    }
